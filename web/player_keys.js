// Keyboard shortcuts and buttons of the player. Everything works by keyboard alone.

import { byId, h } from "./dom.js";
import { isTaken } from "./keys.js";
import { SPEEDS } from "./playback.js";

/** Keys that act again while they are held down. */
const REPEATED = new Set(["ArrowLeft", "ArrowRight", ",", ".", "<", ">"]);

export function installPlayerKeys(player) {
  const { view } = player;
  const second = () => Math.round(player.playback.rateHz);
  const step = (direction) => (event) => player.step(direction * (event.shiftKey ? second() : 1));
  const speed = (by) => () => {
    player.playback.changeSpeed(by);
    player.setSpeed(player.playback.speed);
  };
  const direction = (event) => (event.shiftKey ? -1 : 1);
  const shortcuts = {
    " ": () => player.toggle(),
    k: () => player.toggle(),
    ArrowLeft: step(-1),
    ArrowRight: step(1),
    ",": step(-1),
    ".": step(1),
    "<": step(-1),
    ">": step(1),
    Home: () => player.seek(0),
    End: () => player.seek(player.playback.lastRow),
    ArrowUp: speed(1),
    ArrowDown: speed(-1),
    i: () => player.changeLoop("loopFrom"),
    o: () => player.changeLoop("loopTo"),
    x: () => player.changeLoop("clearLoop"),
    g: (event) => player.goToGap(direction(event)),
    m: () => player.overlays?.goToLargest(),
    e: (event) => player.goToEvent(direction(event)),
    f: () => view.follow(!view.isFollowing),
    t: () => view.toggle("trails"),
    l: () => view.toggle("labels"),
    "?": () => byId("keys").showModal(),
  };
  addEventListener("keydown", (event) => {
    if (event.key === "Escape" && event.target.matches("input, select")) return event.target.blur();
    const act = shortcuts[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    // The scene handles its own arrow keys, and a list scrolls with them.
    if (!act || event.defaultPrevented || isTaken(event)) return;
    if (event.key !== " " && event.key.length > 1 && event.target.closest(".scroll")) return;
    if (event.repeat && !REPEATED.has(event.key)) return;
    event.preventDefault();
    act(event);
  });
  installButtons(player);
  installSlider(player);
}

/** The keys that assistive technology expects of a slider. */
function installSlider(player) {
  const seconds = (n) => Math.round(n * player.playback.rateHz);
  const steps = { ArrowUp: () => 1, ArrowDown: () => -1, PageUp: () => seconds(10), PageDown: () => -seconds(10) };
  byId("axis").addEventListener("keydown", (event) => {
    const step = steps[event.key];
    if (!step || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    player.step(step());
  });
}

function installButtons(player) {
  const { view } = player;
  byId("speed").append(...SPEEDS.map((speed) => h("option", { value: String(speed) }, `${speed}×`)));
  byId("speed").value = "1";
  byId("speed").addEventListener("change", (event) => {
    player.setSpeed(Number(event.target.value));
    // The keys of the player work again.
    event.target.blur();
  });
  const click = (id, act) => byId(id).addEventListener("click", act);
  click("play", () => player.toggle());
  click("back", () => player.step(-1));
  click("forward", () => player.step(1));
  click("loop-from", () => player.changeLoop("loopFrom"));
  click("loop-to", () => player.changeLoop("loopTo"));
  click("loop-clear", () => player.changeLoop("clearLoop"));
  click("next-gap", () => player.goToGap(1));
  click("next-event", () => player.goToEvent(1));
  click("keys-button", () => byId("keys").showModal());
  click("view-follow", () => view.follow(!view.isFollowing));
  click("view-trails", () => view.toggle("trails"));
  click("view-labels", () => view.toggle("labels"));
}
