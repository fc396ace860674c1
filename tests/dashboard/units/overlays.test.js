import { axesOf, bodiesText } from "/bodies.js";
import { bodiesCount, bodyLines } from "/body_list.js";
import { Comparison, distances } from "/comparison.js";
import { curveColumns } from "/curves.js";
import { downloadPath } from "/downloads.js";
import { Forces } from "/forces.js";
import { axisTime } from "/format.js";
import { comparisonText } from "/overlays.js";
import { Motion } from "/motion.js";
import { split } from "/motion_decoder.js";
import { frameText } from "/player.js";
import { parseBodies, parseForces, parsePoses } from "/service_source.js";
import { LiveParser } from "/stream.js";
import { StripHistory, ledgerText, withPrefix } from "/strips.js";
import { gapsThatBegin } from "/time_axis.js";
import { equal, isTrue, near, test, throws } from "./harness.js";

const PART = { is_by_number: true, other_first_number: 1, frames_only_here: 0, frames_only_there: 0, first_bin: 0, bin_frames: 2, other_first: 0, markers: [1, 0, null], markers_missing: 0, max_error_mm: [0.5, null],
  largest: { error_mm: 0.5, frame: 1, marker: 0 }, samples: 4, sum_of_squares_mm2: 1, gaps_differing: 1, is_damaged: false, end_frame: 3 };

test("the parts of a comparison add up, also where two share a bin", () => {
  const found = new Comparison("b", null);
  isTrue(Number.isNaN(found.rmsMm));
  found.add(PART);
  found.add({ ...PART, first_bin: 1, max_error_mm: [0.7, 0.1], largest: { error_mm: 0.7, frame: 3, marker: 1 }, end_frame: 6 });
  found.add({ ...PART, first_bin: 3, max_error_mm: [null], largest: null, samples: 0, sum_of_squares_mm2: 0, gaps_differing: 0, end_frame: 8 });
  equal(found.largestByBin, [0.5, 0.7, 0.1, null]);
  equal([found.largest.frame, found.samples, found.gapsDiffering, found.endRow], [3, 8, 2, 8]);
  near(found.rmsMm, 0.5, 1e-9);
  equal([0, 0.13, 0.15, 0.69, 0.7].map((error) => found.classOf(error)), [0, 0, 1, 4, 4]);
  const text = comparisonText(found, { frames: 8, rate_hz: 2 }, ["a", "knee", "c"]);
  equal(text, "Compared with b: largest error 0.7 mm: knee at 0:01.500 · rms 0.5 mm · 1 marker in only one of them · 2 samples in only one of them");
  found.add({ ...PART, is_by_number: false, other_first_number: 101, frames_only_here: 3 });
  const other = comparisonText(found, { frames: 3, rate_hz: 2 }, ["a", "knee", "c"]);
  isTrue(other.includes("compared from the first frame of each on, which is number 101 there · 3 frames only in this take"), other);
});

test("positions of the other take are those of its own frame and marker", () => {
  const buffer = { frames: 3, shownRow: (row) => row, positionsAt: (row) => (row === 2 ? new Float32Array([1, 2, 3, 4, 5, 6]) : null) };
  const found = new Comparison("b", buffer);
  equal(found.otherPositions(1), null, "not compared yet");
  found.add({ ...PART, other_first: 1 });
  equal([...found.otherPositions(1)].map(String), ["4", "5", "6", "1", "2", "3", "NaN", "NaN", "NaN"]);
  equal([-2, 0, 2].map((row) => found.otherPositions(row)), [null, null, null], "before, not loaded, behind");
  buffer.shownRow = (row) => row - 1;
  equal(found.otherPositions(1), null, "frames are left out");
  const far = distances([0, 0, 0, NaN, 0, 0], [1, 2, 2, 1, 1, 1]);
  equal([far[0], Number.isNaN(far[1])], [3, true]);
});

test("a curve has the ends of all bins of a pixel", () => {
  const values = [[0, 1], [-2, 0], null, [5, 6]];
  equal(curveColumns(4, 10, 39, 2, (bin) => values[bin]), [[0, -2, 1], [1, -2, 6]], "a bin that reaches into a pixel counts there, too");
  equal(curveColumns(1, 1, 0, 3, () => [1, NaN]), []);
});

test("rigid bodies have axes, a state, and the share in which they are tracked", () => {
  const half = Math.SQRT1_2;
  const turned = axesOf([half, 0, 0, half], 2).map((axis) => axis.map((part) => Math.round(part * 1e6) / 1e6 + 0));
  equal(turned, [[0, 2, 0], [-2, 0, 0], [0, 0, 2]], "a quarter turn about z");
  const pose = (state, x = NaN) => [state, 0.1, x, x, x, 1, 0, 0, 0];
  const values = new Float32Array([...pose(0, 5), ...pose(1), ...pose(0, NaN)]);
  const names = ["wand", "", "club"];
  equal(bodyLines({ names, values, frames: 4, tracked: [4, 1, 0] }).map(({ text }) => text), [
    "wand · tracked · share tracked 100 %",
    "body 2 · lost · share tracked 25.0 %",
    "club · not tracked · share tracked 0 %",
  ]);
  equal(bodiesCount({ names, values }), "1 of 3 tracked");
  equal(bodiesText(names.slice(0, 2), values), "1 of 2 rigid bodies tracked; without a pose: body 2 (lost)");
  equal(bodiesText(["wand"], values), "1 of 1 rigid body tracked");
  const many = new Float32Array(Array(8).fill(pose(253)).flat());
  isTrue(bodiesText(Array(8).fill("b"), many).endsWith("b (missing), b (missing) and 2 more"));
});

test("rigid bodies alone place the camera, and poses that stop are not shown", () => {
  const motion = new Motion();
  motion.setTable({ labels: [], labelled: [], bones: [], up_axis: 3, bodies: ["a", "b"] });
  const values = new Float32Array([0, 0, 100, 200, 900, 1, 0, 0, 0, 0, 0, -100, 200, 1100, 1, 0, 0, 0]);
  motion.push({ positionsMm: new Float32Array(0) }, 0);
  motion.setPoses({ values, frames: 1, tracked: [1, 1] });
  equal([motion.updateBox(1).low, motion.box.high], [[-100, 200, 0], [100, 200, 1100]]);
  for (let i = 0; i < 10; i += 1) motion.push({ positionsMm: new Float32Array(0) }, 0);
  isTrue(motion.bodies.values !== null);
  motion.push({ positionsMm: new Float32Array(0) }, 0);
  equal([motion.bodies.values, motion.bodies.names], [null, ["a", "b"]]);
});

test("a window of poses of rigid bodies is parsed", () => {
  const buffer = new ArrayBuffer(32 + 2 * 72);
  const view = new DataView(buffer);
  [[0, 0x3142504d], [4, 2], [16, 2], [20, 3], [24, 2]].forEach(([at, value]) => view.setUint32(at, value, true));
  const { frames, every, positions, isDamaged } = parseBodies(buffer, 2);
  equal([frames, every, positions.length, isDamaged], [2, 3, 36, true]);
  throws(() => parseBodies(buffer, 1), "bodies");
});

test("forces are those of each plate, and their curve has the ends", () => {
  const load = (up) => [0, 0, up, 1, 2, 3, 4, up - 1, up + 1];
  const buffer = { positionsAt: (row) => (row === 1 ? new Float32Array([...load(700), ...load(NaN)]) : null) };
  const forces = new Forces({ plates: [{ name: "1" }, { name: "left" }] }, buffer, 6, 3);
  equal(forces.at(0), null);
  equal(forces.at(1)[0], { force: [0, 0, 700], cop: [1, 2, 3], freeMoment: 4, low: 699, high: 701 });
  equal(forces.texts(1), ["plate 1: 700 N", "plate left: no sample"]);
  forces.add({ firstRow: 3, frames: 1, positions: new Float32Array([...load(5), ...load(8)]) });
  equal(forces.curves.map((curve) => [...curve].map(String)), [["NaN", "NaN", "4", "6"], ["NaN", "NaN", "7", "9"]]);
});

function bytes(magic, n, frames, floats) {
  const view = new DataView(new ArrayBuffer(32 + 4 * floats));
  [...magic].forEach((c, i) => view.setUint8(i, c.charCodeAt(0)));
  view.setUint32(4, n, true);
  view.setUint32(16, frames, true);
  view.setUint32(20, 1, true);
  return view.buffer;
}

test("windows of forces and of poses have their own shapes", () => {
  equal(parseForces(bytes("MPF1", 2, 3, 54), 2).frames, 3);
  equal(parsePoses(bytes("MPP1", 1, 2, 24)).positions.length, 24);
  throws(() => parseForces(bytes("MPF1", 2, 3, 53), 2), "expected 3 frames");
  throws(() => parseForces(bytes("MPW1", 2, 3, 54), 2), "not a window");
  throws(() => parsePoses(bytes("MPP1", 1, 2, 23)), "expected 2 frames");
});

test("columns of sampled channels are read from the live stream", () => {
  const message = new DataView(new ArrayBuffer(28));
  message.setUint32(0, 24, true);
  message.setUint8(4, 4);
  message.setUint8(5, 3);
  message.setBigUint64(8, 1000n, true);
  message.setUint32(16, 50, true);
  message.setFloat32(20, -1.5, true);
  message.setFloat32(24, 2, true);
  const [found] = new LiveParser().push(new Uint8Array(message.buffer));
  equal([found.kind, found.group, found.first, found.n, ...found.ranges], ["samples", 3, 1000, 50, -1.5, 2]);
  message.setUint32(0, 23, true);
  throws(() => new LiveParser().push(new Uint8Array(message.buffer)), "two floats per channel");
});

test("a strip chart keeps ten seconds, and knows its ends, its level and clipping", () => {
  const channels = [{ full_scale: [-10, 9.5] }, { full_scale: null }];
  const strip = new StripHistory({ channels, rate_hz: 1000 });
  for (let i = 0; i <= 300; i += 1) strip.push(i * 50, { first: 50 * i, n: 50, ranges: [i === 250 ? -10 : -1, 4, NaN, NaN] });
  isTrue(strip.columns.length <= 210 && strip.columns[0].first >= 5000, strip.columns.length);
  equal(strip.ends(0, Infinity, 15_000), [-10, 4]);
  equal(strip.ends(0, 1, 15_000), [-1, 4]);
  equal(strip.ends(0, 1, 17_000), null, "nothing has come for two seconds");
  equal(strip.ends(1, Infinity, 15_000), null);
  equal(strip.ageS(14_050, 15_500), 1.5);
  strip.push(16_000, { first: 0, n: 50, ranges: [1, 2, NaN, NaN] });
  equal(strip.columns.length, 1, "the device began again");
  equal([[-10, 0], [0, 9.5], [-9.9, 9.4]].map((range) => strip.isClipped(0, range)), [true, true, false]);
  isTrue(!strip.isClipped(1, [-1e9, 1e9]));
  near(strip.level(0, [-1, 4]), 4 / 9.5, 1e-9);
  equal(strip.level(1, [-1, 4]), null);
});

test("the ledger of a group, and values with their units", () => {
  const group = { taken: 2000, stored: 1980, lost_on_link: 20, dropped_by_device: 0, lost_ring_full: 0, lost_other: 0, unknown_after_disconnect: 0, jumps: 1 };
  equal(ledgerText(group).replace(/\u202f/g, ""), "1980 of 2000 samples; lost: 20 on the link; numbers jumped 1 time");
  equal(ledgerText(undefined), "");
  equal([[2e-4, "V"], [-0.0042, "V"], [1.5, "V"], [700.4, "N"], [3, ""]].map(([value, unit]) => withPrefix(value, unit)),
    ["200 µV", "-4.20 mV", "1.50 V", "700 N", "3.00"]);
});

test("frames have the numbers of their source, and times no more digits than differ", () => {
  equal(frameText(0, { frames: 2001 }).replace(/\u202f/g, ""), "frame 1 of 2001");
  equal(frameText(4, { frames: 20, first_frame: 41 }), "frame 45: 5 of 20");
  equal([[42, 1], [42.5, 0.1], [42.05, 0.05], [3723, 60]].map(([seconds, step]) => axisTime(seconds, step)), ["0:42", "0:42.5", "0:42.05", "1:02:03"]);
});

test("the markers whose gap begins are named, and downloads have their formats", () => {
  const nan = [NaN, NaN, NaN];
  equal(gapsThatBegin([...nan, 1, 1, 1, ...nan], [1, 1, 1, 1, 1, 1, ...nan]), [0]);
  equal(gapsThatBegin([...nan, 1, 1, 1], null), [0]);
  equal([downloadPath("a b", "take"), downloadPath("a b", "c3d")], ["/v1/takes/a%20b/download", "/v1/takes/a%20b/download?format=c3d"]);
});

test("a decoded block of a shared page has markers, and the poses of rigid bodies", () => {
  const step = 0.5;
  // Two frames of a marker and a body: half a turn about z, and lost.
  const block = new Float32Array([1, 2, 3, 10, 20, 30, 0, 0, 800, 4, 5, 6, NaN, NaN, NaN, 1 * step, 0, 0]);
  const { positions, poses } = split(block, 1, 1, step);
  equal([...positions], [1, 2, 3, 4, 5, 6]);
  equal([...poses].map((value) => (Number.isNaN(value) ? null : value)), [0, null, 10, 20, 30, 0, 0, 0, 1, 1, null, null, null, null, null, null, null, null]);
  equal(bodiesText(["wand"], poses.subarray(9)), "0 of 1 rigid body tracked; without a pose: wand (lost)");
  equal(split(block, 6, 0, step).poses, null);
  isTrue(split(block, 6, 0, step).positions === block);
});
