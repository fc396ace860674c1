import { answerWords } from "/actions.js";
import { describe, deviceLine, fileNotice, obstacle, shownState } from "/state.js";
import { facts, health, verdict } from "/takes.js";
import { equal, isTrue, test } from "./harness.js";

const DEVICE = { uri: "serial:/dev/ttyUSB0", presence: "streaming", model: "DVMC-8820", serial: "7", firmware: "1.4",
  driver: "dvmc", rate_hz: 59.94, markers: 15, obstacle: null, outages: 0, is_awaited: false, outage: null };
const AWAY = { ...DEVICE, presence: "absent", is_awaited: true, outage: { seconds: 10, frames: 1599, ends_in_s: 50.4 } };
const SILENT = { ...DEVICE, presence: "silent", outage: { seconds: 10, frames: 1599, ends_in_s: null } };
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

test("an answer to save-last says that less was held, and that alone", () => {
  const answer = { name: "a", rows: 98, seconds: 1.7, ending: "saved", ledger: LEDGER, remarks: ["1.7 s were held, not the 500.0 s that were asked for"] };
  equal(answerWords("save-last", answer, 1, 60), "a is on disk: 0:01.7, 98 rows, no frame lost, the ledger closes. " +
    "Note: 1.7 s were held, not the 500.0 s that were asked for.");
});

test("a mark says where it is", () => {
  equal(answerWords("mark", { row: 1200 }, 1, 120).replace("\u202f", " "), "Marked at row 1 200 (0:10.0).");
});

test("the state says what matters in it", () => {
  equal(describe(STATUS), ["ready, 2.5 s held of 10 s"]);
  equal(describe({ ...STATUS, state: "failed", failure: "the disk is full: make room" }), ["the disk is full: make room"]);
  equal(describe({ ...STATUS, state: "recording", take: { name: "b" } }), ["b"]);
  equal(describe({ ...STATUS, state: "idle", last_take: { name: "c" } }), ["last take: c"]);
});

test("a device that is away or silent is the state, whatever the service does, unless that has failed", () => {
  for (const state of ["idle", "armed", "recording"]) equal(shownState({ state, device: AWAY }), "absent", state);
  for (const state of ["armed", "recording"]) equal(shownState({ state, device: SILENT }), "silent", state);
  equal(shownState({ state: "failed", device: AWAY }), "failed");
  for (const presence of ["streaming", "present"]) equal(shownState({ state: "armed", device: { ...DEVICE, presence } }), "armed");
});

test("without a device it is said what waits, what is missing so far, and how it goes on", () => {
  const recording = { ...STATUS, state: "recording", take: { name: "b" } };
  equal(describe({ ...recording, device: AWAY }).map((line) => line.replace("\u202f", " ")), ["Recording waits: b",
    "1 599 frames missing so far", "Recording resumes when the device is back, or ends in 0:50"]);
  equal(describe({ ...recording, device: SILENT })[2], "Recording resumes when the device sends again");
  equal(describe({ ...STATUS, device: AWAY }), ["Armed: nothing can be recorded", "Ready again when the device is back"]);
  equal(describe({ ...STATUS, state: "idle", device: { ...DEVICE, presence: "absent" } }), ["Idle"]);
  const ended = { ...STATUS, state: "idle", device: { ...AWAY, outage: null }, last_take: { name: "b", ending: "device gone" } };
  equal(describe(ended), ["b has ended: the device did not come back", "Armed as soon as the device is there"]);
});

test("what keeps the device away is said", () => {
  equal(obstacle(STATUS), null);
  equal(obstacle({ ...STATUS, device: { ...DEVICE, presence: "absent", obstacle: "busy" } }), "Busy");
  equal(deviceLine(DEVICE), "DVMC-8820 · 7 · firmware 1.4 · streaming · dvmc · serial:/dev/ttyUSB0 · 15 markers at 59.94 Hz");
});

test("a file that others touch is said", () => {
  equal(fileNotice({ take: null }), null);
  equal(fileNotice({ take: { file: "in_place", file_notice: null } }), null);
  equal(fileNotice({ take: { file: "removed", file_notice: "the take a was removed" } }), "The take a was removed");
});

test("takes say what is known of them and no more", () => {
  const take = { name: "a", bytes: 61_234, modified_unix_ms: 0, is_open: false, health: "unknown", seconds: 0, markers: 0 };
  isTrue(facts(take, 1e12).startsWith("61.2 kB"), "no length that is not known");
  isTrue(facts({ ...take, seconds: 5, markers: 1 }, 1e12).startsWith("0:05.0 · 1 marker · "), "length and markers");
  isTrue(facts({ ...take, ending: "device gone" }, 1e12).includes(" · ended: device gone"), "how it ended");
  isTrue(!facts({ ...take, ending: "" }, 1e12).includes("ended"), "no ending that is not known");
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
