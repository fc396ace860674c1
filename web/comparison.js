// How far a take is from another one: the distances of the markers in a frame, and the largest ones over time. Pure but for
// drawing.

import { toZUp } from "./camera.js";

/** Classes of distances, from the smallest to the largest; each has a colour and a size. */
export const ERROR_CLASSES = 5;

export class Comparison {
  /** By marker, its index in the other take, or null. */
  markers = [];
  markersMissing = 0;
  /** The frame of the other take that belongs to frame 0. */
  otherFirst = 0;
  binFrames = 1;
  /** By bin, the largest distance in millimetres; null where no sample is in both takes. */
  largestByBin = [];
  /** {error_mm, frame, marker} of the whole take so far, or null. */
  largest = null;
  samples = 0;
  gapsDiffering = 0;
  /** How the frames of the two are matched, as the service states it. */
  frames = {};
  isDamaged = false;
  /** One past the last row that was compared. */
  endRow = 0;
  #sumOfSquares = 0;

  /** `other` is the name of the other take, `buffer` has its frames. */
  constructor(other, buffer) {
    this.other = other;
    this.buffer = buffer;
  }

  /** Adds a part, as GET /v1/takes/{name}/difference states it. */
  add(part) {
    this.markers = part.markers;
    this.markersMissing = part.markers_missing;
    this.otherFirst = part.other_first;
    this.frames = part;
    this.binFrames = part.bin_frames;
    part.max_error_mm.forEach((error, i) => {
      const bin = part.first_bin + i;
      const known = this.largestByBin[bin] ?? null;
      this.largestByBin[bin] = known === null ? error : Math.max(known, error ?? 0);
    });
    if (part.largest && !(this.largest?.error_mm >= part.largest.error_mm)) this.largest = part.largest;
    this.samples += part.samples;
    this.#sumOfSquares += part.sum_of_squares_mm2;
    this.gapsDiffering += part.gaps_differing;
    this.isDamaged ||= part.is_damaged;
    this.endRow = part.end_frame;
  }

  /** The root of the mean square of all distances so far, in millimetres. */
  get rmsMm() {
    return this.samples > 0 ? Math.sqrt(this.#sumOfSquares / this.samples) : NaN;
  }

  otherRow(row) {
    return row + this.otherFirst;
  }

  /** By marker, the position in the other take at a row, three numbers each, NaN where there is none; null if its frames are not loaded. */
  otherPositions(row) {
    const at = this.otherRow(row);
    const { buffer } = this;
    if (this.endRow === 0 || at < 0 || at >= buffer.frames || buffer.shownRow(at) !== at) return null;
    const theirs = buffer.positionsAt(at);
    if (!theirs) return null;
    const positions = new Float32Array(3 * this.markers.length).fill(NaN);
    this.markers.forEach((other, marker) => {
      if (other !== null) positions.set(theirs.subarray(3 * other, 3 * other + 3), 3 * marker);
    });
    return positions;
  }

  /** The class of a distance: 0 to ERROR_CLASSES - 1. */
  classOf(errorMm) {
    const top = this.largest?.error_mm ?? 0;
    return top > 0 ? Math.min(ERROR_CLASSES - 1, Math.floor((errorMm / top) * ERROR_CLASSES)) : 0;
  }
}

/** The distances between two lists of positions, three numbers each; NaN where one is missing. Pure. */
export function distances(ours, theirs) {
  const found = new Float32Array(ours.length / 3);
  for (let i = 0; i < found.length; i += 1) {
    found[i] = Math.hypot(ours[3 * i] - theirs[3 * i], ours[3 * i + 1] - theirs[3 * i + 1], ours[3 * i + 2] - theirs[3 * i + 2]);
  }
  return found;
}

/**
 * The distances from another take: the colour and the size of a marker show the class of its distance, and a line leads to
 * where the other take has it.
 */
export function drawErrors({ comparison, errors, other }, ctx, motion, project, points, { colours }) {
  const [place, at] = [[0, 0, 0], [0, 0, 0]];
  const discs = Array.from({ length: ERROR_CLASSES }, () => new Path2D());
  const lines = new Path2D();
  errors.forEach((error, slot) => {
    const [x, y, radius, seen] = points.subarray(4 * slot, 4 * slot + 4);
    if (seen < 1 || Number.isNaN(error)) return;
    const which = comparison.classOf(error);
    const size = radius * (1 + 0.15 * which);
    discs[which].moveTo(x + size, y);
    discs[which].arc(x, y, size, 0, 2 * Math.PI);
    toZUp(motion.upAxis, ...other.subarray(3 * slot, 3 * slot + 3), place, 0);
    if (!project(...place, at) || Math.hypot(at[0] - x, at[1] - y) < 2) return;
    lines.moveTo(x, y);
    lines.lineTo(at[0], at[1]);
    lines.moveTo(at[0] + 3, at[1]);
    lines.arc(at[0], at[1], 3, 0, 2 * Math.PI);
  });
  ctx.strokeStyle = colours.text;
  ctx.lineWidth = 1.5;
  ctx.stroke(lines);
  ctx.strokeStyle = colours.panel;
  ctx.lineWidth = 1.2;
  discs.forEach((disc, which) => {
    ctx.fillStyle = colours[`error-${which + 1}`];
    ctx.fill(disc);
    ctx.stroke(disc);
  });
}
