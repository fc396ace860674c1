// The strip charts of the sampled channels: the least and the largest value in each twentieth of a second.

import { byId, h, setAttribute, setHidden, setText } from "./dom.js";
import { count, plural, rounded } from "./format.js";
import { causes } from "./metrics.js";
import { OnDemand } from "./on_demand.js";

const COLOURS = ["panel", "raised", "line", "text", "muted", "accent", "bad"];
/** Seconds shown, and how many columns of a group are kept: at most twenty a second. */
const SPAN_S = 10;
const COLUMNS_MAX = 21 * SPAN_S;
/** The level is that of this time. */
const LEVEL_S = 1;
/** How often the charts are drawn. */
const DRAW_MS = 100;
/** Height of a channel: less for each if there are many. */
const LANE_PX = [20, 46];
const GROUP_PX = 420;
/** Space for names and levels, in pixels. */
const NAME_PX = 76;
const LEVEL_PX = 96;

/** The columns of a group over the last seconds, by the numbers of their samples. Pure: times are arguments. */
export class StripHistory {
  /** {first, n, ranges}: ranges are [low, high] by channel. */
  columns = [];
  #endMs = 0;

  constructor(group) {
    this.group = group;
  }

  /** Adds a column that arrived at a time. Numbers that fall are those of another run of the device. */
  push(nowMs, { first, n, ranges }) {
    if (this.columns.length > 0 && first < this.columns.at(-1).first) this.columns = [];
    this.columns.push({ first, n, ranges });
    this.#endMs = nowMs;
    const oldest = first + n - SPAN_S * this.group.rate_hz;
    while (this.columns.length > COLUMNS_MAX || this.columns[0].first + this.columns[0].n <= oldest) this.columns.shift();
  }

  /** How long ago a sample was taken, in seconds. */
  ageS(number, nowMs) {
    const { first, n } = this.columns.at(-1);
    return (first + n - number) / this.group.rate_hz + Math.max(0, nowMs - this.#endMs) / 1000;
  }

  /** The ends of a channel over the last seconds: [low, high]; null if it had no value. */
  ends(channel, seconds, nowMs) {
    let [low, high] = [Infinity, -Infinity];
    for (const { first, n, ranges } of this.columns) {
      if (this.ageS(first + n, nowMs) > seconds || !Number.isFinite(ranges[2 * channel])) continue;
      low = Math.min(low, ranges[2 * channel]);
      high = Math.max(high, ranges[2 * channel + 1]);
    }
    return low > high ? null : [low, high];
  }

  /** Whether values reach the ends of what the counts of a channel can express. */
  isClipped(channel, [low, high]) {
    const scale = this.group.channels[channel].full_scale;
    // The ends are sent as float32.
    const reach = scale ? 1e-6 * (scale[1] - scale[0]) : 0;
    return Boolean(scale) && (low <= scale[0] + reach || high >= scale[1] - reach);
  }

  /** The share of the full scale that a channel used, 0 to 1; null if it has none. */
  level(channel, [low, high]) {
    const scale = this.group.channels[channel].full_scale;
    if (!scale) return null;
    return Math.min(1, Math.max(low < 0 ? low / scale[0] : 0, high > 0 ? high / scale[1] : 0));
  }
}

/** The samples of a group in the take, as a text. Pure. */
export function ledgerText(group) {
  if (!group) return "";
  const lost = causes(group);
  const jumps = group.jumps > 0 ? `; numbers jumped ${plural(group.jumps, "time")}` : "";
  return `${count(group.stored)} of ${count(group.taken)} samples${lost.length > 0 ? `; lost: ${lost.join(", ")}` : ", none lost"}${jumps}`;
}

export class Strips {
  #strips = [];
  #drawnMs = 0;

  /** Shows the groups of a table. */
  setGroups(groups) {
    const text = JSON.stringify(groups);
    if (text === this.#text) return;
    this.#text = text;
    this.#strips = groups.map((group) => this.#create(group));
    byId("strips").replaceChildren(...this.#strips.map(({ figure }) => figure));
    setHidden(byId("strips-panel"), groups.length === 0);
    const n = groups.reduce((sum, { channels }) => sum + channels.length, 0);
    setText(byId("strips-count"), `${plural(n, "channel")} · last ${SPAN_S} s`);
  }

  #text = "[]";

  #create(group) {
    const history = new StripHistory(group);
    const lanePx = Math.max(LANE_PX[0], Math.min(LANE_PX[1], GROUP_PX / group.channels.length));
    const canvas = h("canvas", { role: "img", "aria-label": `Group ${group.number}` });
    canvas.style.height = `${Math.ceil(lanePx * group.channels.length)}px`;
    const clipped = h("span", { "data-level": "bad" });
    const ledger = h("small");
    const figure = h("figure", { class: "strip" },
      h("figcaption", {}, `Group ${group.number} `,
        h("small", {}, `${plural(group.channels.length, "channel")} at ${Number(group.rate_hz.toFixed(3))} Hz · `), ledger, " ", clipped),
      canvas);
    const strip = { history, lanePx, canvas, clipped, ledger, figure };
    strip.drawing = new OnDemand(canvas, COLOURS, () => this.#draw(strip));
    return strip;
  }

  /** Adds a column of the group with this index. */
  push(column, nowMs) {
    this.#strips[column.group]?.history.push(nowMs, column);
    if (nowMs - this.#drawnMs < DRAW_MS) return;
    this.#drawnMs = nowMs;
    this.invalidate();
  }

  invalidate() {
    this.#strips.forEach(({ drawing }) => drawing.invalidate());
  }

  /** Shows the ledger of the take that is recorded. */
  showLedger(take) {
    for (const { history, ledger } of this.#strips) {
      const group = take?.sample_ledger?.groups.find(({ group: number }) => number === history.group.number);
      setText(ledger, ledgerText(group) || (take ? "" : "no take"));
    }
  }

  #draw(strip) {
    const room = strip.drawing.clear();
    if (!room) return;
    const { history } = strip;
    const nowMs = performance.now();
    const wrong = [];
    history.group.channels.forEach((channel, index) => {
      if (this.#drawLane(strip, index, room.width, nowMs)) wrong.push(channel.name || `channel ${index + 1}`);
    });
    const names = wrong.slice(0, 3).join(", ");
    setText(strip.clipped, wrong.length === 0 ? "" : `✕ clipped: ${names}${wrong.length > 3 ? ` and ${wrong.length - 3} more` : ""}`);
    setAttribute(strip.canvas, "aria-label", `Group ${history.group.number}: ${wrong.length === 0 ? "no channel is clipped" : `clipped: ${wrong.join(", ")}`}`);
  }

  /** Draws a channel; returns whether it was clipped. */
  #drawLane({ history, lanePx, drawing: { ctx, colours } }, index, width, nowMs) {
    const { name, unit } = history.group.channels[index];
    const [top, height] = [index * lanePx, lanePx - 4];
    const right = width - LEVEL_PX;
    ctx.fillStyle = colours.raised;
    ctx.fillRect(NAME_PX, top, right - NAME_PX, height);
    ctx.font = "600 12px system-ui, sans-serif";
    ctx.textBaseline = "middle";
    ctx.textAlign = "right";
    ctx.fillStyle = colours.muted;
    ctx.fillText(name || `channel ${index + 1}`, NAME_PX - 6, top + height / 2, NAME_PX - 8);
    const ends = history.ends(index, Infinity, nowMs);
    if (!ends) return false;
    const [low, high] = ends[0] === ends[1] ? [ends[0] - 1, ends[1] + 1] : ends;
    const y = (value) => top + height - 2 - ((value - low) / (high - low)) * (height - 4);
    const x = (number) => Math.max(NAME_PX, right - (history.ageS(number, nowMs) / SPAN_S) * (right - NAME_PX));
    const [usual, clipped] = [new Path2D(), new Path2D()];
    let isClipped = false;
    for (const { first, n, ranges } of history.columns) {
      const range = [ranges[2 * index], ranges[2 * index + 1]];
      const [from, to] = [x(first), x(first + n)];
      if (!Number.isFinite(range[0]) || to <= NAME_PX) continue;
      const is = history.isClipped(index, range);
      isClipped ||= is;
      const above = y(range[1]);
      (is ? clipped : usual).rect(from, above, Math.max(1, to - from + 0.2), Math.max(1.5, y(range[0]) - above));
    }
    ctx.fillStyle = colours.accent;
    ctx.fill(usual);
    ctx.fillStyle = colours.bad;
    ctx.fill(clipped);
    this.#drawLevel(ctx, colours, { history, index, unit, top, height, right, width, isClipped, nowMs });
    return isClipped;
  }

  /** The largest magnitude of the last second, and its share of the full scale as a bar. */
  #drawLevel(ctx, colours, { history, index, unit, top, height, right, width, isClipped, nowMs }) {
    const recent = history.ends(index, LEVEL_S, nowMs);
    if (!recent) return;
    const peak = Math.abs(recent[0]) > Math.abs(recent[1]) ? recent[0] : recent[1];
    const level = history.level(index, recent);
    ctx.textAlign = "left";
    ctx.fillStyle = isClipped ? colours.bad : colours.text;
    ctx.font = `${isClipped ? 700 : 500} 12px system-ui, sans-serif`;
    ctx.fillText(`${isClipped ? "✕ " : ""}${withPrefix(peak, unit)}`, right + 8, top + height / 2 - (level === null ? 0 : 3), LEVEL_PX - 10);
    if (level === null) return;
    ctx.fillStyle = colours.line;
    ctx.fillRect(right + 8, top + height - 5, width - right - 10, 3);
    ctx.fillStyle = isClipped ? colours.bad : colours.accent;
    ctx.fillRect(right + 8, top + height - 5, (width - right - 10) * level, 3);
  }
}

/** A value with its unit, and a prefix where volts are small. Pure. */
export function withPrefix(value, unit) {
  const size = Math.abs(value);
  if (unit === "V" && size < 0.9995) {
    return size < 0.9995e-3 ? `${rounded(value * 1e6)} µV` : `${rounded(value * 1e3)} mV`;
  }
  return unit ? `${rounded(value)} ${unit}` : rounded(value);
}
