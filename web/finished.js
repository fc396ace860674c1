// Finished takes: their rating and notes, their names, and the trash; in two dialogs.

import { ServiceError, get, sendCommand } from "./api.js";
import { byId, h, limitBytes, setAttribute, setHidden, setText } from "./dom.js";
import { bytes, dateTime } from "./format.js";

const RATINGS = { good: "Good", bad: "Bad", none: "Not rated" };
/** Not those of a take's health. */
const GLYPHS = { good: "★", bad: "⊘" };

/** The rating of a take as [glyph, text], its notes on one line behind it; empty without any. Pure. */
export function ratingText({ notes }) {
  if (!notes) return ["", ""];
  if (notes.problem) return ["▲", notes.problem];
  const rating = notes.rating in GLYPHS ? [RATINGS[notes.rating]] : [];
  const text = notes.text.trim().replace(/\s*\n\s*/g, " / ");
  return [GLYPHS[notes.rating] ?? "", [...rating, ...(text ? [text] : [])].join(": ")];
}

/** What a dialog would change of a take: the requests, as [path, body]. Pure. */
export function changes(take, { rating, text, name, opened = take.notes?.text ?? "" }) {
  const path = `/v1/takes/${encodeURIComponent(take.name)}`;
  const before = take.notes ?? { rating: "none" };
  const edit = {};
  if (rating !== before.rating) edit.rating = rating;
  // A browser changes line ends: only what somebody has typed counts.
  if (text !== opened) edit.text = text;
  const requests = [];
  // Another take that has got the name meanwhile stays as it is.
  const id = take.take_id ? { take_id: take.take_id } : {};
  if (!before.problem && Object.keys(edit).length > 0) requests.push([`${path}/notes`, { ...id, ...edit }]);
  if (name !== take.name) requests.push([`${path}/rename`, { ...id, to: name }]);
  return requests;
}

/** Why a request failed, as the service says it. Pure. */
function failure(error) {
  return error instanceof ServiceError ? `Refused: ${error.message}` : `No reply: ${error.message}. Check the list before you repeat it`;
}

export class Finished {
  #take = null;
  #openedText = "";

  constructor(onChanged) {
    this.onChanged = onChanged;
    document.body.append(this.#createTakeDialog(), this.#createTrashDialog());
    ["take-notes", "take-name"].forEach((id) => limitBytes(byId(id)));
    byId("trash-button").addEventListener("click", () => this.#openTrash());
  }

  /** Opens the dialog of a take. */
  open(take) {
    this.#take = take;
    const { rating, text, problem } = take.notes ?? { rating: "none", text: "" };
    setText(byId("take-title"), take.name);
    byId(`rating-${rating in RATINGS ? rating : "none"}`).checked = true;
    byId("take-notes").value = text;
    this.#openedText = byId("take-notes").value;
    byId("take-name").value = take.name;
    byId("take-review").disabled = Boolean(problem);
    this.#answer("none", problem ?? "");
    this.#confirm(false);
    byId("take-dialog").showModal();
  }

  #createTakeDialog() {
    const radio = ([value, word]) => h("label", { class: "rating" },
      h("input", { type: "radio", name: "rating", id: `rating-${value}`, value }), h("span", { class: "glyph", "aria-hidden": "true" }, GLYPHS[value] ?? "–"), word);
    const close = () => byId("take-dialog").close();
    const save = h("button", { type: "submit", id: "take-save" }, "Save");
    const form = h("form", { id: "take-form" },
      h("h2", { id: "take-title" }),
      h("fieldset", { id: "take-review" },
        h("legend", { class: "visually-hidden" }, "Rating and notes"),
        h("div", { class: "ratings", role: "radiogroup", "aria-label": "Rating" }, ...Object.entries(RATINGS).map(radio)),
        h("label", { class: "field" }, "Notes", h("textarea", { id: "take-notes", rows: "4", "data-bytes-max": "4096" }))),
      h("label", { class: "field" }, "Name", h("input", { id: "take-name", type: "text", "data-bytes-max": "200", autocomplete: "off", spellcheck: "false", required: true })),
      h("p", { id: "take-answer", class: "answer", role: "status" }),
      h("div", { id: "take-buttons", class: "dialog-buttons" }, save,
        h("button", { type: "button", id: "take-trash", click: () => this.#confirm(true) }, "Move to trash"),
        h("button", { type: "button", id: "take-close", click: close }, "Close")),
      h("div", { id: "take-confirm", class: "dialog-buttons", hidden: true },
        h("p", { id: "take-confirm-text" }),
        h("button", { type: "button", id: "take-trash-now", click: () => this.#trash() }, "Move it to the trash"),
        h("button", { type: "button", id: "take-keep", click: () => this.#confirm(false) }, "Keep it")));
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.#save();
    });
    return h("dialog", { id: "take-dialog", "aria-labelledby": "take-title" }, form);
  }

  #createTrashDialog() {
    const close = h("button", { type: "button", click: () => byId("trash-dialog").close() }, "Close");
    return h("dialog", { id: "trash-dialog", "aria-labelledby": "trash-title" },
      h("h2", { id: "trash-title" }, "Trash"),
      h("p", {}, "Takes in the trash still occupy the disk. They are removed when their time is over (take.trash_keep)."),
      h("ul", { id: "trash-list" }),
      h("p", { id: "trash-answer", class: "answer", role: "status" }),
      h("div", { class: "dialog-buttons" }, close));
  }

  #answer(kind, text) {
    setAttribute(byId("take-answer"), "data-kind", kind);
    setText(byId("take-answer"), text);
  }

  /** Asks whether the take should go, or takes the question back. */
  #confirm(asks) {
    setHidden(byId("take-buttons"), asks);
    setHidden(byId("take-confirm"), !asks);
    if (!asks) return;
    setText(byId("take-confirm-text"), `Move ${this.#take.name} and its notes to the trash?`);
    byId("take-trash-now").focus();
  }

  async #save() {
    const rating = document.querySelector("#take-form input[name=rating]:checked").value;
    const wanted = { rating, text: byId("take-notes").value, name: byId("take-name").value.trim(), opened: this.#openedText };
    const requests = changes(this.#take, wanted);
    const remarks = [];
    byId("take-save").disabled = true;
    this.#answer("waiting", "Saving …");
    try {
      for (const [path, body] of requests) {
        const answer = await sendCommand(path, body);
        remarks.push(...(answer.remarks ?? []));
        // Saved already if the next request is refused.
        this.#take = path.endsWith("/notes") ? { ...this.#take, notes: answer } : { ...this.#take, name: answer.name };
        setText(byId("take-title"), this.#take.name);
      }
      if (remarks.length > 0) this.#answer("done", `Done. Note: ${remarks.join(". ")}.`);
      else byId("take-dialog").close();
    } catch (error) {
      this.#answer(error instanceof ServiceError ? "refused" : "unknown", failure(error));
    } finally {
      byId("take-save").disabled = false;
      this.onChanged();
    }
  }

  async #trash() {
    byId("take-trash-now").disabled = true;
    try {
      const { name, take_id: id } = this.#take;
      await sendCommand(`/v1/takes/${encodeURIComponent(name)}/trash`, id ? { take_id: id } : {});
      byId("take-dialog").close();
    } catch (error) {
      this.#answer(error instanceof ServiceError ? "refused" : "unknown", failure(error));
    } finally {
      byId("take-trash-now").disabled = false;
      this.#confirm(false);
      this.onChanged();
    }
  }

  async #openTrash() {
    setText(byId("trash-answer"), "");
    byId("trash-list").replaceChildren();
    byId("trash-dialog").showModal();
    await this.#showTrash();
  }

  async #showTrash() {
    try {
      const takes = await get("/v1/trash");
      byId("trash-list").replaceChildren(...takes.map((take) => this.#trashRow(take)));
      if (takes.length === 0) byId("trash-list").append(h("li", {}, "The trash is empty."));
    } catch (error) {
      setText(byId("trash-answer"), failure(error));
    }
  }

  #trashRow({ id, name, bytes: size, removed_unix_ms: removedMs }) {
    const restore = h("button", { type: "button", "aria-label": `Restore ${name}` }, "Restore");
    restore.addEventListener("click", async () => {
      restore.disabled = true;
      try {
        const { name: restored } = await sendCommand(`/v1/trash/${encodeURIComponent(id)}/restore`);
        setText(byId("trash-answer"), `${restored} is back in the list.`);
      } catch (error) {
        setText(byId("trash-answer"), failure(error));
        restore.disabled = false;
      }
      await this.#showTrash();
      this.onChanged();
    });
    const note = `${bytes(size).join(" ")} · in the trash until ${dateTime(removedMs, Date.now())}`;
    return h("li", {}, h("div", { class: "take-text" }, h("strong", {}, name), h("p", { class: "note" }, note)), restore);
  }
}
