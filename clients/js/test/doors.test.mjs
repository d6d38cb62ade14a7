// Which door is taken, and what stands between.
import assert from "node:assert/strict";
import { createServer as createHttp, request } from "node:http";
import { connect as connectTcp, createServer } from "node:net";
import test, { after, before } from "node:test";
import { connect, doorsOf, shown } from "../dist/test/internals.js";
import { FakeHub } from "./fakehub.mjs";
import { as, startLab, until } from "./lab.mjs";

let lab;
before(async () => (lab = await startLab()));
after(() => lab.stop());

const listening = (server) => new Promise((resolve) => server.listen(0, "127.0.0.1", () => resolve(server.address().port)));

test("an address is the doors that its credentials permit", () => {
  const doors = (...args) => doorsOf(...args).map(shown);
  assert.deepEqual(doors("mom://lab.example.org", true, false), ["wss://lab.example.org:7666", "https://lab.example.org:7666", "wss://lab.example.org:443", "https://lab.example.org:443"]);
  assert.deepEqual(doors("mom://lab.example.org:9", false, false), ["wss://lab.example.org:9", "ws://lab.example.org:9", "https://lab.example.org:9"]);
  assert.deepEqual(doors("mom://[::1]:9", true, false), ["wss://[::1]:9", "ws://[::1]:9", "https://[::1]:9", "http://[::1]:9"]);
  assert.deepEqual(doors("moms://localhost:9", false, false), ["wss://localhost:9", "https://localhost:9"]);
  assert.deepEqual(doors("mom://lab:9", false, true), ["wss://lab:9", "https://lab:9"]);
  assert.deepEqual([doors("ws://lab", false, false), doors("https://lab/?poll=1", true, true)], [["ws://lab:80"], ["https://lab:443"]]);
  for (const wrong of ["lab", "ws://", "ws://lab:0", "ws://lab:70000", "ws://user@lab", "ws://::1", "bin://lab", "ws://lab?form=json", "javascript:alert(1)"]) {
    assert.throws(() => doorsOf(wrong, false, false), { kind: "local" }, wrong);
  }
  assert.throws(() => doorsOf("ws://lab", false, true), { code: "insecure", message: /write wss:\/\/lab:80/ });
  assert.throws(() => doorsOf("ws://127.0.0.1.example.org", true, false), { code: "insecure" });
});

test("a door that says nothing holds nobody up, and what worked is tried first", async () => {
  const sockets = new Set();
  let silent = 0;
  const server = createServer((near) => {
    sockets.add(near.on("error", () => undefined));
    near.once("data", (first) => {
      // TLS gets no answer.
      if (first[0] === 0x16) return (silent += 1);
      const far = connectTcp(lab.port, "127.0.0.1").on("error", () => undefined);
      far.write(first);
      near.pipe(far).pipe(near);
    });
  });
  const port = await listening(server);
  try {
    const begin = performance.now();
    for (const again of [false, true]) {
      const client = await connect(`mom://127.0.0.1:${port}`, as("alice"));
      assert.match(client.state.door, /^ws:/);
      assert.equal(silent, 1);
      if (!again) assert.ok(performance.now() - begin >= 240);
      await client.close();
    }
  } finally {
    for (const socket of sockets) socket.destroy();
    server.close();
  }
});

test("a first connection waits for a hub that is not there yet", async () => {
  const server = createServer();
  const port = await listening(server);
  await new Promise((resolve) => server.close(resolve));
  let hub;
  const client = await connect(`ws://127.0.0.1:${port}`, as("alice", {
    onState: (state) => {
      if (state.state === "trying" && state.attempt === 2) hub = FakeHub.start({ port });
    },
  }));
  assert.equal(client.name, "alice");
  await client.close();
  await (await hub).stop();
});

/** A proxy that gives an answer on when it is over. */
async function bufferingProxy(port, asked) {
  const server = createHttp((near, answer) => {
    asked.push(`${near.method} ${near.url.replace(/[0-9a-f]{32}/, "ID").replace(/\d+/g, "N")}`);
    const far = request({ port, host: "127.0.0.1", path: near.url, method: near.method, headers: { ...near.headers, host: `127.0.0.1:${port}` } }, (came) => {
      const parts = [];
      came.on("data", (part) => parts.push(part));
      came.on("error", () => undefined);
      came.on("end", () => answer.writeHead(came.statusCode, came.headers).end(Buffer.concat(parts)));
    });
    far.on("error", () => answer.destroy());
    answer.on("close", () => far.destroy());
    near.pipe(far);
  });
  return { port: await listening(server), stop: () => (server.closeAllConnections(), new Promise((resolve) => server.close(resolve))) };
}

test("behind a proxy that holds answers back the tunnel polls", async () => {
  const asked = [];
  const proxy = await bufferingProxy(lab.port, asked);
  const client = await connect(`http://127.0.0.1:${proxy.port}`, as("alice"));
  try {
    const chat = await client.channel("/chat");
    const events = chat.events();
    await chat.sendAcknowledged("chat", new Uint8Array(200_000));
    assert.equal((await until(events, (event) => event.type === "message")).content.length, 200_000);
    assert.ok(asked.includes("GET /tunnel/ID?at=N"), "it begins with a stream");
    assert.equal(asked.filter((one) => one.startsWith("GET")).at(-1), "GET /tunnel/ID?at=N&wait=N");
  } finally {
    await client.close();
    await proxy.stop();
  }
});
