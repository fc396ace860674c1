// The table of marker quality, worst first. A row highlights its marker in the view.

import { byId, h, setAttribute, setText } from "./dom.js";
import { count, percent, plural, rounded } from "./format.js";
import { GLYPHS } from "./tiles.js";

/** Columns and the sign of their order: 1 if small values are worse, -1 if large ones are. */
export const COLUMNS = [
  { key: "label", title: "Marker", sign: 1 },
  { key: "visible", title: "Visible", sign: 1, hint: "share of all frames, in percent" },
  { key: "gaps", title: "Gaps", sign: -1, hint: "how often the marker disappeared" },
  { key: "longest_gap_s", title: "Longest", sign: -1, hint: "the longest gap, in seconds" },
  { key: "noise_mm", title: "Noise", sign: -1, hint: "standard deviation of the noise on one axis, in millimetres, from fourth " +
    "differences of consecutive frames; a dash where noise cannot be separated from motion or rounding" },
  { key: "swaps_suspected", title: "Swaps", sign: -1, hint: "how often the marker jumped to the place of another" },
];
/** Columns that order equal rows, the first first. */
const TIE_BREAKERS = ["visible", "longest_gap_s", "swaps_suspected", "gaps", "noise_mm", "label"];

/** Compares two rows by a column, worse first; unknown values come last. */
function compare(a, b, { key, sign }) {
  if (key === "label") return a.label.localeCompare(b.label, undefined, { numeric: true }) * sign;
  if (a[key] === null || b[key] === null) return (a[key] === null) - (b[key] === null);
  return (a[key] - b[key]) * sign;
}

/** The rows sorted by a column, worse first, or better first if reversed; equal rows by `TIE_BREAKERS`. Pure. */
export function sorted(rows, key, isReversed = false) {
  const by = COLUMNS.find((column) => column.key === key);
  const tieBreakers = TIE_BREAKERS.map((tie) => COLUMNS.find((column) => column.key === tie));
  return [...rows].sort((a, b) => {
    const isKnown = a[key] !== null && b[key] !== null;
    const first = compare(a, b, by) * (isReversed && isKnown ? -1 : 1);
    return tieBreakers.reduce((found, tie) => found || compare(a, b, tie), first);
  });
}

/** The level of a marker's visibility: ok, watch or bad. Pure. */
export function level({ visible, swaps_suspected: swaps }) {
  if (visible < 0.5) return "bad";
  return visible < 0.9 || swaps > 0 ? "watch" : "ok";
}

export class Markers {
  #rows = new Map();
  #quality = [];
  #key = "visible";
  #isReversed = false;
  #selected = null;

  /** `onPoint({hovered, pinned})` is called with labels, or null for none. */
  constructor(onPoint) {
    this.onPoint = onPoint;
    this.#heads = COLUMNS.map(({ key, title, hint }) =>
      h("th", { scope: "col", title: hint ?? null },
        h("button", { type: "button", click: () => this.#sortBy(key) }, title, h("span", { "aria-hidden": "true" }))));
    byId("markers-head").append(...this.#heads);
    byId("markers-body").addEventListener("pointerleave", () => this.onPoint({ hovered: null }));
  }

  #heads = [];

  /** `isOld`: the device sends no frames; the values are those up to the last frame. */
  show(quality, isOld = false) {
    this.#quality = quality;
    const labels = new Set(quality.map(({ label }) => label));
    for (const [label, row] of this.#rows) {
      if (labels.has(label)) continue;
      row.element.remove();
      this.#rows.delete(label);
    }
    // The noise column is hidden if no marker has a value.
    byId("markers-body").closest("table").classList.toggle("noiseless", quality.every(({ noise_mm: noise }) => noise === null));
    for (const marker of quality) this.#update(this.#rows.get(marker.label) ?? this.#createRow(marker.label), marker);
    this.#applyOrder();
    const weak = quality.filter((marker) => level(marker) !== "ok").length;
    const text = isOld ? "up to the last frame" : weak === 0 ? "all well visible" : `${plural(weak, "marker")} to check`;
    setText(byId("markers-count"), quality.length === 0 ? "none yet" : `${count(quality.length)} · ${text}`);
  }

  showDisconnected() {
    setText(byId("markers-count"), "outdated: no connection");
  }

  highlight(label) {
    if (this.#selected === label) return;
    this.#rows.get(this.#selected)?.element.classList.remove("selected");
    this.#selected = label;
    this.#rows.get(label)?.element.classList.add("selected");
  }

  #sortBy(key) {
    this.#isReversed = this.#key === key && !this.#isReversed;
    this.#key = key;
    this.#applyOrder();
  }

  #applyOrder() {
    const body = byId("markers-body");
    sorted(this.#quality, this.#key, this.#isReversed).forEach((marker, place) => {
      const { element } = this.#rows.get(marker.label);
      if (body.children[place] !== element) body.insertBefore(element, body.children[place] ?? null);
    });
    COLUMNS.forEach(({ key, sign }, i) => {
      const isUp = (sign > 0) !== this.#isReversed;
      setAttribute(this.#heads[i], "aria-sort", key !== this.#key ? null : isUp ? "ascending" : "descending");
      setText(this.#heads[i].querySelector("span"), key !== this.#key ? "" : isUp ? " ↑" : " ↓");
    });
  }

  #createRow(label) {
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

  #update({ element, glyph, button, cells }, marker) {
    const found = level(marker);
    setAttribute(element, "data-level", found);
    setText(glyph, found === "ok" ? "" : GLYPHS[found]);
    setAttribute(glyph, "aria-label", { ok: null, watch: "check", bad: "poorly visible" }[found]);
    setAttribute(button, "title", marker.labelled ? null : "unlabelled: not identified by the device");
    const noise = marker.noise_mm;
    const texts = [`${percent(marker.visible)} %`, count(marker.gaps), `${rounded(marker.longest_gap_s)} s`,
      noise === null ? "–" : `${rounded(noise)} mm`, count(marker.swaps_suspected)];
    cells.forEach((cell, i) => setText(cell, texts[i]));
  }
}
