// The take inside a shared page: its overview as JSON, and a line of base64 for each block of frames.

import { decodeBlock } from "./motion_decoder.js";

/** The bytes of a line of base64. */
function bytesOf(line) {
  const text = atob(line);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i += 1) bytes[i] = text.charCodeAt(i);
  return bytes;
}

export class SharedSource {
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
    const { markers: n, frames, page } = this.take;
    // A picture can be drawn between two blocks.
    await new Promise((resolve) => setTimeout(resolve));
    const held = Math.min(page.block_frames, frames - firstRow);
    const line = this.lines[firstRow / page.block_frames];
    if (line === undefined) throw new Error("the page is incomplete: save it or send it again");
    return { firstRow, every: 1, frames: held, positions: decodeBlock(bytesOf(line), n, held, page.step_mm), isDamaged: false };
  }

  async gaps(onPart) {
    onPart(this.take.page.gaps);
  }
}
