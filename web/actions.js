// What can be done, and what came of it, in words. An order shows that it is under way until the service answers.

import { Refused, order } from "./api.js";
import { byId, setAttribute, setText } from "./dom.js";
import { count, nextName, plural, running, short } from "./format.js";

const WAITING = {
  arm: "Arming",
  disarm: "Disarming",
  start: "Starting: waiting until the first frame is on disk",
  stop: "Stopping: waiting until the ledger is on disk",
  mark: "Marking",
  "save-last": "Saving",
};

/** What an answer says, in words. Pure. */
export function answerWords(what, answer, tookMs, rateHz) {
  const took = `${short(tookMs / 1000)} s`;
  const remarks = (answer.remarks ?? []).map((remark) => ` Note: ${remark}.`).join("");
  if (what === "start") {
    const before = answer.first_frame.before_request_s;
    const roll = before > 0.05 ? `, from ${short(before)} s before you asked` : "";
    return `Recording ${answer.name}${roll}. Its first frame is on disk (${took}).${remarks}`;
  }
  if (what === "stop" || what === "save-last") {
    const { ledger, rows, seconds } = answer;
    const lost = Math.max(0, rows - ledger.recorded);
    const losses = lost > 0 ? `${plural(lost, "frame")} lost` : "no frame lost";
    const closes = ledger.closes ? "the ledger closes" : "the ledger does not close: verify the take";
    const ending = ["stopped", "saved"].includes(answer.ending) ? "" : ` It ended by itself: ${answer.ending}.`;
    return `${answer.name} is on disk: ${running(seconds)}, ${count(rows)} rows, ${losses}, ${closes}.${ending}${remarks}`;
  }
  if (what === "mark") {
    const at = rateHz > 0 ? ` (${running(answer.row / rateHz)})` : "";
    return `Marked at row ${count(answer.row)}${at}.`;
  }
  return what === "arm" ? `Armed (${took}).` : "Idle: the device is stopped, the pre-roll is forgotten.";
}

export class Actions {
  #status = null;
  #isLost = true;
  #pending = new Set();

  constructor(onDone) {
    this.onDone = onDone;
    byId("arm").addEventListener("click", () => this.#arm());
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
    this.#paint();
  }

  /** By key or button; what cannot be done now does nothing. */
  start() {
    if (!byId("record").disabled && this.#status?.state !== "recording") this.#record();
  }

  stop() {
    if (!byId("record").disabled && this.#status?.state === "recording") this.#record();
  }

  async mark() {
    if (byId("mark").disabled) return;
    const text = byId("mark-text").value.trim();
    if (await this.#give("mark", byId("mark"), { text })) byId("mark-text").value = "";
  }

  async #arm() {
    const isOn = this.#status.state === "armed";
    await this.#give(isOn ? "disarm" : "arm", byId("arm"));
  }

  async #record() {
    if (this.#status.state === "recording") {
      const done = await this.#give("stop", byId("record"));
      const name = byId("name");
      if (done && name.value.trim() === done.name) name.value = nextName(done.name);
      return;
    }
    const body = {};
    const [name, notes] = [byId("name").value.trim(), byId("notes").value.trim()];
    if (name) body.name = name;
    if (notes) body.notes = notes;
    if (await this.#give("start", byId("record"), body)) byId("notes").value = "";
  }

  async #saveLast() {
    const seconds = Number(byId("save-seconds").value);
    await this.#give("save-last", byId("save"), { seconds });
  }

  /** What the service answered, or null where it refused or cannot be reached. */
  async #give(what, button, body = {}) {
    if (this.#pending.has(what)) return null;
    this.#pending.add(what);
    this.#paint();
    setAttribute(button, "aria-busy", "true");
    say("waiting", `${WAITING[what]} …`);
    const began = performance.now();
    try {
      const onRetry = () => say("waiting", `${WAITING[what]}: no answer, asking again under the same id …`);
      const answer = await order(`/v1/${what}`, body, { onRetry });
      say("done", answerWords(what, answer, performance.now() - began, this.#status?.device.rate_hz ?? 0));
      return answer;
    } catch (error) {
      if (error instanceof Refused) say("refused", error.message);
      else say("unknown", `${error.message}: whether it was done is not known. Look at the state, then decide`);
      return null;
    } finally {
      setAttribute(button, "aria-busy", null);
      this.#pending.delete(what);
      this.#paint();
      this.onDone();
    }
  }

  #paint() {
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
    byId("mark").disabled = !isRecording || isBusy("mark", "stop");
    byId("save").disabled = !["armed", "recording"].includes(state) || isBusy("save-last");
  }
}

const ANSWERS = { waiting: "…", done: "Done:", refused: "Refused:", unknown: "No answer:" };

function say(kind, words) {
  setAttribute(byId("answer"), "data-kind", kind);
  setText(byId("answer"), kind === "waiting" ? words : `${ANSWERS[kind]} ${words}`);
}
