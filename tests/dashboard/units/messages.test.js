import { responseMessage } from "/actions.js";
import { describe, deviceLine, fileNotice, obstacle, shownState } from "/state.js";
import { health, takeSummary, uploadText, verifyResult } from "/takes.js";
import { equal, isTrue, test } from "./harness.js";

const DEVICE = { uri: "serial:/dev/ttyUSB0", presence: "streaming", model: "DVMC-8820", serial: "7", firmware: "1.4",
  driver: "dvmc", rate_hz: 59.94, markers: 15, obstacle: null, outages: 0, is_awaited: false, outage: null };
const AWAY = { ...DEVICE, presence: "absent", is_awaited: true, outage: { seconds: 10, frames: 1599, ends_in_s: 50.4 } };
const SILENT = { ...DEVICE, presence: "silent", outage: { seconds: 10, frames: 1599, ends_in_s: null } };
const STATUS = { state: "armed", failure: null, device: DEVICE, take: null, last_take: null, pre_roll: { wanted_s: 10, held_s: 2.5 } };
const LEDGER = { recorded: 98, closes: true };

test("a response to start reports that the first frame is on disk, and the pre-roll", () => {
  const answer = { name: "a", first_frame: { before_request_s: 4.25 }, remarks: ["the pre-roll is shorter"] };
  equal(responseMessage("start", answer, 180, 120),
    "Recording a, starting 4.25 s before the request. Its first frame is on disk (0.18 s). Note: the pre-roll is shorter.");
  isTrue(!responseMessage("start", { name: "a", first_frame: { before_request_s: 0 } }, 180, 120).includes("before"), "no pre-roll");
});

test("a response to stop reports lost frames, whether the ledger closes, and why the take ended", () => {
  const answer = { name: "a", rows: 100, seconds: 1.7, ending: "stopped", ledger: LEDGER };
  equal(responseMessage("stop", answer, 1, 60), "a is on disk: 0:01.7, 100 frames, 2 lost, the ledger closes.");
  const open = { ...answer, rows: 98, ending: "disk full", ledger: { ...LEDGER, closes: false } };
  equal(responseMessage("stop", open, 1, 60),
    "a is on disk: 0:01.7, 98 frames, none lost, the ledger does not close: verify the take. It ended by itself: disk full.");
});

test("a response to save-last reports a shorter pre-roll once", () => {
  const answer = { name: "a", rows: 98, seconds: 1.7, ending: "saved", ledger: LEDGER, remarks: ["only 1.7 s of the requested 500.0 s were held"] };
  equal(responseMessage("save-last", answer, 1, 60), "a is on disk: 0:01.7, 98 frames, none lost, the ledger closes. " +
    "Note: only 1.7 s of the requested 500.0 s were held.");
});

test("a response to mark reports the frame and the time", () => {
  equal(responseMessage("mark", { row: 1200 }, 1, 120).replace("\u202f", " "), "Marked at frame 1 200 (0:10.0).");
});

test("each state is described", () => {
  equal(describe(STATUS), ["ready, pre-roll 2.5 s of 10 s"]);
  equal(describe({ ...STATUS, state: "failed", failure: "the disk is full: make room" }), ["the disk is full: make room"]);
  equal(describe({ ...STATUS, state: "recording", take: { name: "b" } }), ["b"]);
  equal(describe({ ...STATUS, state: "idle", last_take: { name: "c" } }), ["last take: c"]);
});

test("an absent or silent device takes precedence over every state but failed", () => {
  for (const state of ["idle", "armed", "recording"]) equal(shownState({ state, device: AWAY }), "absent", state);
  for (const state of ["armed", "recording"]) equal(shownState({ state, device: SILENT }), "silent", state);
  equal(shownState({ state: "failed", device: AWAY }), "failed");
  for (const presence of ["streaming", "present"]) equal(shownState({ state: "armed", device: { ...DEVICE, presence } }), "armed");
});

test("without a device the page tells what is interrupted, how many frames are missing, and when it resumes", () => {
  const recording = { ...STATUS, state: "recording", take: { name: "b" } };
  equal(describe({ ...recording, device: AWAY }).map((line) => line.replace("\u202f", " ")), ["Recording interrupted: b",
    "1 599 frames missing so far", "Recording resumes when the device is back, or the take ends in 0:50"]);
  equal(describe({ ...recording, device: SILENT })[2], "Recording resumes when the device sends again");
  equal(describe({ ...STATUS, device: AWAY }), ["Armed: nothing can be recorded", "Ready again when the device is back"]);
  equal(describe({ ...STATUS, state: "idle", device: { ...DEVICE, presence: "absent" } }), ["Idle"]);
  const ended = { ...STATUS, state: "idle", device: { ...AWAY, outage: null }, last_take: { name: "b", ending: "device gone" } };
  equal(describe(ended), ["b has ended: the device did not come back", "Arms as soon as the device is connected"]);
});

test("the obstacle and the device are described", () => {
  equal(obstacle(STATUS), null);
  equal(obstacle({ ...STATUS, device: { ...DEVICE, presence: "absent", obstacle: "busy" } }), "Busy");
  equal(deviceLine(DEVICE), "DVMC-8820 · 7 · firmware 1.4 · streaming · dvmc · serial:/dev/ttyUSB0 · 15 markers at 59.94 Hz");
});

test("a change of the file by another program is reported", () => {
  equal(fileNotice({ take: null }), null);
  equal(fileNotice({ take: { file: "in_place", file_notice: null } }), null);
  equal(fileNotice({ take: { file: "removed", file_notice: "the take a was removed" } }), "The take a was removed");
});

test("the upload of a take says where it is, or why not", () => {
  equal(uploadText({ upload: null }), "");
  const upload = { state: "uploaded", url: "s3://lab/a.take", message: "" };
  equal(uploadText({ upload }), "in the archive (s3://lab/a.take)");
  equal(uploadText({ upload: { ...upload, state: "waiting", message: "no network" } }), "waits to be uploaded: no network");
  equal(uploadText({ upload: { ...upload, state: "from tomorrow" } }), "from tomorrow (s3://lab/a.take)");
});

test("the summary of a take contains known facts only", () => {
  const take = { name: "a", bytes: 61_234, modified_unix_ms: 0, is_open: false, health: "unknown", seconds: 0, markers: 0 };
  isTrue(takeSummary(take, 1e12).startsWith("61.2 kB"), "no unknown length");
  isTrue(takeSummary({ ...take, seconds: 5, markers: 1 }, 1e12).startsWith("0:05.0\u00a0· 1 marker\u00a0· "), "length and markers");
  isTrue(takeSummary({ ...take, ending: "device gone" }, 1e12).includes("\u00a0· ended: device gone"), "how it ended");
  isTrue(!takeSummary({ ...take, ending: "" }, 1e12).includes("ended"), "no unknown ending");
  equal(health({ ...take, is_open: true }), ["none", "being written"]);
  equal([health({ health: "cut off" })[0], health({ health: "from tomorrow" })], ["bad", ["watch", "from tomorrow"]]);
});

test("the result of a verification is described", () => {
  const good = { health: "complete", seconds: 5, samples: 600, max_error_mm: 0.4987, tolerance_mm: 0.5, problems: [], contradictions: [] };
  equal(verifyResult(good), "complete. 0:05.0, 600 samples, largest error 0.499 mm (tolerance 0.5 mm)");
  equal(verifyResult({ ...good, tolerance_mm: 0, max_error_mm: 0 }), "complete. 0:05.0, 600 samples, bit-exact");
  equal(verifyResult({ ...good, health: "cut off", problems: ["no footer"] }), "cut off: repair it with mocapd recover. no footer");
  equal(verifyResult({ ...good, health: "damaged", problems: ["a", "b"], contradictions: ["c", "d"] }), "damaged. a; b; c; and 1 more");
});
