// Mouse, touch and keyboard control of the view.

/** A press that moves less than this is a click. */
const CLICK_MAX_PX = 3;
const MOUSE_REACH_PX = 16;
const FINGER_REACH_PX = 28;
const TURN_PER_PX = 0.008;

export function installPointer(view) {
  const { canvas } = view;
  const pointers = new Map();
  let moved = 0;
  const at = (event) => [event.offsetX, event.offsetY];

  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, at(event));
    moved = 0;
  });
  canvas.addEventListener("pointermove", (event) => {
    const now = at(event);
    const before = pointers.get(event.pointerId);
    if (!before) return view.select({ hovered: view.markerAt(now, MOUSE_REACH_PX) });
    const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    moved += Math.abs(dx) + Math.abs(dy);
    const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
    if (other) pinch(view, before, now, other);
    else if (event.shiftKey || event.buttons & 6) view.moveCamera((camera) => camera.pan(dx, dy, view.height));
    else if (moved > CLICK_MAX_PX) view.moveCamera((camera) => camera.orbit(-dx * TURN_PER_PX, dy * TURN_PER_PX));
    pointers.set(event.pointerId, now);
  });
  canvas.addEventListener("pointerup", (event) => {
    if (pointers.size === 1 && moved <= CLICK_MAX_PX) {
      const found = view.markerAt(at(event), event.pointerType === "touch" ? FINGER_REACH_PX : MOUSE_REACH_PX);
      view.select({ pinned: found === view.pinned ? -1 : found, hovered: -1 });
    }
    pointers.delete(event.pointerId);
  });
  canvas.addEventListener("pointercancel", (event) => pointers.delete(event.pointerId));
  canvas.addEventListener("pointerleave", () => view.select({ hovered: -1 }));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const step = Math.sign(event.deltaY) * Math.min(0.2, Math.abs(event.deltaY) * 0.002);
    view.moveCamera((camera) => camera.zoom(Math.exp(step)));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => onKey(view, event));
}

/** Two fingers: their distance zooms, their midpoint pans. */
function pinch(view, before, now, other) {
  const apart = (point) => Math.max(10, Math.hypot(point[0] - other[0], point[1] - other[1]));
  view.moveCamera((camera) => {
    camera.zoom(apart(before) / apart(now));
    camera.pan((now[0] - before[0]) / 2, (now[1] - before[1]) / 2, view.height);
  });
}

const ARROWS = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

function onKey(view, event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const arrow = ARROWS[event.key];
  if (arrow && event.shiftKey) view.moveCamera((camera) => camera.pan(30 * arrow[0], 30 * arrow[1], view.height));
  else if (arrow) view.moveCamera((camera) => camera.orbit(-0.08 * arrow[0], 0.08 * arrow[1]));
  else if (event.key === "+" || event.key === "=") view.moveCamera((camera) => camera.zoom(0.9));
  else if (event.key === "-") view.moveCamera((camera) => camera.zoom(1 / 0.9));
  else return;
  event.preventDefault();
}
