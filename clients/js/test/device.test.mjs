// What every device does alike (tests/cases/device.txt), replayed by a cart that has all that the dialogues ask for.
import assert from "node:assert/strict";
import test from "node:test";
import { DEVICE_CODES, DeviceError, Machine, Outlet, Pull, Rest, Sample, mostSimilar } from "../dist/test/internals.js";
import { Stage, check, replay } from "./stage.mjs";

/** mm/s, µs for which a velocity holds, and mm from the middle of its rail to an end. */
const SPEED = 100;
const HOLDS = 200_000;
const END = 1000;

/** A cart on a rail that stands at once. */
class Cart extends Machine {
  name = "the cart";
  verbs = ["go", "by", "jog"];
  now = 0;
  x = 0;
  planned = 0;
  speed = 0;
  until = 0;
  jogs = false;
  pushed = 0;

  constructor(completes) {
    super();
    this.completes = completes;
  }

  read(verb, words) {
    return this.verbs.includes(verb.text) ? { verb: verb.text, value: words.number(verb.text, "a number", "it") } : undefined;
  }

  isRelative({ verb }) {
    return verb === "by";
  }

  neverWaits({ verb }) {
    return verb === "jog";
  }

  isMoving() {
    return this.speed !== 0;
  }

  plan(script) {
    let { planned } = this;
    for (const [{ verb, value }, number] of script.actions()) {
      planned = { go: value, by: planned + value, jog: planned }[verb];
      if (Math.abs(planned) > END) throw new DeviceError("workspace-boundary", "the rail ends before").atStatement(number);
    }
    this.planned = planned;
  }

  begin({ verb, value }, now) {
    this.advance(now);
    this.jogs = verb === "jog";
    const way = verb === "go" ? value - this.x : value;
    [this.speed, this.until] = this.jogs ? [value, now + HOLDS] : [SPEED * Math.sign(way), now + Math.round((Math.abs(way) / SPEED) * 1e6)];
  }

  doneAt() {
    return this.until;
  }

  givesWay() {
    return this.jogs;
  }

  /** It goes on as it is until the next one begins. */
  giveWay(now) {
    this.advance(now);
    this.jogs = false;
  }

  halt(now) {
    this.advance(now);
    [this.speed, this.jogs, this.planned, this.pushed] = [0, false, this.x, 0];
  }

  advance(now) {
    const ends = Math.min(now, this.until);
    this.x += (this.speed * Math.max(0, ends - this.now) + this.pushed * (now - this.now)) / 1e6;
    if (now >= this.until) [this.speed, this.jogs] = [0, false];
    this.now = now;
  }

  position() {
    return { x: this.x };
  }

  /** Something may move it. */
  nextWake() {
    return this.now + 150_000;
  }

  isPressed = false;

  estop() {
    return this.isPressed;
  }

  /** As by a hand. */
  push() {
    this.pushed = 50;
  }
}

const STATEMENTS = { go: "go 100", back: "go 0", wrong: "og 100", beyond: "go 1001", "beyond-error": "workspace-boundary 5002", relative: "by 20", velocity: "jog 50" };

// Some dialogues are played for each of several events; none may be left out in silence.
for (const [completes, name, least] of [[false, "a cart", 51], [true, "a cart that completes its statement", 55]]) {
  test(`${name} does what every device does`, async () => {
    const played = await replay(() => new Cart(completes), STATEMENTS);
    assert.ok(played >= least, `${played} dialogues`);
  });
}

test("who owns what does not come to rest is refused after twice its stopping time and a second", async () => {
  const cart = new Cart(false);
  cart.position = () => ({ x: (cart.x += 2) });
  const stage = new Stage(cart);
  for (const line of ["told 0", "grabbed 6"]) await stage.act(line);
  stage.heard();
  await check(stage, "rolling", `alice command 1 6: go 100
    > status alice/1 waiting 0/1
    after 2999
    after 1
    > status alice/1 error 0/1 changing-hands 5105
    > state free`);
});

test("each stop and halt reaches the machine, also at rest", async () => {
  const cart = new Cart(false);
  let halts = 0;
  cart.halt = () => (halts += 1);
  const stage = await Stage.of(cart);
  for (const [line, reaches] of [["hub halt", 1], ["bob stop 3", 1], ["bob stop 4", 1], ["bob unstop 3", 0], ["bob unstop 4", 0], ["bob stop 2", 1], ["down", 1], ["lagged", 1], ["lagged", 1]]) {
    const before = halts;
    await stage.act(line);
    assert.equal(halts - before, reaches, line);
  }
});

test("what comes with commands that wait is bounded", async () => {
  const stage = await Stage.of(new Cart(false));
  const send = (id, bytes) => {
    const content = { script: "wait 10", attachments: { sound: new Uint8Array(bytes) } };
    const parcel = { family: "message", name: "command", sender: "alice", context: "/robot/arm", id, fence: 5, content };
    return stage.tell({ type: "message", name: "command", sender: "alice", content, history: false, parcel });
  };
  await send(1, 5 << 20);
  await send(2, 4 << 20);
  await send(3, 9 << 20);
  await send(4, 3 << 20);
  assert.deepEqual(stage.heard(), [
    "status alice/1 waiting 0/1",
    "status alice/1 executing 1/1",
    "status alice/2 error 0/0 queue-full 5103",
    "status alice/3 error 0/0 queue-full 5103",
    "status alice/4 waiting 0/1",
  ]);
  for (const [content, text] of [[{ script: "wait 1", attachments: { sound: "loud" } }, "the attachment `sound` must be bytes"], [{ script: "wait 1", attachments: 7 }, "attachments are a map of names to bytes"]]) {
    const parcel = { family: "message", name: "command", sender: "alice", context: "/robot/arm", fence: 5, content };
    await stage.tell({ type: "message", name: "command", sender: "alice", content, history: false, parcel });
    assert.equal(stage.out.pop().content.error.text, text);
  }
});

test("what it says of refusals has the words and keys of all devices", async () => {
  const stage = await Stage.of(new Cart(false));
  await stage.act("gate bob 6");
  const error = async (line) => {
    stage.heard();
    await stage.act(line);
    return stage.out.at(-1).content.error;
  };
  const now = "and bob owns its token now, with fence 6";
  assert.deepEqual(await error("alice command 1 5: wait 1"), { name: "older-fence", code: 205, text: `the command was sent under fence 5, ${now}`, owner: "bob" });
  assert.deepEqual(await error("alice command 1 -: wait 1"), { name: "older-fence", code: 205, text: `the command was sent without a fence, ${now}`, owner: "bob" });
  assert.deepEqual(await error("bob command 1 6: wait 1; og 5"), {
    name: "syntax",
    code: 5001,
    text: "statement 2: there is no `og`; did you mean `go`?",
    statement: 2,
    position: 8,
    line: 1,
    column: 9,
    nearest: "go",
  });
  assert.deepEqual(await error("bob command 1 6 on red: wait 1"), { name: "bad-slot", code: 220, text: "the slot based-on is the id of a state, a number from 0 to 9007199254740991", slot: "based-on" });
  const stale = await error("bob command 1 6 on next: wait 1");
  assert.deepEqual(stale, { name: "stale-state", code: 208, text: "the device has not published this state since it was started", state: stage.states.at(-1) });
  await stage.act("max-age 500");
  const unknown = await error("bob command 1 6: wait 1");
  assert.deepEqual([unknown.name, unknown.retry, /its sender has not measured its clock yet$/.test(unknown.text)], ["too-old", true, true]);
});

test("the protocol has a row for each error", async () => {
  const { readFileSync } = await import("node:fs");
  const protocol = readFileSync(new URL("../../../docs/PROTOCOL.md", import.meta.url), "utf8");
  const rows = [...protocol.matchAll(/^\| (5\d\d\d) \| `([a-z-]+)` \|/gm)].map(([, number, word]) => [word, Number(number)]);
  assert.deepEqual(rows, Object.entries(DEVICE_CODES));
});

test("a device that asks for its commands takes the answer to its newest request only, once, and while it is surely good", async () => {
  const pull = new Pull(1_000_000);
  pull.ask(7, 0);
  pull.ask(8, 1_000_000);
  const refuses = (reference, expires, age) => {
    try {
      pull.check({ name: "command", sender: "alice", reference, expires }, age);
    } catch (error) {
      return error.content.name;
    }
    return undefined;
  };
  for (const [reference, expires, age, refused] of [
    [8, 100, { micros: 50_000, error: 49_999 }, undefined],
    [8, 100, { micros: 50_000, error: 50_000 }, "expired"],
    [8, 100, { micros: 0 }, "expired"],
    [8, 100, undefined, "expired"],
    [7, 100, { micros: 0, error: 0 }, "expired"],
    [8, undefined, { micros: 0, error: 0 }, "bad-slot"],
    [undefined, 100, { micros: 0, error: 0 }, "bad-slot"],
  ]) {
    assert.equal(refuses(reference, expires, age), refused, `${reference} ${expires} ${age?.micros}`);
  }
  pull.renew(1_000_001);
  assert.equal(refuses(8, 100, { micros: 0, error: 0 }), "expired", "an answer is taken once");
  pull.check({ name: "command", sender: "hub" }, undefined);

  const stage = new Stage(new Cart(false), { options: { pulling: 1_000_000 } });
  for (const line of ["told 0", "gate alice 5", "grabbed 5", "rests"]) await stage.act(line);
  stage.out = [];
  stage.server.ask(stage.gate, stage.now, stage.out);
  assert.deepEqual([stage.out[0].name, stage.out[0].content, stage.out[0].delivery], ["next", { wait: 1000 }, "latest"]);
  assert.equal(stage.server.asksAt(stage.gate), stage.now + 1_000_000);
  await stage.act("bob stop");
  assert.equal(stage.server.asksAt(stage.gate), undefined, "stopped it asks for nothing");
});

test("rest is measured, or its stopping time is waited for", () => {
  const at = (x, now) => Sample.of({ x, name: "a" }, now);
  const rest = new Rest(1, 500_000);
  rest.disturb(100_000);
  // Measured before it was to stand.
  rest.observe(at(0, 90_000), 500_000);
  for (let step = 0; step < 20; step++) {
    rest.observe(at(2 * step, 100_000 + 50_000 * step), 100_000 + 50_000 * step);
    assert.equal(rest.known, undefined, "it rolls at 40 mm/s");
  }
  const stands = 100_000 + 19 * 50_000;
  rest.observe(at(38.5, stands + 299_999), stands + 299_999);
  assert.equal(rest.known, undefined);
  rest.observe(at(38.5, stands + 300_000), stands + 300_000);
  assert.equal(rest.known, "measured");
  rest.observe(at(60, stands + 900_000), stands + 900_000);
  assert.equal(rest.known, undefined, "it was pushed");
  for (const none of [undefined, at(NaN, 0)]) {
    const blind = new Rest(1, 500_000);
    blind.disturb(1000);
    blind.observe(none, 500_000);
    assert.deepEqual([blind.known, blind.nextLook(500_000)], [undefined, 550_000]);
    blind.observe(none, 501_000);
    assert.deepEqual([blind.known, blind.nextLook(1)], ["not-measured", undefined]);
    blind.observe(at(3, 700_000), 700_000);
    assert.equal(blind.known, undefined, "what is measured counts");
  }
  const turns = new Rest(2, 500_000);
  [359, 0, 359.6, 0.4, 359].forEach((heading, step) => turns.observe(Sample.of({ heading }, 100_000 * step), 100_000 * step));
  assert.equal(turns.known, "measured", "a heading goes on at the full turn");
});

test("the nearest word is the one with the fewest changes, of which a swap is one", () => {
  assert.deepEqual(["rde", "ab", "GO", "x"].map((word) => mostSimilar(word.toLowerCase(), ["green", "red", "go"])), ["red", "go", "go", "go"]);
  assert.equal(mostSimilar("x", []), "");
});

test("what cannot be said while the link is down is said after it, in order, and of states the newest only", async () => {
  const sent = [];
  let fails = false;
  const outlet = new Outlet(async (parcel) => {
    if (fails) throw Object.assign(new Error("gone"), { kind: "connection" });
    sent.push(parcel.content);
  });
  const parcel = (content) => ({ family: "message", name: content.split("-")[0], content, ...(content.startsWith("state") ? { delivery: "latest" } : {}), ...(content.endsWith("bob") ? { address: ["bob"] } : {}) });
  outlet.push([parcel("status-0")]);
  outlet.down = true;
  outlet.push(["state-1", "state-2-bob", "status-1", "state-3", "status-2"].map(parcel));
  assert.deepEqual(sent, ["status-0"]);
  outlet.down = false;
  assert.deepEqual(sent.splice(0), ["status-0", "state-2-bob", "status-1", "state-3", "status-2"]);
  // What the link refused as it went down.
  fails = true;
  outlet.push(["status-3", "state-4"].map(parcel));
  outlet.down = true;
  await new Promise(setImmediate);
  fails = false;
  outlet.push(Array.from({ length: 5000 }, (_, count) => parcel(`status-${count + 4}`)));
  outlet.down = false;
  assert.deepEqual([sent.length, sent[0], sent.at(-1)], [4096, "status-908", "status-5003"], "what is held back is bounded, and the oldest goes");
});
