// The robot of the README, as it stands there, at a broker that floods it, freezes, and is killed.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import test from "node:test";
import { setTimeout as sleep } from "node:timers/promises";
import { WebSocket } from "ws";
import { connect } from "../dist/mom-client.js";
import { as, startLab, until } from "./lab.mjs";

const [, example] = /## A robot\n[\s\S]*?```js\n([\s\S]*?)```/.exec(readFileSync(new URL("../README.md", import.meta.url), "utf8"));
const LOST = "the connection to the hub is silent or lost";

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
  const lines = example.replace(/^import .*$/m, "").replace("mom://lab.example.org", `ws://127.0.0.1:${lab.port}`).replace('"secret"', '"arm"');
  const AsyncFunction = (async () => undefined).constructor;
  const robot = async () => {
    const made = { told: [] };
    const motors = { brake: (why) => made.told.push(why), drive: (command) => made.told.push(command), position: () => 7 };
    const mine = async (address, options) => {
      made.client = await connect(address, { ...options, webSocket: WebSocket });
      t.after(() => made.client.close());
      return made.client;
    };
    await new AsyncFunction("connect", "motors", "setInterval", lines)(mine, motors, () => undefined);
    return made;
  };
  const alice = await open("alice");
  const arm = await alice.channel("/robot/arm");
  return { lab, open, robot, alice, arm, events: arm.events(), guard: await (await alice.token("/robot/token")).grab() };
}

/** Has the robot carry out a command, as soon as it knows that it may move. */
async function drives({ arm, guard }, { told }, command) {
  await eventually(async () => {
    await arm.sendAcknowledged("command", command, { fence: guard.fence });
    return told.includes(command);
  });
}

test("it fits 25 lines, and obeys", async (t) => {
  assert.ok(example.trimEnd().split("\n").length <= 25);
  const at = await scene(t);
  const robot = await at.robot();
  await drives(at, robot, "home");
  const { channels } = await at.alice.stop("/robot");
  assert.equal(channels.find(({ path }) => path === "/robot/arm").devices[0].word, "stopped");
  const { content } = await until(at.events, (event) => event.type === "message" && event.name === "state" && event.content.stopped);
  assert.equal(content.position, 7);
  await at.alice.unstop("/robot/arm", content.stop);
  await drives(at, robot, "up");
});

test("it obeys a stop behind 1 100 messages", async (t) => {
  const at = await scene(t);
  const robot = await at.robot();
  await drives(at, robot, "home");
  const bob = await at.open("bob");
  const chatter = await bob.channel("/robot/arm");
  const said = Array.from({ length: 1100 }, (_, count) => chatter.send("note", count, { echo: false }));
  const stopped = chatter.send("stop", "smoke", { echo: false });
  await eventually(() => robot.told.some((why) => /^stopped by .*: smoke$/.test(why)));
  await Promise.all([...said, stopped]);
  await at.arm.sendAcknowledged("command", "up", { fence: at.guard.fence });
  const { content } = await until(at.events, (event) => event.type === "message" && event.name === "status");
  assert.equal(content.error.name, "stopped");
  assert.ok(!robot.told.includes("up"));
});

test("it halts where the hub freezes, and moves again when it hears how it stands", async (t) => {
  const at = await scene(t);
  const robot = await at.robot();
  await drives(at, robot, "home");
  at.lab.signal("SIGSTOP");
  await eventually(() => robot.told.includes(LOST));
  at.lab.signal("SIGCONT");
  await eventually(() => robot.client.state.state === "connected");
  await drives(at, robot, "up");
});

test("it halts where the hub is killed", async (t) => {
  const at = await scene(t);
  const robot = await at.robot();
  await drives(at, robot, "home");
  at.lab.signal("SIGKILL");
  await eventually(() => robot.told.includes(LOST));
});

test("it finds a stop that was said while it was away", async (t) => {
  const at = await scene(t);
  const before = await at.robot();
  await drives(at, before, "home");
  await before.client.close();
  const { channels } = await at.alice.stop("/robot/arm", { reason: "smoke" });
  assert.deepEqual(channels[0].devices, []);
  const robot = await at.robot();
  await at.arm.sendAcknowledged("command", "up", { fence: at.guard.fence });
  const { content } = await until(at.events, (event) => event.type === "message" && event.name === "status");
  assert.equal(content.error.name, "stopped");
  await at.alice.unstop("/robot/arm", channels[0].number);
  await drives(at, robot, "down");
  assert.ok(!robot.told.includes("up"));
});
