// Requests for the windows of a take: those that are not wanted any more give way.

import { TakeBodies } from "/bodies.js";
import { FrameBuffer } from "/frame_buffer.js";
import { Overlays } from "/overlays.js";
import { ServiceSource } from "/service_source.js";
import { equal, isTrue, test } from "./harness.js";

/** Less than the second after which a service that is busy is asked again. */
const AT_ONCE_MS = 500;

const settled = () => new Promise((resolve) => setTimeout(resolve, 20));

/** Runs `body` with a service that is busy, except for what `isFree` says; `body` gets the list of what is asked for. */
async function withService(isFree, body) {
  const real = globalThis.fetch;
  const asked = [];
  const ends = [];
  globalThis.fetch = (path, { signal }) => new Promise((resolve, reject) => {
    const request = { path: path.replace(/^.*\/|\?.*$/g, ""), isCancelled: false };
    asked.push(request);
    ends.push(reject);
    signal.addEventListener("abort", () => {
      request.isCancelled = true;
      reject(signal.reason);
    });
    const free = isFree(request.path);
    if (free === false) resolve(new Response(JSON.stringify({ kind: "unavailable", message: "busy" }), { status: 503 }));
    else if (free !== null) resolve(new Response(free));
  });
  try {
    await body(asked);
  } finally {
    // What is still open would keep its turn, which other tests need.
    ends.forEach((end) => end(new Error("the service has ended")));
    globalThis.fetch = real;
  }
}

function sourceOf(take) {
  const source = new ServiceSource("a");
  source.take = { rate_hz: 10, markers: 1, frames: 100_000, ...take };
  return source;
}

/** A window of one frame in which everything is 0. */
function windowOf(magic, signals, bytesEach) {
  const view = new DataView(new ArrayBuffer(32 + bytesEach * signals));
  [[0, magic], [4, signals], [16, 1], [20, 1]].forEach(([at, value]) => view.setUint32(at, value, true));
  return view.buffer;
}

test("a request that was cancelled while the service is busy gives its turn to the next one", () =>
  withService((path) => (path === "face" ? windowOf(0x3150504d, 1, 48) : false), async (asked) => {
    const source = sourceOf();
    const cancels = [new AbortController(), new AbortController(), new AbortController()];
    const refused = cancels.map(({ signal }, i) => source.window(100 * i, 10, 1, signal).then(() => "answered", (error) => error.name));
    await settled();
    equal(asked.map(({ path }) => path), ["window", "window"], "two at a time, which both wait a second");
    const beganMs = performance.now();
    const next = source.poses(0, 10, 1);
    cancels.forEach((cancel) => cancel.abort());
    equal(await Promise.all(refused), ["AbortError", "AbortError", "AbortError"]);
    equal((await next).frames, 1);
    isTrue(performance.now() - beganMs < AT_ONCE_MS, `after ${performance.now() - beganMs} ms`);
    equal(asked.map(({ path }) => path), ["window", "window", "face"], "the third was cancelled before its turn");
  }));

test("a request that is still wanted is repeated while the service is busy", async () => {
  let times = 0;
  await withService(() => (++times < 2 ? false : windowOf(0x3157504d, 1, 12)), async (asked) => {
    equal((await sourceOf().window(0, 1, 1, new AbortController().signal)).frames, 1);
    equal(asked.length, 2);
  });
});

test("windows of poses and forces are cancelled, too", () =>
  withService(() => null, async (asked) => {
    const source = sourceOf();
    for (const request of [
      (signal) => source.poses(0, 10, 1, signal),
      (signal) => source.forces(0, 10, 1, 2, signal),
      (signal) => source.bodyPoses(0, 10, 1, 2, signal),
    ]) {
      const cancel = new AbortController();
      const ended = request(cancel.signal).then(() => "answered", () => "ended");
      await settled();
      cancel.abort();
      equal(await ended, "ended");
    }
    equal(asked, ["face", "forces", "poses"].map((path) => ({ path, isCancelled: true })));
  }));

test("a take that is not shown any more ends its requests, and makes no others", () =>
  withService(() => null, async (asked) => {
    const source = sourceOf();
    const ended = [
      source.window(0, 10, 1, new AbortController().signal),
      source.gaps(() => true),
      source.bodies(),
    ].map((request) => request.then(() => "answered", (error) => error.name));
    await settled();
    source.close();
    equal(await Promise.all(ended), ["AbortError", "AbortError", "AbortError"]);
    equal(asked.map(({ path, isCancelled }) => [path, isCancelled]), [["window", true], ["bodies", true]], "the third had no turn yet");
    const buffer = new FrameBuffer(source, { ...source.take, rate_hz: 10, window_frames_max: 1000 }, { onFailed: () => isTrue(false, "it has not failed") });
    buffer.want(0);
    await settled();
    equal(asked.length, 2);
  }));

test("a page that was left makes no requests, and makes them again when it is back", async () => {
  let isAway = false;
  await withService(() => (isAway ? null : JSON.stringify({ names: [], window_frames_max: 1 })), async (asked) => {
    isAway = true;
    const source = sourceOf();
    const [bodies, plates] = [source.bodies(), source.plates()];
    await settled();
    dispatchEvent(new PageTransitionEvent("pagehide", { persisted: true }));
    const gaps = source.gaps(() => false);
    await settled();
    equal(asked.map(({ path, isCancelled }) => [path, isCancelled]), [["bodies", true], ["plates", true]]);
    isAway = false;
    dispatchEvent(new PageTransitionEvent("pageshow", { persisted: true }));
    equal((await bodies).names, []);
    await Promise.all([plates, gaps]);
    equal(asked.slice(2).map(({ path }) => path).sort(), ["bodies", "gaps", "plates"]);
  });
});

/** A player whose own frames are being loaded all the time. */
function busyPlayer(source) {
  const player = { overview: { ...source.take, face: {} }, buffer: { idle: () => new Promise(() => {}) }, refreshed: 0 };
  player.refresh = () => (player.refreshed += 1);
  return player;
}

test("the face is loaded although the frames never rest, and a jump cancels its old windows", () =>
  withService(() => null, async (asked) => {
    const source = sourceOf();
    const overlays = new Overlays();
    overlays.player = busyPlayer(source);
    overlays.openFace(source, () => true);
    equal(overlays.player.refreshed, 1);
    overlays.want({ row: 0, loop: null }, 10);
    await settled();
    overlays.want({ row: 90_000, loop: null }, 10);
    await settled();
    equal(asked.map(({ path, isCancelled }) => [path, isCancelled]),
      [["face", true], ["face", true], ["face", false], ["face", false]]);
    const without = new Overlays();
    without.player = busyPlayer(source);
    without.player.overview.face = null;
    without.openFace(source, () => true);
    without.want({ row: 0, loop: null }, 10);
    equal([asked.length, without.player.refreshed], [4, 0], "a take without a face");
  }));

test("a jump cancels the windows of rigid bodies where the source can", async () => {
  const text = document.createElement("p");
  text.id = "bodies-text";
  document.body.append(text);
  const signals = [];
  for (const canCancel of [true, undefined]) {
    const source = sourceOf();
    const player = busyPlayer(source);
    player.buffer.idle = async () => {};
    const bodies = new TakeBodies(player);
    signals.length = 0;
    const bodyPoses = (...given) => new Promise(() => signals.push(given[4]));
    await bodies.open({ canCancel, bodyPoses, bodies: async () => ({ names: ["wand"], window_frames_max: 1000 }) }, () => true);
    bodies.want({ row: 0, loop: null }, 10);
    bodies.want({ row: 90_000, loop: null }, 10);
    equal(signals.map(({ aborted }) => aborted), canCancel ? [true, true, false, false] : [false, false]);
  }
  text.remove();
});
