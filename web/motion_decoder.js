// Decodes the motion of a shared page, block by block. docs/sharing.md specifies the format; a test compares every bit
// with what mocapd decodes. Pure.

const TOP = 2 ** 24;
/** Classes of the magnitude of earlier residuals; magnitudes that have a bit each. */
const CLASSES = 12;
const UNARY_MAX = 14;

/** Where the models of each kind begin; all are of a bit. */
const HAS_EXACT = 0;
const PRESENCE = 1;
const ORDER = 3;
const PRESENT = 5;
const EXACT = 7;
const AS_EXPECTED = 8;
const ZERO = AS_EXPECTED + 8;
const NEGATIVE = ZERO + 3 * CLASSES;
const MORE = NEGATIVE + 9;
const LENGTH = MORE + CLASSES * UNARY_MAX;
const MODELS = LENGTH + 32;

/** An adaptive binary range decoder: docs/codec.md, "Range coder". */
class RangeDecoder {
  #at = 0;
  #code = 0;
  #range = 2 ** 32 - 1;
  #fast = new Uint16Array(MODELS).fill(1 << 15);
  #slow = new Uint16Array(MODELS).fill(1 << 15);
  #bits = new Uint8Array(MODELS);

  constructor(bytes) {
    this.bytes = bytes;
    for (let i = 0; i < 4; i += 1) this.#code = this.#code * 256 + this.#next();
  }

  /** Behind the last byte there are zeros. */
  #next() {
    const byte = this.#at < this.bytes.length ? this.bytes[this.#at] : 0;
    this.#at += 1;
    return byte;
  }

  /** A bit whose probability to be 0 is given in 2^-16. */
  split(probability) {
    const bound = Math.floor((this.#range * probability) / 65_536);
    const bit = this.#code >= bound;
    if (bit) {
      this.#code -= bound;
      this.#range -= bound;
    } else {
      this.#range = bound;
    }
    while (this.#range < TOP) {
      this.#range *= 256;
      this.#code = (this.#code * 256 + this.#next()) % 2 ** 32;
    }
    return bit;
  }

  /** A bit with a model, which learns it. */
  bit(model) {
    const [fast, slow] = [this.#fast[model], this.#slow[model]];
    const bit = this.split(Math.min(65_504, Math.max(32, (fast + slow) >> 1)));
    const age = 31 - Math.clz32(this.#bits[model] + 2);
    const [quick, steady] = [Math.min(age, 5), Math.min(age, 7)];
    this.#fast[model] = bit ? fast - (fast >> quick) : fast + ((65_535 - fast) >> quick);
    this.#slow[model] = bit ? slow - (slow >> steady) : slow + ((65_535 - slow) >> steady);
    this.#bits[model] = Math.min(126, this.#bits[model] + 1);
    return bit;
  }

  /** `n` bits of probability 1/2, the highest first. */
  plain(n) {
    let value = 0;
    for (let i = 0; i < n; i += 1) value = value * 2 + (this.split(1 << 15) ? 1 : 0);
    return value;
  }

  /** 0, 1 or 2, with two models. */
  three(model) {
    if (!this.bit(model)) return 0;
    return this.bit(model + 1) ? 2 : 1;
  }

  /** A residual of an axis; `class` is that of earlier residuals, `sign` that of the last two, 0 to 8. */
  residual(axis, kind, sign) {
    if (!this.bit(ZERO + axis * CLASSES + kind)) return 0;
    const isNegative = this.bit(NEGATIVE + sign);
    let size = 0;
    while (size < UNARY_MAX && this.bit(MORE + kind * UNARY_MAX + size)) size += 1;
    if (size === UNARY_MAX) size += this.#large();
    return isNegative ? -(size + 1) : size + 1;
  }

  /** The number of bits in unary, then these. */
  #large() {
    let n = 0;
    while (n < 31 && this.bit(LENGTH + n)) n += 1;
    return 2 ** n + this.plain(n) - 1;
  }
}

/** Numbers of a pose, as in the live stream: state, residual, position, and the quaternion w, x, y, z. */
const POSE_VALUES = 9;
/** What stands for 1 in the turn of a rigid body, in millimetres. */
const TURN_MM = 800;

/**
 * The positions of `n` markers and the poses of `bodies` rigid bodies of a decoded block, in which each body has two
 * trajectories behind those of the markers: its place, and its turn, or the number of its state in steps.
 */
export function split(block, n, bodies, step) {
  if (bodies === 0) return { positions: block, poses: null };
  const columns = 3 * (n + 2 * bodies);
  const frames = block.length / columns;
  const positions = new Float32Array(3 * n * frames);
  const poses = new Float32Array(POSE_VALUES * bodies * frames).fill(NaN);
  for (let frame = 0; frame < frames; frame += 1) {
    const from = columns * frame;
    positions.set(block.subarray(from, from + 3 * n), 3 * n * frame);
    for (let body = 0; body < bodies; body += 1) {
      const at = from + 3 * n + 6 * body;
      putPose(poses, POSE_VALUES * (bodies * frame + body), block.subarray(at, at + 6), step);
    }
  }
  return { positions, poses };
}

function putPose(poses, into, [px, py, pz, tx, ty, tz], step) {
  if (Number.isNaN(px)) {
    poses[into] = Math.round(tx / step);
    return;
  }
  const [x, y, z] = [tx / TURN_MM, ty / TURN_MM, tz / TURN_MM];
  const square = x * x + y * y + z * z;
  poses[into] = 0;
  poses.set([px, py, pz], into + 2);
  poses.set([1 - square, 2 * x, 2 * y, 2 * z].map((v) => v / (1 + square)), into + 5);
}

/** Decodes a block of `frames` frames of `n` trajectories; `step` is the distance of lattice points in millimetres. */
export function decodeBlock(bytes, n, frames, step) {
  const coder = new RangeDecoder(bytes);
  const positions = new Float32Array(3 * n * frames).fill(NaN);
  const hasExact = coder.bit(HAS_EXACT);
  const presence = new Uint8Array(n);
  const order = new Uint8Array(n).fill(1);
  for (let slot = 0; slot < n; slot += 1) {
    presence[slot] = coder.three(PRESENCE);
    if (presence[slot] !== 1) order[slot] = 1 + coder.three(ORDER);
  }
  const points = new Points(n, coder);
  for (let frame = 0; frame < frames; frame += 1) {
    for (let slot = 0; slot < n; slot += 1) {
      const isPresent = presence[slot] === 0 || (presence[slot] === 2 && coder.bit(PRESENT + (points.known[slot] > 0 ? 1 : 0)));
      const into = 3 * (frame * n + slot);
      if (!isPresent) {
        points.known[slot] = 0;
      } else if (hasExact && coder.bit(EXACT)) {
        const bits = Uint32Array.from([0, 1, 2], () => coder.plain(32));
        positions.set(new Float32Array(bits.buffer), into);
        points.known[slot] = 0;
      } else {
        points.read(slot, order[slot]);
        for (let axis = 0; axis < 3; axis += 1) positions[into + axis] = points.last[9 * slot + axis] * step;
      }
    }
  }
  return positions;
}

/** The last points of the markers, and the residuals of their predictions. */
class Points {
  /** By marker, how many points are known since its last gap, up to 3. */
  known;
  /** By marker, three points, the newest first. */
  last;
  #residuals;
  /** By marker, whether the last two samples were where they were expected, the newest in the lowest bit. */
  #asExpected;
  /** The sample read before, of any marker. */
  #before = new Int32Array(3);
  #wasExpected = 0;

  constructor(n, coder) {
    this.coder = coder;
    this.known = new Uint8Array(n);
    this.last = new Int32Array(9 * n);
    this.#residuals = new Int32Array(6 * n);
    this.#asExpected = new Uint8Array(n);
  }

  /** Reads the next point of a marker. */
  read(slot, order) {
    const { last, known } = this;
    const [p, r] = [9 * slot, 6 * slot];
    const residuals = this.#residuals;
    const isNew = known[slot] === 0;
    if (isNew) {
      if (last.subarray(p, p + 9).every((value) => value === 0)) last.set(this.#before, p);
      residuals.fill(0, r, r + 6);
      this.#asExpected[slot] = 0;
    }
    const used = Math.min(order, Math.max(1, known[slot]));
    const context = (this.#asExpected[slot] << 1) | this.#wasExpected;
    const isExpected = !isNew && this.coder.bit(AS_EXPECTED + context);
    const differences = isExpected ? [0, 0, 0] : this.#readDifferences(r, isNew);
    for (let axis = 0; axis < 3; axis += 1) {
      const at = p + axis;
      const [a, b, c] = [last[at], last[at + 3], last[at + 6]];
      const expected = used === 1 ? a : used === 2 ? 2 * a - b : 3 * (a - b) + c;
      last[at + 6] = b;
      last[at + 3] = a;
      last[at] = expected + differences[axis];
      residuals[r + 3 + axis] = isNew ? 0 : residuals[r + axis];
      residuals[r + axis] = isNew ? 0 : differences[axis];
      this.#before[axis] = last[at];
    }
    this.#wasExpected = isExpected ? 1 : 0;
    this.#asExpected[slot] = ((this.#asExpected[slot] << 1) | this.#wasExpected) & 3;
    known[slot] = Math.min(3, known[slot] + 1);
  }

  #readDifferences(r, isNew) {
    const residuals = this.#residuals;
    const differences = [0, 0, 0];
    let beside = 0;
    for (let axis = 0; axis < 3; axis += 1) {
      const [newer, older] = [residuals[r + axis], residuals[r + 3 + axis]];
      const earlier = 2 * Math.abs(newer) + Math.abs(older) + beside;
      const kind = isNew ? CLASSES - 1 : earlier >= 512 ? CLASSES - 2 : 32 - Math.clz32(earlier);
      differences[axis] = this.coder.residual(axis, kind, 3 * (Math.sign(newer) + 1) + Math.sign(older) + 1);
      beside = Math.abs(differences[axis]);
    }
    return differences;
  }
}
