// The chart of the last two minutes: frame rate and lost frames.

import { byId, setAttribute } from "./dom.js";
import { lostSoFar } from "./metrics.js";
import { count } from "./format.js";
import { OnDemand } from "./on_demand.js";

export const SPAN_S = 120;

/** Samples of the last two minutes: {t, hz, lost}; `hz` is null where the rate is unknown. Pure. */
export class RateHistory {
  samples = [];
  nominalHz = 0;
  #previousLost = null;

  /** Adds a status at a time in seconds. `lost` counts frames since the previous status; a counter that fell was reset. */
  add(t, status) {
    const isRunning = status !== null && (status.state === "armed" || status.state === "recording");
    const hz = status?.input.measured_hz ?? 0;
    const lost = isRunning ? lostSoFar(status) : 0;
    const before = this.#previousLost;
    // In the first three seconds the average is not a rate yet.
    const isKnown = isRunning && status.input.frames >= 3 * (status.device.rate_hz || 0);
    const sample = { t, hz: isKnown ? hz : null, lost: isRunning && before !== null ? Math.max(0, lost - before) : 0 };
    if (status !== null) {
      this.#previousLost = isRunning ? lost : null;
      this.nominalHz = status.device.rate_hz || this.nominalHz;
    }
    this.samples.push(sample);
    while (this.samples[0].t < t - SPAN_S) this.samples.shift();
  }

  /** Lost frames per second before `now`: [newest, …, oldest]. */
  lostBySecond(now) {
    const bins = new Array(SPAN_S).fill(0);
    for (const { t, lost } of this.samples) {
      const bin = Math.floor(now - t);
      if (bin >= 0 && bin < SPAN_S) bins[bin] += lost;
    }
    return bins;
  }

  /** Limits of the rate axis: they include the nominal rate ± 2 %, so that noise does not fill the chart. */
  range() {
    const rates = this.samples.flatMap(({ hz }) => (hz === null ? [] : [hz]));
    if (this.nominalHz > 0) rates.push(this.nominalHz * 0.98, this.nominalHz * 1.02);
    if (rates.length === 0) return [0, 1];
    const [low, high] = [Math.min(...rates), Math.max(...rates)];
    const padding = Math.max((high - low) * 0.08, 0.1);
    return [Math.max(0, low - padding), high + padding];
  }
}

export class History {
  rates = new RateHistory();
  constructor() {
    this.drawing = new OnDemand(byId("history"), ["muted", "line", "accent", "bad", "text"], () => this.#draw());
  }

  add(status) {
    this.rates.add(performance.now() / 1000, status);
    this.drawing.invalidate();
  }

  #draw() {
    const room = this.drawing.clear();
    if (!room) return;
    const { width, height } = room;
    const { ctx } = this.drawing;
    ctx.font = "12px system-ui, sans-serif";
    const now = performance.now() / 1000;
    const plot = { left: 58, right: width - 8, split: height * 0.56, bottom: height - 18 };
    const x = (t) => plot.right - ((now - t) / SPAN_S) * (plot.right - plot.left);
    this.#drawRates(ctx, plot, x);
    this.#drawLosses(ctx, plot, now);
    ctx.fillStyle = this.drawing.colours.muted;
    ctx.textBaseline = "alphabetic";
    for (const [text, at, align] of [["2 min ago", plot.left, "left"], ["1 min", (plot.left + plot.right) / 2, "center"],
      ["now", plot.right, "right"]]) {
      ctx.textAlign = align;
      ctx.fillText(text, at, height - 4);
    }
  }

  #drawRates(ctx, { left, right, split }, x) {
    const { samples, nominalHz } = this.rates;
    const [low, high] = this.rates.range();
    const y = (hz) => split - 6 - ((hz - low) / (high - low)) * (split - 26);
    ctx.fillStyle = this.drawing.colours.muted;
    ctx.textAlign = "right";
    ctx.textBaseline = "middle";
    if (nominalHz > 0) {
      ctx.strokeStyle = this.drawing.colours.muted;
      ctx.setLineDash([5, 5]);
      line(ctx, left, y(nominalHz), right, y(nominalHz));
      ctx.setLineDash([]);
      ctx.fillText(`${Number(nominalHz.toFixed(1))} Hz`, left - 6, y(nominalHz));
    }
    ctx.strokeStyle = this.drawing.colours.accent;
    ctx.lineWidth = 2;
    ctx.beginPath();
    let isPenDown = false;
    for (const { t, hz } of samples) {
      if (hz !== null && x(t) >= left) {
        if (isPenDown) ctx.lineTo(x(t), y(hz));
        else ctx.moveTo(x(t), y(hz));
      }
      isPenDown = hz !== null && x(t) >= left;
    }
    ctx.stroke();
    ctx.lineWidth = 1;
  }

  #drawLosses(ctx, { left, right, split, bottom }, now) {
    const bins = this.rates.lostBySecond(now);
    const maximum = Math.max(...bins);
    const width = (right - left) / SPAN_S;
    ctx.strokeStyle = this.drawing.colours.line;
    line(ctx, left, bottom + 0.5, right, bottom + 0.5);
    ctx.fillStyle = this.drawing.colours.bad;
    bins.forEach((lost, second) => {
      if (lost === 0) return;
      const barHeight = Math.max(2, (lost / Math.max(maximum, 5)) * (bottom - split - 12));
      ctx.fillRect(right - (second + 1) * width, bottom - barHeight, Math.max(1.5, width - 0.5), barHeight);
    });
    ctx.fillStyle = this.drawing.colours.muted;
    ctx.textAlign = "left";
    ctx.textBaseline = "top";
    ctx.fillText(maximum === 0 ? "no frames lost" : `lost frames per second, maximum ${count(maximum)}`, left, split + 2);
    const sum = bins.reduce((a, b) => a + b, 0);
    setAttribute(this.drawing.canvas, "aria-label",
      `Frame rate and lost frames of the last two minutes: ${count(sum)} frames lost`);
  }
}

function line(ctx, x1, y1, x2, y2) {
  ctx.beginPath();
  ctx.moveTo(x1, y1);
  ctx.lineTo(x2, y2);
  ctx.stroke();
}
