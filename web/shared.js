// The player of a shared page, which has the take inside and needs no network.

import { byId, setHidden, setText } from "./dom.js";
import { roundedUp } from "./format.js";
import { installTheme } from "./keys.js";
import { Player } from "./player.js";
import { SharedSource } from "./shared_source.js";

/** The sentence at the foot of the page. Pure. */
export function accuracyText({ tolerance_mm: ofTake, page }) {
  const take = ofTake > 0 ? `${roundedUp(ofTake)} mm by the take` : "nothing by the take, which is lossless";
  return `Positions differ from the original by at most ${roundedUp(page.tolerance_mm)} mm: ${take}, ` +
    `${roundedUp(page.added_mm)} mm by this page (measured: ${roundedUp(page.max_added_mm)} mm). Made by mocapd; nothing is loaded from a network.`;
}

installTheme();
const overview = JSON.parse(byId("take").textContent);
const player = new Player();
// For the browser's console and the tests.
window.mocapdPlayer = player;
setText(byId("foot"), accuracyText(overview));
setHidden(byId("foot"), false);
player.open(new SharedSource(overview, byId("motion").textContent));
