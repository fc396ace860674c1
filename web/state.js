// The state, as the loudest thing on the page.

import { byId, setAttribute, setHidden, setText } from "./dom.js";
import { running, span } from "./format.js";

const WORDS = { idle: "Idle", armed: "Armed", recording: "Recording", failed: "Failed" };

/** What stands below the state's word. Pure. */
export function describe(status) {
  const { state, take, pre_roll: preRoll, last_take: last } = status;
  if (state === "recording" && take) return take.name;
  if (state === "failed") return status.failure ?? "no reason is known: see the events";
  if (state === "armed") {
    // Nothing that comes now would be recorded.
    if (status.device.presence === "absent") return "not ready: the device is away";
    if (status.device.presence === "silent") return "not ready: the device sends nothing";
    const held = `${preRoll.held_s.toFixed(1)} s held`;
    return preRoll.wanted_s > 0 ? `ready, ${held} of ${preRoll.wanted_s.toFixed(0)} s` : "ready";
  }
  if (status.device.presence === "absent") return "the device is not there";
  return last ? `last take: ${last.name}` : "the device does not run";
}

/** Why the device keeps people waiting, in words, or null. Pure. */
export function obstacle(status) {
  const { presence, obstacle: words } = status.device;
  if (words) return `Device ${presence}: ${words}`;
  if (presence === "silent") return "Device silent: it should stream and sends nothing";
  if (presence === "absent" && status.state !== "idle") return "Device absent: waiting for it to come back";
  return null;
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
    this.#state(status.state, WORDS[status.state] ?? status.state, describe(status));
    setText(byId("rig"), status.rig);
    setText(byId("device"), deviceLine(status.device));
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
    this.#tick();
  }

  /** The time runs on between two answers, and stands still without any. */
  #tick() {
    const { take, state } = this.#status ?? {};
    const nowMs = performance.now();
    if (this.#lost) {
      const ago = span(Math.max(0, (nowMs - this.#lost.sinceMs) / 1000)).join(" ");
      const known = this.#status
        ? `last known, ${ago} ago: ${(WORDS[state] ?? state).toLowerCase()}${take ? ` ${take.name}` : ""}`
        : `for ${ago}`;
      this.#state("lost", "No connection", `${this.#lost.why}; trying again · ${known}`);
      return setText(byId("timer"), "");
    }
    const runs = state === "recording" && take;
    setText(byId("timer"), runs ? running(take.seconds + (nowMs - this.#atMs) / 1000) : "");
  }

  #state(state, word, what) {
    setAttribute(byId("hero"), "data-state", state);
    setText(byId("state"), word);
    setText(byId("what"), what);
    const title = `${state === "recording" ? "● " : ""}${word} · mocapd`;
    if (document.title !== title) document.title = title;
    // What is said aloud changes with the state only, not with every number.
    const said = state === "armed" || state === "lost" ? word : `${word}. ${what}`;
    if (said !== this.#said && state !== "waiting") setText(byId("announce"), said);
    this.#said = said;
  }
}
