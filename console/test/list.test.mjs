import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./bundle.mjs";

const list = await load("panels/commands/list.ts");
const { changed, snapshot, thingsOf, word, EMPTY } = await load("panels/objects/objects.ts");
const { append, draftOf, textOf } = await load("panels/chat/lines.ts");

const texts = (items) => items.map(({ text }) => text);
const of = (...names) => list.add([], names);
const with_ = (items, key, state) => list.progress(items, key, { state });

test("commands are added, changed, moved, doubled and removed", () => {
  const items = of("a", "b", "c");
  assert.deepEqual(items.map(({ key, state }) => [key, state]), [[1, "waiting"], [2, "waiting"], [3, "waiting"]]);
  assert.deepEqual(texts(list.add(items, ["x", "y"], 1)), ["a", "x", "y", "b", "c"]);
  assert.deepEqual(texts(list.duplicate(items, 2)), ["a", "b", "b", "c"]);
  assert.deepEqual(texts(list.move(items, 1, 1)), ["b", "a", "c"]);
  assert.deepEqual(texts(list.move(items, 1, -1)), ["a", "b", "c"]);
  assert.deepEqual(texts(list.moveTo(items, 3, 0)), ["c", "a", "b"]);
  assert.deepEqual(texts(list.moveTo(items, 9, 0)), ["a", "b", "c"]);
  assert.deepEqual(texts(list.remove(items, 2)), ["a", "c"]);
  assert.equal(list.asText(items), "a\nb\nc\n");
});

test("what is under way is neither changed nor removed", () => {
  for (const state of ["sending", "taken", "executing"]) {
    const items = with_(of("a", "b"), 1, state);
    assert.deepEqual(list.edit(items, 1, "x"), items);
    assert.deepEqual(list.remove(items, 1), items);
    assert.deepEqual(list.again(items, 1), items);
    assert.deepEqual(texts(list.clearAll(items)), ["a"]);
    assert.equal(list.next(items).key, 2);
    assert.deepEqual(texts(list.rewrite(items, ["x"])), ["a", "x"]);
  }
});

test("another text waits as if it had never been sent; the same stays as it is", () => {
  const items = list.progress(of("a"), 1, { state: "error", statement: 1, of: 2, error: { code: "syntax" } });
  assert.deepEqual(list.edit(items, 1, "a"), items);
  assert.deepEqual(list.edit(items, 1, "b"), [{ key: 1, text: "b", state: "waiting", statement: 0, of: 0 }]);
  assert.equal(list.again(items, 1)[0].state, "waiting");
});

test("a text keeps what begins and ends as before", () => {
  const items = with_(with_(of("a", "b", "c"), 1, "finished"), 3, "finished");
  const after = list.rewrite(items, ["a", "x", "y", "c"]);
  assert.deepEqual(after.map(({ text, state }) => [text, state]), [["a", "finished"], ["x", "waiting"], ["y", "waiting"], ["c", "finished"]]);
  assert.equal(new Set(after.map(({ key }) => key)).size, 4);
  assert.deepEqual(list.rewrite(items, ["a", "b", "c"]), items);
  assert.deepEqual(list.rewrite(items, []), []);
  assert.deepEqual(texts(list.rewrite(of("a", "a"), ["a", "a", "a"])), ["a", "a", "a"]);
});

test("survives a reload, after which what was under way is not known", () => {
  let items = of("a", "b", "c", "d");
  items = with_(with_(items, 1, "finished"), 2, "executing");
  items = list.progress(items, 3, { state: "error", error: { kind: "refused", code: "busy", text: "no", content: { big: 1n } } });
  const after = list.restore(list.save(items));
  assert.deepEqual(after.map(({ state }) => state), ["finished", "unknown", "error", "waiting"]);
  assert.deepEqual([after[2].error.code, after[2].error.text], ["busy", "no"]);
  for (const nonsense of [null, "", "{", "{}", "[1, null, {}]"]) assert.deepEqual(list.restore(nonsense), []);
  assert.equal(list.restore('[{"text":"a","state":"dancing"}]')[0].state, "waiting");
});

test("objects: all at first, then what differs; a gap is noticed", () => {
  const red = { name: "red", x: 1, y: 2, z: 20, yaw: 0, held: false, colour: [200, 40, 40], seen: new Date(1000) };
  let model = snapshot({ seq: 5, objects: [red, { x: 1 }, { name: "lost" }] });
  assert.deepEqual(thingsOf(model).map(({ name, colour, since }) => [name, colour, since]), [["red", "rgb(200 40 40)", 1000]]);
  model = changed(model, { seq: 6, objects: [{ name: "red", x: 9, held: true, seen: null, written: new Date(2000), "written-by": "bob" }], gone: [] });
  assert.deepEqual(thingsOf(model).map(({ x, y, held, since, writtenBy }) => [x, y, held, since, writtenBy]), [[9, 2, true, 2000, "bob"]]);
  assert.equal(model.gap, false);
  assert.equal(changed(model, { seq: 6, gone: ["red"] }), model);
  const missed = changed(model, { seq: 8, objects: [], gone: ["red"] });
  assert.deepEqual([missed.gap, thingsOf(missed)], [true, []]);
  assert.equal(changed(EMPTY, { seq: 1 }).gap, true);
  assert.deepEqual(thingsOf(snapshot("nonsense")), []);
  assert.deepEqual(["red", "it's", "a;b"].map(word), ["red", "'it'\\''s'", "'a;b'"]);
});

test("chat: to all, to one, and to nobody who is here", () => {
  const here = ["bob", "bob-2", "ann lee"];
  for (const [draft, chosen, want] of [
    [" hello ", "", { to: undefined, text: "hello" }],
    ["hello", "bob", { to: "bob", text: "hello" }],
    ["/bob hi", "", { to: "bob", text: "hi" }],
    ["/bob-2 hi\nthere", "bob", { to: "bob-2", text: "hi\nthere" }],
    ["/ann lee hi", "", { to: "ann lee", text: "hi" }],
    ["/bob", "", { to: "bob", text: "" }],
    ["/carol hi", "", { unknown: "carol" }],
    ["/ hi", "", { to: undefined, text: "/ hi" }],
  ]) assert.deepEqual(draftOf(draft, here, chosen), want, draft);
  assert.equal(textOf("<b>x</b>"), "<b>x</b>");
  // What turns the direction of what others read is shown, and a line of its own stays one.
  assert.equal(textOf("pay \u202e01\nnow"), "pay \\u{202e}01\nnow");
  assert.equal(textOf({ a: 1n }), '{"a":"1"}');
  let lines = [];
  for (let at = 0; at < 600; at += 1) lines = append(lines, { kind: "said", who: "a", text: "", mine: false, at, history: false, cut: false });
  assert.deepEqual([lines.length, lines[0].key, lines.at(-1).key], [500, 101, 600]);
});
