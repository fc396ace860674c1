import { chartRows, column, limits, speedAt, tickSeconds } from "/charts.js";
import { roundedUp, takeTime } from "/format.js";
import { FrameBuffer } from "/frame_buffer.js";
import { Playback } from "/playback.js";
import { parseWindow } from "/service_source.js";
import { TakeMotion } from "/take_motion.js";
import { GapCounts, gapBegins } from "/time_axis.js";
import { equal, isTrue, near, test, throws } from "./harness.js";

const always = () => true;

/** Draws for so many seconds at a display's rate, and returns the rows that were drawn. */
function drawn(playback, seconds, hz = 60, isReady = always) {
  const rows = [];
  for (let i = 0; i < seconds * hz; i += 1) {
    if (playback.advance(1000 / hz, isReady)) rows.push(playback.row);
  }
  return rows;
}

test("at speed 1 no frame of a 60 Hz take is skipped, whatever the display's rate", () => {
  for (const hz of [30, 50, 59.94, 60, 75, 144]) {
    const playback = new Playback(100_000, 60);
    playback.play();
    const rows = drawn(playback, 20, hz);
    rows.forEach((row, i) => equal(row, i + 1, `${hz} Hz:`));
    isTrue(rows.length >= 20 * Math.min(hz, 60) * 0.95, `${hz} Hz: ${rows.length} rows in 20 s`);
  }
});

test("playback keeps to the clock, at every speed", () => {
  for (const [rateHz, speed] of [[60, 1], [120, 1], [1000, 1], [240, 0.25], [100, 4], [50, 0.1]]) {
    const playback = new Playback(1_000_000, rateHz);
    playback.speed = speed;
    playback.play();
    drawn(playback, 10);
    near(playback.row, rateHz * speed * 10, 1 + rateHz * speed / 60, `${rateHz} Hz × ${speed}:`);
  }
});

test("it ends at the last frame, which is drawn, and begins again", () => {
  const playback = new Playback(100, 1000);
  playback.play();
  equal(drawn(playback, 1).at(-1), 99);
  equal(playback.isPlaying, false);
  playback.toggle();
  equal([playback.row, playback.isPlaying], [0, true]);
});

test("a loop repeats its rows, both ends included", () => {
  const playback = new Playback(1000, 60);
  playback.seek(10);
  playback.loopFrom();
  playback.seek(14);
  playback.loopTo();
  equal(playback.loop, [10, 14]);
  playback.play();
  playback.seek(10);
  equal(drawn(playback, 0.2).slice(0, 8), [11, 12, 13, 14, 10, 11, 12, 13]);
});

test("a loop end before its start, and one frame, are no loop", () => {
  const playback = new Playback(100, 60);
  playback.seek(99);
  playback.loopFrom();
  equal(playback.loop, null);
  playback.seek(50);
  playback.loopFrom();
  playback.seek(20);
  playback.loopTo();
  equal(playback.loop, [0, 20], "the start is replaced");
  playback.clearLoop();
  equal(playback.loop, null);
});

test("steps pause, and stay within the take", () => {
  const playback = new Playback(10, 60);
  playback.play();
  playback.step(-1);
  equal([playback.row, playback.isPlaying], [0, false]);
  playback.step(100);
  equal(playback.row, 9);
  playback.seek(3.6);
  equal(playback.row, 4);
});

test("it waits for frames that are not loaded, and goes on without a jump", () => {
  const playback = new Playback(1000, 60);
  playback.play();
  const rows = drawn(playback, 2, 60, (row) => row < 30);
  equal(rows.at(-1), 29);
  equal(drawn(playback, 0.1)[0], 30);
});

test("a window is parsed, and anything else is refused", () => {
  const buffer = new ArrayBuffer(32 + 24);
  const view = new DataView(buffer);
  [0x4d, 0x50, 0x57, 0x31].forEach((byte, i) => view.setUint8(i, byte));
  view.setUint32(4, 1, true);
  view.setBigUint64(8, 5_000_000_000n, true);
  [2, 3, 2].forEach((value, i) => view.setUint32(16 + 4 * i, value, true));
  [1.5, 2, 3, NaN, NaN, NaN].forEach((value, i) => view.setFloat32(32 + 4 * i, value, true));
  const window = parseWindow(buffer, 1);
  equal([window.firstRow, window.frames, window.every, window.isDamaged], [5_000_000_000, 2, 3, true]);
  equal([...window.positions.subarray(0, 3)], [1.5, 2, 3]);
  throws(() => parseWindow(buffer, 2), "expected 2 frames of 2 markers");
  throws(() => parseWindow(buffer.slice(0, 40), 1), "a window of 40 bytes");
  throws(() => parseWindow(new ArrayBuffer(8), 1), "not a window");
  view.setUint8(3, 0x32);
  throws(() => parseWindow(buffer, 1), "not a window");
});

const overview = { name: "a", frames: 200, rate_hz: 10, seconds: 20, markers: 2, labels: ["a", ""], labelled: [true, false],
  bones: [[0, 1]], up_axis: 2, window_frames_max: 40 };

/** Positions by row: the first marker moves along y, the second is missing in rows 20 to 99. */
function positionsAt(row) {
  return Float32Array.of(1, row, 3, ...(row >= 20 && row < 100 ? [NaN, NaN, NaN] : [row, 2, 2]));
}

test("a row has its markers, the trail behind them, and the last place of those that are missing", () => {
  const motion = new TakeMotion();
  motion.setTake(overview);
  equal(motion.labels, ["a", "u002"]);
  isTrue(motion.show(30, positionsAt), "shown");
  equal([motion.nSeen, motion.isSeen(0), motion.isSeen(1)], [1, true, false]);
  // y points up.
  equal([...motion.last.subarray(0, 3)], [3, 1, 30]);
  equal([...motion.last.subarray(3, 6)], [2, 19, 2]);
  near(motion.timeMs() - motion.lastSeenMs[1], 1100, 1e-6);
  equal(motion.show(31, () => null), false, "not loaded");
  equal(motion.row, 30);
  motion.show(99, positionsAt);
  isTrue(motion.lastSeenMs[1] === -Infinity, "longer ago than it is drawn");
  motion.show(100, positionsAt);
  equal([motion.nSeen, motion.last[3]], [2, 2]);
});

test("frames are loaded by windows around the current one, with bounded memory", async () => {
  const asked = [];
  const source = {
    window: async (firstRow, rows, every) => {
      asked.push(firstRow);
      const frames = Math.ceil(rows / every);
      return { firstRow, every, frames, positions: Float32Array.from({ length: 6 * frames }, (_, i) => firstRow + Math.floor(i / 6)) };
    },
  };
  const long = { ...overview, frames: 1_000_000 };
  const buffer = new FrameBuffer(source, long);
  buffer.keptMax = 8;
  const settle = () => new Promise((resolve) => setTimeout(resolve, 5));
  equal(buffer.windowFrames, 40);
  for (let row = 0; row < 40_000; row += 1000) {
    buffer.want(row, 10);
    isTrue(buffer.isWaitingFor(row), "not loaded yet");
    await settle();
    equal(buffer.positionsAt(row)[0], row);
    isTrue(buffer.ranges().length <= 8, `${buffer.ranges().length} windows`);
  }
  equal(asked.slice(0, 2), [0, 40]);
  isTrue(asked.length < 200, `${asked.length} requests`);
  equal(buffer.positionsAt(5), null, "was removed");
});

test("a window that cannot be read is reported once, and playback does not wait for it", async () => {
  const errors = [];
  const source = { window: async () => { throw new Error("the disk"); } };
  const buffer = new FrameBuffer(source, { ...overview, frames: 30 }, { onFailed: (error) => errors.push(error.message) });
  buffer.want(0);
  await new Promise((resolve) => setTimeout(resolve, 5));
  buffer.want(1);
  await new Promise((resolve) => setTimeout(resolve, 5));
  equal(errors, ["the disk"]);
  equal(buffer.isWaitingFor(0), false);
});

test("a jump ends the requests for windows that are not wanted any more, but none that is awaited", async () => {
  const asked = [];
  const window = (firstRow, _rows, _every, signal) => new Promise((_, reject) => {
    const request = { firstRow, isCancelled: false };
    asked.push(request);
    signal.addEventListener("abort", () => {
      request.isCancelled = true;
      reject(new Error("cancelled"));
    });
  });
  const errors = [];
  const onFailed = (error) => errors.push(error.message);
  const buffer = new FrameBuffer({ window, canCancel: true }, { ...overview, frames: 1_000_000 }, { onFailed });
  const shown = () => asked.map(({ firstRow, isCancelled }) => [firstRow / buffer.windowFrames, isCancelled]);
  const rowOf = (index) => index * buffer.windowFrames;
  buffer.want(rowOf(100));
  equal(shown(), [[100, false], [101, false]]);
  buffer.want(rowOf(101));
  equal(shown(), [[100, false], [101, false]], "both are wanted still");
  buffer.want(rowOf(500));
  equal(shown(), [[100, true], [101, true], [500, false], [501, false]]);
  buffer.fetch(rowOf(700));
  buffer.want(rowOf(600));
  equal(shown().slice(2), [[500, true], [501, true], [700, false], [600, false]]);
  await new Promise((resolve) => setTimeout(resolve, 5));
  equal(errors, [], "what was cancelled has not failed");
  const kept = new FrameBuffer({ window }, { ...overview, frames: 1_000_000 });
  kept.want(0);
  kept.want(rowOf(900));
  equal(shown().slice(6), [[0, false], [1, false]], "of other sources at most two are loaded at once");
});

test("takes of very many markers load only what a display shows while they play", () => {
  const asked = [];
  const source = { window: (firstRow, rows, every) => { asked.push(every); return new Promise(() => {}); } };
  const buffer = new FrameBuffer(source, { ...overview, markers: 2000, rate_hz: 1000, frames: 100_000 });
  buffer.want(0, 0);
  buffer.want(0, 1000);
  buffer.want(0, 0);
  equal([asked[0], asked.at(-1)], [1, 1]);
  isTrue(asked.some((every) => every > 1 && 1000 / every >= 60), JSON.stringify(asked));
});

test("gaps of parts are added up, and rows without any are known", () => {
  const gaps = new GapCounts();
  const part = (first_bin, missing_samples, lost_frames, end_frame) => ({ bin_frames: 10, first_bin, missing_samples, lost_frames, end_frame });
  gaps.add(part(0, [0, 3, 1], [0, 0, 0], 25));
  gaps.add(part(2, [1, 0, 0, 0, 0], [0, 0, 0, 2, 0], 70));
  equal([gaps.missing, gaps.lost, gaps.endRow], [[0, 3, 2, 0, 0, 0, 0], [0, 0, 0, 0, 0, 2, 0], 70]);
  equal([0, 9, 10, 30, 49, 55, 69, 70].map((row) => gaps.clearRows(row, 1)), [10, 1, 0, 10, 1, 0, 1, 0]);
  equal([0, 9, 15, 35, 69].map((row) => gaps.clearRows(row, -1)), [1, 10, 0, 6, 10]);
});

test("a gap begins where a marker is missing that was there before", () => {
  const at = (...markers) => Float32Array.from(markers.flatMap((there) => (there ? [1, 2, 3] : [NaN, NaN, NaN])));
  equal(gapBegins(at(1, 0), at(1, 1)), true);
  equal(gapBegins(at(1, 0), at(0, 1)), true, "of another marker");
  equal(gapBegins(at(1, 0), at(1, 0)), false, "goes on");
  equal(gapBegins(at(1, 1), at(1, 0)), false, "ends");
  equal([gapBegins(at(1, 0), null), gapBegins(at(1, 1), null)], [true, false], "at the first frame");
});

test("a bound is never rounded down", () => {
  equal([0, 0.004, 0.1125, 0.5 + 0.5, 0.1 + 0.2, 1.004, 0.49991, 39.96, 1234.5].map((mm) => roundedUp(mm)),
    ["0", "0.004", "0.113", "1", "0.3", "1.01", "0.5", "40", "1240"]);
});

test("the charts show ten seconds, at the ends of a take, too", () => {
  equal(chartRows(0, 10_000, 100), [0, 1000]);
  equal(chartRows(5000, 10_000, 100), [4500, 5500]);
  equal(chartRows(9999, 10_000, 100), [8999, 9999]);
  equal(chartRows(3, 10, 100), [0, 9]);
  equal(limits([NaN, NaN], 1), null);
  equal(limits([5, NaN, 5], 20), [-5, 15]);
});

test("the speed is that of the motion, and unknown beside a gap", () => {
  near(speedAt(positionsAt, 0, 50, 100), 0.1, 1e-6, "1 mm per frame at 100 Hz");
  isTrue(Number.isNaN(speedAt(positionsAt, 1, 21, 100)), "in a gap");
  isTrue(Number.isNaN(speedAt(positionsAt, 1, 19, 100)), "beside a gap");
  isTrue(Number.isNaN(speedAt((row) => (row < 10 ? positionsAt(row) : null), 0, 9, 100)), "at the end of what is loaded");
});

test("no peak and no gap is left out of a chart, however many rows a column has", () => {
  const values = [1, 2, 90, 3, NaN, 4, 5, 6];
  equal(column((row) => values[row], 0, 4), { first: 1, low: 1, high: 90, last: 3, isWhole: true });
  equal(column((row) => values[row], 4, 4), { first: 4, low: 4, high: 6, last: 6, isWhole: false });
  equal(column(() => NaN, 0, 3), null);
});

test("while rows are left out, speeds are those of the rows that are there", () => {
  const every4 = (row) => positionsAt(Math.floor(row / 4) * 4);
  for (const row of [100, 101, 102, 103]) near(speedAt(every4, 0, row, 200, 4), 0.2, 1e-6, `row ${row}:`);
  isTrue(Number.isNaN(speedAt((row) => (row === 50 ? Float32Array.of(NaN, NaN, NaN) : positionsAt(row)), 0, 50, 100)), "in a gap");
});

test("a response that ends earlier is completed, and one of other frames is refused", async () => {
  const errors = [];
  const source = { window: async (firstRow, rows) => {
    const frames = Math.min(rows, 16);
    return { firstRow, every: 1, frames, positions: Float32Array.from({ length: 6 * frames }, (_, i) => firstRow + Math.floor(i / 6)) };
  } };
  const buffer = new FrameBuffer(source, overview, { onFailed: (error) => errors.push(error.message) });
  isTrue(await buffer.fetch(39), "complete");
  equal([0, 16, 39].map((row) => buffer.positionsAt(row)[0]), [0, 16, 39]);
  source.window = async (firstRow, rows) => ({ firstRow: firstRow + 1, every: 1, frames: rows, positions: new Float32Array(6 * rows) });
  equal([await buffer.fetch(45), errors], [false, ["the response has other frames than requested"]]);
});

test("times in a take", () => {
  equal([0, 1.0005, 59.9999, 61.25, 3723.4].map(takeTime), ["0:00.000", "0:01.000", "0:59.999", "1:01.250", "1:02:03.400"]);
  equal([0.03, 1, 7, 100_000].map(tickSeconds), [0.05, 1, 10, 172_800]);
});
