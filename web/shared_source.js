// The take inside a shared page: its overview as JSON, and a line of base64 for each block of frames.

import { decodeBlock, split } from "./motion_decoder.js";

/** Decoded blocks that are kept: markers and rigid bodies are asked for one after the other. */
const DECODED_MAX = 4;

/** The bytes of a line of base64. */
function bytesOf(line) {
  const text = atob(line);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i += 1) bytes[i] = text.charCodeAt(i);
  return bytes;
}

export class SharedSource {
  /** The promises of blocks by their first rows. */
  #decoded = new Map();

  /** `overview` is that of the page, `motion` the text with its blocks. */
  constructor(overview, motion) {
    this.take = overview;
    this.name = overview.name;
    // The text begins and ends with a line end. A line may be empty: a block whose bits are all 0.
    this.lines = motion.split("\n").slice(1, -1);
    /** The player loads whole blocks. */
    this.windowFrames = overview.page.block_frames;
  }

  async overview() {
    return this.take;
  }

  /** The window that begins at a row: a block. */
  async window(firstRow) {
    const { positions, frames } = await this.#block(firstRow);
    return { firstRow, every: 1, frames, positions, isDamaged: false };
  }

  /** The names of the rigid bodies. */
  async bodies() {
    return { names: this.take.page.bodies, window_frames_max: this.windowFrames };
  }

  /** Their poses, in the place of positions. */
  async bodyPoses(firstRow) {
    const { poses, frames } = await this.#block(firstRow);
    return { firstRow, every: 1, frames, positions: poses, isDamaged: false };
  }

  #block(firstRow) {
    const known = this.#decoded.get(firstRow);
    if (known) return known;
    const block = this.#decode(firstRow);
    this.#decoded.set(firstRow, block);
    if (this.#decoded.size > DECODED_MAX) this.#decoded.delete(this.#decoded.keys().next().value);
    return block;
  }

  async #decode(firstRow) {
    const { markers: n, frames: all, page } = this.take;
    const bodies = page.bodies.length;
    // A picture can be drawn between two blocks.
    await new Promise((resolve) => setTimeout(resolve));
    const frames = Math.min(page.block_frames, all - firstRow);
    const line = this.lines[firstRow / page.block_frames];
    if (line === undefined) throw new Error("the page is incomplete: save it or send it again");
    const block = decodeBlock(bytesOf(line), n + 2 * bodies, frames, page.step_mm);
    return { frames, ...split(block, n, bodies, page.step_mm) };
  }

  async gaps(onPart) {
    onPart(this.take.page.gaps);
  }
}
