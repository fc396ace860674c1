// The latest positions of the markers, their trails and when each was last visible. Pure: times are arguments.

import { toZUp } from "./camera.js";

/** Frames in a trail: one second at some thirty frames per second. */
export const TRAIL = 30;
/** Frames after which poses are out of date: a third of a second. */
const POSES_KEPT = 10;
/** Markers higher above the floor than this many times their extent are shown close up, without the floor. */
const CLOSE_UP = 2;

export class Motion {
  n = 0;
  upAxis = 0;
  labels = [];
  labelled = [];
  bones = [];
  limbs = [];
  face = null;
  facePose = null;
  /** The rigid bodies: {names, values, frames, tracked}; `values` is null while no poses are known. */
  bodies = { names: [], values: null, frames: 0, tracked: [] };
  #posesAge = 0;
  head = 0;
  nSeen = 0;
  raw = null;
  box = null;

  /** Sets the table of markers; markers whose labels were in the previous table keep their positions and trails. */
  setTable(table) {
    const before = { ...this, slots: new Map(this.labels.map((label, slot) => [label, slot])) };
    this.labels = table.labels.map((label, slot) => label || `u${String(slot + 1).padStart(3, "0")}`);
    this.n = this.labels.length;
    this.labelled = table.labelled;
    this.bones = table.bones.filter((pair) => pair.every((slot) => slot < this.n));
    this.limbs = (table.limbs ?? []).filter((limb) => limb.ends.every((slot) => slot < this.n));
    this.face = table.face ?? null;
    this.facePose = null;
    this.bodies = { names: table.bodies ?? [], values: null, frames: 0, tracked: [] };
    this.upAxis = table.up_axis;
    /** The last visible position of each marker, in millimetres, z up. */
    this.last = new Float32Array(3 * this.n).fill(NaN);
    this.lastSeenMs = new Float64Array(this.n).fill(-Infinity);
    this.trail = new Float32Array(3 * this.n * TRAIL).fill(NaN);
    this.raw = null;
    this.nSeen = 0;
    const isAxisChanged = before.upAxis !== this.upAxis;
    if (isAxisChanged || !this.labels.some((label) => before.slots.has(label))) {
      [this.head, this.box] = [0, null];
      return;
    }
    this.labels.forEach((label, slot) => {
      const from = before.slots.get(label);
      if (from === undefined) return;
      this.lastSeenMs[slot] = before.lastSeenMs[from];
      this.last.set(before.last.subarray(3 * from, 3 * from + 3), 3 * slot);
      for (let age = 0; age < TRAIL; age += 1) {
        const at = 3 * (age * before.n + from);
        this.trail.set(before.trail.subarray(at, at + 3), 3 * (age * this.n + slot));
      }
    });
  }

  /** Adds a frame; `nowMs` is the time of any monotonic clock in milliseconds. */
  push(frame, nowMs) {
    const n = Math.min(this.n, frame.positionsMm.length / 3);
    this.head = (this.head + 1) % TRAIL;
    this.raw = frame.positionsMm;
    this.facePose = null;
    this.#posesAge += 1;
    if (this.#posesAge > POSES_KEPT) this.bodies.values = null;
    this.nSeen = 0;
    for (let slot = 0; slot < this.n; slot += 1) {
      const into = 3 * (this.head * this.n + slot);
      const [x, y, z] = slot < n ? frame.positionsMm.subarray(3 * slot, 3 * slot + 3) : [NaN, NaN, NaN];
      toZUp(this.upAxis, x, y, z, this.trail, into);
      if (!Number.isFinite(x + y + z)) continue;
      this.nSeen += 1;
      this.lastSeenMs[slot] = nowMs;
      for (let i = 0; i < 3; i += 1) this.last[3 * slot + i] = this.trail[into + i];
    }
  }

  /** Sets the poses of the bodies, which belong to the last frame. */
  setPoses({ values, frames, tracked }) {
    Object.assign(this.bodies, { values, frames, tracked });
    this.#posesAge = 0;
  }

  /** The origins of the bodies that have a pose, z up. */
  #origins() {
    const { names, values } = this.bodies;
    const origins = [];
    for (let body = 0; values && body < Math.min(names.length, values.length / 9); body += 1) {
      const [state, , x, y, z] = values.subarray(9 * body, 9 * body + 5);
      if (state !== 0 || !Number.isFinite(x + y + z)) continue;
      const origin = [0, 0, 0];
      toZUp(this.upAxis, x, y, z, origin, 0);
      origins.push(origin);
    }
    return origins;
  }

  /** Limbs with both ends visible whose length deviates from the subject's scan by more than `off_mm`. */
  deviatingLimbs() {
    return this.limbs.filter(({ ends: [a, b], length_mm, off_mm }) => {
      if (!this.isSeen(a) || !this.isSeen(b)) return false;
      const [p, q] = [a, b].map((slot) => this.last.subarray(3 * slot, 3 * slot + 3));
      return Math.abs(Math.hypot(p[0] - q[0], p[1] - q[1], p[2] - q[2]) - length_mm) > off_mm;
    });
  }

  /** The vertices of the face, z up, three numbers each; null while its pose is unknown. */
  placedFace() {
    if (!this.face || !this.facePose) return null;
    const placed = new Float32Array(3 * this.face.vertices_mm.length);
    const p = this.facePose;
    this.face.vertices_mm.forEach(([x, y, z], vertex) => {
      const [a, b, c] = [0, 4, 8].map((row) => p[row] * x + p[row + 1] * y + p[row + 2] * z + p[row + 3]);
      toZUp(this.upAxis, a, b, c, placed, 3 * vertex);
    });
    return placed;
  }

  isSeen(slot) {
    return Number.isFinite(this.trail[3 * (this.head * this.n + slot)]);
  }

  /**
   * Updates the box around the visible markers, without outliers: a reflection at the far wall must not move the camera.
   * The box reaches down to the floor, except for a face or a hand high above it. It grows at once and shrinks by a
   * fraction (0 to 1) per call, so that the view stays steady.
   */
  updateBox(shrink) {
    const now = { low: [0, 0, 0], high: [0, 0, 0] };
    const origins = this.#origins();
    for (let axis = 0; axis < 3; axis += 1) {
      const values = origins.map((origin) => origin[axis]);
      for (let slot = 0; slot < this.n; slot += 1) {
        if (this.isSeen(slot)) values.push(this.last[3 * slot + axis]);
      }
      if (values.length === 0) return this.box;
      [now.low[axis], now.high[axis]] = robustRange(values);
    }
    const size = Math.max(...now.high.map((high, axis) => high - now.low[axis]));
    const height = now.low[2];
    const isCloseUp = this.nSeen >= 4 && height > CLOSE_UP * size;
    if (height > 0 && height < 2500 && !isCloseUp) now.low[2] = 0;
    if (!this.box) this.box = now;
    for (let i = 0; i < 3; i += 1) {
      const { low, high } = this.box;
      low[i] = now.low[i] < low[i] ? now.low[i] : low[i] + (now.low[i] - low[i]) * shrink;
      high[i] = now.high[i] > high[i] ? now.high[i] : high[i] + (now.high[i] - high[i]) * shrink;
    }
    return this.box;
  }
}

/** Minimum and maximum without outliers: values more than half the 5th to 95th percentile range beyond it. */
function robustRange(values) {
  values.sort((a, b) => a - b);
  const cut = values.length >= 10 ? Math.ceil(values.length * 0.05) : 0;
  const [low, high] = [values[cut], values[values.length - 1 - cut]];
  const reach = (high - low) / 2;
  return [values.find((value) => value >= low - reach), values.findLast((value) => value <= high + reach)];
}
