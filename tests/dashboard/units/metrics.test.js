import { causes, metrics } from "/metrics.js";
import { clientText, publishText, publishedLines } from "/published.js";
import { RateHistory } from "/history.js";
import { COLUMNS, level, sorted } from "/markers.js";
import { equal, isTrue, near, test } from "./harness.js";

const LEDGER = { finished: false, closes: true, frames_sent: 1000, recorded: 1000, lost_on_link: 0, dropped_by_device: 0,
  lost_ring_full: 0, lost_other: 0, duplicates: 0, unknown_after_disconnect: 0, samples_announced: 15_000,
  samples_present: 14_000, samples_occluded: 1000, samples_not_finite: 0, markers_dropped: 0, contradictions: [] };
const TAKE = { take_id: "", name: "a", path: "", started_unix_ms: 0, rows: 1000, seconds: 8, bytes: 10_000,
  durable_bytes: 9000, ratio: 20, max_error_mm: 0.4321, ledger: LEDGER };
const STATUS = {
  state: "armed",
  device: { presence: "streaming", rate_hz: 120, outages: 0 },
  input: { frames: 12_000, lost: 0, measured_hz: 120.01, ring_fill: 0.02, ring_latency_p99_us: 40, jitter_p99_us: 300,
    drift_ppm: 12, cpu_cores: 0.1 },
  pre_roll: { wanted_s: 10, held_s: 10, held_bytes: 1000, is_cut: false },
  take: null,
  disk: { directory: "/", free_bytes: 5e11, keep_free_bytes: 268_435_456, left_s: 86_400 },
};

const metric = (id, change = {}) => {
  const status = structuredClone(STATUS);
  for (const [key, value] of Object.entries(change)) {
    status[key] = value !== null && typeof value === "object" && status[key] ? { ...status[key], ...value } : value;
  }
  return metrics(status).find((found) => found.id === id);
};
const parts = (found) => [found.value, found.unit, found.level, found.word];

test("the frame rate is compared with the nominal rate", () => {
  equal(parts(metric("rate")), ["120.0", "Hz", "ok", "nominal"]);
  equal(parts(metric("rate", { input: { measured_hz: 118.4 } })), ["118.4", "Hz", "watch", "1.3 % slow"]);
  equal(parts(metric("rate", { input: { measured_hz: 90 } })), ["90.00", "Hz", "bad", "25.0 % slow"]);
  equal(metric("rate", { input: { measured_hz: 60, frames: 100 } }).level, "none", "no level in the first seconds");
  equal(parts(metric("rate", { device: { presence: "silent" }, input: { measured_hz: 0 } })), ["0.00", "Hz", "bad", "silent"]);
});

test("idle and failed show no metrics of frames", () => {
  for (const state of ["idle", "failed"]) {
    for (const id of ["rate", "lost", "ring", "delay", "jitter", "outages", "pre-roll"]) {
      equal(parts(metric(id, { state })), ["–", "", "none", ""], `${state}, ${id}:`);
    }
  }
});

test("lost frames have a percentage and causes", () => {
  equal(parts(metric("lost")), ["0", "", "ok", "none"]);
  equal(metric("lost", { input: { lost: 2 } }).level, "watch");
  const ledger = { ...LEDGER, lost_on_link: 5, lost_ring_full: 2 };
  const found = metric("lost", { input: { lost: 120 }, take: { ...TAKE, ledger } });
  equal([found.level, found.word], ["bad", "1.0 %"]);
  isTrue(found.note.endsWith("in the take: 5 on the link, 2 to a full ring"), found.note);
  equal(causes(LEDGER), []);
});

test("the disk shows the time left, and its levels", () => {
  equal(parts(metric("disk")), ["24", "h", "ok", "enough"]);
  equal(metric("disk", { disk: { left_s: 3000 } }).word, "running low");
  equal(metric("disk", { disk: { left_s: 60 } }).level, "bad");
  equal(parts(metric("disk", { disk: { free_bytes: 268_435_456 } })), ["0", "s", "bad", "full"]);
  equal(parts(metric("disk", { disk: { left_s: null } })).slice(0, 2), ["500", "GB"]);
  equal(metric("disk", { disk: { free_bytes: null } }).note, "free space unknown");
});

test("a filling ring, a late frame, an outage and a limited pre-roll have levels", () => {
  equal([0.1, 0.6, 0.9].map((fill) => metric("ring", { input: { ring_fill: fill } }).level), ["ok", "watch", "bad"]);
  equal(metric("delay", { input: { ring_latency_p99_us: 9000 } }).word, "late");
  equal(parts(metric("jitter", { input: { jitter_p99_us: 0 } })), ["–", "", "none", ""]);
  equal(metric("outages", { device: { outages: 1 } }).level, "watch");
  equal(metric("pre-roll", { pre_roll: { is_cut: true, held_s: 4 } }).word, "limited by memory");
});

test("the metrics of a take are empty without a take", () => {
  equal(["size", "error", "ledger", "seen"].map((id) => metric(id, { take: TAKE }).value), ["10.0", "0.432", "closes", "93.3"]);
  equal(["size", "error", "ledger", "seen"].map((id) => metric(id).note), Array(4).fill("no take"));
  const wrong = { ...LEDGER, contradictions: ["more recorded than sent"] };
  equal(metric("ledger", { take: { ...TAKE, ledger: wrong } }).level, "bad");
  equal(metric("ledger", { take: { ...TAKE, ledger: { ...LEDGER, closes: false } } }).level, "watch");
});

test("without a device no metric of frames is ok, and missing frames count as lost", () => {
  const outage = { seconds: 10, frames: 1200, ends_in_s: 50 };
  const change = { device: { presence: "absent", outage }, take: TAKE, state: "recording", input: { measured_hz: 0 } };
  const found = (id) => metric(id, change);
  equal([found("ledger").value, found("ledger").level], ["waiting", "bad"]);
  equal(parts(found("lost")).slice(2), ["bad", "no data"]);
  equal(found("lost").value.replace("\u202f", " "), "1 200");
  equal(["rate", "outages"].map((id) => found(id).level), ["bad", "bad"]);
  for (const id of ["ring", "delay", "jitter"]) equal(parts(found(id)), ["–", "", "none", ""], id);
  equal(found("pre-roll").level, "watch");
});

test("the history counts frames lost since the previous status", () => {
  const past = new RateHistory();
  const at = (t, lost, state = "armed") => past.add(t, { ...STATUS, state, input: { ...STATUS.input, measured_hz: 119, lost } });
  at(0, 500);
  at(0.5, 503);
  at(1, 503);
  past.add(1.5, null);
  at(2, 504);
  at(2.5, 0);
  equal(past.samples.map(({ lost }) => lost), [0, 3, 0, 0, 1, 0]);
  equal(past.samples.map(({ hz }) => hz), [119, 119, 119, null, 119, 119]);
  equal(past.lostBySecond(2.5).slice(0, 3), [1, 0, 3]);
  past.add(3, { ...STATUS, input: { ...STATUS.input, frames: 100 } });
  equal(past.samples.at(-1).hz, null, "in the first seconds there is no rate yet");
  at(200, 0);
  equal(past.samples.length, 1, "two minutes are stored");
});

test("the rate axis includes the nominal and the measured rates", () => {
  const past = new RateHistory();
  past.add(0, { ...STATUS, input: { ...STATUS.input, measured_hz: 60 } });
  const [low, high] = past.range();
  isTrue(low < 60 && high > 120, `${low} to ${high}`);
  near(new RateHistory().range()[0], 0);
});

const ROWS = [
  { label: "m10", visible: 0.99, gaps: 3, longest_gap_s: 0.1, noise_mm: null, swaps_suspected: 0 },
  { label: "m9", visible: 0.4, gaps: 1, longest_gap_s: 5, noise_mm: 0.2, swaps_suspected: 0 },
  { label: "a", visible: 0.99, gaps: 9, longest_gap_s: 0.3, noise_mm: 0.1, swaps_suspected: 2 },
];
const order = (key, isReversed) => sorted(ROWS, key, isReversed).map(({ label }) => label);

test("markers are sorted worst first by every column, and in reverse", () => {
  equal(order("visible"), ["m9", "a", "m10"], "equal rows by the longer gap");
  equal(order("gaps"), ["a", "m10", "m9"]);
  equal(order("longest_gap_s", true), ["m10", "a", "m9"]);
  equal(order("label"), ["a", "m9", "m10"]);
  equal([order("noise_mm"), order("noise_mm", true)], [["m9", "a", "m10"], ["a", "m9", "m10"]], "unknown is last");
  equal(COLUMNS.map(({ key }) => order(key).length), [3, 3, 3, 3, 3, 3]);
  equal(ROWS.map(level), ["ok", "bad", "watch"]);
});

test("a client that missed frames says so", () => {
  const client = { address: "10.0.0.7:5151", version: "1.25", transport: "udp", is_streaming: true, is_in_control: false,
    frames_sent: 12_000, frames_missed: 0 };
  equal(clientText(client), "10.0.0.7:5151 by UDP · version 1.25 · 12\u202f000 frames sent");
  isTrue(clientText({ ...client, frames_missed: 1 }).includes("1 frame missed"));
  isTrue(clientText({ ...client, batches_missed: 2 }).endsWith("frames sent · 2 batches of samples missed"));
  isTrue(clientText({ ...client, is_streaming: false, is_in_control: true }).endsWith("requests no frames · in control"));
  const publish = { protocol: "qtm", listen: "127.0.0.1:22223", clients: [client], clients_max: 10, frames_missed: 3 };
  equal(publishText(publish), "QTM at 127.0.0.1:22223: 1 of 10, 3 frames missed in all");
  equal(publishText({ ...publish, protocol: "foxglove", frames_missed: 0, batches_missed: 1 }),
    "FOXGLOVE at 127.0.0.1:22223: 1 of 10, 1 batch of samples missed in all");
  const samples = { ...publish, protocol: "lsl", clients: [], frames_missed: 0, poses_left_out: 1, batches_left_out: 2 };
  equal(publishText(samples), "LSL at 127.0.0.1:22223: 0 of 10, poses of 1 frame left out, 2 batches of samples left out");
  equal(publishedLines([publish, samples]), [publishText(publish), clientText(client), publishText(samples)]);
});
