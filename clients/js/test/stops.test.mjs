// Stopping a session and a channel, and letting go, against a real broker; what waits and what is dropped, at a hub of the test's.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import test, { after, before } from "node:test";
import { setTimeout as sleep } from "node:timers/promises";
import { WebSocket } from "ws";
import { device as declare, verb } from "../dist/device.js";
import { Time, connect, isObeyed } from "../dist/mom-client.js";
import { FakeHub } from "./fakehub.mjs";
import { as, startLab, until } from "./lab.mjs";

let lab;
before(async () => (lab = await startLab()));
after(() => lab.stop());

async function open(t, user, options) {
  const client = await connect(`ws://127.0.0.1:${lab.port}`, as(user, options));
  t.after(() => client.close());
  return client;
}

const eventually = async (holds) => {
  for (const end = Date.now() + 5000; !(await holds()); await sleep(5)) assert.ok(Date.now() < end, `waited for ${holds}`);
};

/** A robot at the lab, and what its machine was told. */
async function robot(t) {
  const told = [];
  const client = await open(t, "arm");
  const verbs = { home: verb.instant("Says so", {}, () => told.push("home")) };
  const device = await client.obey("/robot/arm", declare("arm", { does: "Nothing", verbs, halt: () => told.push("halt"), position: () => ({ x: 7 }) }));
  return { client, device, told };
}

test("one request stops what is below a session, without joining it, and an unstop that names the numbers lets go", async (t) => {
  const { client: arm, device, told } = await robot(t);
  const [alice, bob] = [await open(t, "alice"), await open(t, "bob")];
  const seen = (await bob.channel("/robot/arm")).events();
  told.length = 0;
  const report = await alice.stop("/", { reason: "smoke" });
  const { path, number, guarded, devices } = report.channels.find((told) => told.path === "/robot/arm");
  assert.deepEqual([guarded, devices], [true, [{ peer: arm.name, word: "stopped", rest: "measured" }]]);
  assert.ok(report.others > 0 && device.isStopped);
  assert.deepEqual(told, ["halt"]);
  assert.match(device.mayMove().text, /^stopped by .*: smoke$/);
  const stop = await until(seen, (event) => event.type === "message" && event.name === "stop");
  assert.deepEqual([stop.stop, stop.parcel.context], [number, path]);
  // A peer that asks or comes later finds out who did it and why.
  const state = await bob.stops("/robot/arm");
  assert.deepEqual([state.number, state.stopped, state.by, state.user, state.reason, state.since instanceof Time], [number, true, alice.name, "alice", "smoke", true]);
  const listed = (await bob.list("/robot")).find((each) => each.path === "/robot/arm");
  assert.deepEqual([listed.stop.number, listed.stop.by], [number, alice.name]);
  const late = (await (await open(t, "bob")).channel("/robot/arm")).events();
  const told1 = await until(late, (event) => event.type === "stops");
  assert.deepEqual([told1.path, told1.state.number, told1.state.reason], ["/robot/arm", number, "smoke"]);

  const freed = await bob.unstop("/", { "/robot/arm": number });
  const one = freed.channels.find((channel) => channel.path === path);
  assert.ok(isObeyed(one), JSON.stringify(one));
  assert.deepEqual([one.devices, device.mayMove()], [[{ peer: arm.name, word: "unstopped" }], null]);
  assert.equal((await until(late, (event) => event.type === "message" && event.name === "unstop")).stop, number);
  assert.equal((await bob.stops("/robot/arm")).stopped, false);
});

test("an unstop of an older stop lifts nothing, and says who has stopped since, and why", async (t) => {
  const { device } = await robot(t);
  const [alice, bob] = [await open(t, "alice"), await open(t, "bob")];
  const first = (await alice.stop("/robot/arm")).channels[0].number;
  const second = (await bob.stop("/robot/arm", { reason: "a hand is in it", within: 500 })).channels[0].number;
  assert.ok(second > first);
  const [refused] = (await alice.unstop("/robot/arm", first)).channels;
  assert.deepEqual(refused.newer.map(({ number, by, reason, stopped }) => [number, by, reason, stopped]), [[second, bob.name, "a hand is in it", true]]);
  assert.ok(!isObeyed(refused) && device.isStopped);
  // By a message, too, where the number stands in a slot.
  const channel = await alice.channel("/robot/arm");
  await assert.rejects(channel.sendAcknowledged("unstop", undefined, { stop: first }), { code: "newer-stop" });
  await assert.rejects(channel.sendAcknowledged("unstop"), { code: "bad-slot" });
  await channel.sendAcknowledged("unstop", undefined, { stop: second });
  await eventually(() => !device.isStopped);
});

test("the cases of answers", () => {
  const cases = JSON.parse(readFileSync(new URL("../../../tests/cases/answers.json", import.meta.url), "utf8"));
  assert.ok(cases.length >= 12);
  for (const { name, answer, obeyed } of cases) {
    assert.equal(isObeyed({ path: "/robot/arm", number: 7, guarded: true, kept: true, newer: [], devices: [{ peer: "arm", ...answer }] }), obeyed, name);
  }
});

test("what obeys and still moves does not stand, and is waited for", async (t) => {
  const client = await open(t, "arm");
  let says = { moving: true, reached: true };
  // By itself: a declared device says what it has measured.
  const channel = await client.channel("/robot/arm", { device: true });
  let stop = 0;
  const report = () => channel.send("state", { ...says, stopped: stop > 0, stop }, { delivery: "latest", echo: false });
  void (async () => {
    for await (const event of channel.events()) {
      if (event.type !== "message" || !/stop$/.test(event.name)) continue;
      stop = event.name === "stop" ? event.stop : 0;
      await report();
    }
  })();
  const alice = await open(t, "alice");
  const [rolling] = (await alice.stop("/robot/arm", { within: 100 })).channels;
  assert.deepEqual([rolling.devices, isObeyed(rolling)], [[{ peer: client.name, word: "stopped", moving: true }], false]);
  says = { moving: true, reached: false };
  const [unreached] = (await alice.stop("/robot/arm", { within: 100 })).channels;
  assert.deepEqual(unreached.devices, [{ peer: client.name, word: "stopped", moving: true, reached: false }]);
  const stopping = alice.stop("/robot/arm", { within: 9000 });
  const heard = channel.events();
  await until(heard, (event) => event.type === "message" && event.name === "stop");
  says = { moving: false, reached: true, rest: "measured" };
  await report();
  const [rests] = (await stopping).channels;
  assert.deepEqual([rests.devices, isObeyed(rests)], [[{ peer: client.name, word: "stopped", rest: "measured" }], true]);
  await alice.unstop("/robot/arm", rests.number);
});

test("a declared device that still rolls obeys, and stands when it has measured it", async (t) => {
  const client = await open(t, "arm");
  let [x, rolls] = [0, true];
  const verbs = { go: verb("Drives on", {}, (_, signal) => new Promise((_, reject) => signal.addEventListener("abort", () => reject(signal.reason)))) };
  const rolling = declare("arm", { does: "It rolls", verbs, halt: () => undefined, position: () => ({ x: rolls ? (x += 5) : x }) });
  const device = await client.obey("/robot/arm", rolling);
  const alice = await open(t, "alice");
  const arm = await alice.channel("/robot/arm");
  const guard = await (await alice.token("/robot/token")).grab();
  rolls = false;
  await eventually(() => device.state().rest === "measured");
  rolls = true;
  await arm.sendAcknowledged("command", "go", { fence: guard.fence });
  await eventually(() => device.state().executing);
  const [told] = (await alice.stop("/robot/arm", { within: 500 })).channels;
  assert.deepEqual([told.devices, isObeyed(told)], [[{ peer: client.name, word: "stopped", moving: true }], false]);
  const stopping = alice.stop("/robot/arm", { within: 9000 });
  rolls = false;
  const [rests] = (await stopping).channels;
  assert.deepEqual([rests.devices, isObeyed(rests)], [[{ peer: client.name, word: "stopped", rest: "measured" }], true]);
  await alice.unstop("/robot/arm", rests.number);
});

test("a device that is thinned stays one, and its own stop is stopped in the hub's books", async (t) => {
  const { client, device } = await robot(t);
  await device.channel.thin({ newest: true });
  const bob = await open(t, "bob");
  assert.deepEqual((await bob.members("/robot/arm")).map(({ peer, device }) => [peer, device]), [[client.name, true]]);
  device.stopItself("bumper");
  await eventually(async () => (await bob.stops("/robot/arm")).stopped);
  const { only, reason, number } = await bob.stops("/robot/arm");
  assert.deepEqual([only, reason], [[client.name], "stopped by itself: bumper"]);
  await eventually(() => device.mayMove()?.held === "stopped");
  await bob.unstop("/robot/arm", number);
  assert.equal(device.isStopped, false);
});

test("a request to stop is sent again after a loss, and what lets go is dropped then", async (t) => {
  const hub = await FakeHub.start();
  t.after(() => hub.stop());
  hub.onParcel = (connection, parcel) => {
    if (parcel.name === "stop" && hub.silent) return;
    if (parcel.name === "stop" || parcel.name === "unstop") connection.reply(parcel, { channels: [], others: 0, denied: [] });
    else hub.answer(connection, parcel);
  };
  const alice = await connect(hub.url, { guest: true, webSocket: WebSocket, link: true });
  t.after(() => alice.close());
  hub.silent = true;
  const again = alice.stop("/robot", { reason: "smoke" });
  await eventually(() => hub.heard.filter(({ name }) => name === "stop").length === 1);
  // The hub has not acknowledged it.
  hub.link.read -= 1;
  hub.silent = false;
  hub.cut();
  await eventually(() => alice.state.state === "resuming");
  await assert.rejects(alice.unstop("/robot/arm", 3), { code: "lost" });
  await again;
  assert.deepEqual(hub.heard.filter(({ name }) => name === "stop").map(({ content }) => content?.reason), ["smoke", "smoke"]);
});

test("a halt of the hub tells which token guards the channel from now on; nobody else's does", async (t) => {
  const hub = await FakeHub.start();
  t.after(() => hub.stop());
  const alice = await connect(hub.url, { guest: true, webSocket: WebSocket });
  t.after(() => alice.close());
  const arm = await alice.channel("/robot/arm");
  const [connection] = hub.connections;
  const says = (sender, guard) => connection.say({ family: "message", name: "halt", sender, context: "/robot/arm", content: { guard } });
  const guard = { token: "/robot/token", names: ["command"], owner: "bob", fence: 3 };
  const events = arm.events();
  says("bob", guard);
  await until(events, ({ name, sender }) => name === "halt" && sender === "bob");
  assert.equal(arm.guard.owner, undefined);
  says("hub", guard);
  await until(events, ({ name, sender }) => name === "halt" && sender === "hub");
  assert.deepEqual(arm.guard, guard);
  const command = (fence) => ({ family: "message", name: "command", context: "/robot/arm", sender: "bob", fence });
  assert.deepEqual([undefined, 2, 3].map((fence) => arm.permits(command(fence))), [false, false, true]);
  // News of an older ownership that come late make no old command valid again.
  for (const name of ["grabbed", "released"]) {
    connection.say({ family: "event", name, sender: "hub", context: "/robot/token", content: { owner: "carol", level: 1, fence: 2, reason: "released" } });
    await until(events, ({ type }) => type === name);
  }
  assert.deepEqual([2, 3].map((fence) => arm.permits(command(fence))), [false, true]);
  says("hub", {});
  await eventually(() => arm.guard === null);
});

test("a device says what it has heard of stops when its channel is back", async (t) => {
  const hub = await FakeHub.start();
  t.after(() => hub.stop());
  const alice = await connect(hub.url, { guest: true, webSocket: WebSocket });
  t.after(() => alice.close());
  const events = (await alice.channel("/robot/arm", { device: true })).events();
  const [connection] = hub.connections;
  connection.say({ family: "message", name: "stop", context: "/robot/arm", extra: { stop: 7 } });
  await until(events, ({ name }) => name === "stop");
  // As where a hub began anew, and knows no stop.
  connection.say({ family: "event", name: "deleted", context: "/robot/arm", content: {} });
  await until(events, ({ type }) => type === "deleted");
  await alice.channel("/robot/arm", { device: true });
  const joins = hub.heard.filter(({ name, context }) => name === "join" && context === "/robot/arm");
  const { installation, begun, ...word } = joins.at(-1).content.device;
  assert.deepEqual(word, { stop: 7, stopped: true });
  assert.equal(installation.length, 16);
  assert.ok(begun, "when it was started");
});
