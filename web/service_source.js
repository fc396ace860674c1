// Takes over HTTP: the overview, windows of frames and gaps of GET /v1/takes/{name}/…

import { get, getBytes } from "./api.js";

/** Decoding waits for its turn behind other players. */
const TIMEOUT_MS = 65_000;
/** The service was too busy: it is asked again after this time, so many times. */
const RETRY_MS = 1000;
const TRIES = 20;

/** Bytes before the frames of a window. */
const HEADER_BYTES = 32;
const FRAMES_MAGIC = 0x3157504d;
const FORCES_MAGIC = 0x3146504d;
const POSES_MAGIC = 0x3150504d;
const BODIES_MAGIC = 0x3142504d;
/** Bytes of a marker, and of a force plate. */
const MARKER_BYTES = 12;
const PLATE_BYTES = 36;
const POSE_BYTES = 48;
const BODY_BYTES = 36;
/** Longest window that can be requested, in seconds. */
const SECONDS_MAX = 3600;

/** Parses a window of frames, as docs/api.md describes it: {firstRow, every, frames, positions, isDamaged}. Pure. */
export const parseWindow = (buffer, markers) => parse(buffer, FRAMES_MAGIC, markers, MARKER_BYTES);

/** Parses a window of forces likewise, nine numbers for each plate. Pure. */
export const parseForces = (buffer, plates) => parse(buffer, FORCES_MAGIC, plates, PLATE_BYTES);

/** Parses a window of the poses of a face likewise, twelve numbers each. Pure. */
export const parsePoses = (buffer) => parse(buffer, POSES_MAGIC, 1, POSE_BYTES);

/** Parses a window of the poses of rigid bodies likewise, nine numbers for each body. Pure. */
export const parseBodies = (buffer, bodies) => parse(buffer, BODIES_MAGIC, bodies, BODY_BYTES);

function parse(buffer, magic, n, bytesEach) {
  const view = new DataView(buffer);
  if (buffer.byteLength < HEADER_BYTES || view.getUint32(0, true) !== magic) throw new Error("this is not a window of a take");
  const signals = view.getUint32(4, true);
  const [frames, every, flags] = [16, 20, 24].map((at) => view.getUint32(at, true));
  if (signals !== n || buffer.byteLength !== HEADER_BYTES + bytesEach * frames * n || every === 0) {
    throw new Error(`a window of ${buffer.byteLength} bytes: expected ${frames} frames of ${n} markers, plates or bodies`);
  }
  return {
    firstRow: Number(view.getBigUint64(8, true)),
    every,
    frames,
    positions: new Float32Array(buffer, HEADER_BYTES),
    isDamaged: (flags & 2) !== 0,
  };
}

export class ServiceSource {
  /** Requests for windows can be cancelled. */
  canCancel = true;
  #closed = new AbortController();

  /** With `asksForAll` the first overview is the complete one, which takes longer. */
  constructor(name, asksForAll = false) {
    this.name = name;
    this.asksForAll = asksForAll;
    this.path = `/v1/takes/${encodeURIComponent(name)}`;
  }

  /** The take is not shown any more: its requests end, so that those for another one need not wait for them. */
  close() {
    this.#closed.abort();
  }

  /** What the ends of the take state, in the same time for an hour as for a second; `is_complete` says whether that is all. */
  async overview() {
    this.take = await this.#request(get, this.asksForAll ? "overview" : "overview?ends_only=true", FRAMES);
    return this.take;
  }

  /**
   * A source for the take that has the name now. Its first overview is the complete one, so that a take whose ends contradict
   * the rest of it is opened again only once.
   */
  again() {
    return new ServiceSource(this.name, true);
  }

  /** The overview with the events and problems, for which the service looks through the take. */
  completeOverview() {
    return this.#request(get, "overview");
  }

  async window(firstRow, rows, every, signal) {
    const { rate_hz: rateHz, markers } = this.take;
    const query = `from=${firstRow / rateHz}&seconds=${rows / rateHz}&every=${every}`;
    return parseWindow(await this.#request(getBytes, `window?${query}`, FRAMES, signal), markers);
  }

  /**
   * Calls `onPart` with one part of the gaps after another, until the end of the take or until it returns false. Frames
   * are more urgent: `isIdle` resolves when none are being loaded.
   */
  async gaps(onPart, isIdle = async () => {}) {
    let row = 0;
    while (row < this.take.frames) {
      await isIdle();
      const part = await this.#request(get, `gaps?from=${row / this.take.rate_hz}`);
      if (!onPart(part) || part.end_frame <= row) return;
      row = part.end_frame;
    }
  }

  /** A window of the poses of the subject's face. */
  async poses(firstRow, rows, every, signal) {
    return parsePoses(await this.#request(getBytes, `face?${this.#query(firstRow, rows, every)}`, OTHERS, signal));
  }

  /** The force plates of the take: {plates, window_frames_max}. */
  plates() {
    return this.#request(get, "plates");
  }

  /** A window of the forces of so many plates. */
  async forces(firstRow, rows, every, plates, signal) {
    return parseForces(await this.#request(getBytes, `forces?${this.#query(firstRow, rows, every)}`, OTHERS, signal), plates);
  }

  /** The rigid bodies of the take: {names, window_frames_max}. */
  bodies() {
    return this.#request(get, "bodies");
  }

  /** A window of the poses of so many rigid bodies. */
  async bodyPoses(firstRow, rows, every, bodies, signal) {
    return parseBodies(await this.#request(getBytes, `poses?${this.#query(firstRow, rows, every)}`, OTHERS, signal), bodies);
  }

  /** What `read` finds at a path of the take, unless `signal` says that it is not wanted any more. */
  #request(read, path, priority = OTHERS, signal = null) {
    const wanted = AbortSignal.any([this.#closed.signal, signal].filter(Boolean));
    return inTurn((ended) => read(`${this.path}/${path}`, TIMEOUT_MS, ended), priority, wanted);
  }

  /** The part of so many rows, or as many whole steps of them as can be requested at once. */
  #query(firstRow, rows, every) {
    const { rate_hz: rateHz } = this.take;
    const most = Math.max(every, Math.floor((SECONDS_MAX * rateHz) / every) * every);
    return `from=${firstRow / rateHz}&seconds=${Math.min(rows, most) / rateHz}&every=${every}`;
  }

  /** Calls `onPart` with one part of the differences from another take after another, like `gaps`. */
  async difference(other, onPart, isIdle = async () => {}) {
    let row = 0;
    while (row < this.take.frames) {
      await isIdle();
      const query = `against=${encodeURIComponent(other)}&from=${row / this.take.rate_hz}`;
      const part = await this.#request(get, `difference?${query}`);
      if (!onPart(part) || part.end_frame <= row) return;
      row = part.end_frame;
    }
  }
}

/** The service decodes one part of a take after another, for all players: a page has at most this many requests at a time. */
const REQUESTS_MAX = 2;
/** Frames come before all others. */
const FRAMES = 0;
const OTHERS = 1;
const waiting = [[], []];
let running = 0;

/**
 * Aborted while the page is not shown: a browser may keep one that was left for the way back, with its requests, and those of
 * the next page would have to wait for them.
 */
let away = new AbortController();
let back = null;
addEventListener("pagehide", () => {
  away.abort();
  back = new Promise((resolve) => {
    addEventListener("pageshow", () => {
      away = new AbortController();
      resolve();
    }, { once: true });
  });
});

/** Makes a request, which a signal ends, when it is its turn; one that `wanted` has ended gives its turn to the next. */
async function inTurn(request, priority, wanted) {
  if (running >= REQUESTS_MAX) await new Promise((resolve) => waiting[priority].push(resolve));
  else running += 1;
  try {
    return await repeated(request, wanted);
  } finally {
    const next = waiting[FRAMES].shift() ?? waiting[OTHERS].shift();
    if (next) next();
    else running -= 1;
  }
}

/** Repeats a request that the service refuses because it is busy, and one that ended because the page was left. */
async function repeated(request, wanted) {
  for (let attempt = 1; ; attempt += 1) {
    // Otherwise the request is sent at once.
    if (away.signal.aborted) await back;
    wanted.throwIfAborted();
    const { signal: left } = away;
    try {
      return await request(AbortSignal.any([wanted, left]));
    } catch (error) {
      wanted.throwIfAborted();
      if (left.aborted) continue;
      if (error.kind !== "unavailable" || attempt >= TRIES) throw error;
      await pause(RETRY_MS, wanted);
    }
  }
}

/** Resolves after this time, or as soon as the request is cancelled: it must not keep others from their turn. */
function pause(ms, signal) {
  return new Promise((resolve) => {
    const end = () => {
      clearTimeout(timer);
      signal.removeEventListener("abort", end);
      resolve();
    };
    const timer = setTimeout(end, ms);
    signal.addEventListener("abort", end);
  });
}
