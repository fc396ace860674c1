// The player of a take: it connects the position, the frames, the scene, the time axis and the charts.
// Where the frames come from is the source's matter: the service, or the page itself.

import { TakeBodies, drawBodies } from "./bodies.js";
import { CHOSEN_MAX, Charts } from "./charts.js";
import { byId, setAttribute, setHidden, setText } from "./dom.js";
import { count, percentile, plural, roundedUp, takeTime } from "./format.js";
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
/** Markers that are named where a gap begins. */
const NAMED_MAX = 4;
/** How often the time axis states its value while playing. */
const ANNOUNCE_MS = 1000;
/** Drawings over which the script time is measured. */
const TIMES_MAX = 600;
/** Longest time that the events wait for frames, and the time after which they are tried again. */
const IDLE_MS = 5000;
const RETRY_MS = 3000;
/** What the overviews of a take have in common. */
const SAME = ["frames", "markers", "rate_hz", "created_unix_ms"];

const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

export class Player {
  motion = new TakeMotion();
  playback = new Playback(0, 1);
  gaps = new GapCounts();
  buffer = null;
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

  /** `overlays` adds what only a service has; null for a shared page. */
  constructor(overlays = null) {
    this.overlays = overlays;
    this.view = new View(this.motion);
    this.view.isLive = false;
    // In a pause the camera does not move on to what is not quite in the picture.
    this.view.camera.margin = 1.1;
    this.view.timeOf = () => this.motion.timeMs();
    this.view.onDrawn = () => this.#measure();
    this.axis = new TimeAxis({ onSeek: (row) => this.seek(row), onHint: (text) => this.#hint(text) });
    this.charts = new Charts();
    this.lists = new PlayerLists({
      onChoose: (slots) => this.#choose(slots),
      onHover: (slot) => this.view.select({ hovered: slot }),
      onEvent: (frame) => this.seek(frame),
    });
    this.view.onSelected = () => {
      if (this.view.pinned >= 0 && this.view.hovered < 0) this.lists.add(this.view.pinned);
    };
    this.bodies = new TakeBodies(this);
    this.view.layers.bodies = drawBodies;
    this.overlays?.install(this);
    installPlayerKeys(this);
    requestAnimationFrame((now) => this.#tick(now));
  }

  /** Opens the take of a source, and compares it with that of another one; what was open before is dropped. */
  async open(source, other = null) {
    this.#openedMs = performance.now();
    const opened = (this.#opened += 1);
    this.overview = null;
    for (const before of [this.source, this.other]) before?.close?.();
    [this.source, this.other] = [source, other];
    this.#search = null;
    this.hasFailed = false;
    this.#message("Loading");
    this.notice(null);
    this.bodies.close();
    this.overlays?.close();
    let overview;
    try {
      overview = await source.overview();
    } catch (error) {
      if (opened === this.#opened) this.#fail(error);
      return;
    }
    if (opened !== this.#opened) return;
    this.#show(overview, source);
    const isCurrent = () => opened === this.#opened;
    await Promise.all([this.#complete(source, isCurrent), this.#openOthers(source, other, isCurrent), this.#countGaps(source, opened)]);
  }

  /** Reads what the overview does not have yet. That takes longer the longer the take is, so the first picture comes before. */
  async #complete(source, isCurrent) {
    const { overview, buffer } = this;
    if (overview.is_complete) return;
    // While a take is played over a slow link, windows may be loading all the time.
    await Promise.race([buffer.idle(), pause(IDLE_MS)]);
    const complete = await this.#completeOverview(source, isCurrent);
    if (!isCurrent()) return;
    if (SAME.some((part) => overview[part] !== complete[part])) {
      // Another take has the name by now.
      await this.open(source.again(), this.other?.again() ?? null);
      return;
    }
    const isSameSubject = ["bones", "limbs", "face"].every((part) => JSON.stringify(overview[part]) === JSON.stringify(complete[part]));
    Object.assign(overview, complete);
    if (!isSameSubject) this.#showSubject(source, isCurrent);
    this.lists.showEvents(overview);
    byId("next-event").disabled = overview.events.length === 0;
    this.#noticeDamage();
    this.axis.invalidate();
  }

  /** The complete overview; one that cannot be read is tried again, as frames are. Null once another take is shown. */
  async #completeOverview(source, isCurrent) {
    let failure = null;
    while (isCurrent()) {
      try {
        const complete = await source.completeOverview();
        // The message is still there, unless another one came after it.
        if (isCurrent() && failure !== null && byId("notice").textContent === failure) this.notice(null);
        return complete;
      } catch (error) {
        if (!isCurrent()) return null;
        failure = `The events of this take cannot be read: ${error.message}`;
        this.lists.showEvents(this.overview, "cannot be read");
        if (!this.hasFailed) this.notice(failure);
      }
      await pause(RETRY_MS);
    }
    return null;
  }

  /** Shows a subject that was found in the middle of the take. */
  #showSubject(source, isCurrent) {
    this.motion.setTake(this.overview);
    this.view.updateMarkers();
    this.overlays?.openFace(source, isCurrent);
    this.refresh();
  }

  /**
   * What there is besides markers, one after the other, so that frames are not kept waiting. Only the face comes at once:
   * its place in the scene needs no list from the source, and on a busy service the buffer may not be idle for long.
   */
  async #openOthers(source, other, isCurrent) {
    this.overlays?.openFace(source, isCurrent);
    await this.bodies.open(source, isCurrent);
    if (isCurrent()) await this.overlays?.open(source, other, isCurrent);
  }

  #show(overview, source) {
    const opened = this.#opened;
    this.overview = overview;
    this.buffer = new FrameBuffer(source, overview, {
      onLoaded: () => opened === this.#opened && this.#loaded(),
      onFailed: (error) => opened === this.#opened && this.#failed(error),
    });
    // The first frames are decoded while the page is built.
    this.buffer.want(0);
    this.playback = new Playback(overview.frames, overview.rate_hz);
    this.gaps = new GapCounts();
    this.#found = null;
    this.stats = { drawn: 0, skipped: 0, firstPictureMs: NaN, times: [] };
    this.motion.setTake(overview);
    this.view.settle();
    this.view.updateMarkers();
    const shown = { overview, playback: this.playback, buffer: this.buffer, gaps: this.gaps };
    this.axis.show(shown);
    this.charts.show(shown);
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
      if (opened === this.#opened) this.notice(`The gaps of this take cannot be read: ${error.message}`);
    }
  }

  /** Frames could not be read; they are tried again. */
  #failed(error) {
    this.hasFailed = true;
    this.notice(`Frames cannot be read: ${error.message}`);
  }

  #loaded() {
    if (this.hasFailed && this.buffer.has(this.playback.row)) {
      this.hasFailed = false;
      this.notice(null);
    }
    this.#noticeDamage();
    this.refresh();
  }

  /** Damage within a take shows only when it is decoded. */
  #noticeDamage() {
    const { overview, buffer, gaps } = this;
    if (this.hasFailed) return;
    if (overview.problems_total > 0) this.notice(problemText(overview));
    else if (buffer.isDamaged || gaps.isDamaged) this.notice(DAMAGED);
  }

  /** Goes to a row; playing goes on from there. */
  seek(row) {
    if (!this.overview) return;
    this.#endSearch();
    if (this.hasFailed) this.buffer.retry();
    this.playback.seek(row);
    this.#isJump ||= Math.abs(this.playback.row - this.motion.row) > this.playback.rateHz / 2;
    this.refresh();
  }

  step(rows) {
    if (!this.overview) return;
    this.#endSearch();
    this.playback.step(rows);
    this.refresh();
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
    this.refresh();
  }

  setSpeed(speed) {
    this.playback.speed = speed;
    this.refresh();
  }

  /** Changes the loop by a method of the position: loopFrom, loopTo, clearLoop. */
  changeLoop(method) {
    this.playback[method]();
    this.refresh();
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
    this.refresh();
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
  refresh() {
    if (!this.overview) return;
    this.#draw(Infinity);
    this.#showTexts(Infinity, true);
    this.axis.announce();
  }

  #draw(nowMs) {
    const { playback, buffer, motion } = this;
    const rowsPerSecond = playback.isPlaying ? playback.rowsPerSecond : 0;
    buffer.want(playback.row, rowsPerSecond, playback.loop);
    this.bodies.want(playback, rowsPerSecond);
    this.overlays?.want(playback, rowsPerSecond);
    if (motion.show(buffer.shownRow(playback.row), buffer.positionsAt)) {
      if (this.overview.markers > 0 || this.bodies.isShown) this.#message(null);
      this.bodies.show(motion);
      this.overlays?.show(motion);
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
    this.overlays?.invalidate();
  }

  #showTexts(nowMs, isAll) {
    if (!isAll && nowMs - this.#textsMs < TEXTS_MS) return;
    this.#textsMs = Number.isFinite(nowMs) ? nowMs : 0;
    const { playback, motion } = this;
    const row = this.buffer.shownRow(playback.row);
    setText(byId("time"), takeTime(row / playback.rateHz));
    setText(byId("frame"), frameText(row, this.overview));
    this.bodies.showText(row);
    this.overlays?.showTexts(row);
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
    const drawings = [this.axis, this.charts, this.overlays?.curves].flatMap((part) => part?.drawing ?? []);
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

  notice(text) {
    setHidden(byId("notice"), text === null);
    setText(byId("notice"), text ?? "");
  }

  #fail(error) {
    this.#message("Cannot be played");
    this.notice(error.message);
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
