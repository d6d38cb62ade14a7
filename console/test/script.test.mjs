// The tables of kit/device/src/carded.rs: both read scripts alike.
import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./bundle.mjs";
import * as cards from "./cards.mjs";

const { MAX_BYTES, MAX_STATEMENTS, commandsOf, isRelative, mistakesOf, moveTo, read, replaced } = await load("panels/commands/script.ts");
const { cardOf } = await load("hub/card.ts");
const [ARM, MOUNT, CART] = [cards.ARM, cards.MOUNT, cards.CART].map(cardOf);

const verbs = (text, card) => read(text, card).statements?.map(({ verb }) => verb);

test("what the card says is read", () => {
  for (const [text, card, want] of [
    ["move 100 50 200 0 -4.5; grip close", ARM, ["move", "grip"]],
    ["\n;; move 1e2 +50 2e+2 -0 -4.5\r\n;grip\tclose;", ARM, ["move", "grip"]],
    ["# nothing; move\n grip close# move", ARM, ["grip"]],
    ["grip open\nhome;reset;wait 0; wait +60000", ARM, ["grip", "home", "reset", "wait", "wait"]],
    ["jog 1 2 3 4 5", ARM, ["jog"]],
    ["jog 1 2 3 4 5 1000", ARM, ["jog"]],
    ["by .5 5. 0 0 0", ARM, ["by"]],
    ["look 20 -10; wait 500; turn 1 2; home", MOUNT, ["look", "wait", "turn", "home"]],
    ["go 1 2; wait 5 # there", CART, ["go", "wait"]],
    ["via 1 2 3 4 5 6", CART, ["via"]],
    ["jog 5 -9223372036854775808", CART, ["jog"]],
    ["go 1 1; follow ada", CART, ["go", "follow"]],
    ["wait 5; play hello", CART, ["wait", "play"]],
  ]) assert.deepEqual(verbs(text, card), want, text);
});

test("refuses with statement, position and nearest word", () => {
  for (const [text, card, statement, position, nearest, words] of [
    ["", ARM, undefined, 0, undefined, "the script has no statement"],
    [" # home\n ; ", ARM, undefined, 0, undefined, "the script has no statement"],
    ["mvoe 1 2 3 4 5", ARM, 1, 0, "move", "there is no `mvoe`; did you mean `move`?"],
    ["home;\n  GRIP open", ARM, 2, 8, "grip", "there is no `GRIP`; did you mean `grip`?"],
    ["# é\ngrip closed", ARM, 1, 10, "close", "there is no `closed`; did you mean `close`?"],
    ["grip", ARM, 1, 4, undefined, "`grip` takes `grip open|close`; grip is missing"],
    ["grip open close", ARM, 1, 10, undefined, "`grip` ends before `close`; is a `;` or a new line missing?"],
    ["move 1 2 3 4", ARM, 1, 12, undefined, "`move` takes `move x/mm y/mm z/mm spin/° tilt/°`; tilt is missing"],
    ["move 1 2 3 4;home", ARM, 1, 12, undefined, "`move` takes `move x/mm y/mm z/mm spin/° tilt/°`; tilt is missing"],
    ["move 1 2 3 4 5 6", ARM, 1, 15, undefined, "`move` ends before `6`; is a `;` or a new line missing?"],
    ["move 1, 2 3 4 5", ARM, 1, 5, undefined, "x is `1,`, which is not a number"],
    ["move 1 inf 3 4 5", ARM, 1, 7, undefined, "y is `inf`, which is not a number"],
    ["move 1 2 NaN 4 5", ARM, 1, 9, undefined, "z is `NaN`, which is not a number"],
    ["move 1 2 3 1e999 5", ARM, 1, 11, undefined, "spin is `1e999`, which is not a number"],
    ["move 0x10 2 3 4 5", ARM, 1, 5, undefined, "x is `0x10`, which is not a number"],
    ["move 1 2 900 4 5", ARM, 1, 9, undefined, "z is 900, `move` takes 0 to 450 mm"],
    ["wait 60001", ARM, 1, 5, undefined, "`wait` takes a whole number of ms from 0 to 60000, not `60001`"],
    ["wait -1", ARM, 1, 5, undefined, "`wait` takes a whole number of ms from 0 to 60000, not `-1`"],
    ["wait 1.5", ARM, 1, 5, undefined, "`wait` takes a whole number of ms from 0 to 60000, not `1.5`"],
    ["wait", ARM, 1, 4, undefined, "`wait` takes a time in ms; it is missing"],
    ["home now", ARM, 1, 5, undefined, "`home` ends before `now`; is a `;` or a new line missing?"],
    ["jog 0 0 0 0 0 1001", ARM, 1, 14, undefined, "ms is 1001, `jog` takes 1 to 1000 ms"],
    ["home; jog 0 0 0 0 0", ARM, 2, 6, undefined, "`jog` stands alone in its script"],
    ["lok 1 2", MOUNT, 1, 0, "look", "there is no `lok`; did you mean `look`?"],
    ["og 1 2", CART, 1, 0, "go", "there is no `og`; did you mean `go`?"],
    ["wait 1; go 1", CART, 2, 12, undefined, "`go` takes `go x/mm y/mm`; y is missing"],
    ["go 1 y", CART, 1, 5, undefined, "y is `y`, which is not a number"],
    ["go 1 11", CART, 1, 5, undefined, "y is 11, `go` takes -10 to 10 mm"],
    ["go 1 2 3", CART, 1, 7, undefined, "`go` ends before `3`; is a `;` or a new line missing?"],
    ["via 1 2 3", CART, 1, 9, undefined, "`via` takes `via x/mm y/mm …`; y is missing"],
    ["grip closed", CART, 1, 5, "close", "there is no `closed`; did you mean `close`?"],
    ["jog 5 1.5", CART, 1, 6, undefined, "ms is `1.5`, which is not a whole number"],
    ["jog 5 9223372036854775808", CART, 1, 6, undefined, "ms is `9223372036854775808`, which is not a whole number"],
    ["jog 5; wait 1", CART, 1, 0, undefined, "`jog` stands alone in its script"],
    ["wait 1; follow ada; wait 1", CART, 2, 8, undefined, "`follow` must be the last statement of its script"],
  ]) {
    const { mistake } = read(text, card);
    assert.ok(mistake, text);
    assert.deepEqual([mistake.statement, mistake.position, mistake.nearest], [statement, position, nearest], `${text}: ${mistake.text}`);
    assert.equal(mistake.text, statement === undefined ? words : `statement ${statement}: ${words}`);
  }
});

test("ranges with one end, and words beside numbers", () => {
  const arg = (terms) => cardOf({ card: 1, name: "x", verbs: [{ name: "go", moves: true, args: [{ name: "n", type: "number", ...terms }] }] });
  for (const [terms, text, words] of [
    [{ min: 2 }, "go 1", "n is 1, `go` takes 2 and more"],
    [{ max: 2.5, unit: "m" }, "go 3", "n is 3, `go` takes 2.5 and less m"],
    [{ max: 2, choices: ["up"] }, "go u", "n is `u`, which is not a number"],
    [{ max: 2, choices: ["up"] }, "go", "`go` takes `go up|n`; n is missing"],
  ]) assert.equal(read(text, arg(terms)).mistake.text, `statement 1: ${words}`);
  assert.ok(read("go up", arg({ max: 2, choices: ["up"] })).statements);
});

test("is bounded", () => {
  assert.ok(read("home;".repeat(MAX_STATEMENTS), ARM).statements);
  assert.equal(read("home;".repeat(MAX_STATEMENTS + 1), ARM).mistake.position, 5 * MAX_STATEMENTS);
  assert.ok(read("home".padEnd(MAX_BYTES), ARM).statements);
  assert.ok(read("home".padEnd(MAX_BYTES + 1), ARM).mistake);
  assert.ok(read("x".repeat(MAX_BYTES), ARM).mistake.text.length < 200);
  assert.ok(read(`jog 1 ${"9".repeat(60_000)}`, CART).mistake.text.length < 200);
});

test("relative commands are known by the card", () => {
  for (const [text, card, relative] of [
    ["by 0 0 -50 0 0", ARM, true],
    ["grip close; by 0 0 50 0 0; home", ARM, true],
    ["home; by 0 0 50 0 0", ARM, false],
    ["turn 5 0; wait 10", MOUNT, true],
    ["look 5 0; turn 5 0", MOUNT, false],
    ["dance", ARM, false],
    ["grip open; by 5; go 1 1", CART, true],
    ["go 1 1; by 5", CART, false],
    ["jog 5", CART, false],
  ]) assert.equal(isRelative(text, card), relative, text);
});

test("one command per line", () => {
  for (const [text, expected] of [
    ["", []],
    ["# nothing\n\n  ;; \n", []],
    ["home", [[1, "home"]]],
    ["# pick\nmove 1 2 3 4 5; grip close  # got it\r\n\n\thome # home; home\n", [[2, "move 1 2 3 4 5; grip close"], [4, "home"]]],
  ]) assert.deepEqual(commandsOf(text).map(({ line, text }) => [line, text]), expected, text);
});

test("mistakes are told with line and column, and where they are in the text", () => {
  const text = "home\n\n  home; mvoe 1 2 3 4 5\ngrip close\nwait -1";
  const mistakes = mistakesOf(text, ARM);
  assert.deepEqual(mistakes.map(({ line, column }) => [line, column]), [[3, 9], [5, 6]]);
  assert.ok(text.slice(mistakes[0].index).startsWith("mvoe"));
  assert.ok(text.slice(mistakes[1].index).startsWith("-1"));
  assert.equal(mistakesOf(text, ARM, 1).length, 1);
});

test("poses become commands, and statements can be replaced", () => {
  assert.equal(moveTo([1.26, -0.04, 200, -12.345, 0]), "move 1.3 0 200 -12.3 0");
  assert.equal(replaced("home;  move 1 2 300 0 0 ; grip open # x", 2, "move 1 2 450 0 0", ARM), "home;  move 1 2 450 0 0 ; grip open # x");
});
