// The figures on the page: made once, changed where they change.

import { byId, h, setAttribute, setHidden, setText } from "./dom.js";
import { figures } from "./figures.js";

/** A shape beside every word: colour alone says nothing. */
export const GLYPHS = { none: "", ok: "✓", watch: "▲", bad: "✕" };

export class Tiles {
  #made = new Map();

  show(status) {
    for (const figure of figures(status)) {
      const parts = this.#made.get(figure.id) ?? this.#make(figure);
      setAttribute(parts.tile, "data-level", figure.level);
      setText(parts.value, figure.value);
      setText(parts.unit, figure.unit);
      setText(parts.note, figure.note);
      setText(parts.glyph, GLYPHS[figure.level]);
      setText(parts.word, figure.word);
      setHidden(parts.meter, figure.fill === undefined);
      if (figure.fill !== undefined) parts.meter.value = figure.fill;
    }
  }

  /** No figure that may be old is shown as if it were new. */
  lose() {
    for (const { tile, value, unit, note, glyph, word, meter } of this.#made.values()) {
      setAttribute(tile, "data-level", "none");
      setText(value, "–");
      for (const part of [unit, note, glyph, word]) setText(part, "");
      setHidden(meter, true);
    }
  }

  #make({ id, title, isMain }) {
    const parts = {
      value: h("span", { class: "value" }),
      unit: h("span", { class: "unit" }),
      note: h("p", { class: "note" }),
      glyph: h("span", { class: "glyph", "aria-hidden": "true" }),
      word: h("span", {}),
      meter: h("meter", { min: "0", max: "1", high: "0.5", optimum: "0", "aria-label": title }),
    };
    parts.tile = h("article", { class: isMain ? "tile main" : "tile", id: `tile-${id}` },
      h("h2", {}, title),
      h("p", { class: "number" }, parts.value, " ", parts.unit),
      parts.meter,
      h("p", { class: "level" }, parts.glyph, " ", parts.word),
      parts.note);
    byId("tiles").append(parts.tile);
    this.#made.set(id, parts);
    return parts;
  }
}
