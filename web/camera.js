// Where the eye is, and where a point comes to lie on the screen. Pure. Millimetres; z points up.

/** Upwards opening of the view, radians. */
const OPENING = (36 * Math.PI) / 180;
const NEAREST_MM = 100;
const FARTHEST_MM = 200_000;
const STEEPEST = 1.553;
/** Of what is approached: a hand fills half of the view. */
const RADIUS_MIN_MM = 120;

/** Puts a position of the device into axes of which the third points up, right-handed as before. */
export function upright(upAxis, x, y, z, out, at) {
  if (upAxis === 1) [out[at], out[at + 1], out[at + 2]] = [y, z, x];
  else if (upAxis === 2) [out[at], out[at + 1], out[at + 2]] = [z, x, y];
  else [out[at], out[at + 1], out[at + 2]] = [x, y, z];
}

/** Names of the axes that lie right, away and up, as the device calls them. */
export function axisNames(upAxis) {
  return [["x", "y", "z"], ["y", "z", "x"], ["z", "x", "y"], ["x", "y", "z"]][upAxis] ?? ["x", "y", "z"];
}

export class Camera {
  yaw = -0.9;
  pitch = 0.3;
  distanceMm = 5000;
  target = [0, 0, 900];

  /** Turns by so many radians. */
  orbit(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = Math.min(STEEPEST, Math.max(-STEEPEST, this.pitch + pitch));
  }

  /** Nearer by a factor below 1, farther by one above. */
  zoom(factor) {
    this.distanceMm = Math.min(FARTHEST_MM, Math.max(NEAREST_MM, this.distanceMm * factor));
  }

  /** Moves what is looked at, by so many pixels of a view of that height. */
  pan(dx, dy, height) {
    const mm = (2 * this.distanceMm * Math.tan(OPENING / 2)) / height;
    const { right, up } = this.axes();
    for (let i = 0; i < 3; i += 1) this.target[i] += (-dx * right[i] + dy * up[i]) * mm;
  }

  /** Unit vectors: to the right of the screen, up on it, and into it. */
  axes() {
    const [cy, sy] = [Math.cos(this.yaw), Math.sin(this.yaw)];
    const [cp, sp] = [Math.cos(this.pitch), Math.sin(this.pitch)];
    return { right: [-sy, cy, 0], up: [-cy * sp, -sy * sp, cp], into: [-cy * cp, -sy * cp, -sp] };
  }

  /**
   * A function that puts x, y (pixels) and depth (millimetres) of a point into `out`, and says whether it is before the
   * eye. `scale` of it: pixels that a millimetre has at depth 1.
   */
  projector(width, height) {
    const { right, up, into } = this.axes();
    const [tx, ty, tz] = this.target;
    const distance = this.distanceMm;
    const scale = height / (2 * Math.tan(OPENING / 2));
    const project = (x, y, z, out) => {
      const [dx, dy, dz] = [x - tx, y - ty, z - tz];
      const depth = distance + dx * into[0] + dy * into[1] + dz * into[2];
      const factor = scale / depth;
      out[0] = width / 2 + (dx * right[0] + dy * right[1]) * factor;
      out[1] = height / 2 - (dx * up[0] + dy * up[1] + dz * up[2]) * factor;
      out[2] = depth;
      return depth > NEAREST_MM / 10;
    };
    project.scale = scale;
    return project;
  }

  /** Goes a part of the way (0 to 1) to where a box {low, high} fills a view of that shape. */
  approach(box, width, height, part) {
    const radius = Math.max(RADIUS_MIN_MM, 0.5 * Math.hypot(...box.high.map((high, i) => high - box.low[i])));
    const opening = Math.min(OPENING, 2 * Math.atan(Math.tan(OPENING / 2) * (width / height)));
    const wanted = Math.min(FARTHEST_MM, (0.92 * radius) / Math.sin(opening / 2));
    this.distanceMm += (wanted - this.distanceMm) * part;
    for (let i = 0; i < 3; i += 1) {
      this.target[i] += ((box.low[i] + box.high[i]) / 2 - this.target[i]) * part;
    }
  }
}

/** Width of the floor's squares for a distance: 1, 2 or 5 times a power of ten, some twenty across the view. */
export function gridStep(distanceMm) {
  const raw = distanceMm / 12;
  const power = 10 ** Math.floor(Math.log10(raw));
  return power * ([1, 2, 5].find((step) => step * power >= raw) ?? 10);
}
