// The figures: what each says, and whether it is as it should be. docs/dashboard.md has them one by one. Pure.

import { bytes, count, micros, percent, short, span } from "./format.js";

const NO_TAKE = { note: "no take" };
const NONE = { value: "–", unit: "", note: "", level: "none", word: "" };

/** Tiles in their order: {id, title, isMain, value, unit, note, level: none | ok | watch | bad, word, fill}. */
export function figures(status) {
  const runs = status.state === "armed" || status.state === "recording";
  const tile = (id, title, isMain, found) => ({ id, title, isMain, ...NONE, ...found });
  return [
    tile("rate", "Frame rate", true, runs && rate(status)),
    tile("lost", "Frames lost", true, runs && lost(status)),
    tile("disk", "Disk", true, disk(status.disk)),
    tile("ring", "Fullest ring", true, runs && ring(status)),
    tile("size", "Take", false, size(status.take)),
    tile("error", "Largest error", false, error(status.take)),
    tile("ledger", "Ledger", false, ledger(status)),
    tile("seen", "Samples seen", false, samples(status.take)),
    tile("pre-roll", "Pre-roll", false, runs && preRoll(status)),
    tile("delay", "Ring delay, p99", false, runs && delay(status, status.input.ring_latency_p99_us)),
    tile("jitter", "Jitter, p99", false, runs && jitter(status)),
    tile("outages", "Outages", false, runs && outages(status.device)),
    tile("cpu", "Processor", false, { ...value(short(status.input.cpu_cores), "cores"), note: "of the service" }),
  ];
}

const value = (text, unit = "") => ({ value: text, unit });
const ok = (word) => ({ level: "ok", word });
const watch = (word) => ({ level: "watch", word });
const bad = (word) => ({ level: "bad", word });

function rate({ input, device }) {
  const nominal = device.rate_hz;
  const note = nominal > 0 ? `of ${Number(nominal.toFixed(2))} Hz` : "nominal unknown";
  const hz = input.measured_hz;
  const found = { ...value(hz.toFixed(hz < 100 ? 2 : 1), "Hz"), note };
  if (device.presence !== "streaming") return { ...found, ...bad(device.presence) };
  if (nominal <= 0 || input.frames < 3 * nominal) return found;
  const off = hz / nominal - 1;
  if (Math.abs(off) < 0.005) return { ...found, ...ok("on rate") };
  const word = `${percent(Math.abs(off))} % ${off < 0 ? "slow" : "fast"}`;
  return { ...found, ...(Math.abs(off) < 0.02 ? watch(word) : bad(word)) };
}

/** Where a take is being written its ledger knows the causes. */
export function causes(ledger) {
  const names = { lost_on_link: "on the link", dropped_by_device: "by the device", lost_ring_full: "ring full",
    lost_other: "otherwise", unknown_after_disconnect: "while it was away or silent" };
  return Object.entries(names).filter(([key]) => ledger[key] > 0).map(([key, name]) => `${count(ledger[key])} ${name}`);
}

/** Frames lost, with those that were due since the device sent the last one: the ledger has them when it is back. */
export function lostSoFar({ input, device }) {
  return input.lost + (device.outage?.frames ?? 0);
}

function lost(status) {
  const { input, take, device } = status;
  const n = lostSoFar(status);
  const all = input.frames + n;
  const why = take ? causes(take.ledger) : [];
  if (device.outage) why.push(`${count(device.outage.frames)} in this outage`);
  const inTake = why.length > 0 ? `in the take: ${why.join(", ")}` : take ? "none in the take" : "since armed";
  const found = { ...value(count(n)), note: `of ${count(all)}; ${inTake}` };
  if (device.outage) return { ...found, ...bad("no data") };
  if (n === 0) return { ...found, ...ok("none") };
  const share = n / all;
  const word = `${percent(share)} %`;
  return { ...found, ...(share < 0.001 ? watch(word) : bad(word)) };
}

function disk({ free_bytes: free, keep_free_bytes: keep, left_s: left }) {
  if (free === null) return { note: "nobody can tell what is free" };
  const note = `${bytes(free).join(" ")} free`;
  if (free <= keep) return { ...value("0", "s"), note, ...bad("full") };
  if (left === null) return { ...value(...bytes(free - keep)), note: "free for takes" };
  const found = { ...value(...span(left)), note };
  if (left < 600) return { ...found, ...bad("nearly full") };
  return { ...found, ...(left < 3600 ? watch("make room") : ok("enough")) };
}

function ring({ input: { ring_fill: fill }, device }) {
  if (device.outage) return { note: "nothing comes" };
  const found = { ...value(percent(fill), "%"), note: "full loses frames", fill };
  if (fill >= 0.8) return { ...found, ...bad("nearly full") };
  return { ...found, ...(fill >= 0.5 ? watch("filling") : ok("room")) };
}

function size(take) {
  if (!take) return NO_TAKE;
  const behind = bytes(Math.max(0, take.bytes - take.durable_bytes)).join(" ");
  const word = take.ratio > 0 ? `${short(take.ratio)}× smaller` : "";
  return { ...value(...bytes(take.bytes)), note: `${behind} to sync`, word };
}

function error(take) {
  if (!take) return NO_TAKE;
  return { ...value(take.max_error_mm.toFixed(3), "mm"), note: "of a sample, so far" };
}

function ledger({ take, device }) {
  if (!take) return NO_TAKE;
  const { contradictions, closes, recorded, frames_sent: sent } = take.ledger;
  const note = `${count(recorded)} of ${count(sent)}`;
  // It closes over the frames that came; those that are due now are not on it yet.
  if (device.outage) return { ...value("waits"), note: `${note}, and ${count(device.outage.frames)} missing`, ...bad("no data") };
  if (contradictions.length > 0) return { ...value("contradicts"), note: contradictions[0], ...bad("look") };
  return closes ? { ...value("closes"), note, ...ok("") } : { ...value("open"), note, ...watch("does not close") };
}

function samples(take) {
  if (!take || take.ledger.samples_announced === 0) return NO_TAKE;
  const { samples_present: present, samples_announced: announced, samples_occluded: occluded } = take.ledger;
  return { ...value(percent(present / announced), "%"), note: `${count(occluded)} occluded` };
}

function preRoll({ device, pre_roll: { wanted_s: wanted, held_s: held, held_bytes: size, is_cut: isCut } }) {
  if (wanted === 0) return { note: "none is wanted" };
  const found = { ...value(held.toFixed(1), "s"), note: `of ${short(wanted)} s; ${bytes(size).join(" ")}` };
  if (device.outage) return { ...found, ...watch("no data") };
  if (isCut) return { ...found, ...watch("cut: memory") };
  return held >= 0.98 * wanted ? { ...found, ...ok("full") } : found;
}

/** What takes longer than a frame is worth a look. */
function delay({ device }, us) {
  if (device.outage) return { note: "nothing comes" };
  const found = { ...value(...micros(us)), note: "from the last byte" };
  return device.rate_hz > 0 && us > 1e6 / device.rate_hz ? { ...found, ...watch("late") } : found;
}

function jitter({ device, input }) {
  if (input.jitter_p99_us === 0) return { note: "not known yet" };
  const found = delay({ device }, input.jitter_p99_us);
  if (device.outage) return found;
  return { ...found, note: `drift ${input.drift_ppm.toFixed(1)} ppm` };
}

function outages({ outages: n, outage, presence }) {
  if (outage) return { ...value(count(n + 1)), note: "since armed", ...bad(presence === "silent" ? "silent now" : "away now") };
  return { ...value(count(n)), note: "since armed", ...(n === 0 ? ok("none") : watch("went away")) };
}
