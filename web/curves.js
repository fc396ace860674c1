// The curves below the time axis, on the same scale: the upward forces of the plates, and the distance from another take.

import { byId, setAttribute, setHidden } from "./dom.js";
import { rounded } from "./format.js";
import { OnDemand } from "./on_demand.js";
import { AXIS_MARGIN_PX } from "./time_axis.js";

const COLOURS = ["panel", "raised", "line", "text", "muted", "force", "bad", "series-1", "series-2", "series-3", "series-4"];
/** Height of a curve, with the space below it. */
const STRIP_PX = 60;
/** Above a curve, so that its title does not cover its peaks. */
const TITLE_PX = 16;
const GAP_PX = 6;
/** Plates that have a curve. */
const PLATES_MAX = 4;

/** The columns of a curve of bins as [x, low, high], in pixels of a width; `valueAt(bin)` is [low, high] or null. Pure. */
export function curveColumns(bins, binFrames, lastRow, width, valueAt) {
  const columns = new Map();
  for (let bin = 0; bin < bins; bin += 1) {
    const value = valueAt(bin);
    if (value === null || !Number.isFinite(value[0]) || !Number.isFinite(value[1])) continue;
    const from = Math.floor(((bin * binFrames) / Math.max(1, lastRow)) * width);
    const to = Math.max(from + 1, Math.ceil((Math.min(lastRow, (bin + 1) * binFrames) / Math.max(1, lastRow)) * width));
    for (let x = from; x < Math.min(to, width); x += 1) {
      const known = columns.get(x);
      columns.set(x, known ? [Math.min(known[0], value[0]), Math.max(known[1], value[1])] : [...value]);
    }
  }
  return [...columns].map(([x, [low, high]]) => [x, low, high]);
}

export class Curves {
  #canvas = byId("curves");

  constructor({ onSeek }) {
    this.drawing = new OnDemand(this.#canvas, COLOURS, () => this.#draw());
    let isDown = false;
    const seek = (event) => {
      if (!this.playback) return;
      const share = (event.offsetX - AXIS_MARGIN_PX) / Math.max(1, this.#canvas.clientWidth - 2 * AXIS_MARGIN_PX);
      onSeek(Math.round(Math.min(1, Math.max(0, share)) * this.playback.lastRow));
    };
    this.#canvas.addEventListener("pointerdown", (event) => {
      this.#canvas.setPointerCapture(event.pointerId);
      isDown = true;
      seek(event);
    });
    this.#canvas.addEventListener("pointermove", (event) => isDown && seek(event));
    for (const kind of ["pointerup", "pointercancel"]) {
      this.#canvas.addEventListener(kind, () => {
        isDown = false;
      });
    }
  }

  /** Shows the curves of a take: `forces` and `comparison` are null if there are none. */
  show({ playback, forces, comparison }) {
    Object.assign(this, { playback, forces, comparison });
    const strips = this.#strips();
    setHidden(this.#canvas, strips.length === 0);
    this.#canvas.style.height = `${strips.length * STRIP_PX}px`;
    setAttribute(this.#canvas, "aria-label", `Over the whole take: ${strips.map(({ title }) => title).join("; ")}`);
    this.invalidate();
  }

  invalidate() {
    if (this.playback && !this.#canvas.hidden) this.drawing.invalidate();
  }

  #strips() {
    const { forces, comparison } = this;
    const strips = [];
    forces?.curves.slice(0, PLATES_MAX).forEach((curve, plate) => {
      const { name } = forces.plates[plate];
      const valueAt = (bin) => [curve[2 * bin], curve[2 * bin + 1]];
      strips.push({ title: `plate ${name}: upward force (N)`, bins: curve.length / 2, binFrames: forces.columnFrames, valueAt, colour: `series-${plate + 1}`, isFromZero: false });
    });
    if (comparison) {
      const { largestByBin } = comparison;
      const valueAt = (bin) => (largestByBin[bin] === null || largestByBin[bin] === undefined ? null : [0, largestByBin[bin]]);
      strips.push({ title: "largest error (mm)", bins: largestByBin.length, binFrames: comparison.binFrames, valueAt, colour: "bad", isFromZero: true });
    }
    return strips;
  }

  #draw() {
    const room = this.drawing.clear();
    if (!room) return;
    this.#strips().forEach((strip, i) => this.#drawStrip(strip, i * STRIP_PX, room.width));
    const { ctx, colours } = this.drawing;
    const x = AXIS_MARGIN_PX + (this.playback.row / Math.max(1, this.playback.lastRow)) * (room.width - 2 * AXIS_MARGIN_PX);
    ctx.fillStyle = colours.text;
    ctx.fillRect(x - 0.75, 0, 1.5, room.height);
  }

  #drawStrip({ title, bins, binFrames, valueAt, colour, isFromZero }, top, width) {
    const { ctx, colours } = this.drawing;
    const inner = width - 2 * AXIS_MARGIN_PX;
    const height = STRIP_PX - GAP_PX;
    ctx.fillStyle = colours.raised;
    ctx.fillRect(AXIS_MARGIN_PX, top, inner, height);
    const columns = curveColumns(bins, binFrames, this.playback.lastRow, inner, valueAt);
    const high = columns.reduce((most, [, , value]) => Math.max(most, value), isFromZero ? 1e-9 : 1);
    const low = isFromZero ? 0 : columns.reduce((least, [, value]) => Math.min(least, value), 0);
    const y = (value) => top + height - 1 - ((value - low) / (high - low)) * (height - 3 - TITLE_PX);
    ctx.fillStyle = colours[colour];
    for (const [x, from, to] of columns) {
      const above = y(to);
      ctx.fillRect(AXIS_MARGIN_PX + x, above, 1, Math.max(1.5, y(from) - above));
    }
    ctx.font = "11px system-ui, sans-serif";
    ctx.textBaseline = "top";
    ctx.textAlign = "left";
    const text = columns.length === 0 ? title : `${title}, ${rounded(high)} at most`;
    const size = ctx.measureText(text).width;
    ctx.fillStyle = colours.raised;
    ctx.globalAlpha = 0.8;
    ctx.fillRect(AXIS_MARGIN_PX + 2, top + 1, size + 6, 15);
    ctx.globalAlpha = 1;
    ctx.fillStyle = colours.muted;
    ctx.fillText(text, AXIS_MARGIN_PX + 5, top + 3);
  }
}
