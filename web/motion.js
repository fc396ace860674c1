// The newest places of the markers, where they came from, and since when they are not seen. Pure: time comes in.

import { upright } from "./camera.js";

/** Frames that a trail has: a second of some thirty. */
export const TRAIL = 30;
/** Markers higher above the floor than this many times their own size are looked at from near, without the floor. */
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
  head = 0;
  nSeen = 0;
  raw = null;
  box = null;

  /** A table of markers: those that were there before, by their names, keep their places and trails. */
  setTable(table) {
    const before = { ...this, slots: new Map(this.labels.map((label, slot) => [label, slot])) };
    this.labels = table.labels.map((label, slot) => label || `u${String(slot + 1).padStart(3, "0")}`);
    this.n = this.labels.length;
    this.labelled = table.labelled;
    this.bones = table.bones.filter((pair) => pair.every((slot) => slot < this.n));
    this.limbs = (table.limbs ?? []).filter((limb) => limb.ends.every((slot) => slot < this.n));
    this.face = table.face ?? null;
    this.facePose = null;
    this.upAxis = table.up_axis;
    /** Millimetres, z up: where each marker was seen last. */
    this.last = new Float32Array(3 * this.n).fill(NaN);
    this.lastSeenMs = new Float64Array(this.n).fill(-Infinity);
    this.trail = new Float32Array(3 * this.n * TRAIL).fill(NaN);
    this.raw = null;
    this.nSeen = 0;
    const isTurned = before.upAxis !== this.upAxis;
    if (isTurned || !this.labels.some((label) => before.slots.has(label))) {
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

  /** A frame at a time in milliseconds of any clock that only goes forward. */
  push(frame, nowMs) {
    const n = Math.min(this.n, frame.positionsMm.length / 3);
    this.head = (this.head + 1) % TRAIL;
    this.raw = frame.positionsMm;
    this.facePose = null;
    this.nSeen = 0;
    for (let slot = 0; slot < this.n; slot += 1) {
      const into = 3 * (this.head * this.n + slot);
      const [x, y, z] = slot < n ? frame.positionsMm.subarray(3 * slot, 3 * slot + 3) : [NaN, NaN, NaN];
      upright(this.upAxis, x, y, z, this.trail, into);
      if (!Number.isFinite(x + y + z)) continue;
      this.nSeen += 1;
      this.lastSeenMs[slot] = nowMs;
      for (let i = 0; i < 3; i += 1) this.last[3 * slot + i] = this.trail[into + i];
    }
  }

  /** The limbs, both of whose ends are seen, that are not as long as the subject's scan has them. */
  limbsOff() {
    return this.limbs.filter(({ ends: [a, b], length_mm, off_mm }) => {
      if (!this.isSeen(a) || !this.isSeen(b)) return false;
      const [p, q] = [a, b].map((slot) => this.last.subarray(3 * slot, 3 * slot + 3));
      return Math.abs(Math.hypot(p[0] - q[0], p[1] - q[1], p[2] - q[2]) - length_mm) > off_mm;
    });
  }

  /** The vertices of the face, z up, three numbers each; null while nobody knows where it is. */
  facePlaced() {
    if (!this.face || !this.facePose) return null;
    const placed = new Float32Array(3 * this.face.vertices_mm.length);
    const p = this.facePose;
    this.face.vertices_mm.forEach(([x, y, z], vertex) => {
      const [a, b, c] = [0, 4, 8].map((row) => p[row] * x + p[row + 1] * y + p[row + 2] * z + p[row + 3]);
      upright(this.upAxis, a, b, c, placed, 3 * vertex);
    });
    return placed;
  }

  isSeen(slot) {
    return Number.isFinite(this.trail[3 * (this.head * this.n + slot)]);
  }

  /**
   * A box about the markers that are seen, without those far away from all others: a reflection at the far wall must not
   * move the eye. The floor beneath is in, but for a face or a hand high above it. It grows at once and shrinks by a part
   * (0 to 1) a call, so that the view stays calm.
   */
  follow(shrink) {
    const now = { low: [0, 0, 0], high: [0, 0, 0] };
    for (let axis = 0; axis < 3; axis += 1) {
      const values = [];
      for (let slot = 0; slot < this.n; slot += 1) {
        if (this.isSeen(slot)) values.push(this.last[3 * slot + axis]);
      }
      if (values.length === 0) return this.box;
      [now.low[axis], now.high[axis]] = together(values);
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

/** The lowest and the highest of the values, without what lies more than half of the middle nine tenths' width beyond. */
function together(values) {
  values.sort((a, b) => a - b);
  const cut = values.length >= 10 ? Math.ceil(values.length * 0.05) : 0;
  const [low, high] = [values[cut], values[values.length - 1 - cut]];
  const reach = (high - low) / 2;
  return [values.find((value) => value >= low - reach), values.findLast((value) => value <= high + reach)];
}
