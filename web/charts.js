// The charts below the scene: the coordinates and the speed of the chosen markers around the current time.

import { byId, setText } from "./dom.js";
import { axisTime, rounded } from "./format.js";
import { OnDemand, drawColumns } from "./on_demand.js";

const COLOURS = ["panel", "line", "text", "muted", "series-1", "series-2", "series-3", "series-4"];
/** Markers shown at once: as many as there are lines that differ in colour and in pattern. */
export const CHOSEN_MAX = 4;
export const DASHES = [[], [7, 3], [2, 3], [9, 3, 2, 3]];
/** Seconds shown. */
const SPAN_S = 10;
/** Space for the numbers at the left, and for the times below, in pixels. */
const LEFT_PX = 62;
const TIMES_PX = 20;
/** Pixels between two times. */
const TICK_PX = 80;
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

/** Seconds between two times of an axis: a round number, so that they are at least `minimum` apart. Pure. */
export function tickSeconds(minimum) {
  const steps = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14_400, 43_200];
  return steps.find((step) => step >= minimum) ?? Math.ceil(minimum / 86_400) * 86_400;
}

export class Charts {
  chosen = [];

  constructor() {
    this.drawing = new OnDemand(byId("charts"), COLOURS, () => this.overview && this.#draw());
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
    this.drawing.invalidate();
  }

  #draw() {
    const { ctx } = this.drawing;
    const room = this.drawing.clear();
    if (!room) return;
    const { width, height } = room;
    const [first, last] = chartRows(this.playback.row, this.overview.frames, this.overview.rate_hz);
    const rows = [];
    const step = Math.max(1, Math.ceil((last - first) / Math.max(100, width - LEFT_PX)));
    // Whole multiples of the step, so that the lines do not flicker as time goes on.
    for (let row = Math.ceil(first / step) * step; row <= last; row += step) rows.push(row);
    const x = (row) => LEFT_PX + ((row - first) / Math.max(1, last - first)) * (width - LEFT_PX - 4);
    const names = ["x", "y", "z", "speed"];
    const stripPx = (height - TIMES_PX) / names.length;
    names.forEach((name, i) => {
      const strip = { name, top: i * stripPx + 4, height: stripPx - 8, x, width };
      this.#drawStrip(strip, rows, step, i);
    });
    this.#drawTimes([first, last], x, width, height);
    ctx.fillStyle = this.drawing.colours.text;
    ctx.fillRect(x(this.playback.row) - 0.5, 0, 1.5, height - TIMES_PX);
  }

  /** The times below the lowest chart, and the range in the title. */
  #drawTimes([first, last], x, width, height) {
    const { ctx, colours } = this.drawing;
    const rateHz = this.overview.rate_hz;
    const [from, to] = [first / rateHz, last / rateHz];
    const step = tickSeconds(((to - from) * TICK_PX) / Math.max(1, width - LEFT_PX));
    ctx.font = "12px system-ui, sans-serif";
    ctx.textBaseline = "alphabetic";
    ctx.textAlign = "center";
    ctx.fillStyle = colours.muted;
    for (let i = Math.ceil(from / step - 1e-9); i * step <= to; i += 1) {
      const at = x(i * step * rateHz);
      ctx.fillRect(at, height - TIMES_PX, 1, 5);
      const text = axisTime(i * step, step);
      const half = ctx.measureText(text).width / 2;
      ctx.fillText(text, Math.min(width - half, at), height - 3);
    }
    if (this.chosen.length > 0) setText(byId("charts-note"), `${axisTime(from, 0.1)} to ${axisTime(to, 0.1)}`);
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
    const { ctx, colours } = this.drawing;
    const lines = this.chosen.map((slot) => this.#columns(slot, rows, step, quantity));
    const ends = lines.flat().flatMap((found) => (found ? [found.low, found.high] : []));
    const range = limits(ends, quantity === 3 ? 0.1 : 20);
    ctx.strokeStyle = colours.line;
    ctx.lineWidth = 1;
    ctx.strokeRect(LEFT_PX + 0.5, top + 0.5, width - LEFT_PX - 4, height);
    ctx.fillStyle = colours.muted;
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
    const { ctx, colours } = this.drawing;
    ctx.strokeStyle = colours[`series-${series + 1}`];
    ctx.lineWidth = 1.5;
    ctx.setLineDash(DASHES[series]);
    drawColumns(ctx, columns, x, y);
    ctx.setLineDash([]);
  }
}
