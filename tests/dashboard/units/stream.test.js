import { EventParser, LiveParser } from "/stream.js";
import { equal, isTrue, test, throws } from "./harness.js";

/** A message as the service writes it. */
function message(body) {
  const out = new Uint8Array(4 + body.length);
  new DataView(out.buffer).setUint32(0, body.length, true);
  out.set(body, 4);
  return out;
}

function frame(row, ticks, arrivalUs, positions) {
  const body = new Uint8Array(28 + 4 * positions.length);
  const view = new DataView(body.buffer);
  body[0] = 2;
  [row, ticks, arrivalUs].forEach((value, i) => view.setBigUint64(4 + 8 * i, BigInt(value), true));
  positions.forEach((value, i) => view.setFloat32(28 + 4 * i, value, true));
  return message(body);
}

const table = { labels: ["Ä", "b"], labelled: [true, false], up_axis: 3, rate_hz: 120, bones: [[0, 1]] };
const tableBytes = message(new Uint8Array([1, ...new TextEncoder().encode(JSON.stringify(table))]));
const whole = new Uint8Array([
  ...tableBytes,
  ...frame(7, 2 ** 40, 1_795_322_985_615_123, [1.5, -2, 3, NaN, NaN, NaN]),
  ...message(new Uint8Array([9, 1, 2, 3])),
  ...frame(8, 2 ** 40 + 1, 1_795_322_985_623_456, []),
]);

function read(pieces) {
  const parser = new LiveParser();
  return pieces.flatMap((piece) => parser.push(piece));
}

test("a live stream is parsed, and an unknown kind is skipped", () => {
  const [first, second, third, ...rest] = read([whole]);
  equal([first.kind, first.table], ["table", table]);
  equal([second.row, Number(second.ticks), second.arrivalUnixUs], [7, 2 ** 40, 1_795_322_985_615_123]);
  equal([...second.positionsMm].slice(0, 3), [1.5, -2, 3]);
  isTrue(second.positionsMm.slice(3).every(Number.isNaN), "an occluded marker is NaN");
  equal([third.row, third.positionsMm.length, rest.length], [8, 0, 0]);
});

test("the poses of rigid bodies have nine numbers and a count each", () => {
  const body = new Uint8Array(12 + 2 * 44);
  const view = new DataView(body.buffer);
  body[0] = 5;
  view.setBigUint64(4, 9n, true);
  view.setFloat32(12 + 36 + 8, -2.5, true);
  [7n, 2n ** 40n].forEach((n, i) => view.setBigUint64(12 + 72 + 8 * i, n, true));
  const [found] = read([message(body)]);
  equal([found.kind, found.frames, found.tracked, found.values.length, found.values[11]], ["poses", 9, [7, 2 ** 40], 18, -2.5]);
  throws(() => read([message(body.slice(0, -1))]), "nine floats");
});

test("the pose of a face follows its frame", () => {
  const body = new Uint8Array(52);
  body[0] = 3;
  new DataView(body.buffer).setFloat32(4 + 4 * 7, 1.5, true);
  const [found] = read([message(body)]);
  equal([found.kind, found.pose.length, found.pose[7]], ["face", 12, 1.5]);
  throws(() => read([message(body.slice(0, 51))]), "twelve floats");
});

test("a live stream may be split at every byte", () => {
  for (let cut = 0; cut <= whole.length; cut += 1) {
    const found = read([whole.slice(0, cut), whole.slice(cut)]);
    equal(found.map(({ kind, row }) => [kind, row]), [["table", undefined], ["frame", 7], ["frame", 8]], `split at ${cut}:`);
  }
  equal(read([...whole].map((byte) => Uint8Array.of(byte))).length, 3);
});

test("anything but a live stream is refused at once", () => {
  throws(() => read([new TextEncoder().encode("<!doctype html>")]), "not the live stream");
  throws(() => read([new Uint8Array(8)]), "0 bytes");
  throws(() => read([message(new Uint8Array([2, 0, 0, 0]))]), "three floats per marker");
  throws(() => read([message(new Uint8Array(30).fill(2, 0, 1))]), "three floats per marker");
});

test("events are parsed however they are split", () => {
  const text = ': hello\n\nid: 4\ndata: {"a":1}\n\nevent: missed\r\ndata: one\r\ndata: two\r\n\r\ndata:x\n\nid: 9\n\n';
  for (let cut = 0; cut <= text.length; cut += 1) {
    const parser = new EventParser();
    const found = [...parser.push(text.slice(0, cut)), ...parser.push(text.slice(cut))];
    equal(found, [
      { id: "4", type: "message", data: '{"a":1}' },
      { id: null, type: "missed", data: "one\ntwo" },
      { id: null, type: "message", data: "x" },
    ], `split at ${cut}:`);
  }
});
