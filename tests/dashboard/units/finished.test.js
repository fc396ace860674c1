// The texts and requests of finished takes.

import { changes, ratingText } from "/finished.js";
import { startNotice } from "/state.js";
import { equal, test } from "./harness.js";

test("a rating, notes on one line, and notes that cannot be used", () => {
  equal(ratingText({ notes: null }), ["", ""]);
  equal(ratingText({ notes: { rating: "none", text: "", problem: null } }), ["", ""]);
  equal(ratingText({ notes: { rating: "good", text: " left\n  shoe \n", problem: null } }), ["★", "Good: left / shoe"]);
  equal(ratingText({ notes: { rating: "none", text: "x", problem: null } }), ["", "x"]);
  equal(ratingText({ notes: { rating: "later", text: "x", problem: null } }), ["", "x"]);
  equal(ratingText({ notes: { rating: "none", text: "", problem: "damaged" } }), ["▲", "damaged"]);
});

test("only what was changed is sent, the notes first", () => {
  const take = { name: "a b", notes: { rating: "good", text: "x\r\ny", problem: null } };
  const same = { rating: "good", text: "x\ny", opened: "x\ny", name: "a b" };
  equal(changes(take, same), []);
  equal(changes(take, { ...same, rating: "bad" }), [["/v1/takes/a%20b/notes", { rating: "bad" }]]);
  equal(changes(take, { ...same, text: "z", name: "c" }), [["/v1/takes/a%20b/notes", { text: "z" }], ["/v1/takes/a%20b/rename", { to: "c" }]]);
  equal(changes({ name: "a", take_id: "7", notes: null }, { rating: "none", text: "", opened: "", name: "b" }), [["/v1/takes/a/rename", { take_id: "7", to: "b" }]]);
  equal(changes({ name: "a", notes: null }, { rating: "none", text: "", opened: "", name: "a" }), []);
  equal(changes({ name: "a", notes: { rating: "none", text: "", problem: "damaged" } }, { rating: "bad", text: "", opened: "", name: "b" }), [["/v1/takes/a/rename", { to: "b" }]]);
});

test("why a start did not take place is a sentence", () => {
  equal(startNotice({ missed_start: null }), null);
  equal(startNotice({ missed_start: "the rig was not armed" }), "The rig was not armed");
});
