// The force plates of a take: their loads at any row, and the forces of the whole take. Pure but for drawing.

import { toZUp } from "./camera.js";

/** Numbers of a load: force, centre of pressure, free moment, least and largest upward force. */
const VALUES = 9;
/** Millimetres in the scene that a newton is long: the weight of an adult is as long as their legs. */
const MM_PER_N = 1.2;
const HEAD_PX = 9;

export class Forces {
  /** [{name, corners_mm}] */
  plates = [];
  /** By plate and column of the time axis, the least and the largest upward force: [low, high], NaN where there is none. */
  curves = [];
  columnFrames = 1;

  /** `list` is that of GET /v1/takes/{name}/plates; `buffer` loads the loads, as if a plate were three markers. */
  constructor(list, buffer, frames, columnFrames) {
    this.plates = list.plates;
    this.buffer = buffer;
    this.columnFrames = columnFrames;
    const n = Math.ceil(frames / columnFrames);
    this.curves = this.plates.map(() => new Float32Array(2 * n).fill(NaN));
  }

  /** Adds a part of the forces of the whole take: every `columnFrames`-th frame of it. */
  add({ firstRow, frames, positions }) {
    for (let i = 0; i < frames; i += 1) {
      const column = firstRow / this.columnFrames + i;
      this.plates.forEach((_, plate) => {
        this.curves[plate].set(positions.subarray(VALUES * (i * this.plates.length + plate) + 7, VALUES * (i * this.plates.length + plate) + 9), 2 * column);
      });
    }
  }

  /** The load of each plate at a row: {force, cop, freeMoment, low, high}; null if it is not loaded. */
  at(row) {
    const values = this.buffer.positionsAt(row);
    if (!values) return null;
    return this.plates.map((_, plate) => {
      const v = values.subarray(VALUES * plate, VALUES * (plate + 1));
      return { force: [v[0], v[1], v[2]], cop: [v[3], v[4], v[5]], freeMoment: v[6], low: v[7], high: v[8] };
    });
  }

  /** A line for each plate that bears something: `plate 1: 712 N`. */
  texts(row) {
    const loads = this.at(row);
    if (!loads) return [];
    return loads.map(({ force }, i) => `plate ${this.plates[i].name}: ${Number.isFinite(force[2]) ? `${Math.round(Math.hypot(...force))} N` : "no sample"}`);
  }
}

/** The outlines of the plates, and the reaction forces on the subject at the centres of pressure. */
export function drawForces(forces, ctx, { row, upAxis }, project, { colours }) {
  const loads = forces.at(row);
  const [from, to] = [[0, 0, 0], [0, 0, 0]];
  const point = (x, y, z, out) => {
    const p = [0, 0, 0];
    toZUp(upAxis, x, y, z, p, 0);
    return project(p[0], p[1], p[2], out);
  };
  forces.plates.forEach(({ corners_mm: corners, name }, i) => {
    const places = corners.map((corner) => {
      const out = [0, 0, 0];
      return point(...corner, out) ? out : null;
    });
    if (places.some((place) => place === null)) return;
    ctx.beginPath();
    places.forEach(([x, y], corner) => (corner === 0 ? ctx.moveTo(x, y) : ctx.lineTo(x, y)));
    ctx.closePath();
    ctx.globalAlpha = 0.12;
    ctx.fillStyle = colours.force;
    ctx.fill();
    ctx.globalAlpha = 1;
    ctx.strokeStyle = colours.force;
    ctx.lineWidth = 1.5;
    ctx.stroke();
    ctx.fillStyle = colours.muted;
    ctx.font = "600 12px system-ui, sans-serif";
    ctx.textAlign = "center";
    ctx.textBaseline = "middle";
    ctx.fillText(name, ...[0, 1].map((axis) => (places[0][axis] + places[2][axis]) / 2));
    const load = loads?.[i];
    if (!load || !load.cop.every(Number.isFinite) || !load.force.every(Number.isFinite)) return;
    const end = load.cop.map((at, axis) => at + load.force[axis] * MM_PER_N);
    if (!point(...load.cop, from) || !point(...end, to)) return;
    drawArrow(ctx, from, to, colours.force);
  });
}

function drawArrow(ctx, from, to, colour) {
  const length = Math.hypot(to[0] - from[0], to[1] - from[1]);
  ctx.strokeStyle = ctx.fillStyle = colour;
  ctx.lineWidth = 3.5;
  ctx.lineCap = "round";
  ctx.beginPath();
  ctx.arc(from[0], from[1], 3.5, 0, 2 * Math.PI);
  ctx.fill();
  if (length < 4) return;
  const [dx, dy] = [0, 1].map((axis) => (to[axis] - from[axis]) / length);
  const head = Math.min(HEAD_PX, length / 2);
  ctx.beginPath();
  ctx.moveTo(from[0], from[1]);
  ctx.lineTo(to[0] - dx * head, to[1] - dy * head);
  ctx.stroke();
  ctx.beginPath();
  ctx.moveTo(to[0], to[1]);
  ctx.lineTo(to[0] - dx * head * 1.6 - dy * head * 0.7, to[1] - dy * head * 1.6 + dx * head * 0.7);
  ctx.lineTo(to[0] - dx * head * 1.6 + dy * head * 0.7, to[1] - dy * head * 1.6 - dx * head * 0.7);
  ctx.fill();
}
