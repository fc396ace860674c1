// The charts below the scene: the coordinates and the speed of the chosen markers around the current time.

import { byId, colours, onTheme } from "./dom.js";
import { rounded } from "./format.js";

const COLOURS = ["panel", "line", "text", "muted", "series-1", "series-2", "series-3", "series-4"];
/** Markers shown at once: as many as there are lines that differ in colour and in pattern. */
export const CHOSEN_MAX = 4;
export const DASHES = [[], [7, 3], [2, 3], [9, 3, 2, 3]];
/** Seconds shown. */
const SPAN_S = 10;
/** Space for the numbers at the left, in pixels. */
const LEFT_PX = 62;
/** The speed is measured over at least this time on both sides of a frame. */
const SPEED_S = 1 / 60;

/**
 * The speed of a marker at a row in metres per second, from its positions at both sides; NaN beside a gap. Pure.
 */
export function speedAt(positionsAt, slot, row, rateHz) {
  const reach = Math.max(1, Math.round(SPEED_S * rateHz));
  const [before, after] = [row - reach, row + reach].map((at) => (at >= 0 ? positionsAt(at) : null));
  if (!before || !after || !positionsAt(row)) return NaN;
  const apart = Math.hypot(...[0, 1, 2].map((i) => after[3 * slot + i] - before[3 * slot + i]));
  return (apart * rateHz) / (2 * reach) / 1000;
}

/** The rows shown around a row: [first, last]. Pure. */
export function chartRows(row, frames, rateHz) {
  const span = Math.min(frames - 1, Math.round(SPAN_S * rateHz));
  const first = Math.min(Math.max(0, row - Math.round(span / 2)), frames - 1 - span);
  return [Math.max(0, first), Math.max(0, first) + span];
}

/** The limits of an axis around values, with some space; null without a value. Pure. */
export function limits(values, minimum) {
  let [low, high] = [Infinity, -Infinity];
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  if (low > high) return null;
  const padding = Math.max((high - low) * 0.08, (minimum - (high - low)) / 2);
  return [low - padding, high + padding];
}

export class Charts {
  #canvas = byId("charts");
  #isDirty = false;
  chosen = [];

  constructor() {
    this.ctx = this.#canvas.getContext("2d");
    const readColours = () => {
      this.colours = colours(COLOURS);
      this.invalidate();
    };
    onTheme(readColours);
    readColours();
    new ResizeObserver(() => this.invalidate()).observe(this.#canvas);
  }

  show({ overview, playback, buffer }) {
    Object.assign(this, { overview, playback, buffer });
    this.invalidate();
  }

  /** The markers whose lines are drawn, by slot. */
  choose(chosen) {
    this.chosen = chosen;
    this.invalidate();
  }

  invalidate() {
    if (this.#isDirty) return;
    this.#isDirty = true;
    requestAnimationFrame(() => {
      this.#isDirty = false;
      if (this.overview) this.#draw();
    });
  }

  #draw() {
    const { ctx } = this;
    const ratio = Math.min(2, devicePixelRatio || 1);
    const { clientWidth: width, clientHeight: height } = this.#canvas;
    if (width < 100 || height < 60) return;
    this.#canvas.width = Math.round(width * ratio);
    this.#canvas.height = Math.round(height * ratio);
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    const [first, last] = chartRows(this.playback.row, this.overview.frames, this.overview.rate_hz);
    const rows = [];
    const step = Math.max(1, Math.ceil((last - first) / Math.max(100, width - LEFT_PX)));
    // Whole multiples of the step, so that the lines do not flicker as time goes on.
    for (let row = Math.ceil(first / step) * step; row <= last; row += step) rows.push(row);
    const x = (row) => LEFT_PX + ((row - first) / Math.max(1, last - first)) * (width - LEFT_PX - 4);
    const names = ["x", "y", "z", "speed"];
    const stripPx = (height - 4) / names.length;
    names.forEach((name, i) => {
      const strip = { name, top: i * stripPx + 4, height: stripPx - 8, x, width };
      this.#drawStrip(strip, rows, i);
    });
    ctx.fillStyle = this.colours.text;
    ctx.fillRect(x(this.playback.row) - 0.5, 0, 1.5, height);
  }

  #values(slot, rows, quantity) {
    const { positionsAt } = this.buffer;
    if (quantity === 3) return rows.map((row) => speedAt(positionsAt, slot, row, this.overview.rate_hz));
    return rows.map((row) => positionsAt(row)?.[3 * slot + quantity] ?? NaN);
  }

  #drawStrip({ name, top, height, x, width }, rows, quantity) {
    const { ctx } = this;
    const lines = this.chosen.map((slot) => this.#values(slot, rows, quantity));
    const range = limits(lines.flat(), quantity === 3 ? 0.1 : 20);
    ctx.strokeStyle = this.colours.line;
    ctx.lineWidth = 1;
    ctx.strokeRect(LEFT_PX + 0.5, top + 0.5, width - LEFT_PX - 4, height);
    ctx.fillStyle = this.colours.muted;
    ctx.font = "600 12px system-ui, sans-serif";
    ctx.textAlign = "right";
    ctx.textBaseline = "middle";
    ctx.fillText(name, LEFT_PX - 6, top + height / 2 - 7);
    ctx.font = "11px system-ui, sans-serif";
    ctx.fillText(quantity === 3 ? "m/s" : "mm", LEFT_PX - 6, top + height / 2 + 7);
    if (!range) return;
    const [low, high] = quantity === 3 ? [0, Math.max(0.1, range[1])] : range;
    ctx.fillText(rounded(high), LEFT_PX - 6, top + 6);
    ctx.fillText(rounded(low), LEFT_PX - 6, top + height - 5);
    const y = (value) => top + height - ((value - low) / (high - low)) * height;
    lines.forEach((values, i) => this.#drawLine(values, i, (at) => x(rows[at]), y));
  }

  #drawLine(values, series, x, y) {
    const { ctx } = this;
    ctx.strokeStyle = this.colours[`series-${series + 1}`];
    ctx.lineWidth = 1.5;
    ctx.setLineDash(DASHES[series]);
    ctx.beginPath();
    let isPenDown = false;
    values.forEach((value, i) => {
      const isThere = Number.isFinite(value);
      if (isThere && isPenDown) ctx.lineTo(x(i), y(value));
      else if (isThere) ctx.moveTo(x(i), y(value));
      isPenDown = isThere;
    });
    ctx.stroke();
    ctx.setLineDash([]);
  }
}
