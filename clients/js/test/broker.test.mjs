// The client against a real broker.
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { generateKeyPairSync } from "node:crypto";
import { readFileSync } from "node:fs";
import test, { after, afterEach, before } from "node:test";
import { WebSocket } from "ws";
import { Key, MomError, connect } from "../dist/mom-client.js";
import { as, startLab, until } from "./lab.mjs";

const { privateKey, publicKey } = generateKeyPairSync("ed25519");
const raw = publicKey.export({ type: "spki", format: "der" }).subarray(-32).toString("base64");
const pem = privateKey.export({ type: "pkcs8", format: "pem" });

let lab;
before(async () => {
  lab = await startLab({
    config: `\n[login]\nguests = true\nhub = "lab"\n`,
    users: `\n[[users]]\nname = "rover"\nkeys = ["ed25519 ${raw}"]\nlevel = 1\ngroups = []\n`,
  });
});
after(() => lab.stop());

const clients = [];
/** A client that ends with the test. */
const open = async (...options) => {
  const client = await connect(...options);
  clients.push(client);
  return client;
};
afterEach(() => Promise.all(clients.splice(0).map((client) => client.close())));

const ws = () => `ws://127.0.0.1:${lab.port}`;
const doors = { WebSocket: () => ws(), tunnel: () => `http://127.0.0.1:${lab.port}`, "polled tunnel": () => `http://127.0.0.1:${lab.port}?poll=1`, "any door": () => `mom://127.0.0.1:${lab.port}` };

for (const [name, address] of Object.entries(doors)) {
  test(`two peers talk by ${name}`, async () => {
    const alice = await open(address(), as("alice"));
    const bob = await open(address(), as("bob"));
    const [said, heard] = [await alice.channel("/chat"), (await bob.channel("/chat")).events()];
    const content = { text: "hello", many: [1, 2n ** 60n, 0.5, null], image: new Uint8Array(300_000).map((_, at) => at * 7) };
    const receipt = await said.sendAcknowledged("chat", content, { extra: { mood: "good" } });
    assert.deepEqual(receipt, { delivered: 2, dropped: [] });
    const event = await until(heard, (event) => event.type === "message");
    assert.deepEqual([event.name, event.sender, event.parcel.extra], ["chat", alice.name, { mood: "good" }]);
    assert.deepEqual(event.content, content);
  });
}

test("a message of more than what may be unacknowledged leaves at once, as the hub is asked what it has read", async () => {
  const alice = await open(ws(), as("alice"));
  const chat = await alice.channel("/chat");
  await chat.sendAcknowledged("note");
  const begin = performance.now();
  await chat.sendAcknowledged("image", new Uint8Array(5 << 20), { echo: false });
  // The next sign of life would be due after 10 s.
  assert.ok(performance.now() - begin < 5000);
});

test("who refreshes a channel joins it anew, as devices and others see, and goes on hearing it", async () => {
  const alice = await open(ws(), as("alice"));
  const bob = await open(ws(), as("bob"));
  const others = (await bob.channel("/chat")).events();
  const heard = (await alice.channel("/chat")).events();
  await until(others, ({ type, member }) => type === "joined" && member.peer === alice.name);
  await alice.refresh("/chat");
  for (const type of ["left", "joined"]) await until(others, (event) => event.type === type && event.member.peer === alice.name);
  await (await bob.channel("/chat")).send("chat", "again");
  assert.equal((await until(heard, ({ type }) => type === "message")).content, "again");
});

test("a client logs in by key, as a guest and under a nickname", async () => {
  const key = await Key.fromPem(pem);
  const rover = await open(ws(), { user: "rover", key, hubName: "lab", webSocket: WebSocket });
  assert.deepEqual([rover.user, rover.level], ["rover", 1]);
  const guest = await open(ws(), { guest: true, nickname: "visitor", webSocket: WebSocket });
  assert.deepEqual([guest.user, guest.level], ["guest", 0]);
  const ally = await open(ws(), as("alice", { nickname: "ally" }));
  assert.equal(ally.name, "ally");
  await assert.rejects(connect(ws(), { user: "rover", key, hubName: "other", webSocket: WebSocket }), { code: "bad-login", kind: "local" });
  await assert.rejects(connect(ws(), as("alice", { password: "wrong" })), { code: "bad-login", kind: "refused", number: 201 });
  await assert.rejects(connect(ws(), { user: "alice", webSocket: WebSocket }), { kind: "local" });
  await assert.rejects(Key.fromPem("no key"), { code: "bad-encoding" });
});

test("the first example of the README fits ten lines, and runs", async () => {
  const [, example] = /```js\n([\s\S]*?)```/.exec(readFileSync(new URL("../README.md", import.meta.url), "utf8"));
  assert.ok(example.trimEnd().split("\n").length <= 10);
  const lines = example.replace(/^import .*$/m, "").replace("mom://lab.example.org", `mom://127.0.0.1:${lab.port}`).replace("secret", "alice");
  const AsyncFunction = (async () => undefined).constructor;
  const seen = await new Promise((resolve, reject) => {
    const mine = (address, options) => open(address, { ...options, webSocket: WebSocket });
    void new AsyncFunction("connect", "console", lines)(mine, { log: (...words) => resolve(words) }).catch(reject);
  });
  assert.deepEqual(seen, ["alice", "good morning"]);
});

test("who authenticates again stays the peer that it was", async () => {
  const alice = await open(ws(), as("alice"));
  const chat = await alice.channel("/chat");
  await alice.authenticateAgain({ password: "alice" });
  assert.equal((await chat.sendAcknowledged("chat", "still here")).delivered, 1);
  await assert.rejects(alice.authenticateAgain({ password: "wrong" }), { code: "bad-login" });
  const rover = await open(ws(), { user: "rover", key: await Key.fromPem(pem), webSocket: WebSocket });
  await rover.authenticateAgain({ key: await Key.fromPem(pem) });
  assert.equal(rover.user, "rover");
});

test("a guard renews its lease and its deadman time", async () => {
  const carol = await open(ws(), as("carol"));
  await carol.create("/deadman", { kind: "token", manager: "open", deadman: 1500 });
  const guard = await (await carol.token("/deadman")).grab();
  assert.equal(guard.deadman, 1500);
  // Longer than it lasts without a renewal.
  await new Promise((resolve) => setTimeout(resolve, 2500));
  assert.equal(guard.isLost, null);
  assert.equal((await carol.info("/deadman")).owner, "carol");
  await carol.delete("/deadman");
  assert.equal((await guard.lost).reason, "deleted");
});

test("by TLS a secret goes anywhere, over WebSocket and tunnel", async () => {
  const secure = await startLab({ config: `\n[tls]\ncertificate = "hub.crt"\nkey = "hub.key"\nself-signed = true\nhosts = ["127.0.0.1"]\n` });
  try {
    const program = `
      import { WebSocket } from "ws";
      import { connect } from "./dist/mom-client.js";
      for (const scheme of ["wss", "https", "moms"]) {
        const client = await connect(\`\${scheme}://127.0.0.1:${secure.port}\`, { user: "alice", password: "alice", webSocket: WebSocket, connectWithin: 1 });
        const chat = await client.channel("/chat");
        await chat.sendAcknowledged("chat", "hello");
        console.log(client.state.door.split(":")[0]);
        await client.close();
      }`;
    const run = (env) => spawnSync(process.execPath, ["--input-type=module", "--eval", program], { cwd: new URL("..", import.meta.url), encoding: "utf8", env: { ...process.env, ...env } });
    assert.equal(run({ NODE_EXTRA_CA_CERTS: `${secure.folder}/hub.crt` }).stdout, "wss\nhttps\nwss\n");
    // A hub that nobody vouches for is none.
    assert.match(run({}).stderr, /self-signed certificate/);
  } finally {
    await secure.stop();
  }
});

test("a secret goes over no door that others can read", async () => {
  for (const address of ["ws://192.0.2.1", "http://lab.example.org", "ws://localhost.example.org"]) {
    await assert.rejects(connect(address, as("alice")), { code: "insecure", kind: "local", message: /write wss?:\/\/|write https:\/\// });
    await assert.rejects(connect(address, { token: "x", webSocket: WebSocket }), { code: "insecure" });
  }
  await assert.rejects(connect("tcp://127.0.0.1", as("alice")), { kind: "local" });
  await assert.rejects(connect("nonsense", as("alice")), { kind: "local" });
});

test("contexts are found, listed, made and deleted", async () => {
  const carol = await open(ws(), as("carol"));
  assert.deepEqual((await carol.list("/")).map((context) => context.path), ["/calibrate", "/camera", "/chat", "/log", "/model", "/robot", "/servo"]);
  assert.equal((await carol.lookup("/robot/arm")).kind, "channel");
  assert.equal((await carol.info("/robot/token"))["lease"], 180000);
  const root = await carol.session("/");
  const unaddressed = carol.unaddressed();
  const made = await root.create("room", { kind: "channel", manager: "open", delivery: "latest" });
  assert.deepEqual([made.path, made.kind], ["/room", "channel"]);
  assert.equal((await until(unaddressed, (event) => event.type === "created")).path, "/room");
  const room = await carol.channel("/room");
  assert.deepEqual(await room.members(), [{ peer: "carol", user: "carol", level: 5, device: false }]);
  const events = room.events();
  await carol.delete("/room");
  assert.equal((await until(events, (event) => event.type === "deleted")).path, "/room");
  assert.equal((await events.next()).done, true);
  const error = await carol.channel("/robo/arm").catch((error) => error);
  assert.ok(error instanceof MomError);
  assert.deepEqual([error.code, error.number, error.nearest], ["unknown-path", 210, "/robot"]);
  await assert.rejects(carol.channel("/robot"), { code: "wrong-kind" });
  await assert.rejects(carol.session("no path"), { code: "bad-path" });
  assert.ok((await carol.stats("/chat"))["time"]);
});

test("a token is grabbed, refused to others, renewed and released", async () => {
  const alice = await open(ws(), as("alice"));
  const bob = await open(ws(), as("bob"));
  const arm = await alice.channel("/robot/arm");
  const armEvents = arm.events();
  const guard = await (await alice.token("/robot/token")).grab();
  assert.equal((await until(armEvents, (event) => event.type === "grabbed")).fence, guard.fence);
  assert.deepEqual([guard.lease, arm.guard.owner], [180000, "alice"]);
  const theirs = await bob.token("/robot/token");
  const refused = await theirs.grab().catch((error) => error);
  assert.deepEqual([refused.code, refused.owner, refused.rule], ["held", "alice", "robot-token/level-or-lease"]);
  assert.ok(refused.retryAfter > 100000 && refused.mayRetry);
  const bobsArm = await bob.channel("/robot/arm");
  const bobHears = bobsArm.events();
  await bobsArm.send("command", "grip open");
  assert.equal((await until(bobHears, (event) => event.type === "refused")).error.code, "not-owner");
  await arm.sendAcknowledged("command", "grip open");
  const command = await until(bobHears, (event) => event.type === "message" && event.name === "command");
  assert.equal(command.parcel.fence, guard.fence);
  assert.equal(bobsArm.permits(command.parcel), true);
  // A second grab is a renewal of the same ownership.
  const again = await (await alice.token("/robot/token")).grab();
  assert.equal(again.fence, guard.fence);
  await guard.release();
  assert.equal((await again.lost).reason, "released");
  assert.equal((await until(bobHears, (event) => event.type === "message" && event.name === "halt")).sender, "hub");
  assert.equal(bobsArm.permits(command.parcel), false);
  await (await theirs.grab()).release();
});

test("a grab waits in the queue, and a higher level takes the token", async () => {
  const alice = await open(ws(), as("alice"));
  const bob = await open(ws(), as("bob"));
  const carol = await open(ws(), as("carol"));
  const guard = await (await alice.token("/robot/token")).grab();
  const theirs = await bob.token("/robot/token");
  const stop = new AbortController();
  let waiting;
  const place = await new Promise((resolve) => (waiting = theirs.grab({ wait: "unlimited", signal: stop.signal, onPlace: resolve })));
  assert.equal(place, 1);
  const taken = await (await carol.token("/robot/token")).grab();
  assert.deepEqual(await guard.lost, { reason: "preempted", by: "carol" });
  stop.abort();
  await assert.rejects(waiting, { code: "withdrawn" });
  let next;
  await new Promise((resolve) => (next = theirs.grab({ wait: 60_000, onPlace: resolve })));
  await taken.release();
  await (await next).release();
});

test("a token is given, returns, is asked for and handed over", async () => {
  const alice = await open(ws(), as("alice"));
  const bob = await open(ws(), as("bob"));
  const [hers, his] = [await alice.token("/robot/token"), await bob.token("/robot/token")];
  const [aliceHears, bobHears] = [hers.events(), his.events()];
  const guard = await hers.grab();
  const given = await guard.give("bob", { for: 60_000 });
  assert.equal((await until(bobHears, (event) => event.type === "offer")).by, "alice");
  const lent = await his.accept();
  assert.equal(lent.delegation.from, "alice");
  assert.equal((await guard.lost).reason, "given");
  const back = given.returned();
  await lent.release();
  const again = await back;
  assert.ok(again.fence > lent.fence);
  const asked = his.request({ text: "please" });
  assert.equal((await until(aliceHears, (event) => event.type === "requested")).text, "please");
  await hers.acceptRequest("bob");
  await (await asked).release();
  assert.equal((await again.lost).reason, "given");
  const carol = await open(ws(), as("carol"));
  const part = await (await carol.token("/robot/token")).inhibit();
  await assert.rejects(his.grab(), { code: "held" });
  await part.release();
});

test("who has lent a token is told where it does not come back", async () => {
  const alice = await open(ws(), as("alice"));
  const bob = await open(ws(), as("bob"));
  const carol = await open(ws(), as("carol"));
  const [hers, his, boss] = [await alice.token("/robot/token"), await bob.token("/robot/token"), await carol.token("/robot/token")];
  const bobHears = his.events();
  const lend = async (accepts) => {
    const guard = await hers.grab();
    const given = await guard.give("bob", { for: 60_000 });
    await until(bobHears, (event) => event.type === "offer");
    if (accepts) await his.accept();
    return { guard, given };
  };
  // One that was declined stays, and a later grab is not taken for its return.
  const declined = await lend(false);
  await his.decline();
  assert.equal(await declined.given.returned(), null);
  await declined.guard.release();
  const again = await hers.grab();
  await alice.info("/robot/token");
  assert.equal(again.hold.is, null, "it was let go as one that nobody waits for");
  await again.release();
  const preempted = await lend(true);
  const taken = await boss.grab();
  assert.equal(await preempted.given.returned(), null);
  await taken.release();
  const broken = await lend(true);
  await boss.breakHold();
  assert.equal(await broken.given.returned(), null);
  const expelled = await lend(true);
  const back = expelled.given.returned();
  await carol.expel("/robot/token", "alice", { for: 1 });
  assert.equal(await back, null);
  await carol.request({ family: "token", name: "break", context: "/robot/token" });
});

test("a peer that manages a context is asked", async () => {
  const carol = await open(ws(), as("carol"));
  const bob = await open(ws(), as("bob"));
  const consults = carol.consults();
  await carol.create("/mine", { kind: "channel", manager: "self" });
  const answered = (async () => {
    for await (const consult of consults) {
      if (consult.by === "bob" && consult.verb === "join") return consult.deny({ text: "not today" });
      await consult.allow();
    }
  })();
  const refused = await bob.channel("/mine").catch((error) => error);
  assert.deepEqual([refused.code, refused.text.includes("not today")], ["declined", true]);
  await answered;
  await carol.delete("/mine");
});

test("the hub closes for good who is expelled from everything", async () => {
  const guest = await connect(ws(), { guest: true, webSocket: WebSocket });
  const states = guest.states();
  const carol = await open(ws(), as("carol"));
  await carol.expel("/", guest.name, { for: 0, text: "closing time" });
  const closed = await until(states, (state) => state.state === "closed");
  assert.equal(closed.error.code, "revoked");
  await assert.rejects(guest.list("/"), { kind: "closed" });
});

test("who cannot reach the hub keeps trying, and says why when it gives up", async () => {
  const states = [];
  const error = await connect("mom://127.0.0.1:1", as("alice", { connectWithin: 300, onState: (state) => states.push(state) })).catch((error) => error);
  assert.equal(error.kind, "connection");
  assert.match(error.text, /given up after .*websocket with TLS at 127\.0\.0\.1:1/);
  assert.ok(states.length > 2 && states.every((state) => ["trying", "closed"].includes(state.state)));
  const stop = new AbortController();
  const tried = connect("ws://127.0.0.1:1", as("alice", { signal: stop.signal }));
  stop.abort();
  await assert.rejects(tried, { kind: "connection" });
});
