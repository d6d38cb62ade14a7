// A declared device: what every device does alike, its scripts, its card, and what it does where its functions fail.
import assert from "node:assert/strict";
import test from "node:test";
import { DeviceError, attachment, device, encode, number, readScript, verb, whole } from "../dist/test/internals.js";
import { Rail, RailMachine, SPEED, machine, settings, specOf } from "./rail.mjs";
import { Stage, check, replay } from "./stage.mjs";

const STATEMENTS = { go: "go 100", back: "go 0", wrong: "og 100", beyond: "go 1001", "beyond-error": "workspace-boundary 5002", relative: "by 20", velocity: "jog 50" };

/** A cart with an emergency stop of its own. */
function withButton(more) {
  const cart = machine({ ...more, estop: () => cart?.isPressed ?? false });
  cart.isPressed = false;
  return cart;
}

test("a declared cart does what every device does", async () => {
  const played = await replay(() => withButton(), STATEMENTS, settings);
  assert.ok(played >= 58, `${played} dialogues`);
});

test("a declared cart that completes its statement does so too", async () => {
  const played = await replay(() => withButton({ completesOnGive: true }), STATEMENTS, settings);
  assert.ok(played >= 62, `${played} dialogues`);
});

const refusal = (script) => {
  try {
    return readScript(script, machine());
  } catch (error) {
    return error.content();
  }
};

test("what is wrong in a script is told by its statement, its argument, the range and the nearest verb", () => {
  for (const [script, text, more = {}] of [
    ["wait 1; og 5", "statement 2: there is no `og`; did you mean `go`?", { nearest: "go", position: 8, line: 1, column: 9 }],
    ["go", "statement 1: `go` takes x; x is missing"],
    ["go far", "statement 1: x is a number (mm), not `far`"],
    ["by 101", "statement 1: way is a number from -100 to 100 (mm), not `101`"],
    ["wait 1\nbeep 1.5", "statement 2: times is a whole number from 1 to 3, not `1.5`", { line: 2, column: 6 }],
    ["beep 1 2", "statement 1: `beep` ends before `2`; is a `;` or a new line missing?"],
    ["grip clos", "statement 1: how is one of open, close, not `clos`; did you mean `close`?", { nearest: "close" }],
    ["play horn", "statement 1: `horn` did not come with the script: it has no attachments"],
    ["toString", "statement 1: there is no `toString`; did you mean `grip`?"],
    ["wait 60001", "statement 1: `wait` takes a whole number of ms from 0 to 60000, not `60001`"],
    ["jog 10; beep; jog 20", "statement 1: `jog` stands alone in its script", { position: 0, line: 1, column: 1 }],
    ["beep;\n jog 10", "statement 2: `jog` stands alone in its script", { position: 7, line: 2, column: 2 }],
    ["# nothing", "the script has no statement", { position: 0 }],
    [" ".repeat(65_537), "the script has 65537 bytes, at most 65536 are read"],
    ["beep;".repeat(1001), "the script has more than 1000 statements"],
  ]) {
    const content = refusal(script);
    assert.deepEqual([content.name, content.code], ["syntax", 5001], script);
    if (script !== "toString") assert.match(content.text, new RegExp(`${text.replace(/[.?*+^$()[\]]/g, "\\$&")}$`));
    for (const [key, value] of Object.entries(more)) assert.equal(content[key], value, `${script}: ${key}`);
  }
});

test("a function gets what its declaration says, and bytes for an attachment", async () => {
  const cart = machine();
  const stage = await Stage.of(cart, settings);
  const content = { script: "beep; beep 3; grip open; play horn # so", attachments: { horn: new Uint8Array(7) } };
  const parcel = { family: "message", name: "command", sender: "alice", context: "/robot/arm", id: 1, fence: 5, content };
  await stage.tell({ type: "message", name: "command", sender: "alice", content, history: false, parcel });
  await stage.act("ends");
  assert.deepEqual(cart.rail.told.filter((word) => word !== "halt"), ["beep 1", "beep 3", "open", "7 bytes"]);
});

test("the card says what it can do, and nothing that says nothing", () => {
  const rail = new Rail();
  const state = { x: number({ unit: "mm", does: "Where it is" }) };
  const card = device("cart", specOf(rail, { stopsWithin: 500, state, cameras: ["/camera/x"] })).card();
  assert.deepEqual(card, {
    card: 1,
    name: "cart",
    does: "A cart on a rail",
    verbs: [
      { name: "go", does: "Drives to a place", args: [{ name: "x", type: "number", unit: "mm" }], moves: true },
      { name: "by", does: "Drives so far", args: [{ name: "way", type: "number", unit: "mm", min: -100, max: 100 }], moves: true, relative: true },
      { name: "jog", does: "Drives so fast", args: [{ name: "speed", type: "number", unit: "mm/s" }], moves: true, velocity: true },
      { name: "beep", does: "Says so", args: [{ name: "times", type: "whole", min: 1, max: 3, default: 1 }], moves: false },
      { name: "grip", does: "Opens or closes", args: [{ name: "how", type: "word", choices: ["open", "close"] }], moves: true },
      { name: "play", does: "Plays a sound", args: [{ name: "sound", type: "attachment" }], moves: false },
    ],
    state: [{ name: "x", type: "number", unit: "mm", does: "Where it is" }],
    "stops-within": 500,
    "on-loss": "halt",
    cameras: ["/camera/x"],
  });
});

test("a device without a halt or a position is refused when it is made, and so are verbs that no script could name", () => {
  const rail = new Rail();
  const none = () => undefined;
  for (const [more, why] of [
    [{ halt: undefined }, /no function `halt`/],
    [{ position: undefined }, /no function `position`/],
    [{ verbs: { wait: verb("Waits", {}, none) } }, /wait/],
    [{ verbs: { "go on": verb("Goes on", {}, none) } }, /go on/],
    [{ verbs: { go: verb("Goes", { 1: number() }, none) } }, /argument of `go`/],
    [{ verbs: { go: verb("Goes", { x: number({ default: 1 }), y: number() }, none) } }, /y needs a default/],
    [{ verbs: { go: verb("Goes", {}, "no function") } }, /`go` has no function/],
    [{ verbs: { go: verb("Goes", {}, async function* () {}) } }, /`go` has .* a generator, which does nothing/],
    [{ verbs: { go: verb("Goes", {}, function* () {}) } }, /`go` has .* a generator, which does nothing/],
  ]) {
    assert.throws(() => device("cart", specOf(rail, more)), why);
  }
});

/** What is said from here on. */
const plays = (stage, dialogue) => check(stage, "declared", dialogue);

test("a function that fails ends its command, halts, and is logged", async () => {
  for (const [thrown, error] of [[new Error("no power"), "link 5003"], [new DeviceError("battery", "it is empty"), "battery 5111"]]) {
    let cart;
    const fails = {
      go: verb("Fails", {}, async (_, signal) => {
        await cart.rail.sleep(1000, signal);
        throw thrown;
      }),
      now: verb("Fails at once", {}, () => {
        throw thrown;
      }),
    };
    for (const name of Object.keys(fails)) {
      cart = machine({ verbs: fails });
      const stage = await Stage.of(cart, settings);
      cart.rail.told = [];
      await stage.act(`alice command 1 5: ${name}; wait 5`);
      await stage.act("alice command 2 5: wait 5");
      await stage.act("ends");
      assert.deepEqual(stage.heard().filter((line) => / error /.test(line)), [`status alice/1 error 1/2 ${error}`, ...(name === "go" ? ["status alice/2 error 0/1 halted 5101"] : [])]);
      assert.ok(cart.rail.told.includes("halt"));
      assert.deepEqual(cart.logged, [`\`${name}\` failed`]);
    }
  }
});

test("a signal is aborted before the device is halted, and no function begins before the one before it has ended", async () => {
  const told = [];
  let let1End;
  const verbs = {
    go: verb("Ends late", { n: whole() }, ({ n }, signal) => {
      told.push(`go ${n}`);
      signal.addEventListener("abort", () => told.push(`abort ${n}`));
      return new Promise((resolve) => {
        if (n === 1) let1End = resolve;
      });
    }),
  };
  const cart = machine({ verbs, halt: () => told.push("halt") });
  const stage = await Stage.of(cart, settings);
  told.length = 0;
  await plays(stage, `alice command 1 5: go 1
    > status alice/1 waiting 0/1
    > status alice/1 executing 1/1
    hub halt
    > state free moving
    > status alice/1 error 1/1 halted 5101
    after 5000
    > state free moving
    alice command 2 5: go 2
    > status alice/2 waiting 0/1
    > status alice/2 executing 1/1`);
  // Again and again as long as it goes on: it may move the device meanwhile.
  assert.deepEqual(told.splice(3), ["halt", "halt", "halt"]);
  let1End();
  await stage.settle();
  assert.deepEqual(told, ["go 1", "abort 1", "halt", "halt", "go 2"]);
  // And where it does not end at all, the next one fails.
  await stage.act("hub halt");
  stage.heard();
  await plays(stage, `alice command 3 5: go 3
    > status alice/3 waiting 0/1
    > status alice/3 executing 1/1
    after 1000
    > state free moving
    > status alice/3 error 1/1 link 5003`);
  assert.deepEqual(told.slice(5), ["abort 2", "halt", "halt"]);
});

test("a velocity is halted at its end and before anything else, and goes on into the next one", async () => {
  const cart = machine();
  const stage = await Stage.of(cart, settings);
  cart.rail.told = [];
  await stage.act("alice command 1 5: jog 50");
  await stage.act("after 100");
  await stage.act("alice command 2 5: jog 70");
  assert.deepEqual([cart.rail.told, cart.rail.speed], [[], 70]);
  await stage.act("ends");
  assert.deepEqual([cart.rail.told, cart.rail.speed], [["halt"], 0]);
  await stage.act("alice command 3 5: jog 50");
  await stage.act("alice command 4 5: wait 100");
  await stage.act("after 1");
  assert.deepEqual([cart.rail.told, cart.rail.speed], [["halt", "halt"], 0]);
  await stage.act("ends");
  await stage.act("alice command 5 5: jog 50");
  await stage.act("alice command 6 5: go 100");
  // At its end as something else begins, and when its function has ended.
  assert.deepEqual([cart.rail.told.length, cart.rail.speed], [4, SPEED]);
});

test("what has to be known at once must not be a promise", async () => {
  const cart = machine({ position: async () => ({ x: 1 }) });
  assert.deepEqual([cart.position(), cart.isReached(), cart.logged.length], [{}, false, 1]);
  const planner = machine({ plan: async () => Promise.reject(new Error("late")) });
  const stage = await Stage.of(planner, settings);
  await plays(stage, `alice command 1 5: go 5
    > status alice/1 error 0/0 link 5003`);
});

test("where its halt or its position fails nothing is known of it any more, and it takes no command", async () => {
  for (const method of ["halt", "position", "report"]) {
    let fails = false;
    const rail = new Rail();
    const well = specOf(rail, { report: () => ({}) });
    const breaks = () => {
      if (fails) throw new Error("no bus");
      return well[method]();
    };
    const cart = new RailMachine(rail, { report: () => ({}), [method]: breaks });
    const stage = await Stage.of(cart, settings);
    await stage.act("alice command 1 5: go 100");
    await stage.act("after 100");
    fails = true;
    await stage.act("hub halt");
    await stage.act("after 2000");
    assert.equal(cart.broken.error.message, "no bus");
    assert.deepEqual(cart.logged, [`its ${method} failed, and it obeys no more`]);
    const state = stage.server.state();
    assert.deepEqual([state.reached, state.moving, state.rest, state.executing], [false, true, undefined, undefined], method);
    stage.heard();
    await stage.act("alice command 2 5: go 0");
    assert.deepEqual(stage.heard(), ["status alice/2 error 0/0 link 5003"]);
  }
});

test("what a function does after the device was halted is halted once more when it has ended, however late", async () => {
  for (const [how, late] of [["resolve", 1], ["reject", 1], ["resolve", 60_000]]) {
    const cart = machine();
    let ends;
    cart.spec.verbs.late = verb("Actuates late", {}, async () => {
      await new Promise((resolve) => (ends = resolve));
      cart.rail.speed = 300;
      if (how === "reject") throw new Error("so late");
    });
    cart.verbs.push("late");
    const stage = await Stage.of(cart, settings);
    await stage.act("alice command 1 5: late");
    await stage.act("bob stop 1");
    await stage.act(`after ${late}`);
    cart.rail.told = [];
    ends();
    await stage.settle();
    assert.deepEqual([cart.rail.speed, cart.rail.told], [0, ["halt"]], `${how} ${late}`);
    assert.equal(stage.server.state().rest, undefined);
    await stage.act("rests");
  }
});

test("a velocity that has waited in vain for another function never begins", async () => {
  const cart = machine();
  let ends;
  cart.spec.verbs.late = verb("Ends late", {}, () => new Promise((resolve) => (ends = resolve)));
  const stage = await Stage.of(cart, settings);
  for (const line of ["alice command 1 5: late", "hub halt", "alice command 2 5: jog 50", "alice command 3 5: wait 500", "after 100"]) await stage.act(line);
  ends();
  await stage.settle();
  assert.equal(cart.rail.speed, 0);
});

test("what moves by itself is said to move, and no command that is based on a state of it is obeyed", async () => {
  const push = async (stage, cart) => {
    await stage.act("after 140");
    cart.rail.x += 50;
  };
  const rolls = async (_, cart) => (cart.rail.speed = 40);
  const lies = async (stage, cart) => {
    cart.spec.verbs.beep = verb.instant("Moves it all the same", {}, () => void (cart.rail.speed = 40));
    await stage.act("alice command 1 5: beep");
    await stage.act("ends");
  };
  for (const [name, moves, still] of [["pushed", push, true], ["rolls", rolls], ["lies", lies]]) {
    const cart = machine();
    const stage = await Stage.of(cart, settings);
    stage.heard();
    await moves(stage, cart);
    await stage.act("after 150");
    const { moving, rest } = stage.server.state();
    assert.deepEqual([moving, rest], [true, undefined], name);
    const lines = stage.heard();
    assert.ok(lines.includes("state free moving"), `${name}: ${lines}`);
    await stage.act("alice command 2 5 on newest: by 20");
    assert.ok(stage.heard().includes("status alice/2 error 0/0 stale-state 208"), name);
    const told = stage.states.length;
    await stage.act("after 200");
    stage.heard();
    assert.ok(stage.states.length >= told + 3, `${name}: states follow`);
    cart.rail.speed = 0;
    await stage.act("after 400");
    assert.deepEqual([stage.server.state().moving, stage.server.state().rest], [false, "measured"], name);
    if (still) continue;
    // And before it was looked at.
    cart.rail.x -= 50;
    await stage.act("alice command 3 5 on newest: by 20");
    assert.ok(stage.heard().includes("status alice/3 error 0/0 stale-state 208"), name);
  }
});

test("what rolls on behind its command is said to move from the first", async () => {
  const cart = machine();
  cart.spec.verbs.go = verb("Rolls on", { x: number() }, async (_, signal) => {
    cart.rail.speed = 40;
    await cart.rail.sleep(200_000, signal);
  });
  const stage = await Stage.of(cart, settings);
  await stage.act("alice command 1 5: go 100");
  await stage.act("ends");
  assert.equal(stage.server.state().moving, true);
  stage.heard();
  await stage.act("alice command 2 5 on newest: by 20");
  assert.deepEqual(stage.heard(), ["status alice/2 error 0/0 stale-state 208"]);
});

test("until a promise of halt is fulfilled it moves, and nothing begins; one that is late has commands refused", async () => {
  const ends = [];
  const rail = new Rail();
  const cart = new RailMachine(rail, { stopsWithin: 500, halt: () => new Promise((resolve) => ends.push(resolve)) });
  const stage = new Stage(cart, settings);
  for (const line of ["told 0", "grabbed 5", "after 400"]) await stage.act(line);
  assert.deepEqual([stage.server.state().moving, stage.server.state().rest], [true, undefined]);
  for (const end of ends.splice(0)) end();
  await stage.settle();
  await stage.act("rests");
  await stage.act("hub halt");
  await stage.act("alice command 1 5: beep");
  await stage.act("after 400");
  assert.deepEqual([stage.server.state().moving, stage.server.state().rest, rail.told], [true, undefined, []]);
  for (const end of ends.splice(0)) end();
  await stage.settle();
  assert.deepEqual(rail.told, ["beep 1"]);
  await stage.act("rests");
  await stage.act("hub halt");
  stage.heard();
  await stage.act("alice command 2 5: beep");
  await stage.act("after 1499");
  assert.ok(!stage.heard().some((line) => / error /.test(line)));
  await stage.act("after 1");
  assert.ok(stage.heard().includes("status alice/2 error 1/1 link 5003"));
  await stage.act("after 1500");
  stage.heard();
  await stage.act("alice command 3 5: beep");
  assert.deepEqual(stage.heard().filter((line) => / error /.test(line)), ["status alice/3 error 0/0 link 5003"]);
  for (const end of ends.splice(0)) end();
  await stage.settle();
  await stage.act("rests");
  await stage.act("alice command 4 5: beep");
  assert.deepEqual(rail.told, ["beep 1", "beep 1"]);
});

test("no key of the kit's own is overwritten by what an author says", async () => {
  const own = { seq: -1, moving: "no", rest: "measured", reached: 0, stopped: 0, stop: 9, executing: {}, waiting: -1, fence: 99, "stops-within": 1 };
  const stage = await Stage.of(machine({ report: () => ({ ...own, battery: 5 }) }), settings);
  await stage.act("hub halt");
  await stage.act("bob stop 1");
  stage.heard();
  const { said } = stage;
  assert.equal(said.battery, 5);
  for (const [key, value] of Object.entries(own)) if (key !== "rest") assert.notDeepEqual(said[key], value, key);
});

test("an emergency stop that does not say whether it is pressed ends the device as what throws does", async () => {
  for (const wrong of [() => undefined, () => "no", async () => false, () => { throw new Error("no input"); }]) {
    let fails = false;
    const cart = machine({ estop: () => (fails ? wrong() : 0) });
    const stage = await Stage.of(cart, settings);
    assert.equal(stage.said.estop, false, "an input may say so by a number");
    fails = true;
    await stage.act("alice command 1 5: go 100");
    stage.heard();
    assert.ok(cart.broken, String(wrong));
    assert.equal(stage.server.state().reached, false);
  }
});

test("a device without a position is looked at for its emergency stop too", async () => {
  let isPressed = false;
  const cart = machine({ position: () => ({}), estop: () => isPressed });
  const stage = await Stage.of(cart, settings);
  await stage.act("after 5000");
  stage.heard();
  isPressed = true;
  await stage.act("after 150");
  assert.deepEqual(stage.heard(), ["state stopped estop at rest"]);
});

test("what cannot be said ends the device as what throws does", async () => {
  const cyclic = { list: [] };
  cyclic.list.push(cyclic, cyclic);
  const deep = Array.from({ length: 40 }).reduce((inner) => [inner], 1);
  const unsayable = [Infinity, -Infinity, NaN, "a\u0000b", "\ud800", () => 1, cyclic, deep, "x".repeat(2 << 20), 1n << 70n, new Date(NaN), [undefined], Symbol("s")];
  for (const value of unsayable) {
    for (const method of ["report", ...(typeof value === "number" ? ["position"] : [])]) {
      let fails = false;
      const cart = machine({ [method]: () => ({ x: fails ? value : 0 }) });
      const stage = await Stage.of(cart, settings);
      await stage.act("alice command 1 5: go 100");
      fails = true;
      await stage.act("after 100");
      assert.deepEqual(cart.logged.slice(0, 1), [`its ${method} failed, and it obeys no more`]);
      assert.deepEqual([cart.isReached(), stage.heard().filter((line) => / error /.test(line))], [false, ["status alice/1 error 1/1 link 5003"]], method);
      assert.equal(stage.said.x, 0);
    }
  }
});

test("errors and reasons are made sayable, so that each command ends", async () => {
  const pack = (content) => encode({ family: "message", name: "status", content });
  const without = Object.create(null);
  for (const thrown of [new Error("a\u0000b\ud800"), new DeviceError("link", "\u0007".repeat(1 << 24)), without, new DeviceError("obstacle", "near", { reachable: { x: NaN } })]) {
    const cart = machine();
    cart.spec.verbs.go = verb("Fails", {}, () => {
      throw thrown;
    });
    const stage = await Stage.of(cart, settings);
    await stage.act("alice command 1 5: go");
    const { content } = stage.out.find(({ content }) => content.state === "error");
    assert.ok(pack(content).length < 20_000);
    assert.equal(content.error.reachable, undefined);
  }
  const stage = await Stage.of(machine(), settings);
  stage.server.name = "arm";
  stage.server.stopItself("bumper\u0000", stage.now, stage.out);
  const stop = stage.out.find(({ name }) => name === "stop");
  assert.ok(pack(stop.content));
  assert.match(stop.content.reason, /bumper\ufffd/);
});
