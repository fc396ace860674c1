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
 * The speed of a marker at a row in metres per second, from its positions at both sides; NaN in a gap and beside one. Pure.
 * Only every n-th row may be loaded: then it is that of the loaded row before.
 */
export function speedAt(positionsAt, slot, row, rateHz, every = 1) {
  const at = Math.floor(row / every) * every;
  const reach = Math.ceil(Math.max(1, Math.round(SPEED_S * rateHz)) / every) * every;
  const [before, now, after] = [at - reach, at, at + reach].map((near) => (near >= 0 ? positionsAt(near) : null));
  if (!before || !after || !now || Number.isNaN(now[3 * slot])) return NaN;
  const i = 3 * slot;
  return (Math.hypot(after[i] - before[i], after[i + 1] - before[i + 1], after[i + 2] - before[i + 2]) * rateHz) / (2 * reach) / 1000;
}

/**
 * The rows of a column of a chart as {first, low, high, last, isWhole}, so that neither a peak nor a gap of one row is left
 * out; `valueAt(row)` is NaN in a gap. Null if no row has a value. Pure.
 */
export function column(valueAt, firstRow, rows) {
  let found = null;
  let isWhole = true;
  for (let row = firstRow; row < firstRow + rows; row += 1) {
    const value = valueAt(row);
    if (Number.isNaN(value)) {
      isWhole = false;
      continue;
    }
    found ??= { first: value, low: value, high: value, last: value, isWhole };
    found.last = value;
    if (value < found.low) found.low = value;
    if (value > found.high) found.high = value;
  }
  if (found) found.isWhole = isWhole;
  return found;
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
  /** Duration of the last drawing. */
  drawMs = 0;

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
      const beganMs = performance.now();
      if (this.overview) this.#draw();
      this.drawMs = performance.now() - beganMs;
    });
  }

  #draw() {
    const { ctx } = this;
    const ratio = Math.min(2, devicePixelRatio || 1);
    const { clientWidth: width, clientHeight: height } = this.#canvas;
    if (width < 100 || height < 60) return;
    const size = [width, height].map((length) => Math.round(length * ratio));
    if (this.#canvas.width !== size[0] || this.#canvas.height !== size[1]) [this.#canvas.width, this.#canvas.height] = size;
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    ctx.clearRect(0, 0, width, height);
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
      this.#drawStrip(strip, rows, step, i);
    });
    ctx.fillStyle = this.colours.text;
    ctx.fillRect(x(this.playback.row) - 0.5, 0, 1.5, height);
  }

  /** The columns of a marker, each of `step` rows. */
  #columns(slot, rows, step, quantity) {
    const { buffer, overview } = this;
    const { positionsAt, every } = buffer;
    const valueAt = quantity === 3
      ? (row) => speedAt(positionsAt, slot, row, overview.rate_hz, every)
      : (row) => positionsAt(row)?.[3 * slot + quantity] ?? NaN;
    return rows.map((row) => column(valueAt, row, Math.min(step, overview.frames - row)));
  }

  #drawStrip({ name, top, height, x, width }, rows, step, quantity) {
    const { ctx } = this;
    const lines = this.chosen.map((slot) => this.#columns(slot, rows, step, quantity));
    const ends = lines.flat().flatMap((found) => (found ? [found.low, found.high] : []));
    const range = limits(ends, quantity === 3 ? 0.1 : 20);
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

  #drawLine(columns, series, x, y) {
    const { ctx } = this;
    ctx.strokeStyle = this.colours[`series-${series + 1}`];
    ctx.lineWidth = 1.5;
    ctx.setLineDash(DASHES[series]);
    ctx.beginPath();
    let isPenDown = false;
    columns.forEach((found, i) => {
      if (!found) {
        isPenDown = false;
        return;
      }
      const at = x(i);
      if (isPenDown && found.isWhole) ctx.lineTo(at, y(found.first));
      else ctx.moveTo(at, y(found.first));
      if (found.low !== found.high) {
        for (const value of [found.high, found.low, found.last]) ctx.lineTo(at, y(value));
      } else if (!found.isWhole) {
        // A row beside a gap, which no line reaches.
        ctx.lineTo(at, y(found.first) + 1);
      }
      isPenDown = found.isWhole;
    });
    ctx.stroke();
    ctx.setLineDash([]);
  }
}
