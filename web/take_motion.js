// The markers at any row of a take, with their trails and last positions. Pure.

import { toZUp } from "./camera.js";
import { Motion, TRAIL } from "./motion.js";
import { FADE_MS } from "./scene.js";

/** The trail of a second has a point at this rate, as that of the live view. */
const TRAIL_HZ = 30;

export class TakeMotion extends Motion {
  row = -1;

  /** The table of a take's overview. */
  setTake(overview) {
    this.setTable({ labels: [], labelled: [], bones: [], up_axis: overview.up_axis });
    this.setTable(overview);
    this.rateHz = overview.rate_hz;
    this.row = -1;
  }

  /** The time of a row, on the clock of `lastSeenMs`. */
  timeMs(row = this.row) {
    return (row / this.rateHz) * 1000;
  }

  /** Shows a row. `positionsAt(row)` returns its positions, or null if they are not loaded. */
  show(row, positionsAt) {
    const positions = positionsAt(row);
    if (!positions) return false;
    const isNext = row === this.row + 1;
    this.raw = positions;
    this.head = TRAIL - 1;
    this.#showTrail(row, positionsAt);
    this.nSeen = 0;
    for (let slot = 0; slot < this.n; slot += 1) {
      const at = 3 * (this.head * this.n + slot);
      if (Number.isFinite(this.trail[at])) {
        this.nSeen += 1;
        this.lastSeenMs[slot] = this.timeMs(row);
        for (let i = 0; i < 3; i += 1) this.last[3 * slot + i] = this.trail[at + i];
      } else if (!isNext) {
        this.#findLastSeen(slot, row, positionsAt);
      }
    }
    this.row = row;
    return true;
  }

  #showTrail(row, positionsAt) {
    const stride = Math.max(1, Math.round(this.rateHz / TRAIL_HZ));
    for (let age = 0; age < TRAIL; age += 1) {
      const at = row - age * stride;
      const positions = at >= 0 ? positionsAt(at) : null;
      const into = 3 * (TRAIL - 1 - age) * this.n;
      if (!positions) {
        this.trail.fill(NaN, into, into + 3 * this.n);
        continue;
      }
      for (let i = 0; i < 3 * this.n; i += 3) {
        toZUp(this.upAxis, positions[i], positions[i + 1], positions[i + 2], this.trail, into + i);
      }
    }
  }

  /** Searches for the last position of an occluded marker, as far back as it is drawn. */
  #findLastSeen(slot, row, positionsAt) {
    this.lastSeenMs[slot] = -Infinity;
    const first = Math.max(0, row - Math.ceil((FADE_MS / 1000) * this.rateHz));
    for (let at = row - 1; at >= first; at -= 1) {
      const positions = positionsAt(at);
      if (!positions) return;
      if (!Number.isFinite(positions[3 * slot])) continue;
      const [x, y, z] = positions.subarray(3 * slot, 3 * slot + 3);
      toZUp(this.upAxis, x, y, z, this.last, 3 * slot);
      this.lastSeenMs[slot] = this.timeMs(at);
      return;
    }
  }
}
