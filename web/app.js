// Puts the page together: asks how things stand, and hands the answers on.

import { Actions } from "./actions.js";
import { get } from "./api.js";
import { byId, setHidden, setText } from "./dom.js";
import { Events } from "./events.js";
import { span, zone } from "./format.js";
import { History } from "./history.js";
import { installKeys, installTheme } from "./keys.js";
import { Live } from "./live.js";
import { installLogin } from "./login.js";
import { Markers } from "./markers.js";
import { Motion } from "./motion.js";
import { Hero } from "./state.js";
import { Takes } from "./takes.js";
import { Tiles } from "./tiles.js";
import { View } from "./view.js";

const STATUS_MS = 500;
/** What was heard longer ago is not shown as if it were now. */
const SILENT_MS = 2500;
const QUALITY_MS = 2000;
const TAKES_MS = 15_000;
const TAKES_SHOWN = 20;
/** Frames come some thirty a second: without one for this long the picture is old. */
const FROZEN_MS = 1500;

installTheme();
installLogin();
setText(byId("zone"), zone(-new Date().getTimezoneOffset(), Intl.DateTimeFormat().resolvedOptions().timeZone));

const motion = new Motion();
const view = new View(motion);
const hero = new Hero();
const tiles = new Tiles();
const history = new History();
const markers = new Markers(({ hovered, pinned }) => {
  const slot = (label) => (label === null ? -1 : motion.labels.indexOf(label));
  if (hovered !== undefined) view.choose({ hovered: slot(hovered) });
  if (pinned !== undefined) view.choose({ pinned: slot(pinned) === view.pinned ? -1 : slot(pinned) });
});
view.onChosen = (slot) => markers.point(motion.labels[slot] ?? null);
const takes = new Takes(() => showTakes());
const actions = new Actions(() => look());
installKeys(actions, view);

let status = null;
let heardMs = performance.now();
let lost = null;
let failures = 0;

/** How things stand. One question at a time; `look()` in between asks again at once. */
let asking = null;
function look() {
  asking ??= ask().finally(() => {
    asking = null;
  });
  return asking;
}

async function ask() {
  try {
    const answer = await get("/v1/status");
    status = answer;
    heardMs = performance.now();
    const wasLost = lost !== null;
    [lost, failures] = [null, 0];
    hero.show(status);
    tiles.show(status);
    actions.show(status, false);
    if (wasLost) showTakes();
  } catch (error) {
    failures += 1;
    // One answer may be late; two are a connection that is lost, and so is a silence.
    if (failures < 2 && performance.now() - heardMs < SILENT_MS) return;
    lost = error;
    hero.lose(error.message, heardMs);
    tiles.lose();
    markers.lose();
    takes.lose();
    actions.show(null, true);
  }
}

async function showTakes() {
  try {
    takes.show(await get(`/v1/takes?limit=${TAKES_SHOWN}`));
  } catch {
    // The status tells of the connection.
  }
}

async function showQuality() {
  if (document.hidden || lost) return;
  try {
    markers.show(await get("/v1/quality"), document.body.dataset.frames === "none");
  } catch {
    // As above.
  }
}

/** What stands over the view when no frames come: the picture is then not of now. */
function viewMessage() {
  if (lost) return "No connection";
  if (!status) return "Connecting";
  if (status.state === "idle") return status.device.presence === "absent" ? "No device" : "Idle: arm to see the markers";
  const { age_ms: ageMs, is_open: isOpen } = live.stats;
  if (ageMs < FROZEN_MS) return null;
  if (status.device.presence === "absent") return "No device";
  if (status.state === "failed" && !Number.isFinite(ageMs)) return "Failed";
  if (!Number.isFinite(ageMs)) return isOpen ? "No frame yet" : "Connecting to the live view";
  return `No frame for ${span(ageMs / 1000).join(" ")}`;
}

function showLive() {
  const stats = live.measure();
  const message = viewMessage();
  setHidden(byId("view-message"), message === null);
  setText(byId("view-message"), message ?? "");
  byId("view").classList.toggle("old", message !== null);
  const late = live.clocksDiffer() ? "this clock is not the service's" : `${Math.round(stats.latency_p95_ms)} ms late (p95)`;
  setText(byId("view-stats"), message === null
    ? `${stats.seen} of ${stats.markers} seen · ${stats.drawn_hz.toFixed(0)} frames/s · ${late}` : "");
}

const live = new Live(motion, { onTable: () => view.retable(), onFrame: () => view.touch() });
view.onDrawn = (nowMs) => live.drawn(nowMs);
// For whoever looks at them in the browser's console.
window.mocapdStats = live.stats;
window.mocapdMotion = motion;

new Events(({ kind }) => {
  look();
  if (kind.startsWith("take-")) showTakes();
});

/** Again and again, one after the other: a slow answer must not pile up questions. */
async function every(ms, work) {
  for (;;) {
    await work();
    await new Promise((resolve) => setTimeout(resolve, ms));
  }
}

every(STATUS_MS, async () => {
  await look();
  history.add(lost ? null : status);
});
every(QUALITY_MS, showQuality);
every(TAKES_MS, showTakes);
setInterval(showLive, 250);
