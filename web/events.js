// The list of the last fifty events, newest first. After a lost connection the stream resumes at the last event.

import { openStream } from "./api.js";
import { byId, h, setText } from "./dom.js";
import { plural, timeOfDay } from "./format.js";
import { EventParser } from "./stream.js";

const SHOWN = 50;
const RETRY_MS = 1000;
/** The service sends a comment at least every 15 s: longer silence means a lost connection. */
const TIMEOUT_MS = 40_000;

const SYMBOLS = { failure: "✕", warning: "▲", mark: "⚑", "take-started": "●", "take-stopped": "■", "take-saved": "■", "take-changed": "✎", trigger: "»",
  device: "◇", state: "·" };

export class Events {
  #lastId = null;
  #n = 0;
  #page = null;

  constructor(onEvent) {
    this.onEvent = onEvent;
    document.addEventListener("visibilitychange", () => this.#updateVisibility());
    this.#updateVisibility();
  }

  /** A hidden page closes its stream, since a browser has few connections for all pages; it resumes without loss. */
  #updateVisibility() {
    if (document.hidden) {
      this.#page?.abort();
      this.#page = null;
    } else if (!this.#page) {
      this.#page = new AbortController();
      this.#run(this.#page.signal);
    }
  }

  async #run(page) {
    while (!page.aborted) {
      const connection = new AbortController();
      let timer = setTimeout(() => connection.abort(), TIMEOUT_MS);
      const stop = () => connection.abort();
      page.addEventListener("abort", stop);
      try {
        const headers = { Accept: "text/event-stream" };
        if (this.#lastId !== null) headers["Last-Event-ID"] = this.#lastId;
        const response = await openStream("/v1/events?after=0", connection.signal, headers);
        const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
        const parser = new EventParser();
        for (;;) {
          const { done, value } = await reader.read();
          if (done) break;
          clearTimeout(timer);
          timer = setTimeout(stop, TIMEOUT_MS);
          parser.push(value).forEach((event) => this.#handle(event));
        }
      } catch (error) {
        if (!connection.signal.aborted) console.info("events:", error.message);
      }
      page.removeEventListener("abort", stop);
      clearTimeout(timer);
      await new Promise((resolve) => setTimeout(resolve, RETRY_MS));
    }
  }

  #handle({ id, data, type }) {
    if (id !== null) this.#lastId = id;
    const event = JSON.parse(data);
    if (type === "missed") return this.#missed(event.missed);
    this.#prepend(SYMBOLS[event.kind] ?? "·", event.unix_ms, event.kind, event.message);
    this.onEvent(event);
  }

  /** Reports missed events, except on a page that has just been opened. */
  #missed(n) {
    if (this.#n === 0) return;
    const text = n === null ? "the service was restarted: its earlier events are gone"
      : `${plural(n, "event")} missed while this page was not connected, and no longer stored`;
    this.#prepend("▲", Date.now(), "warning", text);
  }

  #prepend(symbol, unixMs, kind, message) {
    const list = byId("events");
    list.prepend(h("li", { "data-kind": kind },
      h("time", { datetime: new Date(unixMs).toISOString() }, timeOfDay(unixMs)),
      h("span", { class: "glyph", "aria-hidden": "true" }, symbol),
      h("span", { class: "kind" }, kind.replace("-", " ")),
      h("span", { class: "message" }, message)));
    while (list.children.length > SHOWN) list.lastChild.remove();
    this.#n += 1;
    setText(byId("events-count"), this.#n > SHOWN ? `last ${SHOWN}` : "");
  }
}
