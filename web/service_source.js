// Takes over HTTP: the overview, windows of frames and gaps of GET /v1/takes/{name}/…

import { get, getBytes } from "./api.js";

/** Decoding waits for its turn behind other players. */
const TIMEOUT_MS = 65_000;
/** The service was too busy: it is asked again after this time, so many times. */
const RETRY_MS = 1000;
const TRIES = 20;

/** Bytes before the frames of a window. */
const HEADER_BYTES = 32;
const MAGIC = 0x3157504d;

/** Parses a window, as docs/api.md describes it: {firstRow, every, frames, positions, isDamaged}. Pure. */
export function parseWindow(buffer, n) {
  const view = new DataView(buffer);
  if (buffer.byteLength < HEADER_BYTES || view.getUint32(0, true) !== MAGIC) throw new Error("this is not a window of a take");
  const markers = view.getUint32(4, true);
  const [frames, every, flags] = [16, 20, 24].map((at) => view.getUint32(at, true));
  if (markers !== n || buffer.byteLength !== HEADER_BYTES + 12 * frames * markers || every === 0) {
    throw new Error(`a window of ${buffer.byteLength} bytes: expected ${frames} frames of ${n} markers`);
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
  constructor(name) {
    this.path = `/v1/takes/${encodeURIComponent(name)}`;
  }

  async overview() {
    this.take = await inTurn(() => get(`${this.path}/overview`, TIMEOUT_MS));
    return this.take;
  }

  async window(firstRow, rows, every) {
    const { rate_hz: rateHz, markers } = this.take;
    const query = `from=${firstRow / rateHz}&seconds=${rows / rateHz}&every=${every}`;
    return parseWindow(await inTurn(() => getBytes(`${this.path}/window?${query}`, TIMEOUT_MS)), markers);
  }

  /**
   * Calls `onPart` with one part of the gaps after another, until the end of the take or until it returns false. Frames
   * are more urgent: `isIdle` resolves when none are being loaded.
   */
  async gaps(onPart, isIdle = async () => {}) {
    let row = 0;
    while (row < this.take.frames) {
      await isIdle();
      const part = await inTurn(() => get(`${this.path}/gaps?from=${row / this.take.rate_hz}`, TIMEOUT_MS));
      if (!onPart(part) || part.end_frame <= row) return;
      row = part.end_frame;
    }
  }
}

/** Repeats a request that the service refuses because it is busy. */
async function inTurn(request) {
  for (let attempt = 1; ; attempt += 1) {
    try {
      return await request();
    } catch (error) {
      if (error.kind !== "unavailable" || attempt >= TRIES) throw error;
      await new Promise((resolve) => setTimeout(resolve, RETRY_MS));
    }
  }
}
