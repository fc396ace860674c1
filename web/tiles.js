// The tiles of the metrics: created once, then updated.

import { byId, h, setAttribute, setHidden, setText } from "./dom.js";
import { metrics } from "./metrics.js";

/** A symbol beside every word: colour alone must not carry the meaning. */
export const GLYPHS = { none: "", ok: "✓", watch: "▲", bad: "✕" };

export class Tiles {
  #tiles = new Map();

  show(status) {
    for (const metric of metrics(status)) {
      const parts = this.#tiles.get(metric.id) ?? this.#create(metric);
      setAttribute(parts.tile, "data-level", metric.level);
      setText(parts.value, metric.value);
      setText(parts.unit, metric.unit);
      setText(parts.note, metric.note);
      setText(parts.glyph, GLYPHS[metric.level]);
      setText(parts.word, metric.word);
      setHidden(parts.meter, metric.fill === undefined);
      if (metric.fill !== undefined) parts.meter.value = metric.fill;
    }
  }

  /** Replaces every value by a dash: outdated values are not shown as current. */
  showDisconnected() {
    for (const { tile, value, unit, note, glyph, word, meter } of this.#tiles.values()) {
      setAttribute(tile, "data-level", "none");
      setText(value, "–");
      for (const part of [unit, note, glyph, word]) setText(part, "");
      setHidden(meter, true);
    }
  }

  #create({ id, title, isMain }) {
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
    this.#tiles.set(id, parts);
    return parts;
  }
}
