// Reads GET /v1/live while the page is visible, and measures the latency of the frames.

import { openStream } from "./api.js";
import { percentile } from "./format.js";
import { LiveParser } from "./stream.js";

const RETRY_MS = 1000;
/** Frames over which the latency is computed: ten seconds at some thirty frames per second. */
const LATENCY_SAMPLES = 300;
/** A larger latency means that the clocks of the browser and the service differ. */
const CLOCKS_DIFFER_MS = 10_000;

export class Live {
  /** Statistics since the page was opened; read by the tests, too. */
  stats = { frames: 0, tables: 0, drawn: 0, received_hz: 0, drawn_hz: 0, latency_p50_ms: NaN,
    latency_p95_ms: NaN, drawn_p95_ms: NaN, worst_ms: NaN, markers: 0, seen: 0, is_open: false };
  lastFrameMs = -Infinity;
  #received = [];
  #latencies = [];
  #drawnLatencies = [];
  #drawn = [];
  #undrawnUs = 0;
  #abort = null;

  /** `onSamples` gets a column of a group of sampled channels, and the time in milliseconds. */
  constructor(motion, { onTable, onFrame, onSamples }) {
    this.motion = motion;
    this.onTable = onTable;
    this.onFrame = onFrame;
    this.onSamples = onSamples;
    document.addEventListener("visibilitychange", () => this.#updateVisibility());
    this.#updateVisibility();
  }

  /** A hidden page requests no frames. */
  #updateVisibility() {
    if (document.hidden) {
      this.#abort?.abort();
      this.#abort = null;
    } else if (!this.#abort) {
      this.#abort = new AbortController();
      this.#run(this.#abort.signal);
    }
  }

  async #run(signal) {
    while (!signal.aborted) {
      try {
        const response = await openStream("/v1/live", signal);
        const reader = response.body.getReader();
        const parser = new LiveParser();
        this.stats.is_open = true;
        for (;;) {
          const { done, value } = await reader.read();
          if (done) break;
          for (const message of parser.push(value)) this.#handle(message);
        }
      } catch (error) {
        if (!signal.aborted) console.info("live stream:", error.message);
      }
      this.stats.is_open = false;
      await new Promise((resolve) => setTimeout(resolve, RETRY_MS));
    }
  }

  #handle(message) {
    if (message.kind === "table") {
      this.motion.setTable(message.table);
      this.stats.tables += 1;
      this.stats.markers = this.motion.n;
      return this.onTable(message.table);
    }
    if (message.kind === "samples") return this.onSamples(message, performance.now());
    if (message.kind === "poses") return this.motion.setPoses(message);
    if (message.kind === "face") {
      this.motion.facePose = message.pose;
      return;
    }
    const nowMs = performance.now();
    this.motion.push(message, nowMs);
    this.lastFrameMs = nowMs;
    this.stats.frames += 1;
    this.stats.seen = this.motion.nSeen;
    this.#undrawnUs = message.arrivalUnixUs;
    pushLimited(this.#received, nowMs, 60);
    pushLimited(this.#latencies, Date.now() - message.arrivalUnixUs / 1000, LATENCY_SAMPLES);
    this.onFrame();
  }

  /** Called when the newest frame has been drawn. */
  drawn(nowMs) {
    if (this.#undrawnUs === 0) return;
    pushLimited(this.#drawnLatencies, Date.now() - this.#undrawnUs / 1000, LATENCY_SAMPLES);
    this.#undrawnUs = 0;
    this.stats.drawn += 1;
    pushLimited(this.#drawn, nowMs, 60);
  }

  /** Updates the statistics; called a few times per second. */
  measure() {
    const nowMs = performance.now();
    const { stats } = this;
    stats.received_hz = rate(this.#received, nowMs);
    stats.drawn_hz = rate(this.#drawn, nowMs);
    stats.latency_p50_ms = percentile(this.#latencies, 0.5);
    stats.latency_p95_ms = percentile(this.#latencies, 0.95);
    stats.drawn_p95_ms = percentile(this.#drawnLatencies, 0.95);
    stats.worst_ms = percentile(this.#latencies, 1);
    stats.age_ms = nowMs - this.lastFrameMs;
    return stats;
  }

  /** Whether the clocks of the browser and the service differ so much that the latency is meaningless. */
  clocksDiffer() {
    const { latency_p95_ms: late } = this.stats;
    return late < -50 || late > CLOCKS_DIFFER_MS;
  }
}

function pushLimited(list, value, maximum) {
  list.push(value);
  if (list.length > maximum) list.shift();
}

/** Events per second over the last two seconds, from their times in milliseconds. */
function rate(times, nowMs) {
  const recent = times.filter((time) => nowMs - time < 2000);
  if (recent.length < 2) return 0;
  return ((recent.length - 1) * 1000) / Math.max(1, nowMs - recent[0]);
}
