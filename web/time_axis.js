// The time axis of a take: gaps, lost frames, events, the loop and the current time. It is a slider.

import { tickSeconds } from "./charts.js";
import { byId, setAttribute } from "./dom.js";
import { axisTime, takeTime } from "./format.js";
import { OnDemand } from "./on_demand.js";

const COLOURS = ["panel", "raised", "line", "edge", "text", "muted", "accent", "watch", "bad", "selected"];

/** From top to bottom, in pixels: flags of events, the band of the take, what is loaded, and the times. */
const FLAGS_PX = 18;
const BAND_PX = 26;
const LOADED_PX = 4;
export const AXIS_HEIGHT_PX = FLAGS_PX + BAND_PX + LOADED_PX + 20;
/** Space at both ends, for the handle. */
export const AXIS_MARGIN_PX = 9;
/** Pixels between two times. */
const TICK_PX = 90;
/** A pointer this close to a flag shows its text. */
const REACH_PX = 7;

/** Counts of missing samples and lost frames by bin, added up from parts. Pure. */
export class GapCounts {
  binFrames = 1;
  missing = [];
  lost = [];
  /** One past the last row that was counted. */
  endRow = 0;
  /** Whether anything damaged was found. */
  isDamaged = false;

  add(part) {
    this.binFrames = part.bin_frames;
    part.missing_samples.forEach((n, i) => {
      const bin = part.first_bin + i;
      this.missing[bin] = (this.missing[bin] ?? 0) + n;
      this.lost[bin] = (this.lost[bin] ?? 0) + part.lost_frames[i];
    });
    this.endRow = part.end_frame;
    this.isDamaged ||= part.is_damaged;
  }

  has(bin) {
    return (this.missing[bin] ?? 0) > 0 || (this.lost[bin] ?? 0) > 0;
  }

  /** How many rows from a row on, forward (1) or back (-1), are counted and in a bin without a gap. */
  clearRows(row, direction) {
    const bin = Math.floor(row / this.binFrames);
    if (row >= this.endRow || (bin + 1) * this.binFrames > this.endRow || this.has(bin)) return 0;
    return direction > 0 ? (bin + 1) * this.binFrames - row : row - bin * this.binFrames + 1;
  }
}

/** The markers with a gap that begins at a row: its positions, and those of the row before it, null at the beginning. Pure. */
export function gapsThatBegin(positions, before) {
  const slots = [];
  for (let i = 0; i < positions.length; i += 3) {
    if (Number.isNaN(positions[i]) && !(before && Number.isNaN(before[i]))) slots.push(i / 3);
  }
  return slots;
}

/** Whether a gap of any marker begins at a row: its positions, and those of the row before it, null at the beginning. Pure. */
export function gapBegins(positions, before) {
  for (let i = 0; i < positions.length; i += 3) {
    if (Number.isNaN(positions[i]) && !(before && Number.isNaN(before[i]))) return true;
  }
  return false;
}

export class TimeAxis {
  #canvas = byId("axis");
  /** Everything but the current time, which is drawn again only where it changed. */
  #still = document.createElement("canvas");
  #isStillDirty = true;
  #width = 300;

  /** `onSeek(row)` is called while the pointer is down, `onHint(text)` with the text of the event under it. */
  constructor({ onSeek, onHint }) {
    this.onSeek = onSeek;
    this.onHint = onHint;
    this.drawing = new OnDemand(this.#canvas, COLOURS, () => this.overview && this.#draw(), () => this.invalidate());
    this.#installPointer();
  }

  /** Shows a take. `buffer` says which rows are loaded, `gaps` where samples are missing. */
  show({ overview, playback, buffer, gaps }) {
    Object.assign(this, { overview, playback, buffer, gaps });
    setAttribute(this.#canvas, "aria-valuemax", String(playback.lastRow));
    this.invalidate();
  }

  /** Draws all of the axis again. */
  invalidate() {
    this.#isStillDirty = true;
    this.move();
  }

  /** Draws the current time again. */
  move() {
    this.drawing.invalidate();
  }

  /** The value for assistive technology. */
  announce() {
    const { playback, overview } = this;
    setAttribute(this.#canvas, "aria-valuenow", String(playback.row));
    setAttribute(this.#canvas, "aria-valuetext", `${takeTime(playback.seconds)} of ${takeTime(overview.seconds)}, frame ${overview.first_frame + playback.row}`);
  }

  #installPointer() {
    const canvas = this.#canvas;
    let isDown = false;
    const seek = (event) => this.playback && this.onSeek(this.#rowAt(event.offsetX));
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      isDown = true;
      seek(event);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (isDown) seek(event);
      if (this.overview) this.onHint(this.#hintAt(event.offsetX));
    });
    const up = () => {
      isDown = false;
    };
    canvas.addEventListener("pointerup", up);
    canvas.addEventListener("pointercancel", up);
    canvas.addEventListener("pointerleave", () => this.onHint(null));
  }

  #x(row) {
    return AXIS_MARGIN_PX + (row / Math.max(1, this.playback.lastRow)) * (this.#width - 2 * AXIS_MARGIN_PX);
  }

  #rowAt(x) {
    const share = (x - AXIS_MARGIN_PX) / Math.max(1, this.#width - 2 * AXIS_MARGIN_PX);
    return Math.round(Math.min(1, Math.max(0, share)) * this.playback.lastRow);
  }

  #hintAt(x) {
    const { events, rate_hz: rateHz } = this.overview;
    const near = events.filter(({ frame }) => Math.abs(this.#x(frame) - x) <= REACH_PX);
    const text = near.slice(0, 3).map(({ frame, kind, text: words }) => `${takeTime(frame / rateHz)} ${kind}${words ? `: ${words}` : ""}`);
    return text.length > 0 ? text.join(" · ") : takeTime(this.#rowAt(x) / rateHz);
  }

  #draw() {
    const { ctx } = this.drawing;
    const room = this.drawing.clear();
    if (!room) return;
    this.#width = room.width;
    if (this.#still.width !== this.#canvas.width || this.#still.height !== this.#canvas.height) {
      [this.#still.width, this.#still.height] = [this.#canvas.width, this.#canvas.height];
      this.#isStillDirty = true;
    }
    if (this.#isStillDirty) {
      this.#isStillDirty = false;
      this.#drawStill(this.#still.getContext("2d"), room.ratio);
    }
    ctx.setTransform(1, 0, 0, 1, 0, 0);
    ctx.drawImage(this.#still, 0, 0);
    ctx.setTransform(room.ratio, 0, 0, room.ratio, 0, 0);
    this.#drawCurrent(ctx);
  }

  #drawStill(ctx, ratio) {
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    ctx.clearRect(0, 0, this.#width, AXIS_HEIGHT_PX);
    ctx.fillStyle = this.drawing.colours.raised;
    ctx.fillRect(AXIS_MARGIN_PX, FLAGS_PX, this.#width - 2 * AXIS_MARGIN_PX, BAND_PX);
    this.#drawLoaded(ctx);
    this.#drawGaps(ctx);
    this.#drawLoop(ctx);
    this.#drawTimes(ctx);
    this.#drawEvents(ctx);
  }

  #drawLoaded(ctx) {
    const { buffer } = this;
    ctx.fillStyle = this.drawing.colours.accent;
    for (const [first, end] of buffer.ranges()) {
      const x = this.#x(first);
      ctx.fillRect(x, FLAGS_PX + BAND_PX + 1, Math.max(1, this.#x(Math.min(end, this.playback.lastRow)) - x), LOADED_PX - 2);
    }
  }

  /** Missing samples as bars, whose height is their share; lost frames as hatching over the whole height. */
  #drawGaps(ctx) {
    const { gaps, overview } = this;
    const bottom = FLAGS_PX + BAND_PX;
    const columns = new Map();
    gaps.missing.forEach((missing, bin) => {
      if (!gaps.has(bin)) return;
      const frames = Math.min(gaps.binFrames, overview.frames - bin * gaps.binFrames);
      const from = Math.floor(this.#x(bin * gaps.binFrames));
      const to = Math.max(from + 1, Math.ceil(this.#x(Math.min(this.playback.lastRow, (bin + 1) * gaps.binFrames))));
      for (let x = from; x < to; x += 1) {
        const column = columns.get(x) ?? { share: 0, isLost: false };
        column.share = Math.max(column.share, missing / Math.max(1, frames * overview.markers));
        column.isLost ||= gaps.lost[bin] > 0;
        columns.set(x, column);
      }
    });
    for (const [x, { share, isLost }] of columns) {
      if (share > 0) {
        const height = Math.max(3, Math.sqrt(share) * BAND_PX);
        ctx.fillStyle = this.drawing.colours.watch;
        ctx.fillRect(x, bottom - height, 1, height);
      }
      if (!isLost) continue;
      ctx.fillStyle = this.drawing.colours.bad;
      for (let y = -(x % 4); y < BAND_PX; y += 4) {
        const top = Math.max(0, y);
        ctx.fillRect(x, FLAGS_PX + top, 1, Math.max(0, Math.min(BAND_PX, y + 2) - top));
      }
    }
    const read = this.#x(Math.min(gaps.endRow, this.playback.lastRow));
    if (gaps.endRow >= overview.frames) return;
    // The part whose gaps are not known yet.
    ctx.strokeStyle = this.drawing.colours.edge;
    ctx.setLineDash([2, 5]);
    ctx.lineWidth = 1;
    ctx.beginPath();
    ctx.moveTo(read, bottom - 1.5);
    ctx.lineTo(this.#width - AXIS_MARGIN_PX, bottom - 1.5);
    ctx.stroke();
    ctx.setLineDash([]);
  }

  #drawLoop(ctx) {
    const { playback } = this;
    if (!playback.loop) return;
    const [from, to] = playback.loop.map((row) => this.#x(row));
    ctx.fillStyle = this.drawing.colours.accent;
    ctx.globalAlpha = 0.22;
    ctx.fillRect(from, FLAGS_PX, to - from, BAND_PX);
    ctx.globalAlpha = 1;
    ctx.strokeStyle = this.drawing.colours.accent;
    ctx.lineWidth = 2;
    for (const [x, inward] of [[from, 5], [to, -5]]) {
      ctx.beginPath();
      ctx.moveTo(x + inward, FLAGS_PX + 1);
      ctx.lineTo(x, FLAGS_PX + 1);
      ctx.lineTo(x, FLAGS_PX + BAND_PX - 1);
      ctx.lineTo(x + inward, FLAGS_PX + BAND_PX - 1);
      ctx.stroke();
    }
  }

  #drawTimes(ctx) {
    const { overview } = this;
    const width = this.#width - 2 * AXIS_MARGIN_PX;
    const step = tickSeconds((overview.seconds * TICK_PX) / width);
    ctx.font = "12px system-ui, sans-serif";
    ctx.textBaseline = "alphabetic";
    ctx.fillStyle = this.drawing.colours.muted;
    for (let i = 0; i * step <= overview.seconds; i += 1) {
      const x = this.#x(i * step * overview.rate_hz);
      ctx.fillRect(x, FLAGS_PX + BAND_PX, 1, LOADED_PX + 3);
      const text = axisTime(i * step, step);
      const half = ctx.measureText(text).width / 2;
      ctx.textAlign = "center";
      ctx.fillText(text, Math.min(this.#width - half, Math.max(half, x)), AXIS_HEIGHT_PX - 3);
    }
  }

  /** A mark is a triangle, any other event a diamond. */
  #drawEvents(ctx) {
    const { overview } = this;
    for (const { frame, kind } of overview.events) {
      const x = this.#x(Math.min(frame, this.playback.lastRow));
      ctx.fillStyle = kind === "mark" ? this.drawing.colours.selected : this.drawing.colours.muted;
      ctx.beginPath();
      if (kind === "mark") {
        ctx.moveTo(x - 5, 3);
        ctx.lineTo(x + 5, 3);
        ctx.lineTo(x, 12);
      } else {
        ctx.moveTo(x, 2);
        ctx.lineTo(x + 4.5, 7);
        ctx.lineTo(x, 12);
        ctx.lineTo(x - 4.5, 7);
      }
      ctx.fill();
      ctx.fillRect(x - 0.5, 11, 1, FLAGS_PX - 11);
    }
  }

  #drawCurrent(ctx) {
    const x = this.#x(this.playback.row);
    ctx.fillStyle = this.drawing.colours.text;
    ctx.fillRect(x - 1, FLAGS_PX - 5, 2, BAND_PX + LOADED_PX + 8);
    ctx.strokeStyle = this.drawing.colours.panel;
    ctx.lineWidth = 2;
    ctx.beginPath();
    ctx.arc(x, FLAGS_PX + BAND_PX / 2, 7, 0, 2 * Math.PI);
    ctx.fill();
    ctx.stroke();
  }
}
