// What happened: the last fifty, newest first, read as they come and taken up again where the connection was cut.

import { open } from "./api.js";
import { byId, h, setText } from "./dom.js";
import { clock, plural } from "./format.js";
import { EventParser } from "./stream.js";

const SHOWN = 50;
const AGAIN_MS = 1000;
/** Longer than the service is ever silent: it gives a sign of life every 15 s. */
const SILENT_MS = 40_000;

const SHAPES = { failure: "✕", warning: "▲", mark: "⚑", "take-started": "●", "take-stopped": "■", "take-saved": "■", trigger: "»",
  device: "◇", state: "·" };

export class Events {
  #lastId = null;
  #n = 0;
  #page = null;

  constructor(onEvent) {
    this.onEvent = onEvent;
    document.addEventListener("visibilitychange", () => this.#look());
    this.#look();
  }

  /** A page that nobody sees listens later: a browser has few connections for all of its pages, and nothing is lost. */
  #look() {
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
      const silent = new AbortController();
      let timer = setTimeout(() => silent.abort(), SILENT_MS);
      const stop = () => silent.abort();
      page.addEventListener("abort", stop);
      try {
        const headers = { Accept: "text/event-stream" };
        if (this.#lastId !== null) headers["Last-Event-ID"] = this.#lastId;
        const response = await open("/v1/events?after=0", silent.signal, headers);
        const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
        const parser = new EventParser();
        for (;;) {
          const { done, value } = await reader.read();
          if (done) break;
          clearTimeout(timer);
          timer = setTimeout(stop, SILENT_MS);
          parser.push(value).forEach((event) => this.#take(event));
        }
      } catch (error) {
        if (!silent.signal.aborted) console.info("events:", error.message);
      }
      page.removeEventListener("abort", stop);
      clearTimeout(timer);
      await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
    }
  }

  #take({ id, data, type }) {
    if (id !== null) this.#lastId = id;
    const event = JSON.parse(data);
    if (type === "missed") return this.#missed(event.missed);
    this.#put(SHAPES[event.kind] ?? "·", event.unix_ms, event.kind, event.message);
    this.onEvent(event);
  }

  /** What is missing is said, but not to a page that has only just come. */
  #missed(n) {
    if (this.#n === 0) return;
    const words = n === null ? "the service was started anew: its events begin again"
      : `${plural(n, "event")} came while this page was away, and are no longer kept`;
    this.#put("▲", Date.now(), "warning", words);
  }

  #put(shape, unixMs, kind, message) {
    const list = byId("events");
    list.prepend(h("li", { "data-kind": kind },
      h("time", { datetime: new Date(unixMs).toISOString() }, clock(unixMs)),
      h("span", { class: "glyph", "aria-hidden": "true" }, shape),
      h("span", { class: "kind" }, kind.replace("-", " ")),
      h("span", { class: "message" }, message)));
    while (list.children.length > SHOWN) list.lastChild.remove();
    this.#n += 1;
    setText(byId("events-count"), this.#n > SHOWN ? `the last ${SHOWN}` : "");
  }
}
