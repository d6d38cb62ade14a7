// What a page does with a command that it sends, beside the dialogues of tests/cases/commander.txt, which the course replays by itself.
import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./bundle.mjs";

const { Carrier, HubError } = await load("hub/carrier.ts", "hub/failure.ts");

const PATH = "/robot/arm";
const TOKEN = "/robot/token";
const settled = () => new Promise((resolve) => setImmediate(resolve));

/** A page's hub and its clock: what is asked of the worker waits until the test answers it. */
function stage(t) {
  let now = 0;
  t.mock.timers.enable({ apis: ["setTimeout", "setInterval"] });
  t.mock.method(performance, "now", () => now);
  const heard = { owned: new Set(), stop: new Set(), link: new Set() };
  const on = (of) => (listener) => (heard[of].add(listener), () => heard[of].delete(listener));
  const tell = (of, ...words) => [...heard[of]].forEach((listener) => listener(...words));
  const asked = [];
  const hub = {
    me: { peer: "alice" },
    owned: new Map([[TOKEN, { path: TOKEN, fence: 5 }]]),
    call: (name, ...args) => new Promise((resolve, reject) => asked.push({ name, args, resolve, reject: (failure) => reject(new HubError(failure)) })),
    onOwned: on("owned"),
    onStop: on("stop"),
    onLink: on("link"),
  };
  let [watcher, id] = [undefined, 0];
  const before = [];
  hub.watch = (_, handlers) => {
    watcher = handlers;
    handlers.joined({});
    handlers.events(before.splice(0), 0);
    return () => (watcher = undefined);
  };
  const carrier = new Carrier(hub, PATH);
  /** What was said before the channel was heard is its history. */
  const take = (event) => (watcher ? watcher.events([event], 0) : before.push({ ...event, history: true }));
  /** Of the commands, in the order in which they were sent. */
  const ids = () => asked.filter(({ name }) => name === "send").map(({ args }) => args[3].id);
  const message = (name, content) => take({ type: "message", name, sender: "robot", content, history: false, id: ++id });
  return {
    hub, carrier, asked, heard, tell,
    sends: () => asked.filter(({ name }) => name === "send").map(({ args: [, , text, { fence, basedOn, expires }] }) => [text, fence, ...[basedOn, expires].filter((slot) => slot !== undefined)]),
    state: (content) => message("state", content),
    status: (of, state, error) => message("status", { peer: "alice", id: ids()[of], state, statement: error?.retry || state === "waiting" ? 0 : 1, of: 1, ...(error ? { error } : {}) }),
    happens: (type, what) => take({ type, path: PATH, what, arrived: 0 }),
    isHeard: () => watcher !== undefined,
    lose(reason, by) {
      hub.owned.delete(TOKEN);
      tell("owned", TOKEN, null, reason, by);
    },
    async receipt(of, delivered = 1) {
      await settled();
      asked.filter(({ name }) => name === "send")[of].resolve({ id: ids()[of], delivered, dropped: [] });
      await settled();
    },
    async answer() {
      asked.findLast(({ name }) => name === "ask").resolve({});
      await settled();
    },
    async pass(ms) {
      for (const end = now + ms; now < end; ) {
        now = Math.min(end, now + 50);
        t.mock.timers.tick(50);
      }
      await settled();
    },
    /** Begins one: what was told of it, and its end. */
    carry(text = "home", more = {}) {
      const one = { told: [], failure: undefined };
      void carrier.carryOut({ text, ...more }, TOKEN, ({ became }) => one.told.push(became)).then((failure) => (one.failure = failure));
      return one;
    },
  };
}

const HANDS = { name: "changing-hands", code: 5105, text: "it ends what bob has begun", retry: true };

test("a device that changes hands is waited for, and the command goes on under the same fence", async (t) => {
  const { carry, sends, receipt, state, status, pass } = stage(t);
  state({ moving: true, fence: 4 });
  const one = carry("home", { expires: 2000 });
  await receipt(0);
  status(0, "error", HANDS);
  await pass(100);
  state({ moving: true, fence: 5 });
  assert.equal(sends().length, 1);
  state({ moving: false, fence: 5 });
  await receipt(1);
  status(1, "waiting");
  status(1, "executing");
  status(1, "finished");
  await settled();
  assert.equal(one.failure, null);
  assert.deepEqual(sends(), [["home", 5, 2000], ["home", 5, 2000]]);
  assert.deepEqual(one.told, ["sent", "again", "sent", "waiting", "executing", "finished"]);
});

test("what counts from where the device is, is sent once it rests, and says from which state", async (t) => {
  const { carry, sends, state } = stage(t);
  state({ moving: true });
  carry("turn 5 0", { basedOn: "newest" });
  await settled();
  assert.deepEqual(sends(), []);
  state({ moving: false });
  assert.deepEqual(sends(), [["turn 5 0", 5, 2]]);
});

test("a device that is lost while it carries a command out ends it, in words that others cannot paint", async (t) => {
  for (const [type, words] of [["lost", "the hub has lost the connection of robot, the device in /robot/arm"], ["left", "robot has left /robot/arm"]]) {
    await t.test(type, async (t) => {
      const { carry, receipt, state, status, happens, heard } = stage(t);
      const one = carry();
      await receipt(0);
      state({ moving: false });
      status(0, "executing");
      happens(type, { member: { peer: "carol" } });
      happens(type, { member: { peer: "robot" } });
      await settled();
      assert.deepEqual([one.failure.code, one.failure.text], ["gone", `${words}; what became of the command is not known`]);
      assert.equal(one.failure.hint, "see who is there: mom tree /robot");
      assert.equal(one.told.at(-1), "error");
      assert.deepEqual(Object.values(heard).map(({ size }) => size), [0, 0, 0], "nobody listens any more");
    });
  }
  const { carry, receipt, status, answer } = stage(t);
  const one = carry();
  await receipt(0);
  status(0, "error", { name: "joint-limit", code: 5005, text: "too\u202e far", statement: 1, reachable: { x: 1 } });
  await answer();
  assert.deepEqual([one.failure.kind, one.failure.code, one.failure.text], ["refused", "joint-limit", "statement 1: too\\u{202e} far [joint-limit 5005]"]);
  assert.deepEqual(one.failure.content.reachable, { x: 1 });
});

test("who loses the token hears whether the device has ended the command, and nothing more is sent", async (t) => {
  const lost = "lost /robot/token: carol has a higher level and took it";
  const first = stage(t);
  const ended = first.carry();
  await first.receipt(0);
  first.status(0, "executing");
  first.lose("preempted", "carol");
  first.status(0, "error", { name: "halted", code: 5101, text: "halted" });
  await settled();
  assert.equal(ended.failure.text, `${lost}; the device has ended the command`);

  t.mock.timers.reset();
  t.mock.restoreAll();
  const { carry, receipt, status, state, sends, lose, pass } = stage(t);
  const [silent, waiting] = [carry("home"), carry("wait 1")];
  await receipt(1);
  status(1, "error", HANDS);
  lose("preempted", "carol");
  await settled();
  assert.equal(waiting.failure.text, `${lost}; nothing of the command ran`);
  state({ moving: false, fence: 5 });
  await pass(1900);
  assert.equal(silent.failure, undefined);
  await pass(200);
  assert.equal(silent.failure.text, `${lost}; the device has not said that it has ended the command`);
  assert.equal(silent.failure.hint, "go and look; switch it off where it moves");
  await pass(90_000);
  assert.equal(sends().length, 2);
});

test("after STOP nothing is sent again, and what runs ends by the device's word", async (t) => {
  const { carry, receipt, status, state, sends, tell, answer, pass } = stage(t);
  const [running, waiting] = [carry("wait 1000"), carry("home")];
  await receipt(1);
  status(1, "error", HANDS);
  tell("stop", "/camera");
  await settled();
  assert.equal(waiting.failure, undefined);
  tell("stop", "/robot");
  await settled();
  assert.deepEqual([waiting.failure.code, waiting.failure.text], ["stopped", "STOP was pressed."]);
  assert.equal(running.failure, undefined);
  state({ moving: false, fence: 5 });
  await pass(1000);
  assert.equal(sends().length, 2);
  const [first] = [carry("home")];
  await receipt(2);
  tell("stop", "/");
  // It may be sent again by what the device says, but not after STOP.
  status(2, "error", HANDS);
  await settled();
  assert.equal(first.failure.text, "STOP was pressed.");
  const stopped = carry("home");
  await receipt(3);
  tell("stop", "/");
  status(3, "error", { name: "stopped", code: 5102, text: "it is stopped" });
  await answer();
  assert.deepEqual([stopped.failure.code, stopped.failure.hint], ["stopped", "let it go with: mom unstop /robot/arm"]);
  assert.equal(sends().length, 4);
});

test("while the link may be resumed what runs may go on, and nothing is sent; without the link the token is lost", async (t) => {
  const { carry, receipt, status, state, sends, tell, asked, pass } = stage(t);
  const running = carry("wait 1000");
  await receipt(0);
  status(0, "executing");
  const waiting = carry("home");
  await receipt(1);
  status(1, "error", HANDS);
  tell("link", { state: "stale" });
  tell("link", { state: "resuming" });
  tell("link", { state: "connected" });
  state({ moving: false, fence: 5 });
  await pass(1000);
  assert.equal(waiting.failure.text, "The link to the hub was lost.");
  assert.equal(running.failure, undefined);
  assert.equal(sends().length, 2);
  const late = carry("home");
  await settled();
  asked.at(-1).reject({ kind: "connection", code: "unknown", text: "it had left", content: {} });
  tell("link", { state: "closed" });
  await settled();
  assert.match(running.failure.text, /^the connection to the hub is lost, and the token with it; what became of the command is not known/);
  assert.match(late.failure.text, /^the connection to the hub is lost/);
});

test("nothing is sent without the token, nor under another ownership than that in which it was begun", async (t) => {
  const { carry, hub, receipt, status, state, sends, tell, carrier } = stage(t);
  const one = carry();
  await receipt(0);
  status(0, "error", HANDS);
  hub.owned.set(TOKEN, { path: TOKEN, fence: 6 });
  tell("owned", TOKEN, hub.owned.get(TOKEN));
  state({ moving: false, fence: 6 });
  await settled();
  assert.match(one.failure.text, /^lost \/robot\/token: .*; nothing of the command ran$/);
  hub.owned.clear();
  const two = carry();
  await settled();
  assert.deepEqual([two.failure.code, two.told], ["not-owner", ["refused"]]);
  assert.equal(sends().length, 1);
  // Nor when the hub has not said yet that it is lost.
  hub.owned.set(TOKEN, { path: TOKEN, fence: 7 });
  state({ moving: true });
  const relative = carry("turn 5 0", { basedOn: "newest" });
  await settled();
  hub.owned.clear();
  state({ moving: false });
  await settled();
  assert.equal(sends().length, 1);
  carrier.drop();
  assert.equal(relative.failure, undefined);
});

test("what the hub refuses stands in its words, and what it does not answer is not known", async (t) => {
  const { carry, asked, receipt, answer, isHeard, pass } = stage(t);
  const refused = carry();
  await settled();
  asked.at(-1).reject({ kind: "refused", code: "held", text: "held\u202e by bob", rule: "robot-token", owner: "bob", content: {} });
  await settled();
  await answer();
  assert.deepEqual([refused.failure.text, refused.failure.rule, refused.failure.owner, refused.told], ["held\\u{202e} by bob", "robot-token", "bob", ["refused"]]);
  const unknown = carry();
  await settled();
  asked.at(-1).reject({ kind: "timed-out", code: "timed-out", text: "no answer within 10 s", content: {} });
  await settled();
  assert.equal(unknown.failure.text, 'send "home" to /robot/arm: no answer within 10 s; what became of the command is not known');
  const nobody = carry();
  await receipt(2, 0);
  assert.deepEqual([nobody.failure.code, nobody.told], ["no-answer", ["refused"]]);
  // The channel is heard for a while, should another follow.
  assert.equal(isHeard(), true);
  await pass(15_000);
  assert.equal(isHeard(), false);
});

test("where nobody hears the channel any more nothing is sent or told", async (t) => {
  const { carry, receipt, status, state, sends, carrier, heard, pass } = stage(t);
  const one = carry();
  await receipt(0);
  status(0, "error", HANDS);
  carrier.drop();
  state({ moving: false, fence: 5 });
  await pass(100_000);
  assert.deepEqual([sends().length, one.failure, one.told], [1, undefined, ["sent", "again"]]);
  assert.deepEqual(Object.values(heard).map(({ size }) => size), [0, 0, 0]);
});
