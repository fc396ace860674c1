// The state, as the loudest thing on the page.

import { byId, setAttribute, setHidden, setText } from "./dom.js";
import { plural, running, span } from "./format.js";

const WORDS = { idle: "Idle", armed: "Armed", recording: "Recording", failed: "Failed", absent: "No device", silent: "No frames" };

const TITLE_SIGNS = { recording: "● ", absent: "⚠ ", silent: "⚠ " };

/** What the page shows as the state: `absent` and `silent` come before what the service does, since nothing that happens
    then is recorded. Pure. */
export function shownState({ state, device }) {
  const isFrameless = device.presence === "absent" || (device.presence === "silent" && state !== "idle");
  return isFrameless && state !== "failed" ? device.presence : state;
}

/** What stands below the state's word, as lines. Pure. */
export function describe(status) {
  const { state, take, pre_roll: preRoll, last_take: last, device } = status;
  if (shownState(status) !== state) return withoutFrames(status);
  if (state === "recording" && take) return [take.name];
  if (state === "failed") return [status.failure ?? "no reason is known: see the events"];
  if (state === "armed") {
    const held = `${preRoll.held_s.toFixed(1)} s held`;
    return [preRoll.wanted_s > 0 ? `ready, ${held} of ${preRoll.wanted_s.toFixed(0)} s` : "ready"];
  }
  return [last ? `last take: ${last.name}` : device.is_awaited ? "the device is being started" : "the device does not run"];
}

/** What the missing device means for the take, what it costs so far, and how it goes on. */
function withoutFrames({ state, take, device, last_take: last }) {
  const { outage, presence } = device;
  const back = presence === "absent" ? "when the device is back" : "when the device sends again";
  if (state === "recording" && take) {
    const lines = [`Recording waits: ${take.name}`];
    if (outage) lines.push(`${plural(outage.frames, "frame")} missing so far`);
    const limit = outage?.ends_in_s != null ? `, or ends in ${running(outage.ends_in_s).split(".")[0]}` : "";
    return [...lines, `Recording resumes ${back}${limit}`];
  }
  if (state === "armed") return ["Armed: nothing can be recorded", `Ready again ${back}`];
  const ended = last?.ending === "device gone" ? [`${last.name} has ended: the device did not come back`] : [];
  return [...ended, device.is_awaited ? "Armed as soon as the device is there" : "Idle"];
}

/** Why the device keeps people waiting, in the service's words, or null. Pure. */
export function obstacle({ device: { obstacle: words } }) {
  return words ? words.charAt(0).toUpperCase() + words.slice(1) : null;
}

/** What others did to the file of the take that is recorded, and what to do, or null. Pure. */
export function fileNotice({ take }) {
  const words = take?.file_notice;
  return words ? words.charAt(0).toUpperCase() + words.slice(1) : null;
}

/** One line about the device. Pure. */
export function deviceLine({ presence, model, serial, firmware, driver, uri, rate_hz: rateHz, markers }) {
  const parts = [model || "no device", serial, firmware && `firmware ${firmware}`, presence, driver, uri];
  if (rateHz > 0) parts.push(`${markers} markers at ${Number(rateHz.toFixed(2))} Hz`);
  return parts.filter(Boolean).join(" · ");
}

export class Hero {
  #status = null;
  #atMs = 0;
  #said = "";
  #lost = null;

  constructor() {
    setInterval(() => this.#tick(), 100);
  }

  show(status) {
    this.#status = status;
    this.#atMs = performance.now();
    this.#lost = null;
    document.body.dataset.link = "live";
    const shown = shownState(status);
    document.body.dataset.frames = shown === "absent" || shown === "silent" ? "none" : "some";
    this.#state(shown, WORDS[shown] ?? shown, describe(status));
    setText(byId("rig"), status.rig);
    setText(byId("device"), deviceLine(status.device));
    const notice = fileNotice(status);
    setHidden(byId("file-notice"), notice === null);
    setText(byId("file-notice"), notice ?? "");
    const words = obstacle(status);
    setHidden(byId("obstacle"), words === null);
    setText(byId("obstacle"), words ?? "");
    this.#tick();
  }

  /** The service does not answer, for this reason, since a time of `performance.now()`. */
  lose(why, sinceMs) {
    this.#lost = { why, sinceMs };
    document.body.dataset.link = "lost";
    setHidden(byId("obstacle"), true);
    setHidden(byId("file-notice"), true);
    this.#tick();
  }

  /** The time runs on between two answers, and stands still without any. Without a device it is the time without data:
      the take does not grow. */
  #tick() {
    const { take, state, device } = this.#status ?? {};
    const nowMs = performance.now();
    if (this.#lost) {
      const ago = span(Math.max(0, (nowMs - this.#lost.sinceMs) / 1000)).join(" ");
      const known = this.#status
        ? `last known, ${ago} ago: ${(WORDS[state] ?? state).toLowerCase()}${take ? ` ${take.name}` : ""}`
        : `for ${ago}`;
      this.#state("lost", "No connection", [`${this.#lost.why}; trying again · ${known}`]);
      return this.#time(null);
    }
    const sinceS = (nowMs - this.#atMs) / 1000;
    if (device?.outage) this.#time(device.outage.seconds + sinceS, "without data");
    else this.#time(state === "recording" && take ? take.seconds + sinceS : null);
  }

  #time(seconds, what = null) {
    setText(byId("timer"), seconds === null ? "" : running(seconds));
    setHidden(byId("timer-what"), what === null);
    setText(byId("timer-what"), what ?? "");
  }

  #state(state, word, lines) {
    setAttribute(byId("hero"), "data-state", state);
    setText(byId("state"), word);
    setText(byId("what"), lines.join("\n"));
    const title = `${TITLE_SIGNS[state] ?? ""}${word} · mocapd`;
    if (document.title !== title) document.title = title;
    // What is said aloud changes with the state only, not with every number.
    const said = ["armed", "lost"].includes(state) ? word : `${word}. ${lines[0]}`;
    if (said !== this.#said && state !== "waiting") setText(byId("announce"), said);
    this.#said = said;
  }
}
