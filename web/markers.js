// How well each marker is seen: a table, worst first, and its row points the marker out in the view.

import { byId, h, setAttribute, setText } from "./dom.js";
import { count, percent, plural, short } from "./format.js";
import { GLYPHS } from "./tiles.js";

/** What the columns hold, and which way is worse first. */
export const COLUMNS = [
  { key: "label", title: "Marker", sign: 1 },
  { key: "visible", title: "Seen", sign: 1, hint: "of all frames, in percent" },
  { key: "gaps", title: "Gaps", sign: -1, hint: "times that it vanished" },
  { key: "longest_gap_s", title: "Longest", sign: -1, hint: "the longest gap, in seconds" },
  { key: "noise_mm", title: "Noise", sign: -1, hint: "standard deviation of the noise on one axis, in millimetres: from fourth " +
    "differences of frames that follow each other, still or moving; a dash where it cannot be told from motion or rounding" },
  { key: "swaps_suspected", title: "Swaps", sign: -1, hint: "times that it jumped to where another marker was" },
];
/** Among equals, in this order. */
const TIES = ["visible", "longest_gap_s", "swaps_suspected", "gaps", "noise_mm", "label"];

/** Compares two rows by a column, worse first; what is not known comes last. */
function compare(a, b, { key, sign }) {
  if (key === "label") return a.label.localeCompare(b.label, undefined, { numeric: true }) * sign;
  if (a[key] === null || b[key] === null) return (a[key] === null) - (b[key] === null);
  return (a[key] - b[key]) * sign;
}

/** The rows by a column, worse first or, turned round, better first; ties by what is worse otherwise. Pure. */
export function sorted(rows, key, isTurned = false) {
  const by = COLUMNS.find((column) => column.key === key);
  const ties = TIES.map((tie) => COLUMNS.find((column) => column.key === tie));
  return [...rows].sort((a, b) => {
    const isKnown = a[key] !== null && b[key] !== null;
    const first = compare(a, b, by) * (isTurned && isKnown ? -1 : 1);
    return ties.reduce((found, tie) => found || compare(a, b, tie), first);
  });
}

/** How a marker is seen, as a level. Pure. */
export function level({ visible, swaps_suspected: swaps }) {
  if (visible < 0.5) return "bad";
  return visible < 0.9 || swaps > 0 ? "watch" : "ok";
}

export class Markers {
  #rows = new Map();
  #quality = [];
  #key = "visible";
  #isTurned = false;
  #chosen = null;

  /** `onPoint({hovered, pinned})` hears labels, null for none. */
  constructor(onPoint) {
    this.onPoint = onPoint;
    this.#heads = COLUMNS.map(({ key, title, hint }) =>
      h("th", { scope: "col", title: hint ?? null },
        h("button", { type: "button", click: () => this.#sortBy(key) }, title, h("span", { "aria-hidden": "true" }))));
    byId("markers-head").append(...this.#heads);
    byId("markers-body").addEventListener("pointerleave", () => this.onPoint({ hovered: null }));
  }

  #heads = [];

  /** `isOld`: the device sends nothing, and this is how it was before. */
  show(quality, isOld = false) {
    this.#quality = quality;
    const labels = new Set(quality.map(({ label }) => label));
    for (const [label, row] of this.#rows) {
      if (labels.has(label)) continue;
      row.element.remove();
      this.#rows.delete(label);
    }
    // Without one figure there is no column: what cannot be known is left out.
    byId("markers-body").closest("table").classList.toggle("noiseless", quality.every(({ noise_mm: noise }) => noise === null));
    for (const marker of quality) this.#fill(this.#rows.get(marker.label) ?? this.#make(marker.label), marker);
    this.#order();
    const weak = quality.filter((marker) => level(marker) !== "ok").length;
    const words = isOld ? "until the last frame" : weak === 0 ? "all well seen" : `${plural(weak, "marker")} to look at`;
    setText(byId("markers-count"), quality.length === 0 ? "none yet" : `${count(quality.length)} · ${words}`);
  }

  lose() {
    setText(byId("markers-count"), "old: no connection");
  }

  point(label) {
    if (this.#chosen === label) return;
    this.#rows.get(this.#chosen)?.element.classList.remove("chosen");
    this.#chosen = label;
    this.#rows.get(label)?.element.classList.add("chosen");
  }

  #sortBy(key) {
    this.#isTurned = this.#key === key && !this.#isTurned;
    this.#key = key;
    this.#order();
  }

  #order() {
    const body = byId("markers-body");
    sorted(this.#quality, this.#key, this.#isTurned).forEach((marker, place) => {
      const { element } = this.#rows.get(marker.label);
      if (body.children[place] !== element) body.insertBefore(element, body.children[place] ?? null);
    });
    COLUMNS.forEach(({ key, sign }, i) => {
      const isUp = (sign > 0) !== this.#isTurned;
      setAttribute(this.#heads[i], "aria-sort", key !== this.#key ? null : isUp ? "ascending" : "descending");
      setText(this.#heads[i].querySelector("span"), key !== this.#key ? "" : isUp ? " ↑" : " ↓");
    });
  }

  #make(label) {
    const button = h("button", {
      type: "button",
      "aria-pressed": "false",
      click: () => this.onPoint({ pinned: label }),
      focus: () => this.onPoint({ hovered: label }),
      blur: () => this.onPoint({ hovered: null }),
    }, label);
    const glyph = h("span", { class: "glyph" });
    const cells = COLUMNS.slice(1).map(() => h("td"));
    const element = h("tr", { pointerenter: () => this.onPoint({ hovered: label }) },
      h("th", { scope: "row" }, glyph, button), ...cells);
    const row = { element, glyph, button, cells };
    this.#rows.set(label, row);
    return row;
  }

  #fill({ element, glyph, button, cells }, marker) {
    const found = level(marker);
    setAttribute(element, "data-level", found);
    setText(glyph, found === "ok" ? "" : GLYPHS[found]);
    setAttribute(glyph, "aria-label", { ok: null, watch: "look", bad: "badly seen" }[found]);
    setAttribute(button, "title", marker.labelled ? null : "the device does not know this marker");
    const noise = marker.noise_mm;
    const texts = [`${percent(marker.visible)} %`, count(marker.gaps), `${short(marker.longest_gap_s)} s`,
      noise === null ? "–" : `${short(noise)} mm`, count(marker.swaps_suspected)];
    cells.forEach((cell, i) => setText(cell, texts[i]));
  }
}
