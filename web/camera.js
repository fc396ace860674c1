// The camera of the view: an orbit camera with a perspective projection. Pure. Millimetres; z points up.

/** Vertical field of view, radians. */
const FIELD_OF_VIEW = (36 * Math.PI) / 180;
const MIN_DISTANCE_MM = 100;
const MAX_DISTANCE_MM = 200_000;
const MAX_PITCH = 1.553;
/** The smallest radius that fills the view: a hand fills half of it. */
const RADIUS_MIN_MM = 120;

/** Permutes the device's axes cyclically so that the third points up; they stay right-handed. */
export function toZUp(upAxis, x, y, z, out, at) {
  if (upAxis === 1) [out[at], out[at + 1], out[at + 2]] = [y, z, x];
  else if (upAxis === 2) [out[at], out[at + 1], out[at + 2]] = [z, x, y];
  else [out[at], out[at + 1], out[at + 2]] = [x, y, z];
}

/** The device's names of the three axes after `toZUp`. */
export function axisNames(upAxis) {
  return [["x", "y", "z"], ["y", "z", "x"], ["z", "x", "y"], ["x", "y", "z"]][upAxis] ?? ["x", "y", "z"];
}

export class Camera {
  yaw = -0.9;
  pitch = 0.3;
  distanceMm = 5000;
  target = [0, 0, 900];
  /** The radius that fills the view, as a multiple of that of the box. */
  margin = 0.92;

  /** Rotates around the target, by angles in radians. */
  orbit(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = Math.min(MAX_PITCH, Math.max(-MAX_PITCH, this.pitch + pitch));
  }

  /** Multiplies the distance by a factor. */
  zoom(factor) {
    this.distanceMm = Math.min(MAX_DISTANCE_MM, Math.max(MIN_DISTANCE_MM, this.distanceMm * factor));
  }

  /** Moves the target by pixels of a view of the given height. */
  pan(dx, dy, height) {
    const mm = (2 * this.distanceMm * Math.tan(FIELD_OF_VIEW / 2)) / height;
    const { right, up } = this.axes();
    for (let i = 0; i < 3; i += 1) this.target[i] += (-dx * right[i] + dy * up[i]) * mm;
  }

  /** Unit vectors of the screen: right, up, and forward into it. */
  axes() {
    const [cy, sy] = [Math.cos(this.yaw), Math.sin(this.yaw)];
    const [cp, sp] = [Math.cos(this.pitch), Math.sin(this.pitch)];
    return { right: [-sy, cy, 0], up: [-cy * sp, -sy * sp, cp], forward: [-cy * cp, -sy * cp, -sp] };
  }

  /**
   * A function that writes x, y (pixels) and depth (millimetres) of a point to `out`, and returns whether the point is in
   * front of the camera. Its `scale` is pixels per millimetre at a depth of 1 mm.
   */
  projector(width, height) {
    const { right, up, forward } = this.axes();
    const [tx, ty, tz] = this.target;
    const distance = this.distanceMm;
    const scale = height / (2 * Math.tan(FIELD_OF_VIEW / 2));
    const project = (x, y, z, out) => {
      const [dx, dy, dz] = [x - tx, y - ty, z - tz];
      const depth = distance + dx * forward[0] + dy * forward[1] + dz * forward[2];
      const factor = scale / depth;
      out[0] = width / 2 + (dx * right[0] + dy * right[1]) * factor;
      out[1] = height / 2 - (dx * up[0] + dy * up[1] + dz * up[2]) * factor;
      out[2] = depth;
      return depth > MIN_DISTANCE_MM / 10;
    };
    project.scale = scale;
    return project;
  }

  /** Moves a fraction (0 to 1) of the way to where a box {low, high} fills a view of the given size. */
  approach(box, width, height, fraction) {
    const radius = Math.max(RADIUS_MIN_MM, 0.5 * Math.hypot(...box.high.map((high, i) => high - box.low[i])));
    const fieldOfView = Math.min(FIELD_OF_VIEW, 2 * Math.atan(Math.tan(FIELD_OF_VIEW / 2) * (width / height)));
    const wanted = Math.min(MAX_DISTANCE_MM, (this.margin * radius) / Math.sin(fieldOfView / 2));
    this.distanceMm += (wanted - this.distanceMm) * fraction;
    for (let i = 0; i < 3; i += 1) {
      this.target[i] += ((box.low[i] + box.high[i]) / 2 - this.target[i]) * fraction;
    }
  }
}

/** The grid spacing for a distance: 1, 2 or 5 times a power of ten, some twenty squares across the view. */
export function gridStep(distanceMm) {
  const raw = distanceMm / 12;
  const power = 10 ** Math.floor(Math.log10(raw));
  return power * ([1, 2, 5].find((step) => step * power >= raw) ?? 10);
}
