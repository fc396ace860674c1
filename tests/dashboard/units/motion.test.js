import { Motion, TRAIL } from "/motion.js";
import { equal, isTrue, near, test } from "./harness.js";

function withTable(labels, upAxis = 3, bones = []) {
  const motion = new Motion();
  motion.setTable({ labels, labelled: labels.map(() => true), up_axis: upAxis, rate_hz: 120, bones });
  return motion;
}

const frame = (...positions) => ({ positionsMm: Float32Array.from(positions) });

test("an occluded marker keeps its last position and time", () => {
  const motion = withTable(["a", "b"]);
  motion.push(frame(1, 2, 3, 4, 5, 6), 100);
  motion.push(frame(7, 8, 9, NaN, NaN, NaN), 133);
  equal([...motion.last], [7, 8, 9, 4, 5, 6]);
  equal([...motion.lastSeenMs], [133, 100]);
  equal([motion.isSeen(0), motion.isSeen(1), motion.nSeen], [true, false, 1]);
});

test("a frame with too few or too many markers is accepted", () => {
  const motion = withTable(["a", "b"]);
  motion.push(frame(1, 2, 3), 1);
  equal([motion.isSeen(0), motion.isSeen(1)], [true, false]);
  motion.push(frame(1, 2, 3, 4, 5, 6, 7, 8, 9), 2);
  equal(motion.nSeen, 2);
});

test("the axis that points up becomes the third", () => {
  const motion = withTable(["a"], 2);
  motion.push(frame(1, 2, 3), 1);
  equal([...motion.last], [3, 1, 2]);
});

test("trails are ring buffers", () => {
  const motion = withTable(["a"]);
  for (let i = 0; i < TRAIL + 3; i += 1) motion.push(frame(i, 0, 0), i);
  const xs = Array.from({ length: TRAIL }, (_, age) => motion.trail[3 * ((motion.head - age + TRAIL) % TRAIL)]);
  equal(xs, Array.from({ length: TRAIL }, (_, age) => TRAIL + 2 - age));
});

test("a table with one more marker keeps the others' positions and trails", () => {
  const motion = withTable(["a", "b"]);
  motion.push(frame(1, 2, 3, 4, 5, 6), 10);
  motion.push(frame(2, 2, 3, 4, 5, 6), 20);
  motion.setTable({ labels: ["b", "c", "a"], labelled: [true, true, true], up_axis: 3, bones: [[0, 2], [0, 3]] });
  equal([...motion.last].slice(6), [2, 2, 3]);
  equal([motion.lastSeenMs[0], motion.lastSeenMs[2]], [20, 20]);
  const before = (motion.head - 1 + TRAIL) % TRAIL;
  equal([...motion.trail.slice(3 * (before * 3 + 2), 3 * (before * 3 + 2) + 3)], [1, 2, 3]);
  equal(motion.bones, [[0, 2]], "a bone to a missing marker is left out");
});

test("markers without a label get one by their slot", () => {
  equal(withTable(["a", ""]).labels, ["a", "u002"]);
});

test("the box leaves out a distant reflection, grows at once and shrinks slowly", () => {
  const motion = withTable(Array.from({ length: 40 }, (_, i) => `m${i}`));
  const cloud = (half) => Array.from({ length: 39 }, (_, i) => [half * Math.sin(i), half * Math.cos(i), 900]).flat();
  motion.push(frame(...cloud(500), 90_000, 0, 900), 1);
  const box = motion.updateBox(0);
  isTrue(box.high[0] <= 500, `the reflection is out: ${box.high[0]}`);
  equal(box.low[2], 0, "the floor is in");
  motion.push(frame(...cloud(800), 0, 0, 900), 2);
  isTrue(motion.updateBox(0).high[0] > 700, "grown at once");
  const high = motion.box.high[0];
  motion.push(frame(...cloud(100), 0, 0, 900), 3);
  near(motion.updateBox(0.1).high[0], high - 0.1 * (high - 99.8), 1);
});

test("the box of a body reaches from floor to head, that of a face leaves the floor out", () => {
  const labels = Array.from({ length: 15 }, (_, i) => `m${i}`);
  const body = withTable(labels);
  body.push(frame(...labels.flatMap((_, i) => [0, 10 * (i % 3), i === 14 ? 1750 : 110 * i])), 1);
  const { low, high } = body.updateBox(0);
  equal([low[2], high[2]], [0, 1750]);
  const face = withTable(labels);
  face.push(frame(...labels.flatMap((_, i) => [15 * i, 8 * (i % 5), 1150 + 12 * (i % 7)])), 1);
  equal(face.updateBox(0).low[2], 1150);
  const stray = withTable(["a"]);
  stray.push(frame(0, 0, 1150), 1);
  equal(stray.updateBox(0).low[2], 0, "one marker has no extent");
});

test("without a visible marker there is no box", () => {
  const motion = withTable(["a"]);
  motion.push(frame(NaN, NaN, NaN), 1);
  equal(motion.updateBox(1), null);
});

test("a limb that deviates from the scan is reported while both ends are visible", () => {
  const motion = new Motion();
  const limbs = [{ ends: [0, 1], length_mm: 300, off_mm: 30 }, { ends: [1, 2], length_mm: 200, off_mm: 20 }];
  motion.setTable({
    labels: ["a", "b"], labelled: [true, true], up_axis: 3, rate_hz: 120, bones: [[0, 1]], limbs,
  });
  equal(motion.limbs.length, 1, "a limb to a missing marker is left out");
  motion.push(frame(0, 0, 0, 0, 0, 325), 1);
  equal(motion.deviatingLimbs(), []);
  motion.push(frame(0, 0, 0, 0, 0, 331), 2);
  equal(motion.deviatingLimbs().length, 1);
  motion.push(frame(0, 0, 0, NaN, NaN, NaN), 3);
  equal(motion.deviatingLimbs(), [], "the position of the other end is unknown");
  equal(withTable(["a", "b"]).deviatingLimbs(), [], "a service without a subject sends no limbs");
});

test("the face is placed by the last frame's pose, and hidden without one", () => {
  const motion = new Motion();
  const face = { vertices_mm: [[0, 0, 0], [1, 2, 3]], lines: [[0, 1]] };
  motion.setTable({ labels: ["a"], labelled: [true], up_axis: 2, rate_hz: 120, bones: [], face });
  motion.push(frame(0, 0, 0), 1);
  equal(motion.placedFace(), null);
  motion.facePose = Float32Array.from([2, 0, 0, 10, 0, 2, 0, 20, 0, 0, 2, 30]);
  equal([...motion.placedFace()], [30, 10, 20, 36, 12, 24], "y is up");
  motion.push(frame(0, 0, 0), 2);
  equal(motion.placedFace(), null, "a frame without a pose has no face");
});
