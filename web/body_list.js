// The list of the rigid bodies of a device.

import { STATES, bodyName, poseOf } from "./bodies.js";
import { h, setText } from "./dom.js";
import { percent } from "./format.js";

/** The number of the state of a body whose pose did not arrive. */
const MISSING = 253;

/** The lines of the list: {text, isTracked}, with the share of the frames in which each body was tracked. Pure. */
export function bodyLines({ names, values, frames, tracked }) {
  return names.map((_, body) => {
    const { isTracked, state } = values ? poseOf(values, body) : { isTracked: false, state: STATES.get(MISSING) };
    const share = frames > 0 ? ` · share tracked ${percent((tracked[body] ?? 0) / frames)} %` : "";
    return { text: `${bodyName(names, body)} · ${state}${share}`, isTracked };
  });
}

/** How many bodies have a pose. Pure. */
export function bodiesCount({ names, values }) {
  return `${bodyLines({ names, values, frames: 0, tracked: [] }).filter(({ isTracked }) => isTracked).length} of ${names.length} tracked`;
}

/** Shows the lines in a list. */
export function showBodies(list, bodies) {
  const lines = bodyLines(bodies);
  while (list.children.length > lines.length) list.lastElementChild.remove();
  while (list.children.length < lines.length) list.append(h("li", {}));
  lines.forEach(({ text, isTracked }, index) => {
    const item = list.children[index];
    item.dataset.tracked = String(isTracked);
    setText(item, `${isTracked ? "●" : "○"} ${text}`);
  });
}
