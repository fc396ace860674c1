// The lists of the player: the markers, some of which are chosen for the charts, and the events.

import { CHOSEN_MAX, DASHES } from "./charts.js";
import { byId, h, setHidden, setText } from "./dom.js";
import { count, plural, takeTime } from "./format.js";

const SYMBOLS = { mark: "▲" };

export class PlayerLists {
  chosen = [];
  #rows = [];
  #labels = [];

  /** `onChoose` gets the slots of the chosen markers, `onHover` a slot or -1, `onEvent` a frame. */
  constructor({ onChoose, onHover, onEvent }) {
    Object.assign(this, { onChoose, onHover, onEvent });
    byId("marker-filter").addEventListener("input", () => this.#filter());
    byId("marker-list").addEventListener("pointerleave", () => this.onHover(-1));
  }

  /** `labels` are those of the scene, where no marker is without one. */
  show(overview, labels) {
    this.#labels = labels;
    this.#rows = this.#labels.map((label, slot) => this.#createRow(label, slot));
    byId("marker-list").replaceChildren(...this.#rows.map(({ element }) => element));
    byId("marker-filter").value = "";
    this.showEvents(overview);
    // The first marker of the take shows what the charts are.
    this.#choose(this.#labels.length > 0 ? [0] : []);
  }

  /** Chooses a marker, too; the one that was chosen first makes room. */
  add(slot) {
    if (!this.chosen.includes(slot)) this.#choose([...this.chosen, slot].slice(-CHOSEN_MAX));
  }

  #createRow(label, slot) {
    const box = h("input", { type: "checkbox" });
    box.addEventListener("change", () => {
      const rest = this.chosen.filter((other) => other !== slot);
      this.#choose(box.checked ? [...rest, slot] : rest);
    });
    const hover = (on) => () => this.onHover(on ? slot : -1);
    const missing = h("span", { class: "missing", hidden: true }, "missing");
    const element = h("li", { pointerenter: hover(true), focusin: hover(true), focusout: hover(false) },
      h("label", {}, box, h("span", {}, label), missing));
    return { element, box, missing };
  }

  /** Says which markers are missing; `isSeen(slot)` tells. */
  showMissing(isSeen) {
    this.#rows.forEach(({ missing }, slot) => setHidden(missing, isSeen(slot)));
  }

  #choose(slots) {
    this.chosen = slots;
    this.#rows.forEach(({ box }, slot) => {
      box.checked = slots.includes(slot);
      box.disabled = !box.checked && slots.length >= CHOSEN_MAX;
    });
    setText(byId("markers-count"), `${count(this.#labels.length)} · ${slots.length} of at most ${CHOSEN_MAX} chosen`);
    byId("legend").replaceChildren(...slots.map((slot, series) => h("li", {}, swatch(series), this.#labels[slot])));
    this.onChoose(slots);
  }

  #filter() {
    const text = byId("marker-filter").value.trim().toLowerCase();
    this.#rows.forEach(({ element }, slot) => setHidden(element, !this.#labels[slot].toLowerCase().includes(text)));
  }

  /** Events are unknown as long as the overview is not complete; `unknown` says why. */
  showEvents({ events, events_total: total, rate_hz: rateHz, is_complete: isComplete }, unknown = "reading") {
    const rows = events.map(({ frame, kind, text }) =>
      h("li", {}, h("button", { type: "button", click: () => this.onEvent(frame) },
        h("span", { class: "when" }, takeTime(frame / rateHz)),
        h("span", { "aria-hidden": "true" }, SYMBOLS[kind] ?? "◆"),
        h("span", {}, text ? `${kind}: ${text}` : kind))));
    byId("event-list").replaceChildren(...rows);
    const shown = total > events.length ? `the first ${count(events.length)} of ${count(total)}` : plural(total, "event");
    const none = isComplete ? "none" : unknown;
    setText(byId("events-count"), total === 0 ? none : shown);
  }
}

/** A short line in the colour and pattern of a series. */
function swatch(series) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  const line = document.createElementNS("http://www.w3.org/2000/svg", "line");
  const set = (element, attributes) => Object.entries(attributes).forEach(([name, value]) => element.setAttribute(name, value));
  set(svg, { class: "swatch", viewBox: "0 0 34 12", "aria-hidden": "true" });
  set(line, { x1: "0", y1: "6", x2: "34", y2: "6", stroke: `var(--series-${series + 1})`, "stroke-dasharray": DASHES[series].join(" ") });
  svg.append(line);
  return svg;
}
