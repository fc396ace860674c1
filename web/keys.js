// Keys that work wherever the focus is, except where somebody writes.

import { byId } from "./dom.js";

/** Whether a key belongs to what has the focus. */
function isTaken(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || event.isComposing) return true;
  if (document.querySelector("dialog[open]")) return true;
  const { target } = event;
  if (target.closest("input, textarea, select")) return true;
  return event.key === " " && target.closest("button, a, summary") !== null;
}

export function installKeys(actions, view) {
  const does = {
    r: () => actions.start(),
    s: () => actions.stop(),
    " ": () => actions.stop(),
    m: () => actions.mark(),
    n: () => byId("name").focus(),
    f: () => view.follow(!view.isFollowing),
    t: () => view.toggle("trails"),
    l: () => view.toggle("labels"),
    "?": () => byId("keys").showModal(),
  };
  addEventListener("keydown", (event) => {
    if (event.key === "Escape" && event.target.matches("input")) return event.target.blur();
    const act = does[event.key.toLowerCase()];
    // Held down it is one press: a take must not begin and end by a book on the keyboard.
    if (!act || event.repeat || isTaken(event)) return;
    event.preventDefault();
    act();
  });
  byId("keys-button").addEventListener("click", () => byId("keys").showModal());
  byId("view-follow").addEventListener("click", () => view.follow(!view.isFollowing));
  byId("view-trails").addEventListener("click", () => view.toggle("trails"));
  byId("view-labels").addEventListener("click", () => view.toggle("labels"));
}

const THEMES = { system: "light", light: "dark", dark: "system" };

export function installTheme() {
  const button = byId("theme");
  const show = (theme) => {
    button.textContent = `Theme: ${theme}`;
    if (theme === "system") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = theme;
  };
  let theme = "system";
  try {
    theme = localStorage.getItem("theme") ?? "system";
  } catch {
    // A browser that keeps nothing: the system's theme it is.
  }
  if (!(theme in THEMES)) theme = "system";
  show(theme);
  button.addEventListener("click", () => {
    theme = THEMES[theme];
    show(theme);
    try {
      localStorage.setItem("theme", theme);
    } catch {
      // It holds until the page is closed.
    }
  });
}
