// The buttons and their results. A button shows that its command is pending until the service answers.

import { ServiceError, sendCommand } from "./api.js";
import { byId, limitBytes, setAttribute, setHidden, setText } from "./dom.js";
import { count, elapsed, nextName, plural, rounded } from "./format.js";

const PROGRESS = {
  arm: "Arming",
  disarm: "Disarming",
  start: "Starting: waiting until the first frame is on disk",
  stop: "Stopping: waiting until the ledger is on disk",
  mark: "Marking",
  "save-last": "Saving",
  cancel: "Cancelling the start",
};

/** The message that describes the response to a command. Pure. */
export function responseMessage(what, answer, tookMs, rateHz) {
  const took = `${rounded(tookMs / 1000)} s`;
  const remarks = (answer.remarks ?? []).map((remark) => ` Note: ${remark}.`).join("");
  if (what === "cancel") return `The start at ${answer.at} is cancelled.`;
  if (what === "start" && answer.at) return `A take will be started at ${answer.at}.${remarks}`;
  if (what === "start") {
    const before = answer.first_frame.before_request_s;
    const start = before > 0.05 ? `, starting ${rounded(before)} s before the request` : "";
    return `Recording ${answer.name}${start}. Its first frame is on disk (${took}).${remarks}`;
  }
  if (what === "stop" || what === "save-last") {
    const { ledger, rows, seconds } = answer;
    const lost = Math.max(0, rows - ledger.recorded);
    const losses = lost > 0 ? `${count(lost)} lost` : "none lost";
    const closes = ledger.closes ? "the ledger closes" : "the ledger does not close: verify the take";
    const ending = ["stopped", "saved"].includes(answer.ending) ? "" : ` It ended by itself: ${answer.ending}.`;
    return `${answer.name} is on disk: ${elapsed(seconds)}, ${plural(rows, "frame")}, ${losses}, ${closes}.${ending}${remarks}`;
  }
  if (what === "mark") {
    const at = rateHz > 0 ? ` (${elapsed(answer.row / rateHz)})` : "";
    return `Marked at frame ${count(answer.row)}${at}.`;
  }
  return what === "arm" ? `Armed (${took}).` : "Idle: the device is stopped and the pre-roll discarded.";
}

/** The fields from which takes are named. */
const NAMES = ["subject", "session", "trial"];

/** The fields of a start that are filled in. */
function startBody() {
  const body = {};
  for (const [field, id] of [["name", "name"], ["notes", "notes"], ["at", "start-at"], ...NAMES.map((id) => [id, id])]) {
    const value = byId(id).value.trim();
    if (value) body[field] = value;
  }
  const seconds = byId("length").value;
  if (seconds) body.seconds = Number(seconds);
  return body;
}

export class Actions {
  #hasNames = false;
  #status = null;
  #isLost = true;
  #pending = new Set();

  constructor(onDone) {
    this.onDone = onDone;
    ["name", "notes", "mark-text", ...NAMES].forEach((id) => limitBytes(byId(id)));
    byId("arm").addEventListener("click", () => this.#arm());
    byId("cancel").addEventListener("click", () => this.#send("cancel", byId("cancel")));
    byId("record").addEventListener("click", () => this.#record());
    byId("mark-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.mark();
    });
    byId("save-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.#saveLast();
    });
  }

  show(status, isLost) {
    this.#status = status ?? this.#status;
    this.#isLost = isLost;
    this.#fillNames();
    this.#render();
  }

  /** Offers the names of the last take, once, if none are filled in. */
  #fillNames() {
    const names = this.#status?.names;
    if (this.#hasNames || !names) return;
    this.#hasNames = true;
    if (NAMES.some((id) => byId(id).value)) return;
    NAMES.forEach((id) => {
      byId(id).value = names[id];
    });
    byId("more").open = true;
  }

  /** Starts a take; does nothing while that is not possible. */
  start() {
    if (!byId("record").disabled && this.#status?.state !== "recording") this.#record();
  }

  stop() {
    if (!byId("record").disabled && this.#status?.state === "recording") this.#record();
  }

  async mark() {
    if (byId("mark").disabled) return;
    const text = byId("mark-text").value.trim();
    if (await this.#send("mark", byId("mark"), { text })) byId("mark-text").value = "";
  }

  async #arm() {
    const isOn = this.#status.state === "armed";
    await this.#send(isOn ? "disarm" : "arm", byId("arm"));
  }

  async #record() {
    if (this.#status.state === "recording") {
      const done = await this.#send("stop", byId("record"));
      const name = byId("name");
      if (done && name.value.trim() === done.name) name.value = nextName(done.name);
      return;
    }
    const invalid = ["length", "start-at"].map(byId).find((field) => !field.checkValidity());
    if (invalid) {
      byId("more").open = true;
      invalid.reportValidity();
      return;
    }
    // A time of day counts once.
    if (await this.#send("start", byId("record"), startBody())) byId("notes").value = byId("start-at").value = "";
  }

  async #saveLast() {
    // Without a number, all that is held.
    const seconds = byId("save-seconds").value;
    await this.#send("save-last", byId("save"), seconds ? { seconds: Number(seconds) } : {});
  }

  /** The response of the service, or null if it refused or cannot be reached. */
  async #send(what, button, body = {}) {
    if (this.#pending.has(what)) return null;
    this.#pending.add(what);
    this.#render();
    setAttribute(button, "aria-busy", "true");
    showResponse("waiting", `${PROGRESS[what]} …`);
    const began = performance.now();
    try {
      const onRetry = () => showResponse("waiting", `${PROGRESS[what]}: no reply, retrying with the same request id …`);
      const answer = await sendCommand(`/v1/${what}`, body, { onRetry });
      showResponse("done", responseMessage(what, answer, performance.now() - began, this.#status?.device.rate_hz ?? 0));
      return answer;
    } catch (error) {
      if (error instanceof ServiceError) showResponse("refused", error.message);
      else showResponse("unknown", `${error.message}: it is not known whether the command was executed. Check the state before you repeat it`);
      return null;
    } finally {
      setAttribute(button, "aria-busy", null);
      this.#pending.delete(what);
      this.#render();
      this.onDone();
    }
  }

  #render() {
    const state = this.#isLost ? "lost" : this.#status.state;
    const isRecording = state === "recording";
    const isBusy = (...whats) => whats.some((what) => this.#pending.has(what));
    const [arm, record] = [byId("arm"), byId("record")];
    setText(arm, isBusy("arm") ? "Arming …" : isBusy("disarm") ? "Disarming …" : state === "armed" ? "Disarm" : "Arm");
    arm.disabled = state === "lost" || isRecording || isBusy("arm", "disarm", "start");
    const word = isBusy("start") ? "Starting …" : isBusy("stop") ? "Stopping …" : isRecording ? "Stop" : "Record";
    setText(record, word);
    setAttribute(record, "data-does", isRecording ? "stop" : "record");
    setAttribute(record, "aria-keyshortcuts", isRecording ? "S Space" : "R");
    record.disabled = state === "lost" || isBusy("start", "stop", "arm", "disarm");
    setHidden(byId("cancel"), !this.#status?.pending_start);
    byId("cancel").disabled = state === "lost" || isBusy("cancel");
    byId("mark").disabled = !isRecording || isBusy("mark", "stop");
    byId("save").disabled = !["armed", "recording"].includes(state) || isBusy("save-last");
  }
}

const PREFIXES = { waiting: "…", done: "Done:", refused: "Refused:", unknown: "No reply:" };

function showResponse(kind, text) {
  setAttribute(byId("answer"), "data-kind", kind);
  setText(byId("answer"), kind === "waiting" ? text : `${PREFIXES[kind]} ${text}`);
}
