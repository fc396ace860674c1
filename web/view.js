// The view of the markers: its canvas, and when it is drawn.

import { Camera } from "./camera.js";
import { byId, colours, onTheme, prefersCalm, setAttribute, setHidden, setText } from "./dom.js";
import { span } from "./format.js";
import { installHands } from "./hands.js";
import { FADE_MS, draw, pick } from "./scene.js";

const COLOURS = ["panel", "text", "muted", "grid", "grid-main", "shadow", "trail", "bone", "off", "marker", "stray", "chosen"];
/** How soon the eye is where the markers are, and how slowly it comes nearer again. */
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
  onChosen = () => {};
  onDrawn = () => {};
  #pinnedLabel = null;
  #points = null;
  #isDirty = true;
  #settled = false;
  #lastMs = 0;

  constructor(motion) {
    this.motion = motion;
    this.canvas = byId("view");
    this.ctx = this.canvas.getContext("2d");
    installHands(this);
    new ResizeObserver(() => this.#resize()).observe(this.canvas);
    onTheme(() => this.#readColours());
    this.#readColours();
    this.#resize();
    requestAnimationFrame((now) => this.#tick(now));
  }

  get chosen() {
    return this.hovered >= 0 ? this.hovered : this.pinned;
  }

  /** There is something new to see. */
  touch() {
    this.#isDirty = true;
  }

  /** There are other markers: what was pointed out stays so by its name, and nothing else does. */
  retable() {
    if (!this.motion.box) this.#settled = false;
    const label = this.#pinnedLabel;
    this.choose({ hovered: -1, pinned: this.motion.labels.indexOf(label) });
    // It may come back.
    this.#pinnedLabel = label;
    this.touch();
  }

  choose({ hovered = this.hovered, pinned = this.pinned }) {
    if (hovered === this.hovered && pinned === this.pinned) return;
    [this.hovered, this.pinned] = [hovered, pinned];
    this.#pinnedLabel = this.motion.labels[pinned] ?? null;
    this.onChosen(this.chosen);
    this.touch();
  }

  follow(isOn) {
    this.isFollowing = isOn;
    setAttribute(byId("view-follow"), "aria-pressed", String(isOn));
    this.touch();
  }

  toggle(option) {
    this.options[option] = !this.options[option];
    setAttribute(byId(`view-${option}`), "aria-pressed", String(this.options[option]));
    this.touch();
  }

  #readColours() {
    this.colours = colours(COLOURS);
    this.touch();
  }

  #resize() {
    const { clientWidth, clientHeight } = this.canvas;
    // While the page is laid out there may be no room for a moment: the eye must not fly away for it.
    if (clientWidth < 50 || clientHeight < 50) return;
    const ratio = Math.min(2, devicePixelRatio || 1);
    this.width = clientWidth;
    this.height = clientHeight;
    this.canvas.width = Math.round(this.width * ratio);
    this.canvas.height = Math.round(this.height * ratio);
    this.ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.touch();
  }

  #tick(nowMs) {
    requestAnimationFrame((now) => this.#tick(now));
    const pastMs = nowMs - this.#lastMs;
    const { motion, camera } = this;
    const isFading = motion.raw && motion.nSeen < motion.n && pastMs > 30 &&
      motion.lastSeenMs.some((seen) => nowMs - seen < FADE_MS);
    if (!this.#isDirty && !isFading) return;
    this.#isDirty = false;
    this.#lastMs = nowMs;
    if (this.isFollowing && motion.raw) {
      const box = motion.follow(Math.min(1, pastMs / SHRINK_MS));
      const isCut = !this.#settled || prefersCalm();
      if (box) camera.approach(box, this.width, this.height, isCut ? 1 : 1 - Math.exp(-pastMs / FOLLOW_MS));
      this.#settled ||= box !== null;
    }
    const { width, height, options, chosen, colours } = this;
    const drawn = draw(this.ctx, camera, motion, { width, height, options, chosen, colours, nowMs });
    this.#points = drawn.points;
    this.#tell(drawn.stepMm);
    this.onDrawn(nowMs);
  }

  #tell(stepMm) {
    const [value, unit] = stepMm >= 1000 ? [stepMm / 1000, "m"] : stepMm >= 10 ? [stepMm / 10, "cm"] : [stepMm, "mm"];
    const { motion, chosen } = this;
    const up = ["up unknown, taken as z", "x up", "y up", "z up"][motion.upAxis];
    setText(byId("view-scale"), `squares ${value} ${unit} · ${up}`);
    setHidden(byId("view-marker"), chosen < 0 || chosen >= motion.n);
    if (chosen < 0 || chosen >= motion.n) return;
    const [x, y, z] = motion.raw?.subarray(3 * chosen, 3 * chosen + 3) ?? [];
    const age = (performance.now() - motion.lastSeenMs[chosen]) / 1000;
    const place = Number.isFinite(x) ? `x ${x.toFixed(1)}  y ${y.toFixed(1)}  z ${z.toFixed(1)} mm`
      : Number.isFinite(age) ? `not seen for ${span(age).join(" ")}` : "not seen yet";
    setText(byId("view-marker"), `${motion.labels[chosen]}   ${place}`);
  }

  /** By hand: the eye does not follow by itself any more. */
  byHand(change) {
    if (this.isFollowing) this.follow(false);
    change(this.camera);
    this.touch();
  }

  /** The marker at a place of the canvas, or -1. */
  at([x, y], reachPx) {
    return pick(this.#points, x, y, reachPx);
  }
}
