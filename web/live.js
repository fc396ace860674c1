// Reads GET /v1/live for as long as somebody looks, and measures how late the frames are.

import { open } from "./api.js";
import { percentile } from "./format.js";
import { LiveParser } from "./stream.js";

const AGAIN_MS = 1000;
/** Frames of which the latency is told: ten seconds of some thirty. */
const LATENCIES = 300;
/** Beyond this the browser's clock and the service's are not the same. */
const CLOCKS_DIFFER_MS = 10_000;

export class Live {
  /** Since the page was opened; the tests read them too. */
  stats = { frames: 0, tables: 0, drawn: 0, received_hz: 0, drawn_hz: 0, latency_p50_ms: NaN,
    latency_p95_ms: NaN, drawn_p95_ms: NaN, worst_ms: NaN, markers: 0, seen: 0, is_open: false };
  lastFrameMs = -Infinity;
  #received = [];
  #latencies = [];
  #drawnLatencies = [];
  #drawn = [];
  #undrawnUs = 0;
  #abort = null;

  constructor(motion, { onTable, onFrame }) {
    this.motion = motion;
    this.onTable = onTable;
    this.onFrame = onFrame;
    document.addEventListener("visibilitychange", () => this.#look());
    this.#look();
  }

  /** A page that nobody sees asks for no frames. */
  #look() {
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
        const response = await open("/v1/live", signal);
        const reader = response.body.getReader();
        const parser = new LiveParser();
        this.stats.is_open = true;
        for (;;) {
          const { done, value } = await reader.read();
          if (done) break;
          for (const message of parser.push(value)) this.#take(message);
        }
      } catch (error) {
        if (!signal.aborted) console.info("live stream:", error.message);
      }
      this.stats.is_open = false;
      await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
    }
  }

  #take(message) {
    if (message.kind === "table") {
      this.motion.setTable(message.table);
      this.stats.tables += 1;
      this.stats.markers = this.motion.n;
      return this.onTable();
    }
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
    keep(this.#received, nowMs, 60);
    keep(this.#latencies, Date.now() - message.arrivalUnixUs / 1000, LATENCIES);
    this.onFrame();
  }

  /** The newest frame is on the screen. */
  drawn(nowMs) {
    if (this.#undrawnUs === 0) return;
    keep(this.#drawnLatencies, Date.now() - this.#undrawnUs / 1000, LATENCIES);
    this.#undrawnUs = 0;
    this.stats.drawn += 1;
    keep(this.#drawn, nowMs, 60);
  }

  /** Counts up what was measured; called a few times a second. */
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

  /** Whether the browser's clock and the service's cannot be the same one. */
  clocksDiffer() {
    const { latency_p95_ms: late } = this.stats;
    return late < -50 || late > CLOCKS_DIFFER_MS;
  }
}

function keep(list, value, most) {
  list.push(value);
  if (list.length > most) list.shift();
}

/** How often things happened a second, over the last two seconds. */
function rate(times, nowMs) {
  const recent = times.filter((time) => nowMs - time < 2000);
  if (recent.length < 2) return 0;
  return ((recent.length - 1) * 1000) / Math.max(1, nowMs - recent[0]);
}
