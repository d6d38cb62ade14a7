// What every commander does alike: the dialogues of tests/cases/commander.txt, and the words for what devices and hubs say.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import test from "node:test";
import { Course, MomError, commandReportOf, errorWords, lossWords, verdict } from "../dist/test/internals.js";

const PLACE = "/robot/arm";

/** A course, and its clock. */
class Stage {
  course = new Course("alice", { place: PLACE, token: "/robot/token" }, 5);
  now = 0;
  says = [];

  /** Something happens. */
  act(line) {
    const [, how, which = "", text] = /^(command|pull)( .*?)?: (.*)$/.exec(line) ?? [];
    if (how) this.#begin(text, which.trim(), how === "pull");
    else this.#happens(line.split(" "), line);
    this.#gather();
  }

  #begin(text, which, whenAsked) {
    if (which === "once") return this.course.begin({ text, once: true });
    const basedOn = which === "relative" ? { basedOn: "newest" } : which && { basedOn: Number(/^on (\d+)$/.exec(which)[1]) };
    this.course.begin({ text, ...basedOn, whenAsked });
  }

  #happens(words, line) {
    const { course } = this;
    this.by = words[0] === "other" ? words.shift() : "robot";
    const [first, second, ...rest] = words;
    switch (first) {
      case "after":
        return this.#pass(Number(second));
      case "sent":
        return course.sent(Number(second));
      case "nobody":
        return course.sent(undefined);
      case "refused":
        return course.refused(new MomError("refused", second, `the words of ${second}`, Number(rest[0])));
      case "unanswered":
        return course.unanswered([second, ...rest].join(" "));
      case "old":
        return this.#heard([second, ...rest], { history: true });
      case "state":
      case "status":
        return this.#heard(words);
      case "next":
        return this.#message("next", undefined, { id: Number(second) });
      case "dropped":
        return course.hear({ type: "dropped", path: PLACE, reason: second, count: 1, parcel: { family: "event", name: "dropped", content: { sender: "alice", receiver: rest[0] } } });
      case "down":
        return course.hear({ type: "link-down" });
      case "lagged":
        return course.hear({ type: "lagged", count: Number(second) });
      case "lost":
        return course.lost({ reason: second, ...(rest.length && { by: rest[1] }) });
      case "asked":
        return course.asked();
      case "cancel":
        return course.cancel();
      case "released":
        return course.released();
    }
    const type = { leaves: "left", "is lost": "lost" }[words.slice(1).join(" ")];
    assert.ok(type, `no such line: ${line}`);
    const member = { peer: first, user: first, level: 0, device: first === "robot" };
    course.hear({ type, path: PLACE, member, ...(type === "lost" && { within: 30_000 }) });
  }

  #message(name, content, slots, history = false) {
    const parcel = { family: "message", name, sender: this.by, context: PLACE, content, ...slots };
    this.course.hear({ type: "message", name, sender: this.by, content, history, parcel });
  }

  #heard([name, id, ...words], { history = false } = {}) {
    const at = words.indexOf("under");
    const fence = at < 0 ? {} : { fence: Number(words[at + 1]) };
    if (name === "state") {
      const content = { moving: words.includes("moving"), stopped: words.includes("stopped"), ...(words.includes("unlinked") && { linked: false }), ...fence };
      return this.#message("state", content, { id: Number(id) }, history);
    }
    const [, peer = "alice", number] = /^(?:(.*)\/)?(.*)$/.exec(id);
    const [state, statements, error, code, retry] = words;
    const [statement, of] = statements.split("/").map(Number);
    const content = { peer, state, statement, of, ...(number !== "-" && { id: Number(number) }), ...fence };
    if (at < 0 && error) content.error = { name: error, code: Number(code), text: `the words of ${error}`, ...(retry && { retry: true }) };
    this.#message("status", content, {}, history);
  }

  /** Time passes, and the course is woken whenever it asked to be. */
  #pass(ms) {
    const until = this.now + ms;
    for (let due = this.course.nextWake; due !== undefined && due <= until; due = this.course.nextWake) {
      this.now = Math.max(this.now, due);
      this.course.wake(this.now);
      this.#gather();
    }
    this.now = until;
    this.course.wake(until);
  }

  #gather() {
    for (let step = this.course.poll(); step; step = this.course.poll()) this.says.push(...linesOf(step));
  }
}

/** A step, as the lines of a dialogue say it. */
function linesOf({ step, command, on, to, progress, end, halt }) {
  switch (step) {
    case "send":
      return [`send ${command.text}${on === undefined ? "" : ` on ${on}`}${to === undefined ? "" : ` for ${to}`}`];
    case "tell":
      return [progress.kind === "again" ? `tells again ${progress.why}` : `tells ${progress.state} ${progress.statement}/${progress.of}`];
    case "end":
      return [`end ${kindOf(end)}`, ...(end.finished ? [] : advice(end))];
    case "halted":
      return [`halted ${halt}`, ...advice(verdict(halt, PLACE))];
    default:
      return [step];
  }
}

function kindOf({ how, name }) {
  if (how.kind === "failed") return `error ${name}`;
  if (how.kind === "refused") return `refused ${name}`;
  return how.kind === "lost" ? `lost ${how.lost.reason}${how.lost.by === undefined ? "" : ` by ${how.lost.by}`}` : name;
}

function advice({ text, hint } = {}) {
  return [...(text === undefined ? [] : [`says ${text}`]), ...(hint === undefined ? [] : [`hint ${hint}`])];
}

/** A line that ends in `*` leaves open the rest of it, and the last one also what follows. */
function fits(says, expected) {
  const isOpen = expected.at(-1)?.endsWith("*") && says.length > expected.length;
  const isSaid = (line, at) => (line.endsWith("*") ? says[at].startsWith(line.slice(0, -1)) : says[at] === line);
  return (isOpen || says.length === expected.length) && expected.every(isSaid);
}

function play(title, lines) {
  const stage = new Stage();
  while (lines.length) {
    const line = lines.shift();
    stage.act(line);
    const expected = [];
    while (lines[0]?.startsWith("> ")) expected.push(lines.shift().slice(2));
    const says = stage.says.splice(0);
    if (!fits(says, expected)) assert.deepEqual(says, expected, `${title}: after \`${line}\``);
  }
}

const dialogues = readFileSync(new URL("../../../tests/cases/commander.txt", import.meta.url), "utf8").replace(/^#.*\n/gm, "");
let played = 0;

for (const dialogue of `\n${dialogues}`.split("\n== ").slice(1)) {
  const [title, ...all] = dialogue.split("\n").filter(Boolean);
  test(title, () => {
    const each = all.find((line) => line.startsWith("each "))?.slice("each ".length) ?? "";
    const lines = all.filter((line) => !line.startsWith("each "));
    for (const one of each.split(" | ")) {
      const [word, says = ""] = one.split(": ");
      play(`${title} (${word})`, lines.map((line) => line.replaceAll("{each}", word).replaceAll("{says}", says)));
      played += 1;
    }
  });
}

test("all dialogues were played", () => {
  assert.ok(played >= 65, `${played} dialogues`);
});

test("an error without words is still told, and none paints on a terminal", () => {
  const words = (error, statement = 0) => errorWords({ peer: "alice", state: "error", statement, of: 2, error });
  assert.equal(words(undefined), "it failed, and the device does not say why");
  assert.equal(words({ text: "statement 1: no", statement: 1 }), "statement 1: no");
  assert.equal(words({ text: "\u001b[2J\n\u202e" }), "\\u{1b}[2J\\n\\u{202e}");
  assert.equal(words({ text: "too far", name: "joint-limit", code: 5005 }, 2), "statement 2: too far [joint-limit 5005]");
  assert.equal(lossWords({ reason: "toString", by: "e\tve" }), "toString by e ve");
});

test("what cannot be read as a status is none", () => {
  const read = (content) => commandReportOf({ content });
  const status = { peer: "alice", state: "error" };
  const wrong = [{ statement: -1 }, { peer: 1 }, { id: "7" }].map((key) => ({ ...status, ...key }));
  for (const content of [undefined, "status", [], {}, { peer: "alice" }, ...wrong]) {
    assert.equal(read(content), undefined, JSON.stringify(content));
  }
  assert.equal(read({ peer: "alice", state: "finished" }).of, 0);
  assert.equal(read(new Map([["peer", "alice"], ["state", "finished"]])).state, "finished");
});

test("what came before something was due is told before it is", () => {
  const { course } = new Stage();
  const steps = () => [course.poll(), course.poll()].filter(Boolean).flatMap(linesOf);
  course.begin({ text: "home" });
  course.sent(7);
  steps();
  // This program stood still for longer than a device may take.
  course.at(10_001);
  course.reported({ id: 7, peer: "alice", state: "executing", statement: 1, of: 1 });
  course.wake(10_001);
  assert.deepEqual(steps(), ["tells executing 1/1"]);
});

test("a device that has ended a command whose receipt has not come is not said to have heard nothing of it", () => {
  const stage = new Stage();
  for (const line of ["command: home", "lost preempted by carol", "status 7 error 0/1 halted 5101"]) stage.act(line);
  const says = "says lost /robot/token: carol has a higher level and took it; the device has ended the command";
  assert.deepEqual(stage.says.slice(1), ["end lost preempted by carol", says]);
});
