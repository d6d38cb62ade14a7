import assert from "node:assert/strict";
import { before, test } from "node:test";
import { load } from "./bundle.mjs";

let answers;
let trial;
before(async () => {
  answers = await load("panels/access/answer.ts");
  trial = await load("panels/access/what-if.svelte.ts");
});

const denied = {
  user: "bob", level: 1, groups: [], allow: false, answer: "deny", code: "held", text: "/robot/token is held by carol", owner: "carol", "owner-level": 5, "retry-after": 180000n,
  rule: "robot-token/level-or-lease", file: "lab.toml", line: 85, key: "managers.robot-token.of[1]", manager: "robot-token", "managed-at": "/robot/token", kind: "token", stands: "asked anew each time",
};

test("an answer is one sentence and its reasons", () => {
  const { answerOf, sentence, reasons } = answers;
  const question = { user: "bob", verb: "grab", path: "/robot/token" };
  const answer = answerOf(denied);
  assert.equal(sentence(question, answer), "bob (level 1) may not grab /robot/token.");
  assert.deepEqual(reasons(answer, String), [
    ["held", "/robot/token is held by carol"],
    ["told", "level=1  owner=carol  owner-level=5  retry-after=180000"],
    ["rule", "robot-token/level-or-lease"],
    ["stands at", "lab.toml:85, managers.robot-token.of[1]"],
    ["manager", "robot-token of /robot/token (token)"],
    ["holds", "asked anew each time"],
  ]);
});

test("messages, waiting and asking have sentences of their own", () => {
  const { answerOf, sentence } = answers;
  const said = (answer, verb, message) => sentence({ user: "carol", verb, path: "/x", message }, answerOf({ answer, allow: answer === "allow", level: 5, groups: ["operator"] }));
  assert.equal(said("allow", "send", "command"), "carol (level 5, operator) may send command to /x.");
  assert.equal(said("allow", "send", "*"), "carol (level 5, operator) may send any other message to /x.");
  assert.equal(said("deny", "send"), "carol (level 5, operator) may not send any other message to /x.");
  assert.equal(said("wait", "grab"), "carol (level 5, operator) has to wait to grab /x.");
  assert.equal(said("ask", "join"), "carol (level 5, operator) may, if those who are asked allow it, join /x.");
});

test("what decided is told also where no rule did", () => {
  const { answerOf, decidedBy, condition } = answers;
  assert.equal(decidedBy(answerOf({ answer: "deny", uncovered: true, rule: "lab" })), "none of lab covers it");
  assert.equal(decidedBy(answerOf({ answer: "deny", manager: "lab", file: "a.toml", line: 3 })), "the manager lab as a whole");
  assert.equal(decidedBy(answerOf({ answer: "deny", manager: "lab" })), "the hub itself, regardless of managers");
  assert.equal(condition(answerOf({ answer: "allow", needs: ["membership of /robot", "ownership of /robot/token"] })), "with ownership of /robot/token");
  assert.equal(condition(answerOf({ answer: "deny", needs: ["ownership of /robot/token"] })), undefined);
});

test("an unknown answer is not a yes", () => {
  const { answerOf } = answers;
  assert.equal(answerOf({ answer: "perhaps", allow: true }).word, "deny");
  assert.equal(answerOf(undefined).word, "deny");
  assert.equal(answerOf({ allow: true }).word, "allow");
});

test("until, guard, and whom it takes the token from", () => {
  const { answerOf, reasons } = answers;
  const answer = answerOf({ answer: "ask", guard: "/t", "guard-owner": "carol", displaces: true, until: new Date(5), asks: { who: "the chair", users: ["carol", "dave"], within: 30000 }, needs: ["membership of /x"] });
  const lines = Object.fromEntries(reasons(answer, (ms) => `at ${ms}`));
  assert.equal(lines["guarded by"], "/t, owned by carol now");
  assert.equal(lines["takes it"], "from its owner");
  assert.equal(lines["until"], "at 5");
  assert.equal(lines["asks"], "the chair: carol, dave; within 30 s");
  assert.equal(lines["also needs"], "membership of /x");
});

test("lines of an editor are found and compared", () => {
  const { changedLines, lineRange } = trial;
  const config = "a\nbb\nccc";
  assert.deepEqual([1, 2, 3, 9].map((line) => config.slice(...lineRange(config, line))), ["a", "bb", "ccc", "ccc"]);
  assert.equal(changedLines(config, config), null);
  assert.deepEqual(changedLines(config, "a\nb\nccc"), { first: 2, last: 2, count: 1 });
  assert.deepEqual(changedLines(config, "a\nccc"), { first: 2, last: 2, count: 1 });
  assert.deepEqual(changedLines(config, "a\nbb\nx\ny\nccc"), { first: 3, last: 4, count: 2 });
});

test("a result of the hub is read as it comes", () => {
  const { resultOf, faultOf } = trial;
  const read = resultOf({ inputs: 7n, differ: 1, differences: [{ at: new Date(3), "recorded-line": 4, peer: "ally", request: "grab", old: "Was", new: "is", line: 2 }, "nonsense"], "unknown-users": ["eve"], cut: true, end: "damaged" }, 12);
  assert.equal(read.inputs, 7);
  assert.equal(read.differences[0].at, 3);
  assert.ok(read.differences[0].words.includes("ally") && read.differences[0].words.includes("was"));
  assert.equal(read.differences[1].peer, "");
  assert.deepEqual([read.unknownUsers, read.cut, read.end, read.more, read.configured, read.took], [["eve"], true, "damaged", false, 0, 12]);
  assert.deepEqual(faultOf({ line: 3n, text: "wrong" }), { line: 3, column: undefined, key: undefined, text: "wrong" });
});

test("edits are kept until they are dropped, and say so when the hub has another configuration", async () => {
  const { WhatIf } = trial;
  const kept = new Map();
  globalThis.sessionStorage = { getItem: (key) => kept.get(key) ?? null, setItem: (key, value) => kept.set(key, value), removeItem: (key) => kept.delete(key) };
  let sha256 = "one";
  const hub = { address: "ws://hub", call: async () => ({ config: "running", file: "mom.toml", sha256, recorded: true }) };
  const first = new WhatIf(hub);
  await first.load();
  assert.deepEqual([first.config, first.isEdited, first.recorded, kept.size], ["running", false, true, 0]);
  first.edit("edited");
  const second = new WhatIf(hub);
  await second.load();
  assert.deepEqual([second.config, second.isEdited, second.stale], ["edited", true, false]);
  sha256 = "two";
  const third = new WhatIf(hub);
  await third.load();
  assert.deepEqual([third.config, third.stale], ["edited", true]);
  third.reset();
  assert.deepEqual([third.config, third.stale, kept.size], ["running", false, 0]);
});
