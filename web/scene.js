// Draws the markers with their trails, bones and labels. Stateless between two frames.

import { drawFloor } from "./floor.js";
import { TRAIL } from "./motion.js";
import { drawLabels } from "./labels.js";

/** An occluded marker fades at its last position within this time, then disappears. */
export const FADE_MS = 4000;
/** A marker's radius, limited to a fraction of the scene: markers on a face sit close and are drawn small. */
const RADIUS_MM = 16;
const RADIUS_FRACTION = 1 / 80;
const BANDS = 5;

/**
 * `view`: {width, height, options: {labels, trails}, selected: slot or -1, colours, nowMs, layers}. `layers.floor` draws on the
 * floor, below the markers, `layers.markers` above them; `layers.bodies` draws rigid bodies.
 */
export function draw(ctx, camera, motion, view) {
  const { width, height } = view;
  ctx.clearRect(0, 0, width, height);
  const project = camera.projector(width, height);
  const stepMm = drawFloor(ctx, camera, motion, project, view);
  if (!motion.raw) return { stepMm, points: null };
  view.layers.floor?.(ctx, motion, project, view);
  const points = projectAll(motion, project, view.nowMs);
  drawShadows(ctx, motion, project, points, view);
  if (view.options.trails) drawTrails(ctx, motion, project, view);
  drawFace(ctx, motion, project, view);
  drawBones(ctx, motion, points, view);
  drawMarkers(ctx, motion, points, view);
  view.layers.markers?.(ctx, motion, project, points, view);
  view.layers.bodies?.(ctx, motion, project, view);
  drawLabels(ctx, motion, points, view);
  return { stepMm, points };
}

/** By slot: x, y, radius in pixels, and opacity (1 visible, below 1 fading, 0 not drawn). */
function projectAll(motion, project, nowMs) {
  const points = new Float32Array(4 * motion.n);
  const at = [0, 0, 0];
  const radiusMm = Math.min(RADIUS_MM, RADIUS_FRACTION * boxDiagonalMm(motion));
  for (let slot = 0; slot < motion.n; slot += 1) {
    const age = nowMs - motion.lastSeenMs[slot];
    const seen = motion.isSeen(slot) ? 1 : Math.max(0, 0.75 * (1 - age / FADE_MS));
    const [x, y, z] = motion.last.subarray(3 * slot, 3 * slot + 3);
    if (seen === 0 || !project(x, y, z, at)) continue;
    const radius = Math.min(14, Math.max(2.8, (radiusMm * project.scale) / at[2]));
    points.set([at[0], at[1], radius, seen], 4 * slot);
  }
  return points;
}

/** The diagonal of the box around the markers. */
function boxDiagonalMm({ box }) {
  return box ? Math.hypot(...box.high.map((high, axis) => high - box.low[axis])) : Infinity;
}

/** A dot on the floor below each marker shows its height. */
function drawShadows(ctx, motion, project, points, { colours }) {
  const at = [0, 0, 0];
  ctx.fillStyle = colours.shadow;
  ctx.beginPath();
  for (let slot = 0; slot < motion.n; slot += 1) {
    if (points[4 * slot + 3] < 1) continue;
    if (!project(motion.last[3 * slot], motion.last[3 * slot + 1], 0, at)) continue;
    const radius = Math.min(10, (RADIUS_MM * project.scale) / at[2]);
    ctx.moveTo(at[0] + radius, at[1]);
    ctx.ellipse(at[0], at[1], radius, radius * 0.45, 0, 0, 2 * Math.PI);
  }
  ctx.fill();
}

function drawTrails(ctx, motion, project, { colours, selected }) {
  const { trail, head, n } = motion;
  const perBand = (TRAIL - 1) / BANDS;
  const [a, b] = [[0, 0, 0], [0, 0, 0]];
  ctx.lineCap = "butt";
  for (let band = 0; band < BANDS; band += 1) {
    ctx.beginPath();
    const first = Math.round(band * perBand);
    const last = Math.round((band + 1) * perBand);
    for (let slot = 0; slot < n; slot += 1) {
      let isPenDown = false;
      for (let age = first; age <= last; age += 1) {
        const i = 3 * (((head - age + TRAIL) % TRAIL) * n + slot);
        const isVisible = Number.isFinite(trail[i]) && project(trail[i], trail[i + 1], trail[i + 2], a);
        if (isVisible && isPenDown) ctx.lineTo(a[0], a[1]);
        else if (isVisible) ctx.moveTo(a[0], a[1]);
        isPenDown = isVisible;
      }
    }
    ctx.globalAlpha = 0.8 * (1 - band / BANDS) ** 1.4;
    ctx.strokeStyle = colours.trail;
    // Without a GPU a line of one pixel is drawn several times faster than a wider one.
    ctx.lineWidth = 1;
    ctx.stroke();
  }
  ctx.globalAlpha = 1;
  if (selected < 0) return;
  ctx.beginPath();
  for (let age = 0; age < TRAIL - 1; age += 1) {
    const [i, j] = [age, age + 1].map((k) => 3 * (((head - k + TRAIL) % TRAIL) * n + selected));
    if (project(trail[i], trail[i + 1], trail[i + 2], a) && project(trail[j], trail[j + 1], trail[j + 2], b)) {
      ctx.moveTo(a[0], a[1]);
      ctx.lineTo(b[0], b[1]);
    }
  }
  ctx.strokeStyle = colours.selected;
  ctx.lineWidth = 2.5;
  ctx.stroke();
}

/** The wireframe of the subject's face, placed by its markers. */
function drawFace(ctx, motion, project, { colours }) {
  const placed = motion.placedFace();
  if (!placed) return;
  const [a, b] = [[0, 0, 0], [0, 0, 0]];
  ctx.beginPath();
  for (const [from, to] of motion.face.lines) {
    const there = [[from, a], [to, b]].every(([vertex, at]) =>
      project(placed[3 * vertex], placed[3 * vertex + 1], placed[3 * vertex + 2], at));
    if (!there) continue;
    ctx.moveTo(a[0], a[1]);
    ctx.lineTo(b[0], b[1]);
  }
  ctx.globalAlpha = 0.7;
  ctx.strokeStyle = colours.bone;
  ctx.lineWidth = 1;
  ctx.stroke();
  ctx.globalAlpha = 1;
}

/** Bones: solid if both ends are visible, dashed and thin if one is at its last known position. */
function drawBones(ctx, motion, points, { colours }) {
  ctx.lineCap = "round";
  ctx.strokeStyle = colours.bone;
  for (const isSolid of [false, true]) {
    ctx.beginPath();
    for (const [a, b] of motion.bones) {
      const seen = Math.min(points[4 * a + 3], points[4 * b + 3]);
      if (seen === 0 || (seen === 1) !== isSolid) continue;
      ctx.moveTo(points[4 * a], points[4 * a + 1]);
      ctx.lineTo(points[4 * b], points[4 * b + 1]);
    }
    ctx.lineWidth = isSolid ? 3.5 : 1.5;
    ctx.setLineDash(isSolid ? [] : [4, 6]);
    ctx.stroke();
  }
  ctx.setLineDash([]);
  drawDeviatingLimbs(ctx, motion, points, colours);
}

/** Limbs whose length deviates from the scan: in another colour and wider, so that colour is not alone. */
function drawDeviatingLimbs(ctx, motion, points, colours) {
  ctx.beginPath();
  for (const { ends: [a, b] } of motion.deviatingLimbs()) {
    ctx.moveTo(points[4 * a], points[4 * a + 1]);
    ctx.lineTo(points[4 * b], points[4 * b + 1]);
  }
  ctx.strokeStyle = colours.off;
  ctx.lineWidth = 6;
  ctx.stroke();
}

/** A disc: labelled. A square: unlabelled. A ring: occluded, at its last position. */
function drawMarkers(ctx, motion, points, { colours, selected }) {
  const known = new Path2D();
  const unknown = new Path2D();
  for (let slot = 0; slot < motion.n; slot += 1) {
    const [x, y, radius, seen] = points.subarray(4 * slot, 4 * slot + 4);
    if (seen === 1 && motion.labelled[slot]) {
      known.moveTo(x + radius, y);
      known.arc(x, y, radius, 0, 2 * Math.PI);
    } else if (seen === 1) {
      unknown.rect(x - 0.85 * radius, y - 0.85 * radius, 1.7 * radius, 1.7 * radius);
    } else if (seen > 0) {
      ctx.globalAlpha = seen;
      ctx.strokeStyle = colours.marker;
      ctx.lineWidth = 1.3;
      ctx.beginPath();
      ctx.arc(x, y, radius, 0, 2 * Math.PI);
      ctx.stroke();
    }
  }
  ctx.globalAlpha = 1;
  ctx.strokeStyle = colours.panel;
  ctx.lineWidth = 1.2;
  for (const [path, colour] of [[known, colours.marker], [unknown, colours.stray]]) {
    ctx.fillStyle = colour;
    ctx.fill(path);
    ctx.stroke(path);
  }
  if (selected >= 0 && points[4 * selected + 3] > 0) {
    const [x, y, radius] = points.subarray(4 * selected, 4 * selected + 3);
    ctx.strokeStyle = colours.selected;
    ctx.lineWidth = 3;
    ctx.beginPath();
    ctx.arc(x, y, radius + 6, 0, 2 * Math.PI);
    ctx.stroke();
  }
}

/** The nearest marker within `reach` pixels of a point, or -1. */
export function pick(points, x, y, reach) {
  let best = -1;
  let nearest = reach * reach;
  for (let slot = 0; points && slot < points.length / 4; slot += 1) {
    const [px, py, , seen] = points.subarray(4 * slot, 4 * slot + 4);
    const distance = (px - x) ** 2 + (py - y) ** 2;
    if (seen > 0 && distance < nearest) [best, nearest] = [slot, distance];
  }
  return best;
}
