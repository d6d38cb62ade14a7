// What the hub compresses as a whole (M16), against a real broker.
import assert from "node:assert/strict";
import { once } from "node:events";
import { createServer, connect as dial } from "node:net";
import test, { after, before } from "node:test";
import { deflateSync } from "node:zlib";
import { Frames, Wire, connect } from "../dist/test/internals.js";
import { as, startLab, until } from "./lab.mjs";

const PROGRAM = Array.from({ length: 4000 }, (_, line) => `MoveL [[${line},0.0,712.0],[0.7071,0,0.7071,0]], vslow, fine, gripper;\n`).join("");

let lab;
before(async () => (lab = await startLab()));
after(() => lab.stop());

/** The bytes that the hub has given to a user's connection. */
async function given(asking, user) {
  const { peers } = await asking.stats("/");
  return Number(peers.find((peer) => peer.user === user).sent);
}

const message = (name) => (event) => event.type === "message" && event.name === name;

for (const scheme of ["ws", "http", "mom"]) {
  test(`a tenth of the bytes comes by ${scheme}`, async () => {
    const address = `${scheme}://127.0.0.1:${lab.port}`;
    const carol = await connect(address, as("carol"));
    const bob = await connect(address, as("bob", { compress: true }));
    const heard = (await bob.channel("/chat")).events();
    const from = await given(carol, "bob");
    const chat = await carol.channel("/chat");
    for (let count = 0; count < 3; count++) await chat.send("program", { count, text: PROGRAM });
    for (let count = 0; count < 3; count++) assert.deepEqual((await until(heard, message("program"))).content, { count, text: PROGRAM });
    assert.ok((await given(carol, "bob")) - from < (3 * PROGRAM.length) / 8);
    // Small ones come at once.
    await chat.send("note", "short");
    assert.equal((await until(heard, message("note"))).content, "short");
    await Promise.all([bob.close(), carol.close()]);
  });
}

test("a link goes on compressed, and nothing is lost", async () => {
  const sockets = new Set();
  const relay = createServer((near) => {
    const far = dial(lab.port, "127.0.0.1");
    for (const [one, other] of [[near, far], [far, near]]) {
      sockets.add(one);
      one.on("error", () => undefined).on("close", () => (sockets.delete(one), other.destroy()));
      one.pipe(other);
    }
  });
  relay.listen(0, "127.0.0.1");
  await once(relay, "listening");
  const carol = await connect(`ws://127.0.0.1:${lab.port}`, as("carol"));
  const bob = await connect(`ws://127.0.0.1:${relay.address().port}`, as("bob", { compress: true }));
  const [ours, theirs] = [await bob.channel("/chat"), await carol.channel("/chat")];
  const [atBob, atCarol] = [ours.events(), theirs.events()];
  const states = bob.states();
  for (let count = 0; count < 6; count++) {
    await theirs.send("from-carol", { count, text: PROGRAM });
    await ours.send("from-bob", { count });
    for (const socket of sockets) socket.destroy();
    await until(states, ({ state }) => state === "resuming");
    await until(states, ({ state, resumed }) => state === "connected" && resumed);
  }
  for (let count = 0; count < 6; count++) {
    assert.deepEqual((await until(atBob, message("from-carol"))).content, { count, text: PROGRAM });
    assert.deepEqual((await until(atCarol, message("from-bob"))).content, { count });
  }
  await Promise.all([bob.close(), carol.close()]);
  relay.close();
});

const PREFACE = Uint8Array.of(0x8f, 0x4d, 0x4f, 0x4d, 1, 3);
const MARK = Uint8Array.of(0, 0, 0, 1, 2);

test("a stream that was not asked for is none, and a broken one ends the connection", async () => {
  assert.throws(() => [...new Frames().push(Buffer.concat([PREFACE, MARK]))], { code: "bad-frame" });
  for (const packed of [Buffer.from("no zlib at all"), Buffer.concat([deflateSync(Buffer.alloc(9)).subarray(0, 2), Buffer.alloc(60, 0xff)])]) {
    const wire = new Wire({ compress: true });
    let closed = 0;
    wire.pipe = { close: () => closed++ };
    const ended = new Promise((resolve) => wire.take({ parcel() {}, drained() {}, ended: resolve }));
    wire.bytes(Buffer.concat([PREFACE, MARK, packed]));
    assert.match(await ended, /stream/);
    assert.ok(closed > 0);
  }
});
