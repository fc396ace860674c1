import { Camera, axisNames, gridStep, toZUp } from "/camera.js";
import { equal, isTrue, near, test } from "./harness.js";

const SIZE = [800, 600];

function seen(camera, x, y, z) {
  const out = [0, 0, 0];
  const isInFront = camera.projector(...SIZE)(x, y, z, out);
  return { x: out[0], y: out[1], depth: out[2], isInFront };
}

test("the target is in the centre, at the distance", () => {
  const camera = new Camera();
  camera.target = [100, -200, 900];
  const { x, y, depth, isInFront } = seen(camera, 100, -200, 900);
  near(x, 400);
  near(y, 300);
  near(depth, camera.distanceMm);
  isTrue(isInFront, "in front of the camera");
});

test("up is up, right is right, and points behind the camera are invisible", () => {
  const camera = new Camera();
  [camera.yaw, camera.pitch, camera.target] = [-Math.PI / 2, 0, [0, 0, 0]];
  // The camera is at -y and looks along +y: x is to the right.
  isTrue(seen(camera, 100, 0, 0).x > 400, "x to the right");
  isTrue(seen(camera, 0, 0, 100).y < 300, "z up on the screen");
  isTrue(seen(camera, 0, 1000, 0).depth > camera.distanceMm, "y away from the camera");
  isTrue(!seen(camera, 0, -camera.distanceMm - 1, 0).isInFront, "behind the camera");
});

test("the axes stay right-handed whichever points up, and the third is up", () => {
  for (const upAxis of [0, 1, 2, 3]) {
    const columns = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((unit) => {
      const out = [0, 0, 0];
      toZUp(upAxis, ...unit, out, 0);
      return out;
    });
    const [a, b, c] = columns;
    const determinant = a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) + a[2] * (b[0] * c[1] - b[1] * c[0]);
    near(determinant, 1);
    equal(columns[(upAxis || 3) - 1], [0, 0, 1], "the axis that points up");
    equal(columns[["x", "y", "z"].indexOf(axisNames(upAxis)[0])], [1, 0, 0], "the name of the first");
  }
});

test("pitch and distance stay within their bounds", () => {
  const camera = new Camera();
  camera.orbit(0, 9);
  isTrue(camera.pitch < Math.PI / 2, "never over the top");
  camera.zoom(1e-9);
  near(camera.distanceMm, 100);
  camera.zoom(1e9);
  near(camera.distanceMm, 200_000);
});

test("panning moves the target with the pointer", () => {
  const camera = new Camera();
  const [x, y, z] = camera.target;
  camera.pan(50, -30, SIZE[1]);
  const now = seen(camera, x, y, z);
  near(now.x, 450, 0.5);
  near(now.y, 270, 0.5);
});

test("a box is entirely in the view, wide or tall", () => {
  const box = { low: [-400, -400, 0], high: [400, 400, 1800] };
  for (const [width, height] of [[800, 600], [390, 700], [1400, 300]]) {
    const camera = new Camera();
    camera.approach(box, width, height, 1);
    const project = camera.projector(width, height);
    const out = [0, 0, 0];
    for (const corner of [0, 1, 2, 3, 4, 5, 6, 7]) {
      const [x, y, z] = [0, 1, 2].map((i) => (corner >> i & 1 ? box.high[i] : box.low[i]));
      isTrue(project(x, y, z, out), "in front of the camera");
      const inside = out[0] > -0.05 * width && out[0] < 1.05 * width && out[1] > -0.05 * height && out[1] < 1.05 * height;
      isTrue(inside, `${width}x${height}: corner ${corner} at ${out}`);
    }
  }
});

test("the grid spacing is round", () => {
  equal([1200, 5000, 6100, 30_000].map(gridStep), [100, 500, 1000, 5000]);
});
