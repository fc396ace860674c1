// The rigid bodies of a device or a take: their poses, drawn as axes with names; and those of a player.

import { toZUp } from "./camera.js";
import { byId, setHidden, setText } from "./dom.js";
import { plural } from "./format.js";
import { FrameBuffer } from "./frame_buffer.js";

/** Numbers of a pose: state, residual, position, and the quaternion w, x, y, z. */
export const POSE_VALUES = 9;
const TRACKED = 0;
export const STATES = new Map([[0, "tracked"], [1, "lost"], [2, "rejected"], [253, "missing"], [254, "refused"], [255, "not listed"]]);
const OTHER = "not tracked";
/** Length of the axes in the scene, as a fraction of the view's height at the body, and in millimetres. */
const AXIS_MM = [40, 200];
const AXIS_FRACTION = 0.07;
/** With more bodies than this, names are drawn only with the labels of the markers. */
const NAMED_MAX = 24;
/** Names of bodies without a pose in a line of text. */
const NAMES_MAX = 6;
/** Bytes of poses that a player keeps. */
const KEPT_BYTES_MAX = 8e6;

/** The name of a body. */
export const bodyName = (names, body) => names[body] || `body ${body + 1}`;

/** The pose of a body: {state, position, quaternion} as sent; the state as a text. Pure. */
export function poseOf(values, body) {
  const v = values.subarray(POSE_VALUES * body, POSE_VALUES * (body + 1));
  const isTracked = v[0] === TRACKED && v.subarray(2).every(Number.isFinite);
  const state = v[0] === TRACKED && !isTracked ? OTHER : STATES.get(v[0]) ?? OTHER;
  return { isTracked, state, position: v.subarray(2, 5), quaternion: v.subarray(5, 9) };
}

/** The ends of the three axes of a body from its origin, of this length. Pure. */
export function axesOf([w, x, y, z], length) {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
    [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
    [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
  ].map((axis) => axis.map((part) => part * length));
}

/** The axes and names of the bodies that have a pose: x is solid, y dashed and z dotted, so that colour is not alone. */
export function drawBodies(ctx, { bodies, upAxis }, project, { colours, options, height }) {
  if (!bodies?.values) return;
  const { names, values } = bodies;
  const [from, to, p] = [[0, 0, 0], [0, 0, 0], [0, 0, 0]];
  const point = (x, y, z, out) => {
    toZUp(upAxis, x, y, z, p, 0);
    return project(p[0], p[1], p[2], out);
  };
  ctx.font = "600 13px system-ui, sans-serif";
  ctx.textAlign = "left";
  ctx.textBaseline = "middle";
  ctx.lineJoin = "round";
  ctx.lineCap = "butt";
  for (let body = 0; body < Math.min(names.length, values.length / POSE_VALUES); body += 1) {
    const { isTracked, position, quaternion } = poseOf(values, body);
    if (!isTracked || !point(...position, from)) continue;
    const length = Math.min(AXIS_MM[1], Math.max(AXIS_MM[0], (AXIS_FRACTION * height * from[2]) / project.scale));
    axesOf(quaternion, length).forEach((axis, i) => {
      if (!point(...position.map((at, part) => at + axis[part]), to)) return;
      ctx.strokeStyle = colours[`axis-${"xyz"[i]}`];
      ctx.lineWidth = 3;
      ctx.setLineDash([[], [7, 3], [2, 3]][i]);
      ctx.beginPath();
      ctx.moveTo(from[0], from[1]);
      ctx.lineTo(to[0], to[1]);
      ctx.stroke();
    });
    ctx.setLineDash([]);
    ctx.beginPath();
    ctx.arc(from[0], from[1], 4, 0, 2 * Math.PI);
    ctx.fillStyle = colours.text;
    ctx.fill();
    if (names.length > NAMED_MAX && !options.labels) continue;
    ctx.strokeStyle = colours.panel;
    ctx.lineWidth = 3;
    ctx.strokeText(bodyName(names, body), from[0] + 9, from[1] + 12);
    ctx.fillText(bodyName(names, body), from[0] + 9, from[1] + 12);
  }
}

/** The state of all bodies as one line. Pure. */
export function bodiesText(names, values) {
  const without = names.flatMap((_, body) => {
    const { isTracked, state } = poseOf(values, body);
    return isTracked ? [] : [`${bodyName(names, body)} (${state})`];
  });
  const known = `${names.length - without.length} of ${plural(names.length, "rigid body", "rigid bodies")} tracked`;
  if (without.length === 0) return known;
  const more = without.length > NAMES_MAX ? ` and ${without.length - NAMES_MAX} more` : "";
  return `${known}; without a pose: ${without.slice(0, NAMES_MAX).join(", ")}${more}`;
}

/** The rigid bodies of the take in a player. */
export class TakeBodies {
  #player;
  #names = [];
  /** Their poses around the current row, as if each were three markers; null if there are none. */
  #buffer = null;

  constructor(player) {
    this.#player = player;
  }

  /** Whether there is something to see without markers. */
  get isShown() {
    return this.#buffer !== null;
  }

  /** Nothing is shown of the take before. */
  close() {
    this.#buffer = null;
    setHidden(byId("bodies-text"), true);
  }

  /** Reads which bodies the take of a source has. */
  async open(source, isCurrent) {
    const player = this.#player;
    if (player.overview.frames === 0) return;
    try {
      await player.buffer.idle();
      const { names, window_frames_max: most } = await source.bodies();
      if (!isCurrent() || names.length === 0) return;
      const window = (firstRow, rows, every, signal) => source.bodyPoses(firstRow, rows, every, names.length, signal);
      const { windowFrames, canCancel } = source;
      const overview = { ...player.overview, markers: 3 * names.length, window_frames_max: most };
      this.#names = names;
      this.#buffer = new FrameBuffer({ window, windowFrames, canCancel }, overview, {
        keptBytesMax: KEPT_BYTES_MAX,
        onLoaded: () => isCurrent() && player.refresh(),
      });
      setHidden(byId("bodies-text"), false);
      player.refresh();
    } catch (error) {
      if (isCurrent()) player.notice(`The rigid bodies of this take cannot be read: ${error.message}`);
    }
  }

  /** Loads what is needed at the current row, and what playback needs next. */
  want({ row, loop }, rowsPerSecond) {
    this.#buffer?.want(row, rowsPerSecond, loop);
  }

  /** The row on display has changed. Bodies stay where they are while the next window is loaded. */
  show(motion) {
    if (!this.#buffer) return;
    const found = this.#buffer.positionsAt(motion.row);
    const values = found ?? (this.#buffer.isWaitingFor(motion.row) ? motion.bodies.values : null);
    motion.bodies = { names: this.#names, values, frames: 0, tracked: [] };
  }

  /** The bodies at a row, as one line. */
  showText(row) {
    if (!this.#buffer) return;
    const values = this.#buffer.positionsAt(row);
    const isLoading = this.#buffer.isWaitingFor(row);
    setText(byId("bodies-text"), values ? bodiesText(this.#names, values) : isLoading ? "Loading rigid bodies" : "The poses of these frames cannot be read");
  }
}
