// How far a take is from another one: the distances of the markers in a frame, and the largest ones over time. Pure.

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
