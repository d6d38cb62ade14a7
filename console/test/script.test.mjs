// The tables of lab/arm/src/script.rs: both read scripts alike.
import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./bundle.mjs";

const { MAX_BYTES, MAX_STATEMENTS, commandsOf, isRelative, mistakesOf, moveTo, read, replaced } = await load("panels/commands/script.ts");

const plain = (statements) => statements?.map(({ verb, numbers, words }) => [verb, ...numbers, ...words]);

test("reads statements", () => {
  const move = ["move", 100, 50, 200, 0, -4.5];
  for (const [text, want] of [
    ["move 100 50 200 0 -4.5; grip close", [move, ["grip", "close"]]],
    ["\n;; move 1e2 +50 2e+2 -0 -4.5\r\n;grip\tclose;", [["move", 100, 50, 200, -0, -4.5], ["grip", "close"]]],
    ["# nothing; move\n grip close# move", [["grip", "close"]]],
    ["grip open\nhome;reset;wait 0; wait 60000", [["grip", "open"], ["home"], ["reset"], ["wait", 0], ["wait", 60000]]],
    ["jog 1 2 3 4 5", [["jog", 1, 2, 3, 4, 5]]],
    ["jog 1 2 3 4 5 1000", [["jog", 1, 2, 3, 4, 5, 1000]]],
    ["by .5 5. 0 0 0", [["by", 0.5, 5, 0, 0, 0]]],
  ]) {
    assert.deepEqual(plain(read(text).statements), want, text);
  }
});

test("refuses with statement, position and nearest word", () => {
  for (const [text, statement, position, nearest, words] of [
    ["", undefined, 0, undefined, "no statement"],
    [" # home\n ; ", undefined, 0, undefined, "no statement"],
    ["mvoe 1 2 3 4 5", 1, 0, "move", "no `mvoe`; did you mean `move`"],
    ["home;\n  GRIP open", 2, 8, "grip", "no `GRIP`"],
    ["# é\ngrip closed", 1, 10, "close", "did you mean `close`"],
    ["grip", 1, 4, undefined, "missing"],
    ["grip open close", 1, 10, undefined, "`grip` ends before `close`"],
    ["move 1 2 3 4", 1, 12, undefined, "tilt is missing"],
    ["move 1 2 3 4;home", 1, 12, undefined, "tilt is missing"],
    ["move 1 2 3 4 5 6", 1, 15, undefined, "ends before `6`"],
    ["move 1, 2 3 4 5", 1, 5, undefined, "x is `1,`, which is not a number"],
    ["move 1 inf 3 4 5", 1, 7, undefined, "y is `inf`"],
    ["move 1 2 NaN 4 5", 1, 9, undefined, "z is `NaN`"],
    ["move 1 2 3 1e999 5", 1, 11, undefined, "spin is `1e999`"],
    ["move 0x10 2 3 4 5", 1, 5, undefined, "x is `0x10`"],
    ["wait 60001", 1, 5, undefined, "0 to 60000"],
    ["wait -1", 1, 5, undefined, "0 to 60000"],
    ["wait 1.5", 1, 5, undefined, "0 to 60000"],
    ["home now", 1, 5, undefined, "ends before `now`"],
    ["jog 100 100 100 0 0", 1, 3, undefined, "173 mm/s is too fast"],
    ["jog 0 0 0 0 91", 1, 3, undefined, "91 degrees/s is too fast"],
    ["jog 0 0 0 0 0 1001", 1, 14, undefined, "from 1 to 1000"],
    ["home; jog 0 0 0 0 0", 2, 0, undefined, "stands alone"],
  ]) {
    const { mistake } = read(text);
    assert.ok(mistake, text);
    assert.deepEqual([mistake.statement, mistake.position, mistake.nearest], [statement, position, nearest], `${text}: ${mistake.text}`);
    assert.ok(mistake.text.includes(words), `${text}: ${mistake.text}`);
  }
  assert.equal(read("grip open; mvoe 1 2 3 4 5").mistake.text, "statement 2: there is no `mvoe`; did you mean `move`?");
});

test("is bounded", () => {
  assert.ok(read("home;".repeat(MAX_STATEMENTS)).statements);
  assert.equal(read("home;".repeat(MAX_STATEMENTS + 1)).mistake.position, 5 * MAX_STATEMENTS);
  assert.ok(read("home".padEnd(MAX_BYTES)).statements);
  assert.ok(read("home".padEnd(MAX_BYTES + 1)).mistake);
  assert.ok(read("x".repeat(MAX_BYTES)).mistake.text.length < 200);
});

test("reads what a camera's mount obeys", () => {
  assert.deepEqual(plain(read("look 20 -10; wait 500; turn 1 2; home", "mount").statements), [["look", 20, -10], ["wait", 500], ["turn", 1, 2], ["home"]]);
  assert.equal(read("lok 1 2", "mount").mistake.nearest, "look");
  assert.ok(read("move 1 2 3 4 5", "mount").mistake);
});

test("relative commands of either language are known", () => {
  for (const [text, language, relative] of [
    ["by 0 0 -50 0 0", "arm", true],
    ["grip close; by 0 0 50 0 0; home", "arm", true],
    ["home; by 0 0 50 0 0", "arm", false],
    ["turn 5 0; wait 10", "mount", true],
    ["look 5 0; turn 5 0", "mount", false],
    ["dance", "arm", false],
  ]) assert.equal(isRelative(text, language), relative, text);
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
  const mistakes = mistakesOf(text);
  assert.deepEqual(mistakes.map(({ line, column }) => [line, column]), [[3, 9], [5, 6]]);
  assert.ok(text.slice(mistakes[0].index).startsWith("mvoe"));
  assert.ok(text.slice(mistakes[1].index).startsWith("-1"));
});

test("poses become commands, and statements can be replaced", () => {
  assert.equal(moveTo([1.26, -0.04, 200, -12.345, 0]), "move 1.3 0 200 -12.3 0");
  assert.equal(replaced("home;  move 1 2 900 0 0 ; grip open # x", 2, "move 1 2 450 0 0"), "home;  move 1 2 450 0 0 ; grip open # x");
});
