// The player of a shared page, which has the take inside and needs no network.

import { byId, setHidden, setText } from "./dom.js";
import { roundedUp } from "./format.js";
import { installTheme } from "./keys.js";
import { Player } from "./player.js";
import { SharedSource } from "./shared_source.js";

/** The sentence at the foot of the page. Pure. */
export function accuracyText({ tolerance_mm: ofTake, page }) {
  const take = ofTake > 0 ? `those of the take by at most ${roundedUp(ofTake)} mm` : "those of the take, which is lossless, not at all";
  return `Positions differ from the original by at most ${roundedUp(page.tolerance_mm)} mm: ${take}, ` +
    `and this page adds at most ${roundedUp(page.added_mm)} mm (the largest that it added is ${roundedUp(page.max_added_mm, 4)} mm).` +
    `${page.angles ? anglesText(page.angles) : ""} Made by mocapd; nothing is loaded from a network.`;
}

function anglesText({ tolerance_degrees: all, added_degrees: added, max_added_degrees: most }) {
  return ` Rotations of rigid bodies differ by at most ${roundedUp(all)}°, of which this page adds at most ${roundedUp(added)}° (the largest that it added is ${roundedUp(most, 4)}°).`;
}

installTheme();
const overview = JSON.parse(byId("take").textContent);
const player = new Player();
// For the browser's console and the tests.
window.mocapdPlayer = player;
setText(byId("foot"), accuracyText(overview));
setHidden(byId("foot"), false);
player.open(new SharedSource(overview, byId("motion").textContent));
