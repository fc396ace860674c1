// The state of the service: the most prominent part of the page.

import { byId, setAttribute, setHidden, setText } from "./dom.js";
import { duration, elapsed, plural } from "./format.js";

const STATE_TITLES = { idle: "Idle", armed: "Armed", recording: "Recording", failed: "Failed", absent: "No device", silent: "No frames" };

const TITLE_SIGNS = { recording: "● ", absent: "⚠ ", silent: "⚠ " };

/** The state that the page shows: `absent` and `silent` of the device take precedence over the service's state, since
    nothing is recorded then. Pure. */
export function shownState({ state, device }) {
  const isFrameless = device.presence === "absent" || (device.presence === "silent" && state !== "idle");
  return isFrameless && state !== "failed" ? device.presence : state;
}

/** The lines below the state. Pure. */
export function describe(status) {
  const { state, take, pre_roll: preRoll, last_take: last, device } = status;
  if (shownState(status) !== state) return withoutFrames(status);
  if (state === "recording" && take) return [take.name, ...(take.wanted_s ? [`ends by itself after ${elapsed(take.wanted_s)}`] : [])];
  if (state === "failed") return [status.failure ?? "reason unknown: see the events"];
  if (state === "armed") {
    const held = `${preRoll.held_s.toFixed(1)} s`;
    return [preRoll.wanted_s > 0 ? `ready, pre-roll ${held} of ${preRoll.wanted_s.toFixed(0)} s` : "ready", ...pendingStart(status)];
  }
  return [last ? `last take: ${last.name}` : device.is_awaited ? "starting the device" : "the device is not running", ...pendingStart(status)];
}

/** A start that waits for longer is shown with its date: its time has probably just passed. */
const HOURS_12_MS = 12 * 3600 * 1000;

/** The line about a start that waits for its time, by the clock of the rig. */
function pendingStart({ pending_start: pending }) {
  if (!pending) return [];
  const isFar = pending.at_unix_ms - Date.now() > HOURS_12_MS;
  return [`A take will be started ${isFar ? `on ${pending.at.slice(0, 10)} ` : ""}at ${pending.at.slice(11, 19)} by the rig's clock`];
}

/** Why the last start at a time of day did not take place, or null. Pure. */
export function startNotice({ missed_start: text }) {
  return text ? text.charAt(0).toUpperCase() + text.slice(1) : null;
}

/** The lines while no frames arrive: the take, the frames missing so far, and when recording resumes. */
function withoutFrames({ state, take, device, last_take: last }) {
  const { outage, presence } = device;
  const back = presence === "absent" ? "when the device is back" : "when the device sends again";
  if (state === "recording" && take) {
    const lines = [`Recording interrupted: ${take.name}`];
    if (outage) lines.push(`${plural(outage.frames, "frame")} missing so far`);
    const limit = outage?.ends_in_s != null ? `, or the take ends in ${elapsed(outage.ends_in_s).split(".")[0]}` : "";
    return [...lines, `Recording resumes ${back}${limit}`];
  }
  if (state === "armed") return ["Armed: nothing can be recorded", `Ready again ${back}`];
  const ended = last?.ending === "device gone" ? [`${last.name} has ended: the device did not come back`] : [];
  return [...ended, device.is_awaited ? "Arms as soon as the device is connected" : "Idle"];
}

/** Why the device is not ready, in the service's words, or null. Pure. */
export function obstacle({ device: { obstacle: text } }) {
  return text ? text.charAt(0).toUpperCase() + text.slice(1) : null;
}

/** What another program did to the file of the current take, and what to do, or null. Pure. */
export function fileNotice({ take }) {
  const text = take?.file_notice;
  return text ? text.charAt(0).toUpperCase() + text.slice(1) : null;
}

/** The device, as one line. Pure. */
export function deviceLine({ presence, model, serial, firmware, driver, uri, rate_hz: rateHz, markers }) {
  const parts = [model || "no device", serial, firmware && `firmware ${firmware}`, presence, driver, uri];
  if (rateHz > 0) parts.push(`${plural(markers, "marker")} at ${Number(rateHz.toFixed(2))} Hz`);
  return parts.filter(Boolean).join(" · ");
}

export class Hero {
  #status = null;
  #receivedMs = 0;
  #announced = "";
  #lost = null;

  constructor() {
    setInterval(() => this.#tick(), 100);
  }

  show(status) {
    this.#status = status;
    this.#receivedMs = performance.now();
    this.#lost = null;
    document.body.dataset.link = "live";
    const shown = shownState(status);
    document.body.dataset.frames = shown === "absent" || shown === "silent" ? "none" : "some";
    this.#showState(shown, STATE_TITLES[shown] ?? shown, describe(status));
    setText(byId("rig"), status.rig);
    setText(byId("device"), deviceLine(status.device));
    const notice = fileNotice(status);
    setHidden(byId("file-notice"), notice === null);
    setText(byId("file-notice"), notice ?? "");
    const missed = startNotice(status);
    setHidden(byId("start-notice"), missed === null);
    setText(byId("start-notice"), missed ?? "");
    const text = obstacle(status);
    setHidden(byId("obstacle"), text === null);
    setText(byId("obstacle"), text ?? "");
    this.#tick();
  }

  /** Shows that the service does not answer: the reason, and the time of its last response by `performance.now()`. */
  showDisconnected(why, sinceMs) {
    this.#lost = { why, sinceMs };
    document.body.dataset.link = "lost";
    setHidden(byId("obstacle"), true);
    setHidden(byId("file-notice"), true);
    setHidden(byId("start-notice"), true);
    this.#tick();
  }

  /** Advances the timer between two responses; without a connection it is empty. During an outage it shows the time
      without data, since the take does not grow. */
  #tick() {
    const { take, state, device } = this.#status ?? {};
    const nowMs = performance.now();
    if (this.#lost) {
      const ago = duration(Math.max(0, (nowMs - this.#lost.sinceMs) / 1000)).join(" ");
      const known = this.#status
        ? `last known, ${ago} ago: ${(STATE_TITLES[state] ?? state).toLowerCase()}${take ? ` ${take.name}` : ""}`
        : `for ${ago}`;
      this.#showState("lost", "No connection", [`${this.#lost.why}; trying again · ${known}`]);
      return this.#showTimer(null);
    }
    const sinceS = (nowMs - this.#receivedMs) / 1000;
    if (device?.outage) this.#showTimer(device.outage.seconds + sinceS, "without data");
    else this.#showTimer(state === "recording" && take ? take.seconds + sinceS : null);
  }

  #showTimer(seconds, what = null) {
    setText(byId("timer"), seconds === null ? "" : elapsed(seconds));
    setHidden(byId("timer-label"), what === null);
    setText(byId("timer-label"), what ?? "");
  }

  #showState(state, word, lines) {
    setAttribute(byId("hero"), "data-state", state);
    setText(byId("state"), word);
    setText(byId("state-detail"), lines.join("\n"));
    const title = `${TITLE_SIGNS[state] ?? ""}${word} · mocapd`;
    if (document.title !== title) document.title = title;
    // Screen readers announce changes of the state, not of every number.
    const announced = ["armed", "lost"].includes(state) ? word : `${word}. ${lines[0]}`;
    if (announced !== this.#announced && state !== "waiting") setText(byId("announce"), announced);
    this.#announced = announced;
  }
}
