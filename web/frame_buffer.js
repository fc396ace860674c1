// The frames of a take around the current row, loaded by windows. Memory is bounded, however long the take is.

/** Bytes of all windows that are kept. */
const KEPT_BYTES_MAX = 48e6;
/** Bytes and seconds of a window: small enough to load quickly, large enough that there are few requests. */
const WINDOW_BYTES = 400_000;
const WINDOW_S = 10;
/** The shortest window, unless a response cannot hold it. */
const WINDOW_S_MIN = 0.5;
/** Windows requested at once. */
const PENDING_MAX = 2;
/** Seconds of the page's clock that are loaded ahead while playing. */
const AHEAD_S = 3;
/** Bytes per second above which playback loads only the frames that a display can show. */
const BYTES_PER_S_MAX = 6e6;
const DISPLAY_HZ = 60;
/** A window that could not be read is tried again after this time, while it is needed. */
const RETRY_MS = 3000;

/** The frame of a take without markers. */
const NOTHING = new Float32Array(0);

export class FrameBuffer {
  /** Only every n-th row is loaded. */
  every = 1;
  /** Whether a window said that something in it is damaged. */
  isDamaged = false;
  #windows = new Map();
  /** The windows that are being loaded, by index: the promise, what cancels the request, and whether somebody awaits it. */
  #pending = new Map();
  #failed = new Set();
  #wanted = [];

  /**
   * `source.window(firstRow, rows, every, signal)` resolves to {firstRow, every, frames, positions}; if the source `canCancel`,
   * the signal ends requests for what is not wanted any more, behind which others would wait. `onLoaded` is called after
   * each window, `onFailed` with the error of one that cannot be read. Of all windows `keptBytesMax` are kept.
   */
  constructor(source, overview, { onLoaded = () => {}, onFailed = () => {}, keptBytesMax = KEPT_BYTES_MAX } = {}) {
    this.source = source;
    this.n = overview.markers;
    this.frames = overview.frames;
    this.rateHz = overview.rate_hz;
    this.onLoaded = onLoaded;
    this.onFailed = onFailed;
    const bytes = 12 * Math.max(1, this.n);
    const shortest = Math.ceil(WINDOW_S_MIN * this.rateHz);
    const rows = Math.max(shortest, Math.min(Math.ceil(WINDOW_S * this.rateHz), Math.floor(WINDOW_BYTES / bytes)));
    /** Frames of a window. */
    this.windowFrames = source.windowFrames ?? Math.max(1, Math.min(rows, overview.window_frames_max));
    this.keptMax = Math.max(6, Math.floor(keptBytesMax / (bytes * this.windowFrames)));
  }

  /** The positions of a row, or of the loaded row before it while rows are left out; null if they are not loaded. */
  positionsAt = (row) => {
    if (this.n === 0) return NOTHING;
    const window = this.#windows.get(this.#index(row));
    if (!window) return null;
    const frame = Math.floor((row - window.firstRow) / window.every);
    if (frame < 0 || frame >= window.frames) return null;
    return window.positions.subarray(3 * this.n * frame, 3 * this.n * (frame + 1));
  };

  /** The row whose frame is shown for a row: that before it, while rows are left out. */
  shownRow(row) {
    return Math.floor(row / this.every) * this.every;
  }

  has(row) {
    return this.positionsAt(row) !== null;
  }

  /** Ranges of rows that are loaded, [first, end], in no order. */
  ranges() {
    return [...this.#windows.values()].map(({ firstRow, frames, every }) => [firstRow, firstRow + frames * every]);
  }

  /** Loads the window of a row, and those around it that playback needs next. `rowsPerSecond` is 0 in a pause. */
  want(row, rowsPerSecond = 0, loop = null) {
    if (this.n === 0) return;
    this.#chooseEvery(rowsPerSecond);
    const at = this.#index(row);
    const span = this.windowFrames * this.every;
    const ahead = Math.max(1, Math.ceil((rowsPerSecond * AHEAD_S) / span));
    const wanted = [at];
    for (let i = 1; i <= Math.min(ahead, this.keptMax - 3); i += 1) {
      if (loop && (at + i) * span > loop[1]) {
        wanted.push(this.#index(loop[0]));
        break;
      }
      wanted.push(at + i);
    }
    wanted.push(at - 1);
    this.#wanted = wanted.filter((index) => index >= 0 && index * span < this.frames);
    // The windows in use are the last to be removed.
    for (const index of [...this.#wanted].reverse()) {
      const window = this.#windows.get(index);
      if (window && this.#windows.delete(index)) this.#windows.set(index, window);
    }
    this.#cancelOthers();
    this.#request();
  }

  /** Ends the requests for windows that were wanted before a jump. */
  #cancelOthers() {
    if (!this.source.canCancel) return;
    for (const [index, { cancel, isAwaited }] of [...this.#pending]) {
      if (isAwaited || this.#wanted.includes(index)) continue;
      this.#pending.delete(index);
      cancel.abort();
    }
  }

  /** Loads the window of a row, if it can be, and returns whether it has the row. */
  async fetch(row) {
    if (this.n === 0) return false;
    const index = this.#index(row);
    if (!this.#windows.has(index)) {
      const pending = this.#pending.get(index) ?? this.#load(index);
      pending.isAwaited = true;
      await pending.loading;
    }
    return this.has(row);
  }

  /** Resolves when no window is being loaded. */
  async idle() {
    while (this.#pending.size > 0) await Promise.allSettled([...this.#pending.values()].map(({ loading }) => loading));
  }

  /** The first row of the window after that of a row (1), or the last row of the one before it (-1). */
  beside(row, direction) {
    const span = this.windowFrames * this.every;
    return direction > 0 ? (this.#index(row) + 1) * span : this.#index(row) * span - 1;
  }

  /** Whether playback has to wait for the row: it is not loaded, and can be. */
  isWaitingFor(row) {
    return !this.has(row) && !this.#failed.has(this.#index(row));
  }

  #index(row) {
    return Math.floor(row / (this.windowFrames * this.every));
  }

  /** Takes of very many markers, and high speeds: what no display can show is not loaded. */
  #chooseEvery(rowsPerSecond) {
    // A source whose windows are given has all frames at hand.
    const needed = this.source.windowFrames ? 1 : (12 * this.n * rowsPerSecond) / BYTES_PER_S_MAX;
    let every = 1;
    while (every < needed && rowsPerSecond / (2 * every) >= DISPLAY_HZ) every *= 2;
    if (every === this.every) return;
    this.every = every;
    this.#windows.clear();
    this.#failed.clear();
    if (this.source.canCancel) this.#pending.forEach(({ cancel }) => cancel.abort());
    this.#pending.clear();
  }

  #request() {
    for (const index of this.#wanted) {
      if (this.#pending.size >= PENDING_MAX) return;
      if (this.#windows.has(index) || this.#pending.has(index) || this.#failed.has(index)) continue;
      this.#load(index);
    }
  }

  #load(index) {
    const pending = { loading: null, cancel: new AbortController(), isAwaited: false };
    this.#pending.set(index, pending);
    pending.loading = this.#loadWindow(index, pending);
    return pending;
  }

  async #loadWindow(index, pending) {
    const { every, windowFrames } = this;
    const { signal } = pending.cancel;
    try {
      const firstRow = index * windowFrames * every;
      const rows = Math.min(windowFrames * every, this.frames - firstRow);
      const window = await this.#read(firstRow, rows, every, signal);
      if (every !== this.every) return;
      this.#windows.set(index, window);
      this.isDamaged ||= window.isDamaged;
      this.#failed.delete(index);
      while (this.#windows.size > this.keptMax) this.#windows.delete(this.#windows.keys().next().value);
    } catch (error) {
      // What was cancelled, here or by the source, is not wanted any more.
      if (every !== this.every || signal.aborted || error.name === "AbortError") return;
      this.#failed.add(index);
      setTimeout(() => this.#retry(index, every), RETRY_MS);
      this.onFailed(error);
    } finally {
      if (this.#pending.get(index) === pending) this.#pending.delete(index);
    }
    this.#request();
    this.onLoaded();
  }

  /** Reads a window; if a response ends earlier, the rest of it, too. */
  async #read(firstRow, rows, every, signal) {
    const parts = [];
    let read = 0;
    while (read < rows) {
      const part = await this.source.window(firstRow + read, rows - read, every, signal);
      if (part.firstRow !== firstRow + read || part.frames === 0) throw new Error("the response has other frames than requested");
      parts.push(part);
      read += part.frames * every;
    }
    if (parts.length === 1) return parts[0];
    const frames = parts.reduce((sum, part) => sum + part.frames, 0);
    const positions = new Float32Array(3 * this.n * frames);
    let at = 0;
    for (const part of parts) {
      positions.set(part.positions, at);
      at += part.positions.length;
    }
    return { firstRow, every, frames, positions, isDamaged: parts.some(({ isDamaged }) => isDamaged) };
  }

  #retry(index, every) {
    if (every !== this.every) return;
    this.#failed.delete(index);
    if (this.#wanted.includes(index)) this.#request();
  }

  /** Tries again at once to load what could not be read. */
  retry() {
    this.#failed.clear();
    this.#request();
  }
}
