import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./bundle.mjs";

const { Bounded, Meter, MEMBERS, jsonOf, lineOf, shapeOf, sizeOf, visible } = await load("hub/said.ts");
const { emptyForm, pathOf, specOf } = await load("panels/context/spec.ts");
const { columns, filtered, sorted } = await load("panels/peers/table.ts");

test("content on one line is bounded, whatever it is", () => {
  assert.equal(lineOf({ id: 3, state: "executing", pose: { x: 1, y: [1, 2] } }), "id=3 state=executing pose={x=1 y=[1 2]}");
  assert.equal(lineOf("two\nlines"), "two⏎lines");
  assert.equal(lineOf(undefined), "");
  let deep = {};
  for (let depth = 0; depth < 5000; depth += 1) deep = { deep };
  assert.match(lineOf(deep), /\{…\}/);
  const wide = Object.fromEntries(Array.from({ length: 100_000 }, (_, index) => [`key${index}`, "x".repeat(1000)]));
  assert.ok(lineOf(wide).length < 400);
  assert.ok(lineOf("x".repeat(10 ** 7)).length < 400);
  assert.ok(lineOf(Array.from({ length: 10 ** 6 }, () => null)).length < 1000);
});

test("what would change how others are read is shown as what it is", () => {
  assert.equal(visible("a\u202eb\u001b[2Jc\u0000"), "a\\u{202e}b\\u{1b}[2Jc\\u{0}");
  assert.equal(visible("<b>Größe</b>"), "<b>Größe</b>");
});

test("shapes show so many members at most", () => {
  const shape = shapeOf(Array.from({ length: 5000 }, (_, index) => index));
  assert.deepEqual([shape.kind, shape.label, shape.members.length, shape.count], ["branch", "[5000]", MEMBERS, 5000]);
  assert.deepEqual(shapeOf({ constructor: 1 }).members, [["constructor", 1]]);
  assert.deepEqual(shapeOf(null), { kind: "leaf", text: "null", type: "null" });
  assert.equal(shapeOf(new Date(Number.NaN)).text, "");
});

test("sizes are about those of the content", () => {
  assert.equal(sizeOf("hello"), 5);
  assert.equal(sizeOf({ image: new Uint8Array(1000) }), 1005);
  let deep = {};
  for (let depth = 0; depth < 300_000; depth += 1) deep = [deep];
  assert.equal(sizeOf(deep), 0);
});

test("what is copied is JSON", () => {
  assert.equal(jsonOf({ big: 2n ** 60n, bytes: new Uint8Array(3) }), '{\n  "big": "1152921504606846976",\n  "bytes": "<3 B>"\n}');
  assert.equal(jsonOf("text"), "text");
});

test("a list keeps the newest, and a meter knows how many come in a second", () => {
  const list = new Bounded(3);
  list.add([1, 2]);
  list.add([3, 4]);
  assert.deepEqual(list.items, [2, 3, 4]);
  const meter = new Meter(2);
  for (let ms = 0; ms < 4000; ms += 10) meter.add(ms, 5);
  assert.equal(meter.rate(4000), 500);
  assert.equal(meter.rate(60_000), 0);
});

test("the form says to the hub what docs/PROTOCOL.md lists", () => {
  const form = { ...emptyForm(), name: "arm" };
  assert.deepEqual(specOf(form), { kind: "channel" });
  assert.deepEqual(specOf({ ...form, manager: " open ", guard: "/robot/token", names: "command  halt", delivery: "latest", overflow: "wait", latest: true, age: 1.5, parcels: 7, transient: true }), {
    kind: "channel",
    manager: "open",
    transient: true,
    delivery: "latest",
    overflow: "wait",
    keep: { latest: true, parcels: 7, age: 1500 },
    guard: { token: "/robot/token", names: ["command", "halt"] },
  });
  assert.deepEqual(specOf({ ...form, kind: "token", lease: 180, deadman: 500, expiry: "eager", safeOnGive: false, guard: "/x" }), { kind: "token", lease: 180_000, deadman: 500, expiry: "eager", "safe-on-give": false });
  assert.deepEqual(specOf({ ...form, kind: "token", more: '{"safe": {"name": "halt"}}' }), { kind: "token", safe: { name: "halt" } });
  for (const wrong of [{ name: "a b" }, { name: "a/b" }, { name: "" }, { more: "{" }, { more: "[1]" }, { more: '{"kind": "token"}' }]) assert.equal(typeof specOf({ ...form, ...wrong }), "string");
  assert.deepEqual([pathOf("/", "a"), pathOf("/a", "b")], ["/a", "/a/b"]);
});

test("peers in the order of a column, as in mom top", () => {
  const stats = (more) => ({ peer: "", user: "", form: "binary", door: "tcp", tls: false, from: "127.0.0.1", since: 5, silent: 1, roundTrip: undefined, queued: 0, sent: 0, received: 0, dropped: 0, ...more });
  const alice = { name: "alice", user: "alice", level: 1, stats: stats({ queued: 2048, dropped: 3, roundTrip: 0.42, silent: 90_000 }), tokens: ["/robot/token"], heard: { age: 2, error: 1, at: 0 } };
  const bob = { name: "bob", user: "bob", level: 5, stats: stats({ from: undefined }), tokens: [], heard: undefined };
  const guest = { name: "guest", user: "guest", level: 0, stats: undefined, tokens: [], heard: undefined };
  const all = [guest, bob, alice];
  const column = (id) => columns.find((column) => column.id === id);
  const names = (id, reversed = false) => sorted(all, column(id), reversed).map(({ name }) => name);
  for (const id of ["queue", "drops", "trip", "silent", "tokens", "clock"]) assert.equal(names(id)[0], "alice", id);
  assert.equal(names("drops", true)[2], "alice");
  assert.deepEqual(names("level"), ["bob", "alice", "guest"]);
  assert.deepEqual(sorted(all, undefined, false), all);
  const cells = columns.map((column) => column.cell(alice, 65_005));
  assert.deepEqual(cells, ["alice", "alice", "tcp binary", "127.0.0.1", "1 min 30 s", "0.42 ms", "2.0 KiB", "3", "/robot/token", "1", "1 min 5 s", "2.0 ms ± 1.0 ms", "± 1.00 ms"]);
  assert.equal(column("trip").cell(bob), "-");
  assert.deepEqual(columns.map((column) => column.cell(guest)), ["guest", "guest", "", "", "", "", "", "", "", "0", "", "", ""]);
  assert.deepEqual(filtered(all, "ROBOT").map(({ name }) => name), ["alice"]);
  assert.equal(filtered(all, "").length, 3);
});
