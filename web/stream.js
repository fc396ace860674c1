// Parsers of the streams. GET /v1/live: u32 length, u8 kind, then a table in JSON, a frame or a face pose. Pure.

/** Larger than any table of markers; a larger length means that this is not the live stream. */
const MESSAGE_MAX = 8 << 20;
/** Kind, three zero bytes, row, ticks, arrival time. */
const FRAME_HEADER = 28;
/** Kind, group, two zero bytes, number of the first sample, number of samples. */
const SAMPLES_HEADER = 16;
/** Kind, three zero bytes, number of frames with poses; then nine floats and a count for each body. */
const POSES_HEADER = 12;
const BODY_BYTES = 44;

export class StreamError extends Error {}

export class LiveParser {
  #buffer = new Uint8Array(0);

  /** Accepts bytes split anywhere; returns the messages that are complete. */
  push(bytes) {
    let all = bytes;
    if (this.#buffer.length > 0) {
      all = new Uint8Array(this.#buffer.length + bytes.length);
      all.set(this.#buffer);
      all.set(bytes, this.#buffer.length);
    }
    const view = new DataView(all.buffer, all.byteOffset, all.byteLength);
    const messages = [];
    let at = 0;
    while (all.length - at >= 4) {
      const length = view.getUint32(at, true);
      if (length === 0 || length > MESSAGE_MAX) {
        throw new StreamError(`a message of ${length} bytes: this is not the live stream`);
      }
      if (all.length - at - 4 < length) break;
      const message = parseMessage(all.slice(at + 4, at + 4 + length));
      if (message) messages.push(message);
      at += 4 + length;
    }
    this.#buffer = all.slice(at);
    return messages;
  }
}

/** Skips an unknown kind: a newer service may send it. */
function parseMessage(bytes) {
  if (bytes[0] === 1) {
    return { kind: "table", table: JSON.parse(new TextDecoder().decode(bytes.subarray(1))) };
  }
  if (bytes[0] === 3) return parseFace(bytes);
  if (bytes[0] === 4) return parseSamples(bytes);
  if (bytes[0] === 5) return parsePoses(bytes);
  if (bytes[0] !== 2) return null;
  if (bytes.length < FRAME_HEADER || (bytes.length - FRAME_HEADER) % 12 !== 0) {
    throw new StreamError(`a frame of ${bytes.length} bytes: expected three floats per marker`);
  }
  const view = new DataView(bytes.buffer);
  return {
    kind: "frame",
    row: Number(view.getBigUint64(4, true)),
    ticks: view.getBigUint64(12, true),
    arrivalUnixUs: Number(view.getBigUint64(20, true)),
    positionsMm: new Float32Array(bytes.buffer, FRAME_HEADER),
  };
}

/** The pose of the face: a 3x4 matrix, row by row. */
function parseFace(bytes) {
  if (bytes.length !== 4 + 48) throw new StreamError(`a face pose of ${bytes.length} bytes: expected twelve floats`);
  return { kind: "face", pose: new Float32Array(bytes.buffer, 4) };
}

/** A column of a group of sampled channels: the least and the largest value of each. */
function parseSamples(bytes) {
  if (bytes.length < SAMPLES_HEADER || (bytes.length - SAMPLES_HEADER) % 8 !== 0) {
    throw new StreamError(`samples of ${bytes.length} bytes: expected two floats per channel`);
  }
  const view = new DataView(bytes.buffer);
  return { kind: "samples", group: bytes[1], first: Number(view.getBigUint64(4, true)), n: view.getUint32(12, true), ranges: new Float32Array(bytes.buffer, SAMPLES_HEADER) };
}

/** The poses of the rigid bodies, and by body in how many of the frames with poses it was tracked. */
function parsePoses(bytes) {
  if (bytes.length < POSES_HEADER || (bytes.length - POSES_HEADER) % BODY_BYTES !== 0) {
    throw new StreamError(`poses of ${bytes.length} bytes: expected nine floats and a count per body`);
  }
  const view = new DataView(bytes.buffer);
  const n = (bytes.length - POSES_HEADER) / BODY_BYTES;
  const tracked = Array.from({ length: n }, (_, body) => Number(view.getBigUint64(POSES_HEADER + 36 * n + 8 * body, true)));
  return { kind: "poses", frames: Number(view.getBigUint64(4, true)), values: new Float32Array(bytes.buffer, POSES_HEADER, 9 * n), tracked };
}

/** Parses server-sent events from text split anywhere. */
export class EventParser {
  #buffer = "";

  push(text) {
    this.#buffer += text;
    // A trailing carriage return may be half of a line ending.
    const end = this.#buffer.endsWith("\r") ? this.#buffer.length - 1 : this.#buffer.length;
    const blocks = this.#buffer.slice(0, end).replace(/\r\n?/g, "\n").split("\n\n");
    this.#buffer = blocks.pop() + this.#buffer.slice(end);
    if (this.#buffer.length > MESSAGE_MAX) throw new StreamError(`an event of more than ${MESSAGE_MAX} characters`);
    return blocks.map(parseEvent).filter((event) => event.data !== null);
  }
}

function parseEvent(block) {
  const event = { id: null, type: "message", data: null };
  for (const line of block.split("\n")) {
    const [, field, value] = /^([^:]*):? ?(.*)$/.exec(line) ?? [];
    if (field === "data") event.data = event.data === null ? value : `${event.data}\n${value}`;
    else if (field === "id") event.id = value;
    else if (field === "event") event.type = value;
  }
  return event;
}
