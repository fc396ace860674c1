// The downloads of a take: as it is, and as a file of another program's format.

import { getBytes } from "./api.js";
import { h, setText } from "./dom.js";

/** Extensions, and the texts of their links. */
const FORMATS = [["take", "Take"], ["c3d", "C3D"], ["trc", "TRC"], ["csv", "CSV"]];
/** What the formats lack. */
const NOTE = "C3D has the markers, analog channels and force plates; channels of a recording whose rate does not fit the frames are left out. TRC and CSV have the markers. The take has everything.";
/** Converting and sending a large take over a slow network takes a while. */
const TIMEOUT_MS = 600_000;

/** The path of a download. Pure. */
export function downloadPath(name, format) {
  const path = `/v1/takes/${encodeURIComponent(name)}/download`;
  return format === "take" ? path : `${path}?format=${format}`;
}

/** A button that opens the links to the downloads of a take. Without a session cookie, `isFetched`, the page sends its token itself. */
export function downloadMenu(name, isFetched = false) {
  const answer = h("p", { class: "note", role: "status" });
  const links = FORMATS.map(([format, text]) => {
    const file = `${name}.${format}`;
    const link = h("a", { class: "button", href: downloadPath(name, format), download: file, "aria-label": `Download ${file}` }, text);
    if (isFetched) link.addEventListener("click", (event) => fetchFile(event, name, format, answer));
    return link;
  });
  const menu = h("details", { class: "downloads" },
    h("summary", { class: "button", "aria-label": `Download ${name}` }, "Download"),
    h("div", { class: "formats" }, ...links, h("p", { class: "note" }, NOTE), answer));
  menu.addEventListener("keydown", (event) => {
    if (event.key !== "Escape" || !menu.open) return;
    event.stopPropagation();
    menu.open = false;
    menu.querySelector("summary").focus();
  });
  return menu;
}

/** Fetches a file, and gives it to the browser to store. */
async function fetchFile(event, name, format, answer) {
  event.preventDefault();
  setText(answer, "Preparing …");
  try {
    const bytes = await getBytes(downloadPath(name, format), TIMEOUT_MS);
    const url = URL.createObjectURL(new Blob([bytes]));
    h("a", { href: url, download: `${name}.${format}` }).click();
    // The browser has opened it by then.
    setTimeout(() => URL.revokeObjectURL(url), 60_000);
    setText(answer, "");
  } catch (error) {
    setText(answer, `Not downloaded: ${error.message}`);
  }
}
