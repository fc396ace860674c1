// The position in a take: play, pause, speed, seek, step and loop. Pure: elapsed times are arguments.

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8];

/** Up to this many frames per second each one is drawn, with a margin over a display's 60 Hz. */
const EVERY_FRAME_HZ = 62;
/** How far drawing may lag behind the clock: beyond this, the clock waits, and playback is slower than real time. */
const LAG_MAX_S = 0.25;
/** A longer pause between two drawings, of a hidden page, is not made up. */
const ELAPSED_MAX_MS = 250;

export class Playback {
  row = 0;
  isPlaying = false;
  speed = 1;
  /** Rows that are repeated, [first, last], or null. */
  loop = null;
  /** The exact position in rows; its whole part is ahead of `row` while drawing lags behind. */
  #position = 0;

  constructor(frames, rateHz) {
    this.frames = frames;
    this.rateHz = rateHz;
  }

  get seconds() {
    return this.row / this.rateHz;
  }

  get lastRow() {
    return Math.max(0, this.frames - 1);
  }

  /** Rows per second of the page's clock. */
  get rowsPerSecond() {
    return this.rateHz * this.speed;
  }

  /** Plays, from the beginning if the end was reached. */
  play() {
    const [first, last] = this.loop ?? [0, this.lastRow];
    if (this.row >= last || this.row < first) this.seek(first);
    this.isPlaying = this.frames > 1;
  }

  pause() {
    this.isPlaying = false;
    this.#position = this.row;
  }

  toggle() {
    if (this.isPlaying) this.pause();
    else this.play();
  }

  seek(row) {
    this.row = Math.min(this.lastRow, Math.max(0, Math.round(row)));
    this.#position = this.row;
  }

  /** Pauses, and goes some rows forward or back. */
  step(rows) {
    this.pause();
    this.seek(this.row + rows);
  }

  /** Selects the next faster (1) or slower (-1) speed. */
  changeSpeed(by) {
    const at = SPEEDS.indexOf(this.speed);
    this.speed = SPEEDS[Math.min(SPEEDS.length - 1, Math.max(0, at + by))];
  }

  /** The loop begins at the current row. */
  loopFrom() {
    const last = this.loop && this.loop[1] > this.row ? this.loop[1] : this.lastRow;
    this.loop = this.row < last ? [this.row, last] : null;
  }

  /** The loop ends at the current row. */
  loopTo() {
    const first = this.loop && this.loop[0] < this.row ? this.loop[0] : 0;
    this.loop = first < this.row ? [first, this.row] : null;
  }

  clearLoop() {
    this.loop = null;
  }

  /**
   * Moves on by the time since the last drawing, and returns whether the row changed. `isReady(row)` says whether a row
   * can be drawn; the position waits for one that cannot. No row is skipped while rows are no more frequent than
   * drawings of a 60 Hz display.
   */
  advance(elapsedMs, isReady) {
    if (!this.isPlaying) return false;
    const rate = this.rowsPerSecond;
    const position = this.#position + (rate * Math.min(elapsedMs, ELAPSED_MAX_MS)) / 1000;
    const due = Math.floor(position);
    const next = rate <= EVERY_FRAME_HZ ? Math.min(due, this.row + 1) : due;
    const [first, last] = this.loop ?? [0, this.lastRow];
    if (next > last) return this.#end(first, last, isReady);
    if (next !== this.row && !isReady(next)) {
      this.#position = this.row;
      return false;
    }
    this.#position = Math.min(position, next + 1 + LAG_MAX_S * rate);
    const isChanged = next !== this.row;
    this.row = next;
    return isChanged;
  }

  /** At the last row: a loop begins again, otherwise playback ends. The last row is drawn in any case. */
  #end(first, last, isReady) {
    const before = this.row;
    if (before < last && isReady(last)) this.row = this.#position = last;
    else if (before >= last && this.loop && isReady(first)) this.row = this.#position = first;
    else if (before >= last && !this.loop) this.pause();
    return this.row !== before;
  }
}
