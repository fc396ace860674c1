// Draws the floor grid, with a round spacing, and the device's axes with their names.

import { axisNames, gridStep } from "./camera.js";

/** Squares from the centre to the edge, and the length of a line segment in squares: a segment that reaches behind the
 * camera is left out. */
const HALF = 12;
const SEGMENT = 3;

/** Draws the floor; returns the grid spacing in millimetres. */
export function drawFloor(ctx, camera, motion, project, view) {
  const { colours } = view;
  const stepMm = gridStep(camera.distanceMm);
  const [cx, cy] = [0, 1].map((i) => Math.round(camera.target[i] / stepMm) * stepMm);
  const [a, b] = [[0, 0, 0], [0, 0, 0]];
  // Every fifth line is stronger; all lines fade outwards, so that the floor has no edge.
  const paths = [0, 1, 2, 3].map(() => new Path2D());
  const drawSegment = (path, x1, y1, x2, y2) => {
    if (!project(x1, y1, 0, a) || !project(x2, y2, 0, b)) return;
    path.moveTo(a[0], a[1]);
    path.lineTo(b[0], b[1]);
  };
  for (let k = -HALF; k <= HALF; k += 1) {
    const [x, y] = [cx + k * stepMm, cy + k * stepMm];
    for (let i = -HALF; i < HALF; i += SEGMENT) {
      const isInside = Math.max(Math.abs(k), Math.abs(i + SEGMENT / 2)) <= 0.6 * HALF;
      const path = (at) => paths[(Math.round(at / stepMm) % 5 === 0 ? 2 : 0) + (isInside ? 1 : 0)];
      const [from, to] = [i * stepMm, (i + SEGMENT) * stepMm];
      drawSegment(path(x), x, cy + from, x, cy + to);
      drawSegment(path(y), cx + from, y, cx + to, y);
    }
  }
  ctx.lineWidth = 1;
  paths.forEach((path, which) => {
    ctx.globalAlpha = which % 2 ? 1 : 0.4;
    ctx.strokeStyle = which >= 2 ? colours["grid-main"] : colours.grid;
    ctx.stroke(path);
  });
  ctx.globalAlpha = 1;
  drawAxes(ctx, motion, project, stepMm, view);
  return stepMm;
}

/** Axes from the device's origin, one square long; names, not colours, identify them. */
function drawAxes(ctx, motion, project, stepMm, { width, height, colours }) {
  const [from, to] = [[0, 0, 0], [0, 0, 0]];
  if (!project(0, 0, 0, from)) return;
  ctx.strokeStyle = ctx.fillStyle = colours.muted;
  ctx.lineWidth = 2;
  ctx.font = "600 13px system-ui, sans-serif";
  ctx.textAlign = "center";
  ctx.textBaseline = "middle";
  axisNames(motion.upAxis).forEach((name, axis) => {
    const end = [0, 1, 2].map((i) => (i === axis ? stepMm : 0));
    if (!project(...end, to)) return;
    ctx.beginPath();
    ctx.moveTo(from[0], from[1]);
    ctx.lineTo(to[0], to[1]);
    ctx.stroke();
    const length = Math.hypot(to[0] - from[0], to[1] - from[1]) || 1;
    const [x, y] = [0, 1].map((i) => to[i] + ((to[i] - from[i]) / length) * 10);
    if (x > 0 && x < width && y > 0 && y < height) ctx.fillText(name, x, y);
  });
}
