// What a device makes of stops: the cases that all clients replay (tests/cases), and a device at a hub of the test's.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import test from "node:test";
import { setTimeout as sleep } from "node:timers/promises";
import { WebSocket } from "ws";
import { device as declare, sleep as pause, verb, word } from "../dist/device.js";
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
  const verbs = {
    say: verb.instant("Says a word", { what: word() }, ({ what }) => told.push(what)),
    go: verb("Drives on", {}, async (_, signal) => {
      told.push("go");
      await pause(60_000, signal).finally(() => told.push("aborted"));
    }),
  };
  const halt = () => {
    told.push("halt");
    if (settings.breaks?.()) throw new Error("no brake");
  };
  const arm = await client.obey("/robot/arm", declare("arm", { does: "Says words", verbs, halt, position: () => ({ x: 7 }), report: () => ({ pose: told.length }) }));
  const say = (name, more = {}) => hub.link.say({ family: "message", name, context: "/robot/arm", sender: "bob", ...more });
  const said = (name) => hub.heard.filter((parcel) => parcel.family === "message" && parcel.name === name);
  return { hub, client, arm, told, say, said, books: (next) => (stop = next) };
}

test("a device that is put out of its channel halts, says why it may not move, and obeys nothing that comes after it", async (t) => {
  const { hub, client, arm, told, say } = await device(t);
  await eventually(() => arm.mayMove() === null);
  // Another one that is put out does not concern this one.
  hub.link.say({ family: "event", name: "expelled", context: "/robot/arm", sender: "hub", content: { peer: "bob", text: "off" } });
  say("command", { content: "say before" });
  hub.link.say({ family: "event", name: "expelled", context: "/robot/arm", sender: "hub", content: { peer: client.name, text: "arm~2 is the device here now" } });
  say("command", { content: "say after" });
  await arm.ended;
  assert.deepEqual([...new Set(told)], ["halt", "before"]);
  assert.equal(told.at(-1), "halt");
  assert.deepEqual(arm.mayMove(), { held: "unknown", text: "it was expelled from its channel: arm~2 is the device here now" });
});

test("a device obeys stops by their numbers, and says after each how it stands", async (t) => {
  const { arm, told, say, said } = await device(t);
  const states = () => said("state").map(({ content }) => `${content.stopped} ${content.stop}`);
  const ends = () => said("status").filter(({ content }) => content.state === "error");
  await eventually(() => arm.mayMove() === null);
  say("command", { content: "say home; go", id: 8 });
  await eventually(() => told.includes("go"));
  say("stop", { extra: { stop: 7 }, content: "smoke" });
  await eventually(() => states().at(-1) === "true 7");
  const before = states().length;
  say("command", { content: "say up", id: 9 });
  say("unstop", { extra: { stop: 6 } });
  await eventually(() => states().length > before && ends().length === 2);
  assert.deepEqual(told, ["halt", "home", "go", "halt", "aborted", "halt"], "the signal is aborted before it is halted, by which its promise ends later, and once more then");
  assert.deepEqual(ends().map(({ content, reference }) => [content.error.name, content.error.code, content.error.text, reference]), [
    ["stopped", 5102, "the arm was stopped: stopped by bob: smoke", 8],
    ["stopped", 5102, "the arm is stopped and takes no command until the stop is released", 9],
  ]);
  say("unstop", { extra: { stop: 7 } });
  await eventually(() => states().at(-1) === "false 7");
  assert.deepEqual(states().filter((state, at, all) => state !== all[at - 1]), ["false 0", "true 7", "false 7"]);
  assert.equal(arm.isStopped, false);
  // Only the hub may say this.
  told.length = 0;
  say("halt");
  say("command", { content: "say on" });
  await eventually(() => told.length > 0);
  say("halt", { sender: "hub" });
  await eventually(() => told.length > 1);
  assert.deepEqual(told, ["on", "halt"]);
});

test("a device tells its state to who joins, and to all where those are counted", async (t) => {
  const { hub, said } = await device(t);
  const full = () => said("state").filter(({ content }) => content["stops-within"] === 1000).map(({ address }) => address?.[0]);
  await eventually(() => full().length === 2);
  const event = (content) => hub.link.say({ family: "event", name: "joined", context: "/robot/arm", sender: "hub", content });
  event({ peer: "bob", user: "bob", level: 1 });
  await eventually(() => full().length === 3);
  event({ count: 300 });
  await eventually(() => full().length === 4);
  assert.deepEqual(full(), [undefined, undefined, "bob", undefined], "to all as it begins and hears how it stands");
});

test("a device halts at a loss, moves when it has heard how it stands, and says what it knew when it joins again", async (t) => {
  const { hub, arm, told, say, said, books } = await device(t);
  say("stop", { extra: { stop: 5 } });
  await eventually(() => arm.isStopped);
  hub.cut();
  await eventually(() => told.length > 2);
  assert.deepEqual([...new Set(told)], ["halt"]);
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

test("what a loss has ended is told when the connection is back, and what never left is said again", async (t) => {
  const { hub, arm, told, say, said } = await device(t);
  await eventually(() => arm.mayMove() === null);
  say("command", { content: "go", id: 4 });
  await eventually(() => told.includes("go"));
  hub.forgets = true;
  hub.cut();
  await eventually(() => told.includes("aborted"));
  await eventually(() => said("status").some(({ content }) => content.state === "error"));
  const { content, reference } = said("status").find((parcel) => parcel.content.state === "error");
  assert.deepEqual([content.peer, content.error.name, content.error.text, reference], ["bob", "halted", "the arm was halted: the connection to the hub is silent or lost", 4]);
  await eventually(() => arm.mayMove() === null);
});

test("a device obeys in one channel at a time, and where it has left it may obey again", async (t) => {
  const { client, arm, told, say } = await device(t);
  const declared = arm.device;
  await assert.rejects(client.obey("/robot/arm", declared), /arm obeys in \/robot\/arm already/);
  await arm.leave();
  const again = await client.obey("/robot/arm", declared);
  await eventually(() => again.mayMove() === null);
  say("command", { content: "say back" });
  await eventually(() => told.includes("back"));
});

test("a device takes a gap for a stop, says so to itself, and an unstop that names the number frees it", async (t) => {
  const { hub, arm, told, say, said } = await device(t, { eventBuffer: 2 });
  await eventually(() => arm.mayMove() === null);
  const states = said("state").length;
  told.length = 0;
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
  await eventually(() => said("state").length >= states + 2);
  assert.equal(arm.isStopped, true, "that does not name its own stop");
  say("stop", { sender: "alice", extra: { stop: 51 }, content: content });
  say("unstop", { extra: { stop: 51 } });
  await eventually(() => arm.mayMove() === null);
  assert.ok(told.length > 0 && told.every((word) => word === "halt"));
});

test("a device stops itself, and halts when the hub is silent or it leaves", async (t) => {
  const { hub, arm, told, say, said } = await device(t, {}, { heartbeat: 200 });
  arm.stopItself("bumper");
  await eventually(() => said("stop").length === 1);
  assert.deepEqual([said("stop")[0].content, told], [{ reason: "stopped by itself: bumper" }, ["halt", "halt"]]);
  say("unstop");
  await eventually(() => arm.mayMove() === null);
  hub.deaf = true;
  await eventually(() => told.length > 2 && arm.mayMove()?.text === "the hub is silent");
  hub.deaf = false;
  await eventually(() => arm.mayMove() === null);
  say("command", { content: "go", id: 3 });
  await eventually(() => told.includes("go"));
  await arm.leave();
  assert.deepEqual(told.slice(told.indexOf("go")), ["go", "halt", "aborted", "halt"]);
  assert.equal(arm.mayMove().text, "it is no longer a device of its channel");
  const { error } = said("status").at(-1).content;
  assert.deepEqual([error.name, error.text], ["halted", "the arm was halted: it is no longer a device of its channel"]);
});

test("a device whose machine fails halts it", async (t) => {
  t.mock.method(console, "error", () => undefined);
  let breaks = false;
  const { hub, arm, told, say, said } = await device(t, {}, { breaks: () => breaks });
  await eventually(() => arm.mayMove() === null);
  say("command", { content: "go", id: 3 });
  await eventually(() => told.includes("go"));
  breaks = true;
  say("stop", { extra: { stop: 7 } });
  await assert.rejects(arm.ended, /no brake/);
  assert.ok(told.length > 2 && told.at(-1) !== "go");
  assert.equal(arm.mayMove().text, "it is no longer a device of its channel");
  // Nothing is known of it.
  await eventually(() => said("state").at(-1).content.reached === false);
  await eventually(() => hub.heard.some(({ name, context }) => name === "leave" && context === "/robot/arm"));
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
  const { hub, arm, told, say } = await device(t);
  await eventually(() => arm.mayMove() === null);
  // As if it had not run for a while: what is there then is older than the link lives.
  const { now } = performance;
  t.after(() => delete performance.now);
  performance.now = () => now.call(performance) + 4 * hub.heartbeat;
  say("command", { content: "say up" });
  await eventually(() => arm.mayMove() && hub.logins.some(({ name }) => name === "answer"));
  assert.ok(told.length > 0 && told.every((word) => word === "halt"), String(told));
});
