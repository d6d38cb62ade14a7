// A declared device by the real clock, in a channel that a test plays.
import assert from "node:assert/strict";
import test from "node:test";
import { setImmediate as turn } from "node:timers/promises";
import { device, encode, number, sleep, verb, whole } from "../dist/test/internals.js";

const CHANNEL = "/robot/arm";
const guard = { token: "/robot/token", names: ["command"], fence: 5, owner: "alice" };

/** What a device hears, as it is told. */
class Heard {
  #events = [];
  #wake = () => undefined;
  #over = false;

  push(event) {
    this.#events.push(event);
    this.#wake();
  }

  async return() {
    this.#over = true;
    this.#wake();
  }

  async *[Symbol.asyncIterator]() {
    while (!this.#over) {
      if (this.#events.length) yield this.#events.shift();
      else await new Promise((resolve) => (this.#wake = resolve));
    }
  }
}

/** A device that obeys in a channel, and what it says there. */
class Scene {
  said = [];
  events = new Heard();
  #listeners = new Set();

  constructor(t, obeys, most = Infinity) {
    this.device = obeys;
    const client = {
      name: "arm",
      state: { state: "connected" },
      clock: { age: () => undefined, now: () => undefined },
      peer: { devices: new Set(), places: { cards: new Map() } },
      sendParcel: async (parcel) => {
        if (encode(parcel).length > most) throw Object.assign(new Error("too large"), { kind: "local" });
        this.said.push(parcel);
        for (const listener of this.#listeners) listener();
      },
    };
    const channel = { path: CHANNEL, client, guard, permits: () => true, leave: async () => undefined };
    t.mock.method(console, "error", () => undefined);
    this.obeying = obeys.start(channel, this.events);
    // It is rejected where it broke.
    t.after(() => this.obeying.leave().catch(() => undefined));
  }

  /** One that rests for its owner. */
  static async of(t, obeys, most) {
    const scene = new Scene(t, obeys, most);
    scene.events.push({ type: "stops", path: CHANNEL, state: { number: 0, stopped: false, only: [] } });
    scene.events.push({ type: "grabbed", path: guard.token, owner: "alice", level: 1, fence: 5, lease: null });
    await scene.says(({ content }) => content.rest);
    return scene;
  }

  command(id, script, extra) {
    const parcel = { family: "message", name: "command", sender: "alice", context: CHANNEL, id, fence: 5, content: script, extra };
    this.events.push({ type: "message", name: "command", sender: "alice", content: script, history: false, parcel });
  }

  /** Waits until something was said that fits, and gives it. */
  async says(fits) {
    for (;;) {
      const found = this.said.find(fits);
      if (found) return found;
      await new Promise((resolve) => {
        const listener = () => (this.#listeners.delete(listener), resolve());
        this.#listeners.add(listener);
      });
    }
  }

  /** How a command ended. */
  async end(id) {
    const { content } = await this.says(({ name, content }) => name === "status" && content.id === id && ["finished", "error"].includes(content.state));
    return content.error?.name ?? content.state;
  }
}

/** Without a turn for anything else. */
function block(ms) {
  for (const end = performance.now() + ms; performance.now() < end; );
}

/** A cart that says what is done to it. */
function cartOf(more = {}, verbs = {}) {
  const cart = { told: [], x: 0 };
  const go = verb("Drives", { x: number() }, async ({ x }, signal) => {
    cart.told.push(x);
    await sleep(20, signal);
  });
  const by = verb.relative("Drives so far", { way: number() }, ({ way }) => void cart.told.push(way));
  const spec = { does: "A cart", verbs: { go, by, ...verbs }, halt: () => void cart.told.push("halt"), position: () => ({ x: cart.x }), stopsWithin: 100, ...more };
  return Object.assign(cart, { device: device("cart", spec) });
}

test("where its program stands still within a verb, the command ends as halted, and nothing behind it begins", async (t) => {
  const ways = {
    atOnce: verb("Blocks", { ms: whole() }, ({ ms }) => block(ms)),
    promise: verb("Blocks, and gives a promise", { ms: whole() }, async ({ ms }) => block(ms)),
    later: verb("Blocks later", { ms: whole() }, async ({ ms }) => {
      await turn();
      block(ms);
    }),
    instant: verb.instant("Does not move it", { ms: whole() }, async ({ ms }) => {
      await turn();
      block(ms);
    }),
  };
  const cart = cartOf({}, ways);
  const scene = await Scene.of(t, cart.device);
  let id = 0;
  for (const name of Object.keys(ways)) {
    for (const rest of ["; go 100", ""]) {
      cart.told.length = 0;
      scene.command(++id, `${name} 1300${rest}`);
      assert.equal(await scene.end(id), "halted", name);
      assert.ok(cart.told.length > 0 && cart.told.every((told) => told === "halt"), `${name}: ${cart.told}`);
    }
    scene.command(++id, `${name} 1`);
    assert.equal(await scene.end(id), "finished", name);
  }
});

test("a standstill within a verb is noticed in a device that does not measure, too", async (t) => {
  const later = verb("Blocks later", { ms: whole() }, async ({ ms }) => {
    await turn();
    block(ms);
  });
  const cart = cartOf({ position: () => ({}) }, { later });
  const scene = await Scene.of(t, cart.device);
  cart.told.length = 0;
  scene.command(1, "later 1300");
  assert.equal(await scene.end(1), "halted");
  assert.ok(cart.told.includes("halt"));
});

test("blocks of a script that have no turn between them count together", async (t) => {
  const cart = cartOf({}, { block: verb("Blocks", { ms: whole() }, ({ ms }) => block(ms)) });
  const scene = await Scene.of(t, cart.device);
  scene.command(1, "block 600; block 600; go 100");
  assert.equal(await scene.end(1), "halted");
  assert.ok(!cart.told.includes(100));
});

test("whoever asks how it stands is not told that it rests where it was pushed", async (t) => {
  const cart = cartOf();
  const scene = await Scene.of(t, cart.device);
  assert.equal(scene.obeying.state().rest, "measured");
  const before = scene.said.length;
  cart.x = 50;
  const { moving, rest } = scene.obeying.state();
  assert.deepEqual([moving, rest], [true, undefined]);
  scene.obeying.report();
  const said = scene.said.slice(before).filter(({ name }) => name === "state");
  assert.ok(said.length > 0 && said.every(({ content }) => content.moving && content.rest === undefined));
  await scene.says(({ content }) => content.x === 50 && content.rest === "measured");
  // Nobody asks, and it is noticed all the same.
  cart.x = 100;
  const newest = scene.said.findLast(({ name }) => name === "state").id;
  const told = await scene.says(({ name, content }) => name === "state" && content.x === 100);
  assert.deepEqual([told.content.moving, told.content.rest], [true, undefined]);
  scene.command(1, "by 10", { "based-on": newest });
  assert.equal(await scene.end(1), "stale-state");
  assert.ok(!cart.told.includes(10));
});

test("it does not obey again before what it began has ended, and its halt has", async (t) => {
  let [ends, halts] = [undefined, undefined];
  const slow = verb("Ends when it likes", {}, () => new Promise((resolve) => (ends = resolve)));
  const cart = cartOf({ halt: () => halts }, { slow });
  const first = await Scene.of(t, cart.device);
  first.command(1, "slow");
  await first.says(({ content }) => content.state === "executing");
  await first.obeying.leave();
  assert.throws(() => cart.device.check(), /began in \/robot\/arm has not ended yet/);
  assert.throws(() => new Scene({ mock: t.mock, after: () => undefined }, cart.device), TypeError);
  let stands;
  halts = new Promise((resolve) => (stands = resolve));
  ends();
  await turn();
  assert.throws(() => cart.device.check(), TypeError);
  halts = undefined;
  stands();
  await turn();
  cart.device.check();
  await Scene.of(t, cart.device);
});

test("a state that cannot be said ends it, and is not dropped without a word", async (t) => {
  let report = {};
  for (const bad of [{ speed: Infinity }, { text: "\u0000" }]) {
    report = {};
    const scene = await Scene.of(t, cartOf({ report: () => report }).device);
    scene.command(1, "go 100; wait 1000");
    await scene.says(({ content }) => content.state === "executing");
    report = bad;
    scene.obeying.report();
    assert.equal(await scene.end(1), "link");
    await assert.rejects(scene.obeying.ended, TypeError);
    assert.equal((await scene.says(({ content }) => content.reached === false)).content.moving, true);
  }
  // The hub takes less than any hub does.
  report = {};
  const scene = await Scene.of(t, cartOf({ report: () => report }).device, 2000);
  scene.command(1, "go 100; wait 1000");
  await scene.says(({ content }) => content.state === "executing");
  report = { long: "x".repeat(3000) };
  scene.obeying.report();
  assert.equal(await scene.end(1), "link");
  await assert.rejects(scene.obeying.ended, /too large/);
  await scene.says(({ content }) => content.reached === false);
});

test("what it says when it stops itself or fails is heard, whatever was thrown", async (t) => {
  const scene = await Scene.of(t, cartOf().device);
  scene.command(1, "wait 1000");
  await scene.says(({ content }) => content.state === "executing");
  scene.obeying.fail(new TypeError("no\u0007 power"));
  assert.equal(await scene.end(1), "link");
  scene.obeying.stopItself("bumper\u0000");
  assert.match((await scene.says(({ name }) => name === "stop")).content.reason, /bumper\ufffd/);
});
