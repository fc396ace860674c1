// The player of a take: it connects the position, the frames, the scene, the time axis and the charts.
// Where the frames come from is the source's matter: the service, or the page itself.

import { CHOSEN_MAX, Charts } from "./charts.js";
import { Comparison, ERROR_CLASSES } from "./comparison.js";
import { Curves } from "./curves.js";
import { byId, h, setAttribute, setHidden, setText } from "./dom.js";
import { count, percentile, plural, roundedUp, takeTime } from "./format.js";
import { Forces } from "./forces.js";
import { FrameBuffer } from "./frame_buffer.js";
import { Playback } from "./playback.js";
import { installPlayerKeys } from "./player_keys.js";
import { PlayerLists } from "./player_lists.js";
import { TakeMotion } from "./take_motion.js";
import { GapCounts, TimeAxis, gapBegins, gapsThatBegin } from "./time_axis.js";
import { View } from "./view.js";

/** Charts and texts change less often than the scene while playing. */
const CHARTS_MS = 100;
const TEXTS_MS = 60;
/** How often the list of markers says which are missing, while playing. */
const MISSING_MS = 250;
/** Columns of the force curve: one for each pixel of a time axis. */
const COLUMNS = 1024;
/** Poses of a face in a window. */
const POSES_MAX = 1024;
/** Markers that are named where a gap begins. */
const NAMED_MAX = 4;
/** How often the time axis states its value while playing. */
const ANNOUNCE_MS = 1000;
/** Drawings over which the script time is measured. */
const TIMES_MAX = 600;

export class Player {
  motion = new TakeMotion();
  playback = new Playback(0, 1);
  gaps = new GapCounts();
  buffer = null;
  /** The take that this one is compared with, and the force plates; null if there are none. */
  comparison = null;
  forces = null;
  /** The poses of the subject's face, as frames of four markers: twelve numbers. */
  #poses = null;
  /** Whether frames could not be read. */
  hasFailed = false;
  /** Statistics for the tests: the script time of drawings in milliseconds, rows drawn, rows skipped. */
  stats = { drawn: 0, skipped: 0, firstPictureMs: NaN, times: [] };
  #openedMs = 0;
  #lastMs = 0;
  #chartsMs = 0;
  #textsMs = 0;
  /** Whether the frame to be shown is far from the one before. */
  #isJump = false;
  #announcedMs = 0;
  #tickMs = 0;
  #opened = 0;
  /** The running search for a gap, and what it found. */
  #search = null;
  #found = null;
  #missingMs = 0;

  constructor() {
    this.view = new View(this.motion);
    this.view.isLive = false;
    // In a pause the camera does not move on to what is not quite in the picture.
    this.view.camera.margin = 1.1;
    this.view.timeOf = () => this.motion.timeMs();
    this.view.onDrawn = () => this.#measure();
    this.axis = new TimeAxis({ onSeek: (row) => this.seek(row), onHint: (text) => this.#hint(text) });
    this.charts = new Charts();
    this.curves = new Curves({ onSeek: (row) => this.seek(row) });
    this.lists = new PlayerLists({
      onChoose: (slots) => this.#choose(slots),
      onHover: (slot) => this.view.select({ hovered: slot }),
      onEvent: (frame) => this.seek(frame),
    });
    this.view.onSelected = () => {
      if (this.view.pinned >= 0 && this.view.hovered < 0) this.lists.add(this.view.pinned);
    };
    installPlayerKeys(this);
    requestAnimationFrame((now) => this.#tick(now));
  }

  /** Opens the take of a source, and compares it with that of another one; what was open before is dropped. */
  async open(source, other = null) {
    this.#openedMs = performance.now();
    const opened = (this.#opened += 1);
    this.overview = null;
    this.source = source;
    this.#search = null;
    this.hasFailed = false;
    this.#message("Loading");
    this.#notice(null);
    let overview;
    try {
      overview = await source.overview();
    } catch (error) {
      if (opened === this.#opened) this.#fail(error);
      return;
    }
    if (opened !== this.#opened) return;
    this.#show(overview, source);
    await this.#showForces(source, opened);
    if (other) await this.#compare(source, other, opened);
    await this.#countGaps(source, opened);
  }

  #show(overview, source) {
    const opened = this.#opened;
    this.overview = overview;
    this.playback = new Playback(overview.frames, overview.rate_hz);
    this.gaps = new GapCounts();
    [this.comparison, this.forces, this.#found] = [null, null, null];
    this.stats = { drawn: 0, skipped: 0, firstPictureMs: NaN, times: [] };
    this.motion.setTake(overview);
    this.view.settle();
    this.view.updateMarkers();
    this.buffer = new FrameBuffer(source, overview, {
      onLoaded: () => opened === this.#opened && this.#loaded(),
      onFailed: (error) => opened === this.#opened && this.#failed(error),
    });
    this.#poses = this.#posesOf(source, overview, opened);
    const shown = { overview, playback: this.playback, buffer: this.buffer, gaps: this.gaps };
    this.axis.show(shown);
    this.charts.show(shown);
    this.#showCurves();
    this.lists.show(overview, this.motion.labels);
    setText(byId("take-name"), overview.name);
    setText(byId("take-facts"), facts(overview));
    document.title = `${overview.name} – mocapd`;
    this.#noticeDamage();
    if (overview.frames === 0 || overview.markers === 0) {
      this.#message(overview.frames === 0 ? "This take has no frames" : "This take has no markers");
    }
    for (const id of ["play", "back", "forward"]) byId(id).disabled = overview.frames < 2;
    byId("next-event").disabled = overview.events.length === 0;
    this.seek(0);
  }

  #posesOf(source, overview, opened) {
    if (!overview.face || !source.poses) return null;
    const window = (firstRow, rows, every) => source.poses(firstRow, rows, every);
    const table = { ...overview, markers: 4, window_frames_max: POSES_MAX };
    return new FrameBuffer({ window }, table, { onLoaded: () => opened === this.#opened && this.#refresh() });
  }

  async #countGaps(source, opened) {
    this.#hint(null);
    try {
      await source.gaps((part) => {
        if (opened !== this.#opened) return false;
        this.gaps.add(part);
        this.#noticeDamage();
        this.axis.invalidate();
        this.#hint(null);
        return true;
      }, () => this.buffer.idle());
    } catch (error) {
      if (opened === this.#opened) this.#notice(`The gaps of this take cannot be read: ${error.message}`);
    }
  }

  /** The force plates of the take, if it has any: its loads around the current time, and its forces as a curve. */
  async #showForces(source, opened) {
    // A shared page has no forces.
    if (!source.plates || this.overview.frames === 0) return;
    try {
      await this.buffer.idle();
      const list = await source.plates();
      if (opened !== this.#opened || list.plates.length === 0) return;
      const { overview } = this;
      const n = list.plates.length;
      const window = (firstRow, rows, every) => source.forces(firstRow, rows, every, n);
      // Nine numbers for each plate, as many as for three markers.
      const table = { ...overview, markers: 3 * n, window_frames_max: list.window_frames_max };
      const buffer = new FrameBuffer({ window }, table, { onLoaded: () => opened === this.#opened && this.#refresh() });
      const columnFrames = Math.max(1, Math.ceil(overview.frames / COLUMNS));
      this.forces = new Forces(list, buffer, overview.frames, columnFrames);
      this.motion.forces = this.forces;
      this.#showCurves();
      this.#refresh();
      for (let row = 0; row < overview.frames;) {
        await this.buffer.idle();
        const part = await window(row, overview.frames - row, columnFrames);
        if (opened !== this.#opened || part.frames === 0) return;
        this.forces.add(part);
        this.curves.invalidate();
        row += part.frames * part.every;
      }
    } catch (error) {
      if (opened === this.#opened) this.#notice(`The forces of this take cannot be read: ${error.message}`);
    }
  }

  /** Compares the take with another one, part by part. */
  async #compare(source, other, opened) {
    setText(byId("comparison-text"), `Comparing with ${other.name}`);
    setHidden(byId("comparison"), false);
    try {
      const overview = await other.overview();
      if (opened !== this.#opened) return;
      const buffer = new FrameBuffer(other, overview, { onLoaded: () => opened === this.#opened && this.#refreshComparison() });
      this.comparison = new Comparison(other.name, buffer);
      this.motion.comparison = this.comparison;
      this.#showCurves();
      await source.difference(other.name, (part) => {
        if (opened !== this.#opened) return false;
        this.comparison.add(part);
        this.#refreshComparison();
        this.#showComparison();
        return true;
      }, () => this.buffer.idle());
    } catch (error) {
      if (opened !== this.#opened) return;
      this.comparison = null;
      this.motion.comparison = null;
      this.#showCurves();
      setText(byId("comparison-text"), `Not compared: ${error.message}`);
    }
  }

  #refreshComparison() {
    this.motion.compare();
    this.curves.invalidate();
    this.#refresh();
  }

  #showCurves() {
    const { playback, forces, comparison } = this;
    this.curves.show({ playback, forces, comparison });
    setHidden(byId("forces-text"), forces === null);
    setHidden(byId("comparison"), comparison === null);
    byId("largest-error").disabled = true;
    byId("comparison-scale").replaceChildren();
  }

  #showComparison() {
    const { comparison, overview, motion } = this;
    const { largest } = comparison;
    setText(byId("comparison-text"), comparisonText(comparison, overview, motion.labels));
    byId("largest-error").disabled = !largest;
    if (!largest) return;
    const classes = Array.from({ length: ERROR_CLASSES }, (_, i) =>
      h("span", { class: `error-class error-${i + 1}` }, roundedUp((largest.error_mm * (i + 1)) / ERROR_CLASSES)));
    byId("comparison-scale").replaceChildren("up to ", ...classes, " mm");
  }

  /** Goes to the largest distance from the other take. */
  goToLargest() {
    const { largest } = this.comparison ?? {};
    if (!largest) return;
    this.playback.pause();
    this.seek(largest.frame);
    this.view.select({ pinned: largest.marker });
  }

  /** Frames could not be read; they are tried again. */
  #failed(error) {
    this.hasFailed = true;
    this.#notice(`Frames cannot be read: ${error.message}`);
  }

  #loaded() {
    if (this.hasFailed && this.buffer.has(this.playback.row)) {
      this.hasFailed = false;
      this.#notice(null);
    }
    this.#noticeDamage();
    this.#refresh();
  }

  /** Damage within a take shows only when it is decoded. */
  #noticeDamage() {
    const { overview, buffer, gaps } = this;
    if (this.hasFailed) return;
    if (overview.problems_total > 0) this.#notice(problemText(overview));
    else if (buffer.isDamaged || gaps.isDamaged) this.#notice(DAMAGED);
  }

  /** Goes to a row; playing goes on from there. */
  seek(row) {
    if (!this.overview) return;
    this.#endSearch();
    if (this.hasFailed) this.buffer.retry();
    this.playback.seek(row);
    this.#isJump ||= Math.abs(this.playback.row - this.motion.row) > this.playback.rateHz / 2;
    this.#refresh();
  }

  step(rows) {
    if (!this.overview) return;
    this.#endSearch();
    this.playback.step(rows);
    this.#refresh();
  }

  /** What was found last, and a search that is running, are of no interest any more. */
  #endSearch() {
    this.#search = null;
    if (this.#found === null) return;
    this.#found = null;
    this.#hint(null);
  }

  toggle() {
    if (!this.overview) return;
    this.#endSearch();
    if (this.hasFailed) this.buffer.retry();
    // A pause stays at the frame that is shown.
    const { row } = this.motion;
    this.playback.toggle();
    if (!this.playback.isPlaying && row >= 0) this.playback.seek(row);
    this.#refresh();
  }

  setSpeed(speed) {
    this.playback.speed = speed;
    this.#refresh();
  }

  /** Changes the loop by a method of the position: loopFrom, loopTo, clearLoop. */
  changeLoop(method) {
    this.playback[method]();
    this.#refresh();
  }

  /** Goes to the next (1) or previous (-1) event. */
  goToEvent(direction) {
    const { row } = this.playback;
    const frames = (this.overview?.events ?? []).map(({ frame }) => frame);
    const found = direction > 0 ? frames.find((frame) => frame > row) : frames.findLast((frame) => frame < row);
    if (found !== undefined) this.seek(found);
  }

  /** Goes to the next (1) or previous (-1) frame at which a gap of any marker begins. Anything else ends the search. */
  async goToGap(direction) {
    if (!this.overview) return;
    this.playback.pause();
    this.#refresh();
    const search = (this.#search = {});
    const found = await this.#findGap(direction, search);
    if (search !== this.#search) return;
    if (found !== null) {
      this.seek(found);
      this.#found = this.#gapNames(found);
      this.#hint(null);
    } else this.#hint(direction > 0 ? "no gap begins after this frame" : "no gap begins before this frame");
  }

  /** Which markers have a gap that begins at a row, as a text. */
  #gapNames(row) {
    const { buffer, motion } = this;
    const slots = gapsThatBegin(buffer.positionsAt(row) ?? [], row > 0 ? buffer.positionsAt(row - 1) : null);
    const names = slots.slice(0, NAMED_MAX).map((slot) => motion.labels[slot]);
    const more = slots.length > NAMED_MAX ? ` and ${count(slots.length - NAMED_MAX)} more` : "";
    return `A gap of ${names.join(", ")}${more} begins here`;
  }

  async #findGap(direction, search) {
    const { buffer, gaps, overview } = this;
    let at = this.playback.row + direction;
    while (at >= 0 && at < overview.frames) {
      const clear = gaps.clearRows(at, direction);
      if (clear > 0) {
        at += direction * clear;
        continue;
      }
      const isLoaded = buffer.has(at) && (at === 0 || buffer.has(at - 1));
      if (!isLoaded) {
        this.#hint(`searching for a gap: ${takeTime(at / overview.rate_hz)}`);
        const isRead = await buffer.fetch(at);
        if (at > 0) await buffer.fetch(at - 1);
        if (search !== this.#search) return null;
        if (!isRead) {
          at = buffer.beside(at, direction);
          continue;
        }
      }
      if (gapBegins(buffer.positionsAt(at), at > 0 ? buffer.positionsAt(at - 1) : null)) return at;
      at += direction;
    }
    return null;
  }

  #choose(slots) {
    this.charts.choose(slots);
    if (slots.length === 0) setText(byId("charts-note"), `choose up to ${CHOSEN_MAX} markers`);
  }

  #tick(nowMs) {
    requestAnimationFrame((now) => this.#tick(now));
    const elapsedMs = nowMs - this.#lastMs;
    this.#lastMs = nowMs;
    if (!this.overview || !this.playback.isPlaying) return;
    const beganMs = performance.now();
    const before = this.playback.row;
    const isChanged = this.playback.advance(elapsedMs, (row) => !this.buffer.isWaitingFor(row));
    if (isChanged) {
      if (this.playback.row > before + 1) this.stats.skipped += this.playback.row - before - 1;
      this.#draw(nowMs);
    }
    if (isChanged || !this.playback.isPlaying) this.#showTexts(nowMs, !this.playback.isPlaying);
    this.#tickMs = performance.now() - beganMs;
  }

  /** Shows the present state at once. */
  #refresh() {
    if (!this.overview) return;
    this.#draw(Infinity);
    this.#showTexts(Infinity, true);
    this.axis.announce();
  }

  #draw(nowMs) {
    const { playback, buffer, motion } = this;
    const rowsPerSecond = playback.isPlaying ? playback.rowsPerSecond : 0;
    buffer.want(playback.row, rowsPerSecond, playback.loop);
    this.forces?.buffer.want(playback.row, rowsPerSecond, playback.loop);
    this.#poses?.want(playback.row, rowsPerSecond, playback.loop);
    this.comparison?.buffer.want(this.comparison.otherRow(playback.row), rowsPerSecond);
    if (motion.show(buffer.shownRow(playback.row), buffer.positionsAt)) {
      this.#message(null);
      const pose = this.#poses?.positionsAt(motion.row) ?? null;
      motion.facePose = pose && Number.isFinite(pose[0]) ? pose : null;
      if (this.#isJump) {
        // The camera looks for the markers again, at once.
        this.#isJump = false;
        motion.box = null;
        this.view.settle();
      }
      this.view.invalidate();
    } else if (this.overview.markers > 0 && this.overview.frames > 0) {
      this.#message(buffer.isWaitingFor(playback.row) ? "Loading" : "These frames cannot be read");
    }
    if (nowMs === Infinity) this.axis.invalidate();
    else this.axis.move();
    if (nowMs - this.#chartsMs < CHARTS_MS) return;
    this.#chartsMs = Number.isFinite(nowMs) ? nowMs : 0;
    this.charts.invalidate();
    this.curves.invalidate();
  }

  #showTexts(nowMs, isAll) {
    if (!isAll && nowMs - this.#textsMs < TEXTS_MS) return;
    this.#textsMs = Number.isFinite(nowMs) ? nowMs : 0;
    const { playback, motion } = this;
    const row = this.buffer.shownRow(playback.row);
    setText(byId("time"), takeTime(row / playback.rateHz));
    setText(byId("frame"), frameText(row, this.overview));
    if (this.forces) setText(byId("forces-text"), this.forces.texts(row).join(" · "));
    if (isAll || nowMs - this.#missingMs > MISSING_MS) {
      this.#missingMs = Number.isFinite(nowMs) ? nowMs : 0;
      this.lists.showMissing((slot) => motion.isSeen(slot));
    }
    if (nowMs - this.#announcedMs > ANNOUNCE_MS) {
      this.#announcedMs = nowMs;
      this.axis.announce();
    }
    setText(byId("view-stats"), `${motion.nSeen} of ${motion.n} seen`);
    if (!isAll) return;
    setText(byId("play"), playback.isPlaying ? "Pause" : "Play");
    byId("speed").value = String(playback.speed);
    byId("loop-clear").disabled = playback.loop === null;
  }

  #measure() {
    if (!this.overview || this.motion.row < 0) return;
    const { stats } = this;
    stats.drawn += 1;
    if (Number.isNaN(stats.firstPictureMs)) stats.firstPictureMs = performance.now() - this.#openedMs;
    const drawings = [this.axis, this.charts, this.curves].map(({ drawing }) => drawing);
    stats.times.push(drawings.reduce((sum, { drawMs }) => sum + drawMs, this.#tickMs + this.view.drawMs));
    for (const drawing of drawings) drawing.drawMs = 0;
    if (stats.times.length > TIMES_MAX) stats.times.shift();
    stats.p95Ms = percentile(stats.times, 0.95);
  }

  #message(text) {
    setHidden(byId("view-message"), text === null);
    setText(byId("view-message"), text ?? "");
    byId("view").classList.toggle("stale", text !== null);
  }

  #notice(text) {
    setHidden(byId("notice"), text === null);
    setText(byId("notice"), text ?? "");
  }

  #fail(error) {
    this.#message("Cannot be played");
    this.#notice(error.message);
    setText(byId("take-name"), this.source.name ?? "Take");
    setText(byId("take-facts"), "");
    for (const id of ["play", "back", "forward", "next-gap", "next-event"]) byId(id).disabled = true;
  }

  /** The text below the axis: what the pointer is over, or what is known about gaps. */
  #hint(text) {
    setText(byId("axis-hint"), text ?? this.#found ?? this.#gapText());
  }

  #gapText() {
    if (!this.overview) return "";
    const { gaps, overview } = this;
    const share = overview.frames > 0 ? Math.floor((100 * gaps.endRow) / overview.frames) : 100;
    const [missing, lost] = [gaps.missing, gaps.lost].map((bins) => bins.reduce((sum, n) => sum + (n ?? 0), 0));
    if (share >= 100 && missing + lost === 0) return "No gaps: every sample of every frame is there";
    const found = `${plural(missing, "sample")} missing (bars), ${plural(lost, "frame")} lost (hatched)`;
    return share < 100 ? `${found} in the first ${share} %; reading on` : found;
  }
}

/** The number of a frame as its source counts, and its place in the take if that differs. Pure. */
export function frameText(row, { frames, first_frame: first = 1 }) {
  if (first === 1) return `frame ${count(row + 1)} of ${count(frames)}`;
  return `frame ${count(first + row)}: ${count(row + 1)} of ${count(frames)}`;
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
  if (isDamaged) known.push("one of them is damaged");
  if (endRow < frames) known.push(`compared up to ${takeTime(endRow / rateHz)}`);
  return `Compared with ${other}: ${known.join(" · ")}`;
}

/** The facts about a take, as one line. Pure. */
export function facts(overview) {
  const { seconds, frames, rate_hz: rateHz, markers, tolerance_mm: tolerance, source, page } = overview;
  const known = [takeTime(seconds), `${plural(frames, "frame")} at ${Number(rateHz.toFixed(3))} Hz`, plural(markers, "marker")];
  if (page) known.push(`every position is within ${roundedUp(page.tolerance_mm)} mm of the original`);
  else known.push(tolerance > 0 ? `within ${roundedUp(tolerance)} mm of the original` : "lossless");
  if (source && source !== overview.name) known.push(source);
  return known.join(" · ");
}

const DAMAGED = "Part of this take is damaged: what cannot be read is shown as gaps. mocapd verify lists what is wrong";

/** The message about a damaged take. Pure. */
export function problemText({ problems, problems_total: total }) {
  const more = total > 2 ? `; and ${total - 2} more` : "";
  return `This take is damaged: ${problems.slice(0, 2).join("; ")}${more}. What cannot be read is shown as a gap`;
}
