// Keyboard shortcuts of the page, and the theme button. Shortcuts are off while an input field has the focus.

import { byId } from "./dom.js";

/** Whether the focused element or an open dialog handles the key itself. */
export function isTaken(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || event.isComposing) return true;
  if (document.querySelector("dialog[open]")) return true;
  const { target } = event;
  // A checkbox needs the space bar alone.
  if (target.matches("input[type=checkbox]")) return event.key === " ";
  if (target.closest("input, textarea, select")) return true;
  return event.key === " " && target.closest("button, a, summary") !== null;
}

export function installKeys(actions, view) {
  const shortcuts = {
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
    const act = shortcuts[event.key.toLowerCase()];
    // Key repeats are ignored: a book on the keyboard must not start and stop takes.
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
    // The browser stores nothing: use the system's theme.
  }
  if (!(theme in THEMES)) theme = "system";
  show(theme);
  button.addEventListener("click", () => {
    theme = THEMES[theme];
    show(theme);
    try {
      localStorage.setItem("theme", theme);
    } catch {
      // The theme lasts until the page is closed.
    }
  });
}
