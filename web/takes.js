// The list of the last takes: a summary of each, its playback, its download, and its verification.

import { ServiceError, sendCommand } from "./api.js";
import { byId, h, setAttribute, setHidden, setText } from "./dom.js";
import { downloadMenu } from "./downloads.js";
import { ratingText } from "./finished.js";
import { bytes, dateTime, elapsed, plural } from "./format.js";
import { GLYPHS } from "./tiles.js";

/** Verification reads the whole take. */
const VERIFY_TIMEOUT_MS = 600_000;

const HEALTH = {
  unknown: ["none", "not checked yet"],
  complete: ["ok", "complete"],
  lossy: ["watch", "complete, frames lost"],
  damaged: ["bad", "damaged"],
  "cut off": ["bad", "cut off: repair it with mocapd recover"],
  unreadable: ["bad", "unreadable"],
};

/** A take's health as [level, text]. Pure. */
export function health(take) {
  return take.is_open ? ["none", "being written"] : HEALTH[take.health] ?? ["watch", take.health];
}

const UPLOADS = {
  waiting: "waits to be uploaded",
  uploading: "is being uploaded",
  uploaded: "in the archive",
  failed: "cannot be uploaded",
};

/** The upload of a take, as a text; empty without an archive. Pure. */
export function uploadText({ upload }) {
  if (!upload) return "";
  const text = UPLOADS[upload.state] ?? upload.state;
  return upload.message ? `${text}: ${upload.message}` : `${text} (${upload.url})`;
}

/** The known facts about a take, as one line. Pure. */
export function takeSummary(take, nowMs) {
  const known = [];
  if (take.seconds > 0) known.push(elapsed(take.seconds));
  if (take.markers > 0) known.push(plural(take.markers, "marker"));
  known.push(bytes(take.bytes).join(" "), dateTime(take.modified_unix_ms, nowMs));
  if (take.ending) known.push(`ended: ${take.ending}`);
  // A line never begins with the dot.
  return known.join("\u00a0· ");
}

/** The result of a verification, as a message. Pure. */
export function verifyResult({ health: found, seconds, samples, max_error_mm: error, tolerance_mm: tolerance, problems, contradictions }) {
  const wrong = [...problems, ...contradictions];
  const text = health({ health: found })[1];
  if (wrong.length > 0) {
    const more = wrong.length > 3 ? `; and ${wrong.length - 3} more` : "";
    return `${text}. ${wrong.slice(0, 3).join("; ")}${more}`;
  }
  const bound = tolerance > 0 ? `largest error ${error.toFixed(3)} mm (tolerance ${tolerance} mm)` : "bit-exact";
  return `${text}. ${elapsed(seconds)}, ${plural(samples, "sample")}, ${bound}`;
}

export class Takes {
  #rows = new Map();

  constructor(onVerified, onEdit) {
    this.onVerified = onVerified;
    this.onEdit = onEdit;
  }

  show(takes) {
    const list = byId("takes");
    const names = new Set(takes.map(({ name }) => name));
    for (const [name, row] of this.#rows) {
      if (names.has(name)) continue;
      row.element.remove();
      this.#rows.delete(name);
    }
    takes.forEach((take, place) => {
      const row = this.#rows.get(take.name) ?? this.#createRow(take.name);
      this.#update(row, take);
      if (list.children[place] !== row.element) list.insertBefore(row.element, list.children[place] ?? null);
    });
    setText(byId("takes-count"), takes.length === 0 ? "none yet" : `last ${takes.length}`);
  }

  showDisconnected() {
    setText(byId("takes-count"), "outdated: no connection");
  }

  #createRow(name) {
    const parts = {
      summary: h("p", { class: "note" }),
      glyph: h("span", { class: "glyph", "aria-hidden": "true" }),
      word: h("span"),
      upload: h("p", { class: "note" }),
      ratingGlyph: h("span", { class: "glyph", "aria-hidden": "true" }),
      ratingWords: h("span"),
      edit: h("button", { type: "button", "aria-label": `Edit ${name}`, "aria-haspopup": "dialog" }, "Edit"),
      download: downloadMenu(name),
      play: h("a", { class: "button", href: `/player.html?take=${encodeURIComponent(name)}`, "aria-label": `Play ${name}` }, "Play"),
      verify: h("button", { type: "button", "aria-label": `Verify ${name}` }, "Verify"),
      answer: h("p", { class: "note", role: "status" }),
    };
    parts.verify.addEventListener("click", () => this.#verify(name, parts));
    parts.edit.addEventListener("click", () => this.onEdit(parts.take));
    parts.rating = h("p", { class: "rating-text" }, parts.ratingGlyph, parts.ratingWords);
    parts.element = h("li", { "data-take": name },
      h("div", { class: "take-text" }, h("strong", {}, name), parts.summary,
        h("p", { class: "level" }, parts.glyph, " ", parts.word), parts.rating, parts.upload, parts.answer),
      h("div", { class: "take-buttons" }, parts.play, parts.download, parts.verify, parts.edit));
    this.#rows.set(name, parts);
    return parts;
  }

  #update(parts, take) {
    const { element, summary, glyph, word, upload, play, download, verify, rating, ratingGlyph, ratingWords, edit } = parts;
    parts.take = take;
    const [ratingSign, ratingLine] = ratingText(take);
    setText(ratingGlyph, ratingSign);
    setText(ratingWords, ratingLine);
    setAttribute(rating, "data-rating", take.notes?.rating ?? "none");
    setHidden(rating, ratingLine === "");
    setHidden(edit, take.is_open);
    const [level, text] = health(take);
    setText(summary, takeSummary(take, Date.now()));
    setAttribute(element, "data-level", level);
    setText(glyph, GLYPHS[level]);
    setText(word, text);
    setText(upload, uploadText(take));
    setHidden(upload, !take.upload);
    setHidden(play, take.is_open || take.health === "unreadable");
    setHidden(download, take.is_open);
    setHidden(verify, take.is_open);
  }

  async #verify(name, { verify, answer }) {
    verify.disabled = true;
    setAttribute(verify, "aria-busy", "true");
    setText(answer, "Reading the whole take …");
    const path = `/v1/takes/${encodeURIComponent(name)}/verify`;
    try {
      setText(answer, `Verified: ${verifyResult(await sendCommand(path, {}, { tries: 1, timeoutMs: VERIFY_TIMEOUT_MS }))}.`);
    } catch (error) {
      setText(answer, error instanceof ServiceError ? `Refused: ${error.message}` : `No reply: ${error.message}`);
    }
    setAttribute(verify, "aria-busy", null);
    verify.disabled = false;
    this.onVerified();
  }
}
