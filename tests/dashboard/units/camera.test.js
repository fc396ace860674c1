import { Camera, axisNames, gridStep, upright } from "/camera.js";
import { equal, isTrue, near, test } from "./harness.js";

const SIZE = [800, 600];

function seen(camera, x, y, z) {
  const out = [0, 0, 0];
  const isBefore = camera.projector(...SIZE)(x, y, z, out);
  return { x: out[0], y: out[1], depth: out[2], isBefore };
}

test("what is looked at is in the middle, at the distance", () => {
  const camera = new Camera();
  camera.target = [100, -200, 900];
  const { x, y, depth, isBefore } = seen(camera, 100, -200, 900);
  near(x, 400);
  near(y, 300);
  near(depth, camera.distanceMm);
  isTrue(isBefore, "before the eye");
});

test("up is up, right is right, and behind the eye is not seen", () => {
  const camera = new Camera();
  [camera.yaw, camera.pitch, camera.target] = [-Math.PI / 2, 0, [0, 0, 0]];
  // The eye stands at -y and looks along +y: x lies to the right.
  isTrue(seen(camera, 100, 0, 0).x > 400, "x to the right");
  isTrue(seen(camera, 0, 0, 100).y < 300, "z up on the screen");
  isTrue(seen(camera, 0, 1000, 0).depth > camera.distanceMm, "y away from the eye");
  isTrue(!seen(camera, 0, -camera.distanceMm - 1, 0).isBefore, "behind the eye");
});

test("axes stay right-handed whichever points up, and the third is up", () => {
  for (const upAxis of [0, 1, 2, 3]) {
    const columns = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((unit) => {
      const out = [0, 0, 0];
      upright(upAxis, ...unit, out, 0);
      return out;
    });
    const [a, b, c] = columns;
    const determinant = a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) + a[2] * (b[0] * c[1] - b[1] * c[0]);
    near(determinant, 1);
    equal(columns[(upAxis || 3) - 1], [0, 0, 1], "the axis that points up");
    equal(columns[["x", "y", "z"].indexOf(axisNames(upAxis)[0])], [1, 0, 0], "the name of the first");
  }
});

test("turning, zooming and moving stay within their bounds", () => {
  const camera = new Camera();
  camera.orbit(0, 9);
  isTrue(camera.pitch < Math.PI / 2, "never over the top");
  camera.zoom(1e-9);
  near(camera.distanceMm, 100);
  camera.zoom(1e9);
  near(camera.distanceMm, 200_000);
});

test("moving by hand takes what is looked at along", () => {
  const camera = new Camera();
  const [x, y, z] = camera.target;
  camera.pan(50, -30, SIZE[1]);
  const now = seen(camera, x, y, z);
  near(now.x, 450, 0.5);
  near(now.y, 270, 0.5);
});

test("a box that is approached is wholly in the view, wide or tall", () => {
  const box = { low: [-400, -400, 0], high: [400, 400, 1800] };
  for (const [width, height] of [[800, 600], [390, 700], [1400, 300]]) {
    const camera = new Camera();
    camera.approach(box, width, height, 1);
    const project = camera.projector(width, height);
    const out = [0, 0, 0];
    for (const corner of [0, 1, 2, 3, 4, 5, 6, 7]) {
      const [x, y, z] = [0, 1, 2].map((i) => (corner >> i & 1 ? box.high[i] : box.low[i]));
      isTrue(project(x, y, z, out), "before the eye");
      const inside = out[0] > -0.05 * width && out[0] < 1.05 * width && out[1] > -0.05 * height && out[1] < 1.05 * height;
      isTrue(inside, `${width}x${height}: corner ${corner} at ${out}`);
    }
  }
});

test("the floor's squares have round widths", () => {
  equal([1200, 5000, 6100, 30_000].map(gridStep), [100, 500, 1000, 5000]);
});
