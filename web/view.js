// The 3D view of the markers: its canvas, camera, selection and redraws.

import { Camera } from "./camera.js";
import { byId, colours, onTheme, prefersReducedMotion, setAttribute, setHidden, setText } from "./dom.js";
import { duration } from "./format.js";
import { installPointer } from "./pointer.js";
import { FADE_MS, draw, pick } from "./scene.js";

const COLOURS = ["panel", "text", "muted", "grid", "grid-main", "shadow", "trail", "bone", "off", "marker", "stray", "selected", "force", "axis-x", "axis-y", "axis-z",
  "error-1", "error-2", "error-3", "error-4", "error-5"];
/** Time constants with which the camera follows the markers, and with which their box shrinks. */
const FOLLOW_MS = 700;
const SHRINK_MS = 6000;

export class View {
  camera = new Camera();
  isFollowing = true;
  options = { labels: false, trails: true };
  width = 300;
  height = 150;
  pinned = -1;
  hovered = -1;
  onSelected = () => {};
  onDrawn = () => {};
  /** The time of the motion, from that of the page: a player's differs. */
  timeOf = (nowMs) => nowMs;
  /** What is drawn besides the motion, and said of a marker besides its position. */
  layers = {};
  textOf = () => "";
  /** Whether the motion goes on by itself, so that occluded markers fade without a new frame. */
  isLive = true;
  /** Duration of the last drawing. */
  drawMs = 0;
  #pinnedLabel = null;
  #points = null;
  #isDirty = true;
  #settled = false;
  #lastMs = 0;

  constructor(motion) {
    this.motion = motion;
    this.canvas = byId("view");
    this.ctx = this.canvas.getContext("2d");
    installPointer(this);
    new ResizeObserver(() => this.#resize()).observe(this.canvas);
    onTheme(() => this.#readColours());
    this.#readColours();
    this.#resize();
    requestAnimationFrame((now) => this.#tick(now));
  }

  get selected() {
    return this.hovered >= 0 ? this.hovered : this.pinned;
  }

  /** Requests a redraw. */
  invalidate() {
    this.#isDirty = true;
  }

  /** The next drawing moves the camera to the markers at once. */
  settle() {
    this.#settled = false;
    this.invalidate();
  }

  /** The table of markers has changed: the selected marker is found again by its label. */
  updateMarkers() {
    if (!this.motion.box) this.#settled = false;
    const label = this.#pinnedLabel;
    this.select({ hovered: -1, pinned: this.motion.labels.indexOf(label) });
    // The marker may come back.
    this.#pinnedLabel = label;
    this.invalidate();
  }

  select({ hovered = this.hovered, pinned = this.pinned }) {
    if (hovered === this.hovered && pinned === this.pinned) return;
    [this.hovered, this.pinned] = [hovered, pinned];
    this.#pinnedLabel = this.motion.labels[pinned] ?? null;
    this.onSelected(this.selected);
    this.invalidate();
  }

  follow(isOn) {
    this.isFollowing = isOn;
    setAttribute(byId("view-follow"), "aria-pressed", String(isOn));
    this.invalidate();
  }

  toggle(option) {
    this.options[option] = !this.options[option];
    setAttribute(byId(`view-${option}`), "aria-pressed", String(this.options[option]));
    this.invalidate();
  }

  #readColours() {
    this.colours = colours(COLOURS);
    this.invalidate();
  }

  #resize() {
    const { clientWidth, clientHeight } = this.canvas;
    // During layout the canvas may be tiny for a moment: the camera must not react to it.
    if (clientWidth < 50 || clientHeight < 50) return;
    const ratio = Math.min(2, devicePixelRatio || 1);
    this.width = clientWidth;
    this.height = clientHeight;
    this.canvas.width = Math.round(this.width * ratio);
    this.canvas.height = Math.round(this.height * ratio);
    this.ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.invalidate();
  }

  #tick(nowMs) {
    requestAnimationFrame((now) => this.#tick(now));
    const elapsedMs = nowMs - this.#lastMs;
    const { motion, camera } = this;
    const isFading = this.isLive && motion.raw && motion.nSeen < motion.n && elapsedMs > 30 &&
      motion.lastSeenMs.some((seen) => nowMs - seen < FADE_MS);
    if (!this.#isDirty && !isFading) return;
    const beganMs = performance.now();
    this.#isDirty = false;
    this.#lastMs = nowMs;
    if (this.isFollowing && motion.raw) {
      const box = motion.updateBox(Math.min(1, elapsedMs / SHRINK_MS));
      const isInstant = !this.#settled || prefersReducedMotion();
      if (box) camera.approach(box, this.width, this.height, isInstant ? 1 : 1 - Math.exp(-elapsedMs / FOLLOW_MS));
      this.#settled ||= box !== null;
    }
    const { width, height, options, selected, colours, layers } = this;
    const drawn = draw(this.ctx, camera, motion, { width, height, options, selected, colours, layers, nowMs: this.timeOf(nowMs) });
    this.#points = drawn.points;
    this.#showScaleAndMarker(drawn.stepMm);
    this.drawMs = performance.now() - beganMs;
    this.onDrawn(nowMs);
  }

  #showScaleAndMarker(stepMm) {
    const [value, unit] = stepMm >= 1000 ? [stepMm / 1000, "m"] : stepMm >= 10 ? [stepMm / 10, "cm"] : [stepMm, "mm"];
    const { motion, selected } = this;
    const up = ["up axis unknown, z assumed", "x up", "y up", "z up"][motion.upAxis];
    setText(byId("view-scale"), `grid ${value} ${unit} · ${up}`);
    setHidden(byId("view-marker"), selected < 0 || selected >= motion.n);
    if (selected < 0 || selected >= motion.n) return;
    const [x, y, z] = motion.raw?.subarray(3 * selected, 3 * selected + 3) ?? [];
    const age = (this.timeOf(performance.now()) - motion.lastSeenMs[selected]) / 1000;
    const place = Number.isFinite(x) ? `x ${x.toFixed(1)}  y ${y.toFixed(1)}  z ${z.toFixed(1)} mm`
      : Number.isFinite(age) ? `not seen for ${duration(age).join(" ")}` : "not seen yet";
    setText(byId("view-marker"), `${motion.labels[selected]}   ${place}${this.textOf(selected)}`);
  }

  /** Moves the camera for the user; it no longer follows the markers. */
  moveCamera(change) {
    if (this.isFollowing) this.follow(false);
    change(this.camera);
    this.invalidate();
  }

  /** The marker at a pixel of the canvas, or -1. */
  markerAt([x, y], reachPx) {
    return pick(this.#points, x, y, reachPx);
  }
}
