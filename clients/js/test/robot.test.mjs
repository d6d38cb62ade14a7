// The robot of the README, as it stands there, at a broker that floods it, freezes, and is killed.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import test from "node:test";
import { setTimeout as sleep } from "node:timers/promises";
import { WebSocket } from "ws";
import * as kit from "../dist/device.js";
import { connect } from "../dist/mom-client.js";
import { as, startLab, until } from "./lab.mjs";

const [, example] = /## A robot\n[\s\S]*?```js\n([\s\S]*?)```/.exec(readFileSync(new URL("../README.md", import.meta.url), "utf8"));

const eventually = async (holds) => {
  for (const end = Date.now() + 20_000; !(await holds()); await sleep(5)) assert.ok(Date.now() < end, `waited for ${holds}`);
};

/** A broker of the test's own, its owner who drives, and robots that begin as the README has them. */
async function scene(t) {
  const lab = await startLab();
  t.after(async () => {
    // One that is frozen ends when it goes on.
    lab.signal("SIGCONT");
    await lab.stop();
  });
  const open = async (user, options) => {
    const client = await connect(`ws://127.0.0.1:${lab.port}`, as(user, options));
    t.after(() => client.close());
    return client;
  };
  const lines = example.replace(/^import .*$/gm, "").replace("mom://lab.example.org", `ws://127.0.0.1:${lab.port}`).replace('"secret"', '"arm"');
  const AsyncFunction = (async () => undefined).constructor;
  const robot = async () => {
    const made = { told: [] };
    const motors = { brake: () => made.told.push("brake"), driveTo: async (x) => made.told.push(x), speed: (speed) => made.told.push(speed), position: () => 7 };
    const mine = async (address, options) => {
      made.client = await connect(address, { ...options, webSocket: WebSocket });
      t.after(() => made.client.close());
      return made.client;
    };
    const { device, number, sleep, verb } = kit;
    // Signals of this process are none of the robot's: program.test.mjs has it in one of its own.
    const runs = (obeying) => obeying;
    const names = ["connect", "device", "number", "runs", "sleep", "verb", "motors"];
    made.obeying = await new AsyncFunction(...names, `${lines}\nreturn obeying;`)(mine, device, number, runs, sleep, verb, motors);
    return made;
  };
  const alice = await open("alice");
  const arm = await alice.channel("/robot/arm");
  return { lab, open, robot, alice, arm, events: arm.events(), guard: await (await alice.token("/robot/token")).grab() };
}

/** Has the robot drive to a place, as soon as it knows that it may move. */
async function drives({ arm, guard }, { told }, x) {
  await eventually(async () => {
    await arm.sendAcknowledged("command", `go ${x}`, { fence: guard.fence });
    return told.includes(x);
  });
}

/** How a command was refused, by its script. */
async function refusal({ arm, guard, events }, script) {
  await arm.sendAcknowledged("command", script, { fence: guard.fence });
  return (await until(events, (event) => event.type === "message" && event.name === "status" && event.content.error)).content.error;
}

test("it fits 20 lines, and obeys", async (t) => {
  assert.ok(example.trimEnd().split("\n").filter(Boolean).length <= 20);
  const at = await scene(t);
  const robot = await at.robot();
  await drives(at, robot, 10);
  const { channels } = await at.alice.stop("/robot");
  const [{ word, rest }] = channels.find(({ path }) => path === "/robot/arm").devices;
  assert.deepEqual([word, rest], ["stopped", "measured"]);
  const { content } = await until(at.events, (event) => event.type === "message" && event.name === "state" && event.content.stopped);
  assert.equal(content.x, 7);
  await at.alice.unstop("/robot/arm", content.stop);
  await drives(at, robot, 20);
});

test("its card is shown at the hub", async (t) => {
  const { robot, alice } = await scene(t);
  assert.equal(await alice.card("/robot/arm"), undefined);
  await robot();
  const card = await alice.card("/robot/arm");
  assert.deepEqual([card.card, card.verbs.some(({ name, moves }) => name === "go" && moves)], [1, true]);
});

test("what it says of a wrong script names the statement, the argument and its range", async (t) => {
  const at = await scene(t);
  await drives(at, await at.robot(), 10);
  const { name, code, text } = await refusal(at, "jog 5; go 2000");
  assert.deepEqual([name, code, text], ["syntax", 5001, "statement 2: x is a number from -1000 to 1000 (mm), not `2000`"]);
});

test("its owner jogs it by velocities, each from where the one before has led, and it brakes behind the last", async (t) => {
  const at = await scene(t);
  const robot = await at.robot();
  await drives(at, robot, 10);
  await eventually(() => robot.obeying.state().rest);
  robot.told.length = 0;
  for (const speed of [50, 60, 70]) {
    await at.arm.sendAcknowledged("command", `jog ${speed}`, { fence: at.guard.fence });
    await eventually(() => robot.told.includes(speed));
  }
  await eventually(() => robot.told.includes("brake"));
  await eventually(() => robot.obeying.state().rest);
  assert.deepEqual(robot.told, [50, 60, 70, "brake"]);
});

test("the first motion of a new owner waits until it has measured that it rests", async (t) => {
  const at = await scene(t);
  const robot = await at.robot();
  await drives(at, robot, 10);
  await at.guard.release();
  const bob = await at.open("bob");
  const guard = await (await bob.token("/robot/token")).grab();
  await at.arm.sendAcknowledged("command", "go 30", { fence: guard.fence - 1 }).catch(() => undefined);
  await (await bob.channel("/robot/arm")).sendAcknowledged("command", "go 40", { fence: guard.fence });
  await eventually(() => robot.told.includes(40));
  const { content } = await until(at.events, (event) => event.type === "message" && event.name === "state" && event.content.fence === guard.fence && event.content.rest);
  assert.equal(content.rest, "measured");
  assert.ok(!robot.told.includes(30));
});

test("it obeys a stop behind 1 100 messages", async (t) => {
  const at = await scene(t);
  const robot = await at.robot();
  await drives(at, robot, 10);
  const bob = await at.open("bob");
  const chatter = await bob.channel("/robot/arm");
  const said = Array.from({ length: 1100 }, (_, count) => chatter.send("note", count, { echo: false }));
  const stopped = chatter.send("stop", "smoke", { echo: false });
  await eventually(() => /^stopped by .*: smoke$/.test(robot.obeying.mayMove()?.text));
  assert.equal(robot.told.at(-1), "brake");
  await Promise.all([...said, stopped]);
  assert.equal((await refusal(at, "go 20")).name, "stopped");
  assert.ok(!robot.told.includes(20));
});

test("it halts where the hub freezes, and moves again when it hears how it stands", async (t) => {
  const at = await scene(t);
  const robot = await at.robot();
  await drives(at, robot, 10);
  robot.told.length = 0;
  at.lab.signal("SIGSTOP");
  await eventually(() => robot.told.includes("brake"));
  assert.equal(robot.obeying.mayMove().held, "unknown");
  at.lab.signal("SIGCONT");
  await eventually(() => robot.client.state.state === "connected");
  await drives(at, robot, 20);
});

test("it halts where the hub is killed", async (t) => {
  const at = await scene(t);
  const robot = await at.robot();
  await drives(at, robot, 10);
  robot.told.length = 0;
  at.lab.signal("SIGKILL");
  await eventually(() => robot.told.includes("brake"));
  assert.equal(robot.obeying.mayMove().held, "unknown");
});

test("it finds a stop that was said while it was away", async (t) => {
  const at = await scene(t);
  const before = await at.robot();
  await drives(at, before, 10);
  await before.client.close();
  const { channels } = await at.alice.stop("/robot/arm", { reason: "smoke" });
  assert.deepEqual(channels[0].devices, []);
  const robot = await at.robot();
  assert.equal((await refusal(at, "go 20")).name, "stopped");
  await at.alice.unstop("/robot/arm", channels[0].number);
  await drives(at, robot, 30);
  assert.ok(!robot.told.includes(20));
});
