// What the player of a service shows of a take besides its frames and rigid bodies: force plates, the face of its subject, and
// the distances from another take. A shared page has none of these, and nothing of this module.

import { Comparison, ERROR_CLASSES, distances, drawErrors } from "./comparison.js";
import { Curves } from "./curves.js";
import { byId, h, setHidden, setText } from "./dom.js";
import { Forces, drawForces } from "./forces.js";
import { plural, roundedUp, takeTime } from "./format.js";
import { FrameBuffer } from "./frame_buffer.js";

/** Columns of the force curve: one for each pixel of a time axis. */
const COLUMNS = 1024;
/** Largest distance of the frames of a window. */
const EVERY_MAX = 10_000;
/** Bytes of windows that each of the overlays keeps. */
const KEPT_BYTES_MAX = 8e6;
/** Poses of a face in a window. */
const POSES_MAX = 1024;

export class Overlays {
  /** The take that this one is compared with, and the force plates; null if there are none. */
  comparison = null;
  forces = null;
  /** Of the frame on display: the positions in the other take and the distances of the markers; null if not known. */
  other = null;
  errors = null;
  /** Why plates cannot be shown. */
  #unusable = [];
  /** The poses of the face, as frames of four markers: twelve numbers. */
  #poses = null;

  /** Called once, by the player. */
  install(player) {
    this.player = player;
    this.curves = new Curves({ onSeek: (row) => player.seek(row) });
    player.view.layers.floor = (...scene) => this.forces && drawForces(this.forces, ...scene);
    player.view.layers.markers = (...scene) => this.errors && drawErrors(this, ...scene);
    player.view.textOf = (slot) => (Number.isFinite(this.errors?.[slot]) ? `   error ${this.errors[slot].toFixed(3)} mm` : "");
    byId("largest-error").addEventListener("click", () => this.goToLargest());
  }

  /** Nothing is shown of the take before. */
  close() {
    [this.comparison, this.forces, this.other, this.errors, this.#poses] = Array(5).fill(null);
    this.#showCurves();
    setHidden(byId("comparison"), true);
  }

  /** Begins to read the poses of the face, if the take has one. */
  openFace(source, isCurrent) {
    const { overview } = this.player;
    this.#poses = null;
    if (overview.frames === 0 || !overview.face) return;
    const window = (firstRow, rows, every, signal) => source.poses(firstRow, rows, every, signal);
    const { canCancel } = source;
    this.#poses = this.#bufferOf({ window, canCancel }, { ...overview, markers: 4, window_frames_max: POSES_MAX }, isCurrent);
    this.player.refresh();
  }

  /** Reads what else there is for the take of a source, and compares it with that of `other` unless this is null. */
  async open(source, other, isCurrent) {
    if (this.player.overview.frames === 0) return;
    await this.#showForces(source, isCurrent);
    if (other && isCurrent()) await this.#compare(source, other, isCurrent);
  }

  #bufferOf(source, overview, isCurrent, onLoaded = () => this.player.refresh()) {
    return new FrameBuffer(source, overview, { keptBytesMax: KEPT_BYTES_MAX, onLoaded: () => isCurrent() && onLoaded() });
  }

  /** The force plates of the take, if it has any: its loads around the current time, and its forces as a curve. */
  async #showForces(source, isCurrent) {
    const { player } = this;
    const { overview } = player;
    try {
      await player.buffer.idle();
      const list = await source.plates();
      const n = list.plates.length;
      if (!isCurrent()) return;
      this.#unusable = list.unusable;
      setText(byId("forces-text"), unusableText(list.unusable));
      setHidden(byId("forces-text"), n === 0 && list.unusable.length === 0);
      if (n === 0) return;
      const window = (firstRow, rows, every, signal) => source.forces(firstRow, rows, every, n, signal);
      const { canCancel } = source;
      // Nine numbers for each plate, as many as for three markers.
      const buffer = this.#bufferOf({ window, canCancel }, { ...overview, markers: 3 * n, window_frames_max: list.window_frames_max }, isCurrent);
      const columnFrames = Math.min(EVERY_MAX, Math.max(1, Math.ceil(overview.frames / COLUMNS)));
      this.forces = new Forces(list, buffer, overview.frames, columnFrames);
      this.#showCurves();
      player.refresh();
      for (let row = 0; row < overview.frames;) {
        await player.buffer.idle();
        const part = await window(row, overview.frames - row, columnFrames);
        if (!isCurrent() || part.frames === 0) return;
        this.forces.add(part);
        this.curves.invalidate();
        row += part.frames * part.every;
      }
    } catch (error) {
      if (isCurrent()) player.notice(`The forces of this take cannot be read: ${error.message}`);
    }
  }

  /** Compares the take with another one, part by part. */
  async #compare(source, other, isCurrent) {
    const { player } = this;
    setText(byId("comparison-text"), `Comparing with ${other.name}`);
    byId("comparison-scale").replaceChildren();
    byId("largest-error").disabled = true;
    setHidden(byId("comparison"), false);
    try {
      const overview = await other.overview();
      if (!isCurrent()) return;
      this.comparison = new Comparison(other.name, this.#bufferOf(other, overview, isCurrent, () => this.#refreshErrors()));
      this.#showCurves();
      await source.difference(other.name, (part) => {
        if (!isCurrent()) return false;
        this.comparison.add(part);
        this.#refreshErrors();
        this.#showComparison();
        return true;
      }, () => player.buffer.idle());
    } catch (error) {
      if (!isCurrent()) return;
      this.comparison = null;
      this.#refreshErrors();
      this.#showCurves();
      setText(byId("comparison-text"), `Not compared: ${error.message}`);
    }
  }

  #refreshErrors() {
    this.show(this.player.motion);
    this.curves.invalidate();
    this.player.refresh();
  }

  #showCurves() {
    const { forces, comparison } = this;
    this.curves.show({ playback: this.player.playback, forces, comparison });
    setHidden(byId("forces-text"), forces === null);
  }

  #showComparison() {
    const { comparison, player } = this;
    const { largest } = comparison;
    setText(byId("comparison-text"), comparisonText(comparison, player.overview, player.motion.labels));
    byId("largest-error").disabled = !largest;
    if (!largest) return;
    const classes = Array.from({ length: ERROR_CLASSES }, (_, i) =>
      h("span", { class: `error-class error-${i + 1}` }, roundedUp((largest.error_mm * (i + 1)) / ERROR_CLASSES)));
    byId("comparison-scale").replaceChildren("up to ", ...classes, " mm");
  }

  /** Loads what is needed at the current row, and what playback needs next. */
  want({ row, loop }, rowsPerSecond) {
    this.forces?.buffer.want(row, rowsPerSecond, loop);
    this.#poses?.want(row, rowsPerSecond, loop);
    this.comparison?.buffer.want(this.comparison.otherRow(row), rowsPerSecond);
  }

  /** The row on display has changed. */
  show(motion) {
    const pose = this.#poses?.positionsAt(motion.row) ?? null;
    motion.facePose = pose && Number.isFinite(pose[0]) ? pose : null;
    this.other = this.comparison?.otherPositions(motion.row) ?? null;
    this.errors = this.other && motion.raw ? distances(motion.raw, this.other) : null;
  }

  showTexts(row) {
    if (this.forces) setText(byId("forces-text"), [...this.forces.texts(row), ...this.#unusable.map((text) => unusableText([text]))].join(" · "));
  }

  invalidate() {
    this.curves.invalidate();
  }

  /** Goes to the largest distance from the other take. */
  goToLargest() {
    const { largest } = this.comparison ?? {};
    if (!largest) return;
    this.player.playback.pause();
    this.player.seek(largest.frame);
    this.player.view.select({ pinned: largest.marker });
  }
}

/** Why plates are not shown. Pure. */
export function unusableText(unusable) {
  return unusable.map((text) => `force plate ${text}`).join(" · ");
}

/** What is known about the difference between two takes, as one line. Pure. */
export function comparisonText(comparison, { frames, rate_hz: rateHz }, labels) {
  const { other, largest, gapsDiffering, markersMissing, isDamaged, endRow } = comparison;
  const known = [];
  if (largest) {
    const { error_mm: error, frame, marker } = largest;
    known.push(`largest error ${roundedUp(error)} mm: ${labels[marker]} at ${takeTime(frame / rateHz)}`, `rms ${roundedUp(comparison.rmsMm)} mm`);
  } else {
    known.push("no sample is in both");
  }
  const onlyHere = comparison.markers.filter((marker) => marker === null).length;
  if (onlyHere + markersMissing > 0) known.push(`${plural(onlyHere + markersMissing, "marker")} in only one of them`);
  if (gapsDiffering > 0) known.push(`${plural(gapsDiffering, "sample")} in only one of them`);
  const { is_by_number: isByNumber, other_first_number: first, frames_only_here: here, frames_only_there: there } = comparison.frames;
  if (!isByNumber) known.push(`compared from the first frame of each on, which is number ${first} there`);
  if (here > 0) known.push(`${plural(here, "frame")} only in this take`);
  if (there > 0) known.push(`${plural(there, "frame")} only in the other one`);
  if (isDamaged) known.push("one of them is damaged");
  if (endRow < frames) known.push(`compared up to ${takeTime(endRow / rateHz)}`);
  return `Compared with ${other}: ${known.join(" · ")}`;
}
