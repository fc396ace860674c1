// Creates elements and updates them; the page is changed only where a value changed.

import { cutToBytes } from "./format.js";

export const byId = (id) => document.getElementById(id);

/** An element with attributes and children: `h("td", { class: "n" }, "12")`. */
export function h(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(name, value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, value);
  }
  element.append(...children.filter((child) => child !== null));
  return element;
}

export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

export function setAttribute(element, name, value) {
  if (value === null) element.removeAttribute(name);
  else if (element.getAttribute(name) !== value) element.setAttribute(name, value);
}

export function setHidden(element, isHidden) {
  if (element.hidden !== isHidden) element.hidden = isHidden;
}

/** Cuts what is typed into a text field to its `data-bytes-max`: the service limits texts by their bytes. */
export function limitBytes(field) {
  const limit = (event) => {
    if (event.isComposing) return;
    const text = cutToBytes(field.value, Number(field.dataset.bytesMax));
    if (text !== field.value) field.value = text;
  };
  field.addEventListener("input", limit);
  field.addEventListener("compositionend", limit);
}

/** The page's colours for a canvas, by the names of their custom properties. */
export function colours(names) {
  const probe = h("span", { hidden: true });
  document.body.append(probe);
  const style = getComputedStyle(probe);
  const found = {};
  for (const name of names) {
    probe.style.color = `var(--${name})`;
    found[name] = style.color;
  }
  probe.remove();
  return found;
}

/** Calls `callback` when the theme changes, by the button or by the system. */
export function onTheme(callback) {
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", callback);
  new MutationObserver(callback).observe(document.documentElement, { attributeFilter: ["data-theme"] });
}

export const prefersReducedMotion = () => matchMedia("(prefers-reduced-motion: reduce)").matches;
