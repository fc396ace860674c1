// The metrics: the value and level of each. docs/dashboard.md lists their fields and thresholds. Pure.

import { bytes, count, duration, microseconds, percent, rounded } from "./format.js";

const NO_TAKE = { note: "no take" };
const NONE = { value: "–", unit: "", note: "", level: "none", word: "" };

/** Tiles in order: {id, title, isMain, value, unit, note, level: none | ok | watch | bad, word, fill}. */
export function metrics(status) {
  const isRunning = status.state === "armed" || status.state === "recording";
  const tile = (id, title, isMain, metric) => ({ id, title, isMain, ...NONE, ...metric });
  return [
    tile("rate", "Frame rate", true, isRunning && rate(status)),
    tile("lost", "Frames lost", true, isRunning && lost(status)),
    tile("disk", "Disk", true, disk(status.disk)),
    tile("ring", "Fullest ring", true, isRunning && ring(status)),
    tile("size", "Take size", false, size(status.take)),
    tile("error", "Largest error", false, error(status.take)),
    tile("ledger", "Ledger", false, ledger(status)),
    tile("seen", "Samples present", false, samples(status.take)),
    tile("pre-roll", "Pre-roll", false, isRunning && preRoll(status)),
    tile("delay", "Ring delay, p99", false, isRunning && delay(status, status.input.ring_latency_p99_us)),
    tile("jitter", "Jitter, p99", false, isRunning && jitter(status)),
    tile("outages", "Outages", false, isRunning && outages(status.device)),
    tile("cpu", "Processor", false, { ...value(rounded(status.input.cpu_cores), "cores"), note: "of the service" }),
  ];
}

const value = (text, unit = "") => ({ value: text, unit });
const ok = (word) => ({ level: "ok", word });
const watch = (word) => ({ level: "watch", word });
const bad = (word) => ({ level: "bad", word });

function rate({ input, device }) {
  const nominal = device.rate_hz;
  const note = nominal > 0 ? `of ${Number(nominal.toFixed(2))} Hz` : "nominal rate unknown";
  const hz = input.measured_hz;
  const metric = { ...value(hz.toFixed(hz < 100 ? 2 : 1), "Hz"), note };
  if (device.presence !== "streaming") return { ...metric, ...bad(device.presence) };
  if (nominal <= 0 || input.frames < 3 * nominal) return metric;
  const off = hz / nominal - 1;
  if (Math.abs(off) < 0.005) return { ...metric, ...ok("nominal") };
  const word = `${percent(Math.abs(off))} % ${off < 0 ? "slow" : "fast"}`;
  return { ...metric, ...(Math.abs(off) < 0.02 ? watch(word) : bad(word)) };
}

/** The causes of lost frames from the ledger of a take, as texts. */
export function causes(ledger) {
  const names = { lost_on_link: "on the link", dropped_by_device: "by the device", lost_ring_full: "to a full ring",
    lost_other: "to other causes", unknown_after_disconnect: "while absent or silent" };
  return Object.entries(names).filter(([key]) => ledger[key] > 0).map(([key, name]) => `${count(ledger[key])} ${name}`);
}

/** Frames lost, including those due since an outage began: the ledger counts these only after the outage. */
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
  const metric = { ...value(count(n)), note: `of ${count(all)}; ${inTake}` };
  if (device.outage) return { ...metric, ...bad("no data") };
  if (n === 0) return { ...metric, ...ok("none") };
  const share = n / all;
  const word = `${percent(share)} %`;
  return { ...metric, ...(share < 0.001 ? watch(word) : bad(word)) };
}

/** The time left is an estimate from the last half minute, or from the pre-roll: of more days it says nothing. */
const DISK_S_MAX = 30 * 86_400;

function disk({ free_bytes: free, keep_free_bytes: keep, left_s: left }) {
  if (free === null) return { note: "free space unknown" };
  const note = `${bytes(free).join(" ")} free`;
  if (free <= keep) return { ...value("0", "s"), note, ...bad("full") };
  if (left === null) return { ...value(...bytes(free - keep)), note: "free for takes" };
  const metric = { ...(left > DISK_S_MAX ? value("> 30", "days") : value(...duration(left))), note };
  if (left < 600) return { ...metric, ...bad("nearly full") };
  return { ...metric, ...(left < 3600 ? watch("running low") : ok("enough")) };
}

function ring({ input: { ring_fill: fill }, device }) {
  if (device.outage) return { note: "no data" };
  const metric = { ...value(percent(fill), "%"), note: "frames are lost at 100\u00a0%", fill };
  if (fill >= 0.8) return { ...metric, ...bad("nearly full") };
  return { ...metric, ...(fill >= 0.5 ? watch("filling") : ok("ok")) };
}

function size(take) {
  if (!take) return NO_TAKE;
  const behind = bytes(Math.max(0, take.bytes - take.durable_bytes)).join(" ");
  const word = take.ratio > 0 ? `${rounded(take.ratio)}:1` : "";
  return { ...value(...bytes(take.bytes)), note: `${behind} not synced yet`, word };
}

function error(take) {
  if (!take) return NO_TAKE;
  return { ...value(take.max_error_mm.toFixed(3), "mm"), note: "of any sample so far" };
}

function ledger({ take, device }) {
  if (!take) return NO_TAKE;
  const { contradictions, closes, recorded, frames_sent: sent } = take.ledger;
  const note = `${count(recorded)} of ${count(sent)}`;
  // The ledger closes over the frames received; frames due during an outage are counted after it.
  if (device.outage) return { ...value("waiting"), note: `${note}, and ${count(device.outage.frames)} missing`, ...bad("no data") };
  if (contradictions.length > 0) return { ...value("contradictory"), note: contradictions[0], ...bad("check") };
  return closes ? { ...value("closes"), note, ...ok("") } : { ...value("open"), note, ...watch("does not close") };
}

function samples(take) {
  if (!take || take.ledger.samples_announced === 0) return NO_TAKE;
  const { samples_present: present, samples_announced: announced, samples_occluded: occluded } = take.ledger;
  return { ...value(percent(present / announced), "%"), note: `${count(occluded)} occluded` };
}

function preRoll({ device, pre_roll: { wanted_s: wanted, held_s: held, held_bytes: size, is_cut: isCut } }) {
  if (wanted === 0) return { note: "no pre-roll configured" };
  // It is kept by whole key stretches, and so is mostly a little longer than configured.
  const metric = { ...value(Math.min(held, wanted).toFixed(1), "s"), note: `of ${rounded(wanted)} s; ${bytes(size).join(" ")}` };
  if (device.outage) return { ...metric, ...watch("no data") };
  if (isCut) return { ...metric, ...watch("limited by memory") };
  return held >= 0.98 * wanted ? { ...metric, ...ok("full") } : metric;
}

/** A delay of more than one frame period is marked. */
function delay({ device }, us) {
  if (device.outage) return { note: "no data" };
  const metric = { ...value(...microseconds(us)), note: "after its last byte" };
  return device.rate_hz > 0 && us > 1e6 / device.rate_hz ? { ...metric, ...watch("late") } : metric;
}

function jitter({ device, input }) {
  if (input.jitter_p99_us === 0) return { note: "unknown so far" };
  const metric = delay({ device }, input.jitter_p99_us);
  if (device.outage) return metric;
  return { ...metric, note: `drift ${input.drift_ppm.toFixed(1)} ppm` };
}

function outages({ outages: n, outage, presence }) {
  if (outage) return { ...value(count(n + 1)), note: "since armed", ...bad(presence === "silent" ? "silent now" : "absent now") };
  return { ...value(count(n)), note: "since armed", ...(n === 0 ? ok("none") : watch("interrupted")) };
}
