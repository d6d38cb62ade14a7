// What functions of verbs leave behind: it moves the device after its halt, and is halted again; and velocities that do not end in time.
import assert from "node:assert/strict";
import test from "node:test";
import { number, verb } from "../dist/test/internals.js";
import { machine, settings } from "./rail.mjs";
import { Stage } from "./stage.mjs";

const never = new AbortController().signal;
const REST = 300;
const PERIOD = 50;

/** Ways to leave something behind that moves the device so many ms later: what `moves` gives heeds no signal. */
const LEAVES = {
  "the loser of a Promise.race": (moves, rail, signal) => Promise.race([moves(), rail.sleep(10_000_000, signal)]),
  "what a Promise.all does not wait for any more": (moves, rail, signal) => Promise.all([rail.sleep(10_000_000, signal), moves()]),
  "a promise that nobody awaits": async (moves, rail, signal) => {
    void moves();
    await rail.sleep(10_000_000, signal);
  },
  "a timer": async (moves, rail, signal) => {
    rail.sleep(0, never).then(moves);
    await rail.sleep(10_000_000, signal);
  },
  "a listener to the abort of its signal": (moves, rail, signal) => {
    signal.addEventListener("abort", () => void moves());
    return rail.sleep(10_000_000, signal);
  },
};

/** Lets time pass until it is so, ms by ms; gives how many that took. */
async function passUntil(stage, what, isSo) {
  for (let ms = 0; ms < 10_000; ms++) {
    if (isSo()) return ms;
    await stage.pass(1);
  }
  return assert.fail(`${what} never`);
}

for (const [name, leave] of Object.entries(LEAVES)) {
  test(`${name} moves the device after its halt, and it is halted again`, async () => {
    // Within its stopping time, as it ends, and when it has been measured to rest.
    for (const later of [[0], [400], [1300], [3000], [400, 2000, 2100, 5000]]) {
      const cart = machine();
      const { rail } = cart;
      const moves = async () => {
        for (const [place, ms] of later.entries()) {
          await rail.sleep((ms - (later[place - 1] ?? 0)) * 1000 + 20_000, never);
          rail.speed = 50;
          rail.told.push("moves");
        }
      };
      cart.spec.verbs.leave = verb("Leaves something behind", {}, (_, signal) => leave(moves, rail, signal));
      const stage = await Stage.of(cart, settings);
      rail.told = [];
      await stage.act("alice command 1 5: leave");
      await stage.act("after 10");
      await stage.act("bob stop 7");
      for (const count of later.keys()) {
        await passUntil(stage, "it moves", () => rail.told.filter((told) => told === "moves").length > count);
        const took = await passUntil(stage, "it stands", () => rail.speed === 0 || rail.told.filter((told) => told === "moves").length > count + 1);
        assert.ok(took <= cart.stoppingTime / 1000 + REST + PERIOD, `${later}: ${took} ms`);
      }
      stage.heard();
      await stage.act("rests");
      const { stopped, rest } = stage.server.state();
      assert.deepEqual([rail.speed, stopped, rest, rail.told.at(-1)], [0, true, "measured", "halt"], `${later}`);
    }
  });
}

/** A cart whose velocity `slow` ends when the test has it end, and heeds no signal. */
async function slowCart() {
  const ends = {};
  const cart = machine({ stopsWithin: 300 });
  cart.spec.verbs.slow = verb.velocity("Ends when it likes", { speed: number() }, ({ speed }) => {
    cart.rail.told.push(speed);
    cart.rail.speed = speed;
    return new Promise((resolve) => (ends[speed] = resolve));
  });
  cart.verbs.push("slow");
  const stage = await Stage.of(cart, settings);
  const acts = async (...lines) => {
    for (const line of lines) await stage.act(line);
    return cart.rail.told.splice(0);
  };
  await acts();
  const errors = () => stage.heard().filter((line) => / error /.test(line));
  return { stage, cart, ends, acts, errors };
}

test("a velocity waits for the one before it until that has ended, for the stopping time at most", async () => {
  const { stage, cart, ends, acts, errors } = await slowCart();
  assert.deepEqual(await acts("alice command 1 5: slow 50", "after 100", "alice command 2 5: slow 60", "after 100"), [50]);
  ends[50]();
  await stage.settle();
  assert.deepEqual(await acts("after 0"), [60], "at once, and without a halt");
  // This one does not end: it is halted when its time is over.
  assert.deepEqual(await acts("alice command 3 5: slow 70", "after 299"), []);
  assert.deepEqual(await acts("after 1"), ["halt", 70]);
  assert.equal(cart.rail.speed, 70);
  // It has its time once, however many wait behind it.
  assert.deepEqual(await acts("alice command 4 5: slow 80", "after 200", "alice command 5 5: slow 90", "after 99"), []);
  assert.deepEqual(await acts("after 1"), ["halt", 90]);
  assert.deepEqual(errors(), []);
  // What is not waited for any more is halted all the same when it ends.
  for (const speed of [60, 70]) {
    ends[speed]();
    await stage.settle();
    assert.deepEqual(await acts(), ["halt"]);
  }
  ends[90]();
  await stage.settle();
  assert.deepEqual(await acts("after 0"), ["halt"]);
  await stage.act("rests");
  assert.deepEqual([errors(), stage.server.state().executing], [[], undefined]);
});

test("behind what was halted and does not end no velocity begins, and many do not wait longer than one", async () => {
  const { acts, errors } = await slowCart();
  await acts("alice command 1 5: slow 50", "hub halt");
  errors();
  assert.deepEqual(await acts("alice command 2 5: slow 60", "after 600", "alice command 3 5: slow 70", "after 399"), []);
  assert.deepEqual(errors(), []);
  await acts("after 1");
  assert.deepEqual(errors(), ["status alice/3 error 1/1 link 5003"]);
  // Nor does anything else behind velocities of which one goes on.
  const other = await slowCart();
  await other.acts("alice command 1 5: slow 50", "alice command 2 5: slow 60", "after 300");
  assert.deepEqual(await other.acts("alice command 3 5: go 100", "after 999"), ["halt"]);
  assert.deepEqual(other.errors(), []);
  await other.acts("after 1");
  assert.deepEqual(other.errors(), ["status alice/3 error 1/1 link 5003"]);
});
