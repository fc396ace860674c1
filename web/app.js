// Builds the page, polls the service and passes the responses to the parts of the page.

import { Actions } from "./actions.js";
import { get } from "./api.js";
import { drawBodies } from "./bodies.js";
import { bodiesCount, showBodies } from "./body_list.js";
import { byId, setHidden, setText } from "./dom.js";
import { Events } from "./events.js";
import { Finished } from "./finished.js";
import { duration, timeZone } from "./format.js";
import { History } from "./history.js";
import { installKeys, installTheme } from "./keys.js";
import { Live } from "./live.js";
import { installLogin } from "./login.js";
import { Markers } from "./markers.js";
import { Motion } from "./motion.js";
import { Hero } from "./state.js";
import { Strips } from "./strips.js";
import { Takes } from "./takes.js";
import { showPublished } from "./published.js";
import { Tiles } from "./tiles.js";
import { View } from "./view.js";

const STATUS_MS = 500;
/** A status older than this is not shown as current. */
const STALE_MS = 2500;
const QUALITY_MS = 2000;
const TAKES_MS = 15_000;
const TAKES_SHOWN = 20;
/** Some thirty frames arrive per second: without one for this long the view is out of date. */
const FROZEN_MS = 1500;

installTheme();
installLogin();
setText(byId("zone"), timeZone(-new Date().getTimezoneOffset(), Intl.DateTimeFormat().resolvedOptions().timeZone));

const motion = new Motion();
const view = new View(motion);
view.layers = { bodies: drawBodies };
const hero = new Hero();
const tiles = new Tiles();
const history = new History();
const strips = new Strips();
const markers = new Markers(({ hovered, pinned }) => {
  const slot = (label) => (label === null ? -1 : motion.labels.indexOf(label));
  if (hovered !== undefined) view.select({ hovered: slot(hovered) });
  if (pinned !== undefined) view.select({ pinned: slot(pinned) === view.pinned ? -1 : slot(pinned) });
});
view.onSelected = (slot) => markers.highlight(motion.labels[slot] ?? null);
const finished = new Finished(() => showTakes());
const takes = new Takes(() => showTakes(), (take) => finished.open(take));
const actions = new Actions(() => refresh());
installKeys(actions, view);

let status = null;
let respondedMs = performance.now();
let connectionError = null;
let failures = 0;

/** Requests the status. At most one request is pending: calls in between wait for it. */
let pending = null;
function refresh() {
  pending ??= fetchStatus().finally(() => {
    pending = null;
  });
  return pending;
}

async function fetchStatus() {
  try {
    const answer = await get("/v1/status");
    status = answer;
    respondedMs = performance.now();
    const wasDisconnected = connectionError !== null;
    [connectionError, failures] = [null, 0];
    hero.show(status);
    tiles.show(status);
    showPublished(status);
    actions.show(status, false);
    strips.showLedger(status.take);
    if (wasDisconnected) showTakes();
  } catch (error) {
    failures += 1;
    // One response may be late; two failures, or none for STALE_MS, mean that the connection is lost.
    if (failures < 2 && performance.now() - respondedMs < STALE_MS) return;
    connectionError = error;
    hero.showDisconnected(error.message, respondedMs);
    tiles.showDisconnected();
    markers.showDisconnected();
    takes.showDisconnected();
    actions.show(null, true);
  }
}

async function showTakes() {
  try {
    takes.show(await get(`/v1/takes?limit=${TAKES_SHOWN}`));
  } catch {
    // The status poll reports a lost connection.
  }
}

async function showQuality() {
  if (document.hidden || connectionError) return;
  try {
    markers.show(await get("/v1/quality"), document.body.dataset.frames === "none");
  } catch {
    // The status poll reports a lost connection.
  }
}

/** The message over the view while no frames arrive, or null. */
function viewMessage() {
  if (connectionError) return "No connection";
  if (!status) return "Connecting";
  if (status.state === "idle") return status.device.presence === "absent" ? "No device" : "Idle: arm to see the markers";
  const { age_ms: ageMs, is_open: isOpen } = live.stats;
  if (ageMs < FROZEN_MS) return null;
  if (status.device.presence === "absent") return "No device";
  if (status.state === "failed" && !Number.isFinite(ageMs)) return "Failed";
  if (!Number.isFinite(ageMs)) return isOpen ? "No frame yet" : "Connecting to the live view";
  return `No frame for ${duration(ageMs / 1000).join(" ")}`;
}

function showLive() {
  const stats = live.measure();
  const { names, values } = motion.bodies;
  setHidden(byId("bodies-panel"), names.length === 0);
  if (names.length > 0) {
    setText(byId("bodies-count"), bodiesCount(motion.bodies));
    showBodies(byId("bodies"), motion.bodies);
  }
  const message = viewMessage();
  setHidden(byId("view-message"), message === null);
  setText(byId("view-message"), message ?? "");
  byId("view").classList.toggle("stale", message !== null);
  const late = live.clocksDiffer() ? "latency unknown: clocks differ" : `latency ${Math.round(stats.latency_p95_ms)} ms (p95)`;
  setText(byId("view-stats"), message === null
    ? `${stats.seen} of ${stats.markers} seen · ${stats.drawn_hz.toFixed(0)} frames/s · ${late}` : "");
}

const live = new Live(motion, {
  onTable: (table) => {
    strips.setGroups(table.groups ?? []);
    view.updateMarkers();
  },
  onFrame: () => view.invalidate(),
  onSamples: (column, nowMs) => strips.push(column, nowMs),
});
view.onDrawn = (nowMs) => live.drawn(nowMs);
// For the browser's console and the tests.
window.mocapdStats = live.stats;
window.mocapdMotion = motion;

new Events(({ kind }) => {
  refresh();
  if (kind.startsWith("take-")) showTakes();
});

/** Repeats `work` with a pause of `ms`, never two at a time: slow responses must not pile up requests. */
async function repeat(ms, work) {
  for (;;) {
    await work();
    await new Promise((resolve) => setTimeout(resolve, ms));
  }
}

repeat(STATUS_MS, async () => {
  await refresh();
  history.add(connectionError ? null : status);
});
repeat(QUALITY_MS, showQuality);
repeat(TAKES_MS, showTakes);
setInterval(showLive, 250);
