// What stops and frees devices, under load and around a lost connection, against a hub of the tests' own.
import assert from "node:assert/strict";
import test, { afterEach } from "node:test";
import { Queue, connect } from "../dist/test/internals.js";
import { FakeHub } from "./fakehub.mjs";
import { as, until } from "./lab.mjs";

const ends = [];
afterEach(async () => {
  for (const end of ends.splice(0).reverse()) await end();
});

const eventually = async (what) => {
  while (!what()) await new Promise((resolve) => setTimeout(resolve, 2));
};

/** A hub, a client in its channels, and the owner's guard; the hub answers nothing from then on. */
async function driving(settings) {
  const hub = await FakeHub.start({ acknowledges: false, ...settings });
  ends.push(() => hub.stop());
  const client = await connect(hub.url, as("alice"));
  ends.push(() => client.close());
  const [arm, chat, token] = [await client.channel("/robot/arm"), await client.channel("/chat"), await client.token("/robot/token")];
  const guard = await token.grab();
  const joined = hub.heard.length;
  hub.onParcel = () => undefined;
  return { hub, client, arm, chat, token, guard, heard: () => hub.heard.slice(joined), names: () => hub.heard.slice(joined).map((parcel) => parcel.name) };
}

/** Fills what may be unacknowledged, so that messages wait until the hub acknowledges what it has read. */
async function load({ hub, chat }) {
  for (let count = 0; count < 4; count++) void chat.send("image", new Uint8Array(1 << 20));
  await eventually(() => hub.heard.at(-1).content?.length === 1 << 20 && hub.heard.filter((parcel) => parcel.name === "image").length === 3);
}

/** The connection is lost and resumed; the hub has read nothing since `from`. */
async function lose({ hub, client }, from, meanwhile = async () => undefined) {
  const states = client.states();
  hub.link.read = from;
  hub.cut();
  await until(states, (state) => state.state === "resuming");
  await meanwhile();
  await until(states, (state) => state.state === "connected" && state.resumed);
  await eventually(() => hub.link.resent);
}

const drops = async (events, count) => {
  const dropped = {};
  for (let left = count; left > 0; left--) {
    const event = await until(events, (event) => event.type === "dropped");
    assert.equal(event.count, 1);
    dropped[event.parcel.name] = event.reason;
  }
  return dropped;
};

test("unstop, then stop, under load: the robot is stopped", async () => {
  const peer = await driving();
  const { hub, arm, names } = peer;
  await load(peer);
  const events = arm.events();
  void arm.send("note", "before");
  await arm.send("unstop");
  const awaited = arm.sendAcknowledged("unstop", null, { to: ["arm"] });
  await arm.send("stop");
  await assert.rejects(awaited, { kind: "connection", code: "withdrawn", text: /a later stop withdrew it/ });
  assert.deepEqual(await drops(events, 1), { unstop: "withdrawn" });
  await eventually(() => names().at(-1) === "stop");
  hub.link.tell();
  await eventually(() => names().at(-1) === "note");
  assert.deepEqual(names().filter((name) => name !== "image"), ["stop", "note"]);
});

test("an unstop waits for what was said before it in its channel, also where that waits for capacity", async () => {
  const peer = await driving();
  const { hub, client, arm, chat, heard } = peer;
  await load(peer);
  let waiting = true;
  const large = arm.send("map", new Uint8Array(4 << 20)).then(() => (waiting = false));
  const note = arm.send("note");
  await arm.send("unstop");
  assert.ok(waiting && client.peer.outbox.bytes > client.peer.outbox.most);
  await chat.send("stop");
  await eventually(() => heard().at(-1).name === "stop");
  assert.deepEqual(heard().map((parcel) => parcel.name), ["image", "image", "image", "stop"]);
  // The hub reads on, and says so.
  hub.onParcel = () => hub.link.tell();
  hub.link.tell();
  await Promise.all([large, note]);
  await eventually(() => heard().at(-1).name === "unstop");
  assert.deepEqual(heard().slice(-3).map((parcel) => parcel.name), ["map", "note", "unstop"]);
});

test("a release leaves behind all commands, and names its fence", async () => {
  const peer = await driving();
  const { hub, arm, chat, guard, heard } = peer;
  await load(peer);
  for (let count = 0; count < 20; count++) await arm.send("command", count);
  const released = guard.release();
  await chat.send("note", null, { priority: 9 });
  hub.onParcel = (connection, parcel) => hub.answer(connection, parcel);
  hub.link.tell();
  await released;
  await eventually(() => heard().at(-1).name === "note");
  const after = heard().filter((parcel) => parcel.name !== "image");
  assert.deepEqual(after.map((parcel) => parcel.content ?? parcel.name), [...Array(20).keys(), "release", "note"]);
  assert.equal(after[20].fence, 5);
  assert.equal((await guard.lost).reason, "released");
});

test("what must not be sent late, and had left, is told as unknown", async () => {
  const peer = await driving();
  const { hub, arm, chat, guard, token, names } = peer;
  const [events, others] = [arm.events(), chat.events()];
  const from = hub.link.read;
  await arm.send("command", "grip open");
  await arm.send("unstop");
  await arm.send("state", "moving", { delivery: "latest" });
  await chat.send("command", "without a guard");
  await chat.send("note");
  const awaited = [arm.sendAcknowledged("command"), arm.sendAcknowledged("unstop"), guard.give("bob"), token.inhibit(), token.acceptRequest("bob")];
  for (const one of awaited) one.catch(() => undefined);
  await eventually(() => names().length === 10);
  await lose(peer, from, async () => {
    for (const one of [arm.send("command"), arm.send("unstop"), chat.send("command"), arm.sendAcknowledged("unstop"), guard.give("bob"), token.inhibit()]) {
      await assert.rejects(one, { kind: "connection", code: "lost", text: /the connection was lost before it had left/ });
    }
    await arm.send("stop");
  });
  assert.deepEqual(await drops(events, 3), { command: "unknown", unstop: "unknown", state: "unknown" });
  assert.deepEqual(await drops(others, 1), { command: "unknown" });
  for (const one of awaited) {
    const error = await one.catch((error) => error);
    assert.deepEqual([error.kind, error.code, error.number], ["connection", "unknown", 305]);
    assert.match(error.text, /^(message|token) \w+ \/robot\/\w+: .*unknown whether the hub has read it$/);
    assert.doesNotMatch(error.text, /not sent/);
  }
  assert.deepEqual(names().slice(10), ["stop", "note"]);
  // The link is as good as ever.
  await arm.send("command", "grip again");
  await eventually(() => names().at(-1) === "command");
});

test("what must not be sent late, and waited, is told as lost", async () => {
  const peer = await driving();
  const { hub, arm, chat, guard, token, names } = peer;
  await load(peer);
  const [events, others] = [arm.events(), chat.events()];
  const before = names().length;
  await arm.send("command", "grip open");
  await arm.send("note");
  await arm.send("unstop");
  await chat.send("command");
  const awaited = [arm.sendAcknowledged("command"), guard.give("bob"), token.inhibit()];
  for (const one of awaited) one.catch(() => undefined);
  const released = guard.release();
  await lose(peer, hub.link.read, async () => {
    for (const one of awaited) await assert.rejects(one, { kind: "connection", code: "lost" });
    assert.deepEqual(await drops(events, 2), { command: "lost", unstop: "lost" });
    assert.deepEqual(await drops(others, 1), { command: "lost" });
    hub.onParcel = (connection, parcel) => hub.answer(connection, parcel);
  });
  await released;
  await eventually(() => names().at(-1) === "note");
  assert.deepEqual(names().slice(before), ["release", "image", "note"]);
});

test("a release may wait until the device has carried out the last command", async () => {
  const { hub, client, guard, arm } = await driving();
  hub.onParcel = (connection, parcel) => hub.answer(connection, parcel);
  const heard = (name) => hub.heard.filter((parcel) => parcel.name === name);
  const tell = (content) => hub.link.say({ family: "message", name: "status", context: "/robot/arm", sender: "arm", content });
  void arm.send("command", "up");
  void arm.send("command", "down");
  const released = guard.release({ after: "done" });
  await eventually(() => heard("command").length === 2);
  const [first, last] = heard("command").map(({ id }) => id);
  tell({ peer: client.name, id: first, state: "finished" });
  tell({ peer: client.name, id: last, state: "executing" });
  tell({ peer: "bob", id: last, state: "finished" });
  await client.info("/robot/arm");
  assert.equal(heard("release").length, 0);
  tell({ peer: client.name, id: last, state: "error" });
  await released;
  assert.equal(heard("release").length, 1);
  // Nothing is waited for where nothing was said.
  await guard.release({ after: "done" });
});

test("a release that the hub has not read is said again, with its fence", async () => {
  const peer = await driving();
  const { hub, guard, heard } = peer;
  const from = hub.link.read;
  const released = guard.release();
  await eventually(() => heard().length === 1);
  hub.onParcel = (connection, parcel) => hub.answer(connection, parcel);
  await lose(peer, from);
  await released;
  assert.deepEqual(heard().map(({ name, fence }) => [name, fence]), [["release", 5], ["release", 5]]);
});

test("a release of what has another owner by now has nothing to give up", async () => {
  const { hub, guard } = await driving();
  hub.onParcel = (connection, parcel) => connection.error(205, "older-fence", parcel);
  await guard.release();
  assert.equal((await guard.lost).reason, "released");
});

test("who gives up waiting for a token leaves the queue, also over a lost connection", async () => {
  const peer = await driving();
  const { hub, client, token, heard } = peer;
  const from = hub.link.read;
  client.peer.guards.released("/robot/token", null, { reason: "expired" });
  const stop = new AbortController();
  const waiting = token.grab({ wait: "unlimited", signal: stop.signal });
  waiting.catch(() => undefined);
  await eventually(() => heard().length === 1);
  stop.abort();
  await eventually(() => heard().length === 2);
  hub.onParcel = (connection, parcel) => {
    if (parcel.name !== "release") return;
    connection.reply(parcel);
    connection.error(105, "withdrawn", heard()[0]);
  };
  await lose(peer, from + 1);
  await assert.rejects(waiting, { code: "withdrawn" });
  assert.deepEqual(heard().map(({ name, fence }) => [name, fence]), [["grab", undefined], ["release", undefined], ["release", undefined]]);
});

test("a grant that comes too late is given up by its fence", async () => {
  const { hub, client, heard } = await driving();
  client.peer.options.requestTimeout = 1;
  await assert.rejects((await client.token("/robot/token")).grab(), { kind: "timed-out" });
  await eventually(() => heard().length === 1);
  hub.link.say({ family: "reply", name: "ok", reference: heard()[0].id, content: { fence: 9, lease: null } });
  await eventually(() => heard().at(-1).name === "release");
  assert.equal(heard().at(-1).fence, 9);
});

test("a token that could not be given does not return", async () => {
  const { hub, client, guard, heard } = await driving();
  hub.onParcel = (connection, parcel) => connection.error(211, "unknown-peer", parcel);
  await assert.rejects(guard.give("nobody", { for: 1000 }), { code: "unknown-peer" });
  hub.link.say({ family: "event", name: "grabbed", context: "/robot/token", content: { owner: "alice", level: 1, fence: 6, lease: null } });
  await until((await client.token("/robot/token")).events(), (event) => event.type === "grabbed");
  await assert.rejects(client.lookup("/chat"));
  assert.deepEqual(heard().map((parcel) => parcel.name), ["give", "lookup"]);
});

test("a stop needs no token, whatever the token guards", async () => {
  const hub = await FakeHub.start();
  ends.push(() => hub.stop());
  hub.onParcel = (connection, parcel) => {
    if (parcel.name !== "join" || parcel.context !== "/robot/arm") return hub.answer(connection, parcel);
    connection.reply(parcel, { path: "/robot/arm", kind: "channel", guard: { token: "/robot/token", names: ["*"], fence: 1 } });
  };
  const client = await connect(hub.url, as("alice"));
  ends.push(() => client.close());
  const arm = await client.channel("/robot/arm");
  assert.deepEqual(["stop", "unstop", "command"].map((name) => arm.permits({ family: "message", name, sender: "bob" })), [true, true, false]);
});

test("a heartbeat that no hub takes is refused before anybody is asked", async () => {
  for (const heartbeat of [99, 10_001, 0, -1, NaN, 150.5, "1000"]) {
    await assert.rejects(connect("ws://127.0.0.1:1", as("alice", { heartbeat, connectWithin: 1, onState: assert.fail })), { kind: "local", code: "bad-content", text: /from 100 to 10000/ });
  }
  for (const heartbeat of [100, 10_000, undefined]) {
    await assert.rejects(connect("ws://127.0.0.1:1", as("alice", { heartbeat, connectWithin: 1 })), { kind: "connection" });
  }
});

test("a stop is never dropped from events that nobody takes", async () => {
  const hub = await FakeHub.start();
  ends.push(() => hub.stop());
  const client = await connect(hub.url, as("alice", { eventBuffer: 3 }));
  ends.push(() => client.close());
  const arm = await client.channel("/robot/arm");
  const events = arm.events();
  await arm.sendAcknowledged("note");
  const say = (name, sender, context = "/robot/arm") => hub.link.say({ family: "message", name, sender, context });
  for (const [name, sender] of [["stop", "bob"], ["halt", "hub"], ["unstop", "bob"], ["note", "bob"], ["stop", "carol"], ["stop", "bob"], ["note", "bob"]]) say(name, sender);
  await client.lookup("/chat");
  const got = [];
  for (let event = events.tryNext(); event; event = events.tryNext()) got.push(event.type === "message" ? `${event.name} ${event.sender}` : `${event.type} ${event.count}`);
  assert.deepEqual(got, ["lagged 3", "halt hub", "unstop bob", "stop carol", "stop bob"]);
});

test("events that nobody takes hold 64 MiB at most", async () => {
  const hub = await FakeHub.start();
  ends.push(() => hub.stop());
  const client = await connect(hub.url, as("alice"));
  ends.push(() => client.close());
  const events = (await client.channel("/chat")).events();
  for (let number = 0; number < 70; number++) hub.link.say({ family: "message", name: "image", sender: "bob", context: "/chat", id: number, content: { image: new Uint8Array(1 << 20) } });
  await client.lookup("/chat");
  assert.deepEqual([events.tryNext(), events.length], [{ type: "lagged", count: 7 }, 63]);
  const bytes = [];
  for (let event = events.tryNext(); event; event = events.tryNext()) bytes.push(event.parcel.size);
  assert.ok(bytes.every((size) => size > 1 << 20) && bytes.length === 63);
  // What was taken makes room.
  for (let number = 0; number < 63; number++) hub.link.say({ family: "message", name: "image", sender: "bob", context: "/chat", content: new Uint8Array(1 << 20) });
  await client.lookup("/chat");
  assert.deepEqual([events.length, events.tryNext().type], [63, "message"]);
});

test("a stop is kept for the first subscriber, however much has come since the join", async () => {
  const hub = await FakeHub.start();
  ends.push(() => hub.stop());
  const client = await connect(hub.url, as("alice"));
  ends.push(() => client.close());
  const [arm, rest] = [await client.channel("/robot/arm"), client.unaddressed()];
  const say = (name, content) => hub.link.say({ family: "message", name, sender: "bob", context: "/robot/arm", content });
  say("stop", "first");
  for (let count = 0; count < 4095; count++) say("state", count);
  say("stop", "last");
  say("state", 4095);
  // Who takes the rest hears what is not kept for anybody.
  assert.equal((await until(rest, (event) => event.type === "message")).content, "last");
  assert.equal((await until(rest, (event) => event.type === "message")).content, 4095);
  const events = arm.events();
  assert.deepEqual([events.tryNext().count, events.tryNext().content, events.tryNext()], [4097, "last", undefined]);
  say("state", "now");
  assert.equal((await until(events, (event) => event.type === "message")).content, "now");
});

test("a queue drops the oldest that need not be kept, and of those the ones that have been said again", () => {
  const queue = new Queue(2, (count) => `${count} lost`, () => undefined, undefined, (item) => (/[a-z]/.test(item) ? item : undefined));
  const all = () => {
    const items = [];
    for (let item = queue.tryNext(); item; item = queue.tryNext()) items.push(item);
    return items.join(" ");
  };
  for (const item of ["1", "2", "3"]) queue.push(item);
  assert.equal(all(), "1 lost 2 3");
  for (const item of ["a", "b", "1"]) queue.push(item);
  assert.equal(all(), "1 lost a b");
  for (const item of ["a", "b", "c"]) queue.push(item);
  assert.equal(all(), "a b c");
  for (const item of ["a", "b", "a", "c", "b"]) queue.push(item);
  assert.equal(all(), "2 lost a c b");
});
