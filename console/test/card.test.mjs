// Cards as the page reads them, and the statements that forms make by them.
import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./bundle.mjs";
import { ARM, CART, MOUNT, hostile } from "./cards.mjs";

const { cardOf, takesPoses, takesVelocities, usageOf } = await load("hub/card.ts");
const { fieldsOf, inputOf, statementOf } = await load("panels/commands/form.ts");
const { mistakesOf, read } = await load("panels/commands/script.ts");
const { Carded } = await load("hub/cards.svelte.ts");

const verb = (card, name) => cardOf(card).verbs.find((verb) => verb.name === name);

test("a card is read, and what an arm's controls need", () => {
  assert.deepEqual(cardOf(MOUNT).verbs.map(usageOf), ["look pan/° tilt/°", "turn dpan/° dtilt/°", "home"]);
  assert.equal(usageOf(verb(ARM, "jog")), "jog vx/mm/s vy/mm/s vz/mm/s vspin/°/s vtilt/°/s [ms/ms]");
  assert.equal(usageOf(verb(CART, "via")), "via x/mm y/mm …");
  for (const [card, poses, velocities] of [[ARM, true, true], [MOUNT, false, false], [CART, false, false]]) assert.deepEqual([takesPoses(cardOf(card)), takesVelocities(cardOf(card))], [poses, velocities], card.name);
  assert.deepEqual([takesPoses(undefined), takesVelocities(undefined)], [false, false]);
});

test("a content of another form gives none", () => {
  const verbs = (...verbs) => ({ ...CART, verbs });
  for (const wrong of [{}, { card: 2, name: "x" }, { card: 1 }, { ...CART, verbs: {} }, verbs(5), verbs({ name: "a b", moves: true }), verbs({ name: "a\u202eb", moves: true }), verbs({ name: "a;b", moves: true }), verbs({ name: "go", args: [{ name: "x", type: "time" }] })]) assert.equal(cardOf(wrong), undefined, JSON.stringify(wrong));
  assert.equal(cardOf({ card: 1n, name: "none" }).verbs.length, 0);
});

test("a form makes a statement of what is filled in", () => {
  for (const [card, name, values, want] of [
    [ARM, "move", ["1", " -2.5 ", "3", "0", "45"], "move 1 -2.5 3 0 45"],
    [ARM, "grip", ["close"], "grip close"],
    [ARM, "home", [], "home"],
    [ARM, "jog", ["1", "2", "3", "4", "5", ""], "jog 1 2 3 4 5"],
    [ARM, "jog", ["1", "2", "3", "4", "5", "100"], "jog 1 2 3 4 5 100"],
    [CART, "play", ["hello"], "play hello"],
  ]) assert.deepEqual(statementOf(verb(card, name), values).text, want);
  assert.equal(statementOf(verb(CART, "via"), ["1", "2", "3", "4"], 1).text, "via 1 2 3 4");
  assert.equal(fieldsOf(verb(CART, "via"), 2).length, 6);
  assert.equal(fieldsOf(verb(CART, "go"), 2).length, 2);
});

test("what is wrong in a form stands at its field, in the words of the script", () => {
  for (const [card, name, values, faults] of [
    [ARM, "move", ["", "x", "451", "0", "0"], ["x is missing", "y is `x`, which is not a number", "z is 451, `move` takes 0 to 450 mm", undefined, undefined]],
    [ARM, "grip", ["closed"], ["there is no `closed`; did you mean `close`?"]],
    [ARM, "jog", ["0", "0", "0", "0", "0", "1.5"], [undefined, undefined, undefined, undefined, undefined, "ms is `1.5`, which is not a whole number"]],
    [CART, "follow", ["ada; go"], ["leader is one word, without blanks, ; and #"]],
  ]) assert.deepEqual(statementOf(verb(card, name), values), { text: undefined, faults });
});

test("what may be left out is said where something behind it is", () => {
  const { verbs } = cardOf({ card: 1, name: "x", verbs: [{ name: "lift", moves: true, args: [{ name: "a", type: "number", default: 5 }, { name: "b", type: "word", default: "" }, { name: "c", type: "number", default: 7n }] }] });
  assert.equal(statementOf(verbs[0], []).text, "lift");
  assert.equal(statementOf(verbs[0], ["", "on"]).text, "lift 5 on");
  assert.deepEqual(statementOf(verbs[0], ["", "", "1"]).faults, [undefined, "b is missing: one behind it is given", undefined]);
});

test("a hostile card is bounded: nothing of it takes long, or is shown as it is", () => {
  const card = cardOf(hostile());
  assert.ok(card.does.length < 500 && !/[\u0007\u202e]/.test(card.does));
  assert.deepEqual([card.verbs[2].args[0].min, card.verbs[2].args[0].max], [undefined, 1e308]);
  assert.deepEqual(card.verbs.slice(0, 3).map((verb) => inputOf(verb.args[0])), ["text", "number", "number"]);
  const begun = process.cpuUsage();
  for (const line of ["vx99 1", "pick wrong", "pick", "many 1 2", "nan 1e309 1", "nan 1 -1", "constructor 5", "__proto__"]) {
    const { mistake } = read(`${line} ${"z".repeat(60_000)}`, card);
    assert.ok(mistake === undefined ? line === "nan 1 -1" : mistake.text.length < 700, line);
  }
  assert.equal(mistakesOf("qqqqqqqqqqqqqqqqqqqqqqqqqqqqqq\n".repeat(2000), card, 20).length, 20);
  const { user } = process.cpuUsage(begun);
  assert.ok(user < 2_000_000, `${user} µs`);
  assert.equal(read("constructor", card).statements.length, 1);
  assert.equal(read("toString", card).mistake.nearest !== undefined, true);
});

/** A hub whose answers the test gives. */
function hubOf() {
  const [asked, watches] = [[], []];
  return {
    asked,
    watches,
    call: (name, path) => new Promise((resolve, reject) => asked.push({ name, path, resolve, reject })),
    watch: (watch, handlers) => {
      watches.push({ watch, handlers });
      return () => watches.pop();
    },
  };
}

test("a card is asked for while somebody looks, and again when another device may be there, not too often", async (t) => {
  t.mock.timers.enable({ apis: ["setTimeout"] });
  const hub = hubOf();
  const carded = new Carded(hub, "/yard/crane");
  carded.ask();
  t.mock.timers.tick(5000);
  assert.equal(hub.asked.length, 0);
  const [one, other] = [carded.start(), carded.start()];
  assert.equal(hub.watches.length, 1);
  const { handlers } = hub.watches[0];
  handlers.joined({});
  t.mock.timers.tick(0);
  assert.deepEqual(hub.asked.map(({ name, path }) => [name, path]), [["card", "/yard/crane"]]);
  hub.asked[0].resolve(CART);
  await Promise.resolve();
  await Promise.resolve();
  assert.deepEqual([carded.card.name, carded.known], ["cart", true]);
  const before = carded.card;
  // Many come and go: one question.
  for (let count = 0; count < 100; count += 1) handlers.events([{ type: "joined" }, { type: "left" }]);
  t.mock.timers.tick(1500);
  assert.equal(hub.asked.length, 2);
  hub.asked[1].resolve({ ...CART });
  await Promise.resolve();
  await Promise.resolve();
  assert.equal(carded.card, before);
  // A refusal changes nothing; an answer without a card does.
  handlers.events([{ type: "joined" }]);
  t.mock.timers.tick(1500);
  hub.asked[2].reject(new Error("refused"));
  handlers.events([{ type: "joined" }]);
  t.mock.timers.tick(1500);
  await new Promise((resolve) => setImmediate(resolve));
  assert.equal(carded.card, before);
  hub.asked[3].resolve(null);
  await new Promise((resolve) => setImmediate(resolve));
  assert.equal(carded.card, undefined);
  one();
  handlers.events([{ type: "joined" }]);
  other();
  t.mock.timers.tick(5000);
  assert.deepEqual([hub.watches.length, hub.asked.length], [0, 4]);
});
