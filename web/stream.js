// The bytes of GET /v1/live: u32 length, u8 kind; a table in JSON, or a frame. Pure: bytes in, messages out.

/** Larger than any table that a rig can have; what claims more is not this stream. */
const MESSAGE_MAX = 8 << 20;
/** Kind, three bytes of zero, row, ticks, arrival. */
const FRAME_HEAD = 28;

export class StreamError extends Error {}

export class LiveParser {
  #held = new Uint8Array(0);

  /** Takes bytes cut anywhere, and gives the messages that are complete. */
  push(bytes) {
    let all = bytes;
    if (this.#held.length > 0) {
      all = new Uint8Array(this.#held.length + bytes.length);
      all.set(this.#held);
      all.set(bytes, this.#held.length);
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
    this.#held = all.slice(at);
    return messages;
  }
}

/** A kind that is not known is passed over: a newer service may send it. */
function parseMessage(bytes) {
  if (bytes[0] === 1) {
    return { kind: "table", table: JSON.parse(new TextDecoder().decode(bytes.subarray(1))) };
  }
  if (bytes[0] === 3) return parseFace(bytes);
  if (bytes[0] !== 2) return null;
  if (bytes.length < FRAME_HEAD || (bytes.length - FRAME_HEAD) % 12 !== 0) {
    throw new StreamError(`a frame of ${bytes.length} bytes: three floats a marker were expected`);
  }
  const view = new DataView(bytes.buffer);
  return {
    kind: "frame",
    row: Number(view.getBigUint64(4, true)),
    ticks: view.getBigUint64(12, true),
    arrivalUnixUs: Number(view.getBigUint64(20, true)),
    positionsMm: new Float32Array(bytes.buffer, FRAME_HEAD),
  };
}

/** Where the face is: for each axis three factors of a vertex, and what is added. */
function parseFace(bytes) {
  if (bytes.length !== 4 + 48) throw new StreamError(`a face's place of ${bytes.length} bytes: twelve floats were expected`);
  return { kind: "face", pose: new Float32Array(bytes.buffer, 4) };
}

/** Server-sent events: text cut anywhere in, events out. */
export class EventParser {
  #held = "";

  push(text) {
    this.#held += text;
    // A carriage return at the end may be half of a line's end.
    const end = this.#held.endsWith("\r") ? this.#held.length - 1 : this.#held.length;
    const blocks = this.#held.slice(0, end).replace(/\r\n?/g, "\n").split("\n\n");
    this.#held = blocks.pop() + this.#held.slice(end);
    if (this.#held.length > MESSAGE_MAX) throw new StreamError("an event without end");
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
