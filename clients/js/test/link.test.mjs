// A lost connection, against a hub of the tests' own.
import assert from "node:assert/strict";
import test, { afterEach } from "node:test";
import { Attempts, connect } from "../dist/test/internals.js";
import { FakeHub, faultyNetwork } from "./fakehub.mjs";
import { as, until } from "./lab.mjs";

const ends = [];
const start = async (settings) => {
  const hub = await FakeHub.start(settings);
  ends.push(() => hub.stop());
  return hub;
};
const open = async (address, more) => {
  const client = await connect(address, as("alice", more));
  ends.push(() => client.close());
  return client;
};
afterEach(async () => {
  for (const end of ends.splice(0).reverse()) await end();
});

/** Waits until something is so; what it depends on comes over a socket. */
const eventually = async (what) => {
  while (!what()) await new Promise((resolve) => setTimeout(resolve, 2));
};
const texts = (hub) => hub.heard.filter((parcel) => parcel.family === "message").map((parcel) => parcel.content);

test("a hub without links is logged in at again, and contexts are joined again", async () => {
  for (const settings of [{ links: false }, { refuses: true }]) {
    const hub = await start(settings);
    const client = await open(hub.url);
    const chat = await client.channel("/chat");
    const token = await client.token("/robot/token");
    const guard = await token.grab();
    const [events, states] = [chat.events(), client.states()];
    hub.onParcel = (connection, parcel) => parcel.name === "lookup" || hub.answer(connection, parcel);
    const open_request = client.lookup("/chat");
    open_request.catch(() => undefined);
    await eventually(() => hub.heard.at(-1).name === "lookup");
    hub.cut();
    await until(events, (event) => event.type === "link-down");
    await assert.rejects(chat.send("chat", "now"), { kind: "connection", code: "disconnected" });
    await assert.rejects(open_request, { kind: "connection" });
    await until(events, (event) => event.type === "rejoined");
    assert.equal((await guard.lost).reason, "disconnected");
    const seen = [];
    await until(states, (state) => seen.push(state.state) && state.state === "connected" && seen.length > 1);
    assert.deepEqual([seen[0], seen[1], seen.at(-1)], ["connected", "trying", "connected"]);
    assert.equal(hub.heard.filter((parcel) => parcel.name === "join" && parcel.context === "/chat").length, 2);
    assert.equal(hub.heard.filter((parcel) => parcel.name === "grab").length, 1);
  }
});

test("a resumed link loses nothing", async () => {
  const hub = await start();
  const client = await open(hub.url);
  const chat = await client.channel("/chat");
  const guard = await (await client.token("/robot/token")).grab();
  const [events, states, unaddressed] = [chat.events(), client.states(), client.unaddressed()];
  await chat.sendAcknowledged("chat", "before");
  hub.onParcel = () => undefined;
  const receipt = chat.sendAcknowledged("chat", "on its way");
  await eventually(() => texts(hub).includes("on its way"));
  const asked = hub.heard.at(-1);
  hub.cut();
  hub.link.say({ family: "message", name: "chat", sender: "bob", context: "/chat", content: "meanwhile" }, true);
  hub.link.say({ family: "message", name: "chat", sender: "bob", context: "/chat", content: "fleeting" }, false);
  await until(states, (state) => state.state === "resuming");
  await chat.send("chat", "while it was lost");
  const up = await until(states, (state) => state.state === "connected");
  assert.equal(up.resumed, true);
  await eventually(() => texts(hub).includes("while it was lost"));
  hub.link.say({ family: "reply", name: "ok", reference: asked.id, content: { delivered: 1, dropped: [] } }, true);
  assert.equal((await receipt).delivered, 1);
  assert.equal((await until(events, (event) => event.type === "message")).content, "meanwhile");
  assert.deepEqual(texts(hub), ["before", "on its way", "while it was lost"]);
  assert.deepEqual([hub.logins.length, hub.link.resent, guard.isLost], [3, true, null]);
  assert.equal((await until(unaddressed, (event) => event.type === "dropped")).count, 1);
});

test("parcels are counted, acknowledged and kept", async () => {
  const hub = await start({ acknowledges: false });
  const client = await open(hub.url, { heartbeat: 100 });
  assert.equal(hub.logins[0].content.heartbeat, 100);
  const chat = await client.channel("/chat");
  hub.acks.length = 0;
  for (let number = 0; number < 255; number++) hub.link.say({ family: "event", name: "later", context: "/chat" });
  for (let number = 0; number < 2; number++) hub.link.say({ family: "event", name: "later", context: "/chat" });
  await eventually(() => hub.acks.length);
  assert.equal(hub.acks[0], 256);
  hub.link.say({ family: "message", name: "image", context: "/chat", content: new Uint8Array(70_000) });
  await eventually(() => hub.acks.length > 1);
  assert.equal(hub.acks[1], hub.link.sent);
  // With each sign of life, and before it.
  hub.link.say({ family: "event", name: "later", context: "/chat" });
  hub.link.connection.post({ family: "time", name: "ping", id: 1, content: {} });
  await eventually(() => hub.all.at(-1).name === "pong");
  assert.deepEqual(hub.all.slice(-2).map((parcel) => parcel.name), ["ack", "pong"]);
  // What is not acknowledged has the bound of an outbox: nothing more is sent.
  hub.onParcel = () => undefined;
  const large = new Uint8Array(1 << 20);
  let sent = 0;
  for (let number = 0; number < 12; number++) void chat.send("image", large, { priority: number % 2 }).then(() => (sent += 1), () => undefined);
  await eventually(() => texts(hub).length === 3);
  await chat.send("stop");
  await eventually(() => hub.heard.at(-1).name === "stop");
  assert.equal(texts(hub).length, 4);
  hub.link.tell();
  await eventually(() => texts(hub).length === 7);
  assert.ok(sent < 12);
});

test("a hub that has counted other parcels is not gone on with", async () => {
  const hub = await start();
  const client = await open(hub.url);
  await client.channel("/chat");
  const states = client.states();
  hub.link.connection.post({ family: "time", name: "ack", content: { read: 1, checksum: 7 } });
  await until(states, (state) => state.state === "trying");
  await until(states, (state) => state.state === "connected");
  assert.deepEqual(hub.logins.map((parcel) => parcel.name), ["login", "login"]);
  hub.checksum = 7;
  hub.cut();
  await until(states, (state) => state.state === "trying");
  await until(states, (state) => state.state === "connected");
  assert.deepEqual(hub.logins.slice(2).map((parcel) => parcel.name), ["resume", "answer", "login"]);
  assert.equal(hub.logins[3].content.checksum, undefined, "only hubs from 1.3 on know it");
});

test("a count that cannot be ends the link, whichever side says so", async () => {
  const hub = await start({ miscounts: true });
  const client = await open(hub.url);
  const states = client.states();
  hub.link.connection.post({ family: "time", name: "ack", content: { read: 99 } });
  await until(states, (state) => state.state === "trying");
  await until(states, (state) => state.state === "connected");
  assert.deepEqual(hub.logins.map((parcel) => parcel.name), ["login", "login"]);
  hub.cut();
  await until(states, (state) => state.state === "connected");
  assert.deepEqual(hub.logins.slice(2).map((parcel) => parcel.name), ["resume", "answer", "login"]);
});

test("what is not resumed is told as lost, and a login follows on the same connection", async () => {
  const hub = await start();
  const client = await open(hub.url);
  const chat = await client.channel("/chat");
  const guard = await (await client.token("/robot/token")).grab();
  const events = chat.events();
  hub.onParcel = () => undefined;
  const asked = client.lookup("/chat");
  await eventually(() => hub.heard.at(-1).name === "lookup");
  hub.onParcel = (connection, parcel) => hub.answer(connection, parcel);
  hub.forgets = true;
  const [before] = hub.connections;
  hub.cut();
  await assert.rejects(asked, { kind: "connection", code: "unknown", text: /^context lookup \/chat: .* it is unknown whether the hub has read it/ });
  await until(events, (event) => event.type === "link-down");
  await until(events, (event) => event.type === "rejoined");
  assert.equal((await guard.lost).reason, "disconnected");
  assert.deepEqual(hub.logins.map((parcel) => parcel.name), ["login", "resume", "answer", "login"]);
  assert.ok(!hub.connections.has(before) && hub.connections.size === 1);
});

test("after the grace time everything is lost, also without the hub's word", async () => {
  const hub = await start({ grace: 50 });
  const client = await open(hub.url);
  const guard = await (await client.token("/robot/token")).grab();
  const port = hub.port;
  await hub.stop();
  assert.equal((await guard.lost).reason, "disconnected");
  await assert.rejects(client.list("/"), { kind: "connection" });
  assert.equal(client.state.state, "trying");
  assert.ok(port);
});

test("the hub's reason says whether to come back, and how", async () => {
  for (const [code, word, states] of [[300, "shutdown", ["trying", "connected"]], [409, "taken-over", ["closed"]]]) {
    const hub = await start();
    const client = await open(hub.url);
    const seen = [];
    const heard = client.states();
    const [connection] = hub.connections;
    connection.error(code, word);
    connection.socket.close();
    await until(heard, (state) => seen.push(state.state) && state.state === states.at(-1) && seen.length > 1);
    assert.deepEqual(seen, ["connected", ...states]);
    // Nothing of the old link is asked for.
    assert.ok(hub.logins.every((parcel) => parcel.name === "login"));
    if (word === "taken-over") assert.equal(client.state.error.code, "taken-over");
  }
});

test("a silent hub is stale, then lost, then resumed", async () => {
  const hub = await start({ heartbeat: 100 });
  const client = await open(hub.url);
  const states = client.states();
  hub.deaf = true;
  const seen = [];
  await until(states, (state) => {
    seen.push(state.state);
    if (state.state === "resuming") hub.deaf = false;
    return seen.length > 1 && state.state === "connected";
  });
  assert.deepEqual(seen, ["connected", "stale", "resuming", "connected"]);
});

test("who does not come back asks for no link", async () => {
  const hub = await start();
  const client = await open(hub.url, { reconnect: false });
  const states = client.states();
  assert.equal(hub.logins[0].content.link, undefined);
  hub.cut();
  const closed = await until(states, (state) => state.state === "closed");
  assert.equal(closed.error.kind, "connection");
});

/** A generator whose numbers are those of its seed. */
const random = (seed) => () => {
  seed = (Math.imul(seed, 1103515245) + 12345) & 0x7fffffff;
  return seed / 0x7fffffff;
};

test("of 100 lost connections none loses or repeats a parcel", async () => {
  const hub = await start();
  hub.onParcel = (connection, parcel) => {
    hub.answer(connection, parcel);
    if (parcel.family === "message" && typeof parcel.content === "number") connection.say({ family: "message", name: "echo", sender: "bob", context: "/chat", content: parcel.content });
  };
  const next = random(7);
  let cuts = 0;
  // Long enough for a resume; then anywhere, also inside of frames and chunks.
  const network = await faultyNetwork(hub.port, () => (cuts++ < 100 ? 900 + Math.floor(next() * 30_000) : Infinity));
  ends.push(() => network.stop());
  const client = await open(`ws://127.0.0.1:${network.port}`, { reconnect: true });
  const chat = await client.channel("/chat");
  const events = chat.events();
  const [answered, echoed] = [[], []];
  const heard = (async () => {
    for await (const event of events) {
      assert.notEqual(event.type, "link-down");
      if (event.type === "message") echoed.push(event.content);
      if (echoed.length === sent) return;
    }
  })();
  let sent = Infinity;
  let number = 0;
  const asked = [];
  while (cuts < 100) {
    await chat.send("count", number++);
    if (number % 5 === 0) await chat.send("image", new Uint8Array(Math.floor(next() * 60_000)), { priority: -1 });
    if (number % 3 === 0) asked.push(chat.sendAcknowledged("chat", `asked ${number}`).then(() => answered.push(number)));
    if (number % 4 === 0) await new Promise((resolve) => setTimeout(resolve, 1));
    if (client.peer.outbox.bytes > 200_000) await new Promise((resolve) => setTimeout(resolve, 5));
  }
  sent = number;
  if (echoed.length < sent) await heard;
  await Promise.all(asked);
  const counted = texts(hub).filter((content) => typeof content === "number");
  assert.deepEqual(counted, Array.from({ length: number }, (_, place) => place));
  assert.deepEqual(echoed, counted);
  assert.equal(answered.length, Math.floor(number / 3));
});

test("a token is asked for at each login, and what that throws is told", async () => {
  const hub = await start();
  const broken = new TypeError("no token today");
  const webSocket = as("alice").webSocket;
  await assert.rejects(connect(hub.url, { webSocket, token: () => Promise.reject(broken) }), (error) => error === broken);
  let asked = 0;
  const token = async () => {
    asked += 1;
    if (asked === 2) throw broken;
    return `token ${asked}`;
  };
  const client = await connect(hub.url, { webSocket, token });
  ends.push(() => client.close());
  const states = client.states();
  hub.forgets = true;
  hub.cut();
  const failed = await until(states, (state) => state.state === "trying" && state.error?.text.includes("no token"));
  assert.equal(failed.error.kind, "connection");
  await until(states, (state) => state.state === "connected");
  assert.deepEqual(hub.logins.filter((parcel) => parcel.name === "login").map((parcel) => parcel.content.token), ["token 1", "token 3"]);
});

test("several attempts fall into the grace time, and the last one is made just before its end", async () => {
  const never = new AbortController().signal;
  for (const grace of [400, 2000, 30_000, 600_000]) {
    const attempts = new Attempts(Infinity, never);
    const waits = [];
    let at = 0;
    for (let wait; at + (wait = attempts.next(undefined, grace, grace - at)) < grace; at += wait) waits.push(wait);
    assert.ok(waits.length >= 4 && Math.max(...waits) <= Math.min(grace / 4, 30_000), `${grace}: ${waits}`);
    assert.ok(at >= grace - 100, `${grace}: the last at ${at}`);
  }
  const attempts = new Attempts(Infinity, never);
  // What the hub asks for holds, whatever the grace time is.
  assert.equal(attempts.next({ retryAfter: 5000 }, 1000, 1000), 5000);
  const rand = Math.random;
  Math.random = () => 1;
  try {
    for (let count = 0; count < 20; count++) attempts.next(undefined, 1000, 900);
    assert.deepEqual([attempts.next(undefined, 1000, 900), attempts.next(undefined, 1000, 120), attempts.next(undefined, 1000, 50), attempts.next(undefined)], [250, 60, 30_000, 30_000]);
    // At the hub's side of it: 0.1, 0.3, 0.675 and 1.05 s after the loss nobody is there, at 1.3 s it is.
    const hub = await start({ grace: 1500 });
    const client = await open(hub.url);
    const guard = await (await client.token("/robot/token")).grab();
    const states = client.states();
    await hub.stop();
    await until(states, (state) => state.state === "resuming" && state.attempt === 4);
    const again = await start({ port: hub.port, known: hub.known });
    const up = await until(states, (state) => state.state === "connected");
    assert.deepEqual([up.resumed, again.link?.resent ?? true, guard.isLost], [true, true, null]);
  } finally {
    Math.random = rand;
  }
});

test("the waits between attempts are random below a bound that doubles", () => {
  const attempts = new Attempts(Infinity, new AbortController().signal);
  assert.throws(() => attempts.failed({ kind: "local" }));
  assert.throws(() => attempts.failed({ kind: "refused", mayReconnect: false }));
  attempts.failed({ kind: "connection", mayReconnect: true });
  assert.throws(() => new Attempts(0, new AbortController().signal).failed({ kind: "connection", mayReconnect: true, text: "" }), /given up/);
});
