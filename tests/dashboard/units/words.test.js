import { answerWords } from "/actions.js";
import { describe, deviceLine, obstacle } from "/state.js";
import { facts, health, verdict } from "/takes.js";
import { equal, isTrue, test } from "./harness.js";

const DEVICE = { uri: "serial:/dev/ttyUSB0", presence: "streaming", model: "DVMC-8820", serial: "7", firmware: "1.4",
  driver: "dvmc", rate_hz: 59.94, markers: 15, obstacle: null, outages: 0 };
const STATUS = { state: "armed", failure: null, device: DEVICE, take: null, last_take: null, pre_roll: { wanted_s: 10, held_s: 2.5 } };
const LEDGER = { recorded: 98, closes: true };

test("an answer to start says that the first frame is on disk, and what came before", () => {
  const answer = { name: "a", first_frame: { before_request_s: 4.25 }, remarks: ["the pre-roll is shorter"] };
  equal(answerWords("start", answer, 180, 120),
    "Recording a, from 4.25 s before you asked. Its first frame is on disk (0.18 s). Note: the pre-roll is shorter.");
  isTrue(!answerWords("start", { name: "a", first_frame: { before_request_s: 0 } }, 180, 120).includes("before"), "no pre-roll");
});

test("an answer to stop says what was lost, whether the ledger closes, and that it ended by itself", () => {
  const answer = { name: "a", rows: 100, seconds: 1.7, ending: "stopped", ledger: LEDGER };
  equal(answerWords("stop", answer, 1, 60), "a is on disk: 0:01.7, 100 rows, 2 frames lost, the ledger closes.");
  const open = { ...answer, rows: 98, ending: "disk full", ledger: { ...LEDGER, closes: false } };
  equal(answerWords("stop", open, 1, 60),
    "a is on disk: 0:01.7, 98 rows, no frame lost, the ledger does not close: verify the take. It ended by itself: disk full.");
});

test("a mark says where it is", () => {
  equal(answerWords("mark", { row: 1200 }, 1, 120).replace("\u202f", " "), "Marked at row 1 200 (0:10.0).");
});

test("the state says what matters in it", () => {
  equal(describe(STATUS), "ready, 2.5 s held of 10 s");
  equal(describe({ ...STATUS, device: { ...STATUS.device, presence: "absent" } }), "not ready: the device is away");
  equal(describe({ ...STATUS, device: { ...STATUS.device, presence: "silent" } }), "not ready: the device sends nothing");
  equal(describe({ ...STATUS, state: "failed", failure: "the disk is full: make room" }), "the disk is full: make room");
  equal(describe({ ...STATUS, state: "recording", take: { name: "b" } }), "b");
  equal(describe({ ...STATUS, state: "idle", last_take: { name: "c" } }), "last take: c");
  equal(describe({ ...STATUS, state: "idle", device: { ...DEVICE, presence: "absent" } }), "the device is not there");
});

test("what keeps the device away is said", () => {
  equal(obstacle(STATUS), null);
  equal(obstacle({ ...STATUS, device: { ...DEVICE, presence: "silent" } }), "Device silent: it should stream and sends nothing");
  equal(obstacle({ ...STATUS, device: { ...DEVICE, presence: "absent", obstacle: "busy" } }), "Device absent: busy");
  equal(deviceLine(DEVICE), "DVMC-8820 · 7 · firmware 1.4 · streaming · dvmc · serial:/dev/ttyUSB0 · 15 markers at 59.94 Hz");
});

test("takes say what is known of them and no more", () => {
  const take = { name: "a", bytes: 61_234, modified_unix_ms: 0, is_open: false, health: "unknown", seconds: 0, markers: 0 };
  isTrue(facts(take, 1e12).startsWith("61.2 kB"), "no length that is not known");
  isTrue(facts({ ...take, seconds: 5, markers: 1 }, 1e12).startsWith("0:05.0 · 1 marker · "), "length and markers");
  equal(health({ ...take, is_open: true }), ["none", "being written"]);
  equal([health({ health: "cut off" })[0], health({ health: "from tomorrow" })], ["bad", ["watch", "from tomorrow"]]);
});

test("a check says what it found", () => {
  const good = { health: "complete", seconds: 5, samples: 600, max_error_mm: 0.4987, tolerance_mm: 0.5, problems: [], contradictions: [] };
  equal(verdict(good), "complete. 0:05.0, 600 samples within 0.499 of 0.5 mm");
  equal(verdict({ ...good, tolerance_mm: 0, max_error_mm: 0 }), "complete. 0:05.0, 600 samples bit by bit");
  equal(verdict({ ...good, health: "cut off", problems: ["no footer"] }), "cut off: mocapd recover mends it. no footer");
  equal(verdict({ ...good, health: "damaged", problems: ["a", "b"], contradictions: ["c", "d"] }), "damaged. a; b; c; and 1 more");
});
