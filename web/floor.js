// Draws the floor: squares of a round width, and the device's axes with their names.

import { axisNames, gridStep } from "./camera.js";

/** Squares from the middle to the edge, and how many of them are one piece of a line: a piece that reaches behind the
 * eye is left out. */
const HALF = 12;
const PIECE = 3;

/** Returns how wide a square is, in millimetres. */
export function drawFloor(ctx, camera, motion, project, view) {
  const { colours } = view;
  const stepMm = gridStep(camera.distanceMm);
  const [cx, cy] = [0, 1].map((i) => Math.round(camera.target[i] / stepMm) * stepMm);
  const [a, b] = [[0, 0, 0], [0, 0, 0]];
  // Every fifth line is stronger, and all are fainter outwards, so that the floor has no edge.
  const paths = [0, 1, 2, 3].map(() => new Path2D());
  const piece = (path, x1, y1, x2, y2) => {
    if (!project(x1, y1, 0, a) || !project(x2, y2, 0, b)) return;
    path.moveTo(a[0], a[1]);
    path.lineTo(b[0], b[1]);
  };
  for (let k = -HALF; k <= HALF; k += 1) {
    const [x, y] = [cx + k * stepMm, cy + k * stepMm];
    for (let i = -HALF; i < HALF; i += PIECE) {
      const isInside = Math.max(Math.abs(k), Math.abs(i + PIECE / 2)) <= 0.6 * HALF;
      const path = (at) => paths[(Math.round(at / stepMm) % 5 === 0 ? 2 : 0) + (isInside ? 1 : 0)];
      const [from, to] = [i * stepMm, (i + PIECE) * stepMm];
      piece(path(x), x, cy + from, x, cy + to);
      piece(path(y), cx + from, y, cx + to, y);
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

/** From the device's origin, one square long, each with its name: words, not colours. */
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
