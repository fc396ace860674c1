// The last takes: what is known of them, the file, and a check of it.

import { Refused, order } from "./api.js";
import { byId, h, setAttribute, setHidden, setText } from "./dom.js";
import { bytes, plural, running, when } from "./format.js";
import { GLYPHS } from "./tiles.js";

/** A check reads the whole take. */
const VERIFY_MS = 600_000;

const HEALTH = {
  unknown: ["none", "not looked at"],
  complete: ["ok", "complete"],
  lossy: ["watch", "complete, frames lost"],
  damaged: ["bad", "damaged"],
  "cut off": ["bad", "cut off: mocapd recover mends it"],
  unreadable: ["bad", "unreadable"],
};

/** A take's health as [level, words]. Pure. */
export function health(take) {
  return take.is_open ? ["none", "being written"] : HEALTH[take.health] ?? ["watch", take.health];
}

/** What is known of a take, in words. Pure. */
export function facts(take, nowMs) {
  const known = [];
  if (take.seconds > 0) known.push(running(take.seconds));
  if (take.markers > 0) known.push(plural(take.markers, "marker"));
  known.push(bytes(take.bytes).join(" "), when(take.modified_unix_ms, nowMs));
  if (take.ending) known.push(`ended: ${take.ending}`);
  return known.join(" · ");
}

/** What a check found, in words. Pure. */
export function verdict({ health: found, seconds, samples, max_error_mm: error, tolerance_mm: tolerance, problems, contradictions }) {
  const wrong = [...problems, ...contradictions];
  const words = health({ health: found })[1];
  if (wrong.length > 0) {
    const more = wrong.length > 3 ? `; and ${wrong.length - 3} more` : "";
    return `${words}. ${wrong.slice(0, 3).join("; ")}${more}`;
  }
  const bound = tolerance > 0 ? `within ${error.toFixed(3)} of ${tolerance} mm` : "bit by bit";
  return `${words}. ${running(seconds)}, ${plural(samples, "sample")} ${bound}`;
}

export class Takes {
  #rows = new Map();

  constructor(onVerified) {
    this.onVerified = onVerified;
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
      const row = this.#rows.get(take.name) ?? this.#make(take.name);
      this.#fill(row, take);
      if (list.children[place] !== row.element) list.insertBefore(row.element, list.children[place] ?? null);
    });
    setText(byId("takes-count"), takes.length === 0 ? "none yet" : `the last ${takes.length}`);
  }

  lose() {
    setText(byId("takes-count"), "old: no connection");
  }

  #make(name) {
    const path = `/v1/takes/${encodeURIComponent(name)}/download`;
    const parts = {
      facts: h("p", { class: "note" }),
      glyph: h("span", { class: "glyph", "aria-hidden": "true" }),
      word: h("span"),
      download: h("a", { class: "button", href: path, download: `${name}.take`, "aria-label": `Download ${name}` }, "Download"),
      verify: h("button", { type: "button", "aria-label": `Verify ${name}` }, "Verify"),
      answer: h("p", { class: "note", role: "status" }),
    };
    parts.verify.addEventListener("click", () => this.#verify(name, parts));
    parts.element = h("li", { "data-take": name },
      h("div", { class: "take-words" }, h("strong", {}, name), parts.facts,
        h("p", { class: "level" }, parts.glyph, " ", parts.word), parts.answer),
      h("div", { class: "take-buttons" }, parts.download, parts.verify));
    this.#rows.set(name, parts);
    return parts;
  }

  #fill({ element, facts: line, glyph, word, download, verify }, take) {
    const [level, words] = health(take);
    setText(line, facts(take, Date.now()));
    setAttribute(element, "data-level", level);
    setText(glyph, GLYPHS[level]);
    setText(word, words);
    setHidden(download, take.is_open);
    setHidden(verify, take.is_open);
  }

  async #verify(name, { verify, answer }) {
    verify.disabled = true;
    setAttribute(verify, "aria-busy", "true");
    setText(answer, "Reading it all …");
    const path = `/v1/takes/${encodeURIComponent(name)}/verify`;
    try {
      setText(answer, `Verified: ${verdict(await order(path, {}, { tries: 1, limitMs: VERIFY_MS }))}.`);
    } catch (error) {
      setText(answer, error instanceof Refused ? `Refused: ${error.message}` : `No answer: ${error.message}`);
    }
    setAttribute(verify, "aria-busy", null);
    verify.disabled = false;
    this.onVerified();
  }
}
