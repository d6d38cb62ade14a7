// What a device makes of stops: the cases that all clients replay (tests/cases), and a device at a hub of the test's.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import test from "node:test";
import { setTimeout as sleep } from "node:timers/promises";
import { WebSocket } from "ws";
import { Latch, connect } from "../dist/mom-client.js";
import { FakeHub } from "./fakehub.mjs";

const cases = JSON.parse(readFileSync(new URL("../../../tests/cases/latch.json", import.meta.url), "utf8"));

function eventOf({ event, number, sender = "bob", stopped = false, only = [], except = [] }) {
  if (event === "stop" || event === "unstop") return { type: "message", name: event, sender, ...(number === undefined ? {} : { stop: number }) };
  if (event === "state") return { type: "stops", path: "/robot/arm", state: { number, stopped, only, except } };
  return { gap: { type: "lagged", count: 3 }, "link-down": { type: "link-down" }, resumed: { type: "other" } }[event];
}

test("the cases of all clients", async (t) => {
  assert.ok(cases.length >= 15);
  for (const { name, steps } of cases) {
    await t.test(name, () => {
      const latch = new Latch();
      for (const [at, step] of steps.entries()) {
        const turn = latch.observe(eventOf(step));
        assert.deepEqual([turn?.turn ?? null, latch.mayMove() === null, latch.number], [step.turn, step.moves, step.says], `step ${at}`);
      }
    });
  }
});

test("a latch says who stopped the device and why", () => {
  const latch = new Latch();
  assert.equal(latch.mayMove().held, "unknown");
  latch.observe({ type: "message", name: "stop", sender: "bob", content: "smoke", stop: 3 });
  assert.deepEqual(latch.mayMove(), { held: "stopped", text: "stopped by bob: smoke" });
  // The hub says it for another peer.
  latch.observe({ type: "message", name: "stop", sender: "hub", content: { by: "carol", reason: "fire" }, stop: 4 });
  assert.equal(latch.mayMove().text, "stopped by carol: fire");
  assert.deepEqual(latch.word(), { stop: 4, stopped: true });
});

test("a device hears how it stands also where the channel is heard already", async (t) => {
  const { arm } = await device(t, {}, { shared: true });
  await eventually(() => arm.mayMove() === null);
});

const eventually = async (holds) => {
  for (const end = Date.now() + 5000; !holds(); await sleep(5)) assert.ok(Date.now() < end, `waited for ${holds}`);
};

/** A device at a fake hub, what its machine was told, and what the hub hears of its messages. */
async function device(t, options = {}, settings = {}) {
  const hub = await FakeHub.start(settings);
  t.after(() => hub.stop());
  const told = [];
  let stop = { number: 0, stopped: false };
  hub.onParcel = (connection, parcel) => {
    const joins = parcel.name === "join" && parcel.context === "/robot/arm";
    if (joins) connection.reply(parcel, { path: parcel.context, kind: "channel", number: 7, stop });
    else hub.answer(connection, parcel);
  };
  const client = await connect(hub.url, { user: "alice", guest: true, webSocket: WebSocket, link: true, ...options });
  t.after(() => client.close());
  // Another subscriber of this client hears the channel already.
  if (settings.shared) void (await client.channel("/robot/arm")).events();
  const arm = await client.obey("/robot/arm", { halt: (why) => told.push(`halt: ${why}`), move: (command) => told.push(command), free: () => told.push("free"), state: () => ({ pose: told.length }) });
  const say = (name, more = {}) => hub.link.say({ family: "message", name, context: "/robot/arm", sender: "bob", ...more });
  const said = (name) => hub.heard.filter((parcel) => parcel.family === "message" && parcel.name === name);
  return { hub, client, arm, told, say, said, books: (next) => (stop = next) };
}

test("a device that is put out of its channel halts, says why it may not move, and obeys nothing that comes after it", async (t) => {
  const { hub, client, arm, told, say } = await device(t);
  await eventually(() => arm.mayMove() === null);
  // Another one that is put out does not concern this one.
  hub.link.say({ family: "event", name: "expelled", context: "/robot/arm", sender: "hub", content: { peer: "bob", text: "off" } });
  say("command", { content: "before" });
  hub.link.say({ family: "event", name: "expelled", context: "/robot/arm", sender: "hub", content: { peer: client.name, text: "arm~2 is the device here now" } });
  say("command", { content: "after" });
  await arm.ended;
  assert.deepEqual(told, ["before", "halt: it was expelled from its channel: arm~2 is the device here now"]);
  assert.deepEqual(arm.mayMove(), { held: "unknown", text: "it was expelled from its channel: arm~2 is the device here now" });
});

test("a device obeys stops by their numbers, and says after each how it stands", async (t) => {
  const { arm, told, say, said } = await device(t);
  await eventually(() => said("state").length === 1);
  assert.equal(arm.mayMove(), null);
  say("command", { content: "home" });
  await eventually(() => told.includes("home"));
  say("stop", { extra: { stop: 7 }, content: "smoke" });
  say("command", { content: "up", id: 9 });
  say("unstop", { extra: { stop: 6 } });
  await eventually(() => said("state").length === 3 && said("status").length === 1);
  assert.deepEqual(told, ["home", "halt: stopped by bob: smoke"]);
  const [{ content, reference }] = said("status");
  assert.deepEqual([content.state, content.error, reference], ["error", { name: "stopped", text: "stopped by bob: smoke" }, 9]);
  say("unstop", { extra: { stop: 7 } });
  await eventually(() => said("state").length === 4);
  assert.deepEqual(said("state").map((parcel) => [parcel.content.stopped, parcel.content.stop]), [[false, 0], [true, 7], [true, 7], [false, 7]]);
  assert.equal(told.at(-1), "free");
  assert.equal(arm.isStopped, false);
  // Only the hub may say this.
  say("halt");
  say("halt", { sender: "hub" });
  await eventually(() => told.at(-1) === "halt: safe state");
  assert.equal(told.filter((word) => word === "halt: safe state").length, 1);
});

test("a device tells its state to who joins, and to all where those are counted", async (t) => {
  const { hub, said } = await device(t);
  await eventually(() => said("state").length === 1);
  const event = (content) => hub.link.say({ family: "event", name: "joined", context: "/robot/arm", sender: "hub", content });
  event({ peer: "bob", user: "bob", level: 1 });
  await eventually(() => said("state").length === 2);
  event({ count: 300 });
  await eventually(() => said("state").length === 3);
  assert.deepEqual(said("state").map(({ address }) => address), [undefined, ["bob"], undefined]);
});

test("a device halts at a loss, moves when it has heard how it stands, and says what it knew when it joins again", async (t) => {
  const { hub, arm, told, say, said, books } = await device(t);
  say("stop", { extra: { stop: 5 } });
  await eventually(() => arm.isStopped);
  hub.cut();
  await eventually(() => told.includes("halt: the connection to the hub is silent or lost"));
  await eventually(() => arm.mayMove() && hub.logins.some(({ name }) => name === "answer"));
  assert.equal(arm.isStopped, true, "what stopped it holds over the loss");
  hub.link.say({ family: "event", name: "unstopped", context: "/robot/arm", sender: "hub", content: { number: 5, stopped: false } });
  await eventually(() => arm.mayMove() === null);
  say("stop", { extra: { stop: 8 } });
  await eventually(() => arm.isStopped);
  // The hub has forgotten the link, and the device joins anew.
  books({ number: 8, stopped: true, by: "bob" });
  hub.forgets = true;
  hub.cut();
  await eventually(() => hub.heard.filter(({ name, context }) => name === "join" && context === "/robot/arm").length === 2);
  const joins = hub.heard.filter(({ name, context }) => name === "join" && context === "/robot/arm");
  const words = joins.map(({ content }) => content.device);
  assert.deepEqual(words.map(({ stop, stopped }) => ({ stop, stopped })), [{ stop: 0, stopped: false }, { stop: 8, stopped: true }]);
  // It is the same installation, started when it was.
  assert.ok(words[0].installation);
  for (const key of ["installation", "begun"]) assert.deepEqual(words[1][key], words[0][key]);
  await eventually(() => said("state").at(-1).content.stop === 8 && arm.mayMove()?.held === "stopped");
});

test("a device takes a gap for a stop, says so to itself, and an unstop that names the number frees it", async (t) => {
  const { hub, arm, told, say, said } = await device(t, { eventBuffer: 2 });
  await eventually(() => said("state").length === 1);
  // So much comes at once that the oldest are not kept.
  const before = hub.link.connection.socket;
  before._socket.cork();
  for (let at = 0; at < 40; at++) say("map", { content: at });
  before._socket.uncork();
  await eventually(() => said("stop").length >= 1);
  const [{ address, content }] = said("stop");
  assert.deepEqual(address, ["alice"]);
  assert.match(content.reason, /^stopped by itself: it has missed \d+ events$/);
  assert.equal(arm.mayMove().held, "own");
  say("unstop", { extra: { stop: 50 } });
  await eventually(() => said("state").length >= 3);
  assert.equal(arm.isStopped, true, "that does not name its own stop");
  say("stop", { sender: "alice", extra: { stop: 51 }, content: content });
  say("unstop", { extra: { stop: 51 } });
  await eventually(() => arm.mayMove() === null);
  assert.ok(told.some((word) => /missed/.test(word)));
});

test("a device stops itself, and halts when the hub is silent or it leaves", async (t) => {
  const { hub, arm, told, said } = await device(t, {}, { heartbeat: 200 });
  arm.stopItself("bumper");
  await eventually(() => said("stop").length === 1);
  assert.deepEqual([said("stop")[0].content, told.at(-1)], [{ reason: "stopped by itself: bumper" }, "halt: bumper"]);
  hub.deaf = true;
  await eventually(() => told.at(-1) === "halt: the connection to the hub is silent or lost");
  hub.deaf = false;
  await arm.leave();
  assert.equal(told.at(-1), "halt: it is no longer a device of its channel");
});

test("a device whose machine fails halts it", async (t) => {
  const { arm, told, say } = await device(t);
  arm.machine.free = () => {
    throw new Error("no brake");
  };
  say("stop", { extra: { stop: 7 } });
  say("unstop", { extra: { stop: 7 } });
  await assert.rejects(arm.ended, /no brake/);
  assert.equal(told.at(-1), "halt: it is no longer a device of its channel");
});

test("what the hub says of stops is kept in a full queue, the newest of it", async (t) => {
  const { hub, client } = await device(t, { eventBuffer: 2 });
  const events = client.peer.events("/robot/arm");
  const tell = (name, number, only = []) => hub.link.say({ family: "event", name, context: "/robot/arm", sender: "hub", content: { number, stopped: name === "stopped", by: "bob", "unstopped-by": "carol", only } });
  for (const [name, number] of [["stopped", 1], ["unstopped", 1], ["stopped", 2]]) tell(name, number);
  // Of one device only: what is said of all holds beside it.
  tell("stopped", 3, ["belt"]);
  for (let at = 0; at < 9; at++) hub.link.say({ family: "message", name: "map", context: "/robot/arm", sender: "bob" });
  await client.lookup("/chat");
  const got = [];
  for (let event = events.tryNext(); event; event = events.tryNext()) if (event.type === "stops") got.push([event.state.number, event.state.stopped, event.state.by, event.unstoppedBy]);
  assert.deepEqual(got, [[1, false, "bob", "carol"], [2, true, "bob", "carol"], [3, true, "bob", "carol"]]);
});

test("a device whose program stood still moves by nothing that came meanwhile", async (t) => {
  const { hub, arm, told, say, said } = await device(t);
  await eventually(() => said("state").length === 1);
  // As if it had not run for a while: what is there then is older than the link lives.
  const { now } = performance;
  t.after(() => delete performance.now);
  performance.now = () => now.call(performance) + 4 * hub.heartbeat;
  say("command", { content: "up" });
  await eventually(() => arm.mayMove() && hub.logins.some(({ name }) => name === "answer"));
  assert.ok(told.length > 0 && told.every((word) => word.startsWith("halt: ")), String(told));
});
