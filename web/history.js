// Two minutes of frame rate and losses.

import { byId, colours, onTheme, setAttribute } from "./dom.js";
import { lostSoFar } from "./figures.js";
import { count } from "./format.js";

export const SPAN_S = 120;

/** Samples of the last two minutes: {t, hz, lost}; `hz` null where nothing was known. Pure. */
export class Past {
  samples = [];
  nominalHz = 0;
  #lostBefore = null;

  /** At a time in seconds. What was lost is what came since the look before; a counter that fell began anew. */
  add(t, status) {
    const runs = status !== null && (status.state === "armed" || status.state === "recording");
    const hz = status?.input.measured_hz ?? 0;
    const lost = runs ? lostSoFar(status) : 0;
    const before = this.#lostBefore;
    // In the first seconds the rate is counted up, and is none yet.
    const isKnown = runs && status.input.frames >= 3 * (status.device.rate_hz || 0);
    const sample = { t, hz: isKnown ? hz : null, lost: runs && before !== null ? Math.max(0, lost - before) : 0 };
    if (status !== null) {
      this.#lostBefore = runs ? lost : null;
      this.nominalHz = status.device.rate_hz || this.nominalHz;
    }
    this.samples.push(sample);
    while (this.samples[0].t < t - SPAN_S) this.samples.shift();
  }

  /** Lost frames by second before `now`: [newest, …, oldest]. */
  lostBySecond(now) {
    const bins = new Array(SPAN_S).fill(0);
    for (const { t, lost } of this.samples) {
      const bin = Math.floor(now - t);
      if (bin >= 0 && bin < SPAN_S) bins[bin] += lost;
    }
    return bins;
  }

  /** What the axis of rates reaches from and to: the nominal rate in it, and never so narrow that noise looks big. */
  range() {
    const rates = this.samples.flatMap(({ hz }) => (hz === null ? [] : [hz]));
    if (this.nominalHz > 0) rates.push(this.nominalHz * 0.98, this.nominalHz * 1.02);
    if (rates.length === 0) return [0, 1];
    const [low, high] = [Math.min(...rates), Math.max(...rates)];
    const room = Math.max((high - low) * 0.08, 0.1);
    return [Math.max(0, low - room), high + room];
  }
}

export class History {
  past = new Past();
  #canvas = byId("history");

  constructor() {
    const read = () => {
      this.colours = colours(["muted", "line", "accent", "bad", "text"]);
      this.draw();
    };
    onTheme(read);
    new ResizeObserver(() => this.draw()).observe(this.#canvas);
    read();
  }

  add(status) {
    this.past.add(performance.now() / 1000, status);
    this.draw();
  }

  draw() {
    const { clientWidth: width, clientHeight: height } = this.#canvas;
    const ratio = Math.min(2, devicePixelRatio || 1);
    this.#canvas.width = Math.max(1, width * ratio);
    this.#canvas.height = Math.max(1, height * ratio);
    const ctx = this.#canvas.getContext("2d");
    ctx.scale(ratio, ratio);
    ctx.font = "12px system-ui, sans-serif";
    const now = performance.now() / 1000;
    const plot = { left: 58, right: width - 8, split: height * 0.56, bottom: height - 18 };
    const x = (t) => plot.right - ((now - t) / SPAN_S) * (plot.right - plot.left);
    this.#rates(ctx, plot, x);
    this.#losses(ctx, plot, now);
    ctx.fillStyle = this.colours.muted;
    ctx.textBaseline = "alphabetic";
    for (const [text, at, align] of [["2 min ago", plot.left, "left"], ["1 min", (plot.left + plot.right) / 2, "center"],
      ["now", plot.right, "right"]]) {
      ctx.textAlign = align;
      ctx.fillText(text, at, height - 4);
    }
  }

  #rates(ctx, { left, right, split }, x) {
    const { samples, nominalHz } = this.past;
    const [low, high] = this.past.range();
    const y = (hz) => split - 6 - ((hz - low) / (high - low)) * (split - 26);
    ctx.fillStyle = this.colours.muted;
    ctx.textAlign = "right";
    ctx.textBaseline = "middle";
    if (nominalHz > 0) {
      ctx.strokeStyle = this.colours.muted;
      ctx.setLineDash([5, 5]);
      line(ctx, left, y(nominalHz), right, y(nominalHz));
      ctx.setLineDash([]);
      ctx.fillText(`${Number(nominalHz.toFixed(1))} Hz`, left - 6, y(nominalHz));
    }
    ctx.strokeStyle = this.colours.accent;
    ctx.lineWidth = 2;
    ctx.beginPath();
    let isDown = false;
    for (const { t, hz } of samples) {
      if (hz !== null && x(t) >= left) {
        if (isDown) ctx.lineTo(x(t), y(hz));
        else ctx.moveTo(x(t), y(hz));
      }
      isDown = hz !== null && x(t) >= left;
    }
    ctx.stroke();
    ctx.lineWidth = 1;
  }

  #losses(ctx, { left, right, split, bottom }, now) {
    const bins = this.past.lostBySecond(now);
    const most = Math.max(...bins);
    const width = (right - left) / SPAN_S;
    ctx.strokeStyle = this.colours.line;
    line(ctx, left, bottom + 0.5, right, bottom + 0.5);
    ctx.fillStyle = this.colours.bad;
    bins.forEach((lost, second) => {
      if (lost === 0) return;
      const tall = Math.max(2, (lost / Math.max(most, 5)) * (bottom - split - 12));
      ctx.fillRect(right - (second + 1) * width, bottom - tall, Math.max(1.5, width - 0.5), tall);
    });
    ctx.fillStyle = this.colours.muted;
    ctx.textAlign = "left";
    ctx.textBaseline = "top";
    ctx.fillText(most === 0 ? "no frame lost" : `lost a second, ${count(most)} at most`, left, split + 2);
    const sum = bins.reduce((a, b) => a + b, 0);
    setAttribute(this.#canvas, "aria-label",
      `Frame rate and lost frames of the last two minutes: ${count(sum)} frames lost`);
  }
}

function line(ctx, x1, y1, x2, y2) {
  ctx.beginPath();
  ctx.moveTo(x1, y1);
  ctx.lineTo(x2, y2);
  ctx.stroke();
}
