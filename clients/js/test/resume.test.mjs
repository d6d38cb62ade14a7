// Lost connections, against a real broker.
import assert from "node:assert/strict";
import test, { after, before } from "node:test";
import { connect, endPeer } from "../dist/mom-client.js";
import { faultyNetwork } from "./fakehub.mjs";
import { as, startLab, until } from "./lab.mjs";

let lab;
before(async () => (lab = await startLab()));
after(() => lab.stop());

for (const [scheme, cuts, least] of [["ws", 50, 1500], ["http", 15, 6000]]) {
  test(`of ${cuts} lost connections of ${scheme} none loses or repeats a message`, async () => {
    let seed = 11;
    const random = () => (seed = (Math.imul(seed, 1103515245) + 12345) & 0x7fffffff) / 0x7fffffff;
    let made = 0;
    const network = await faultyNetwork(lab.port, () => (made++ < cuts ? least + Math.floor(random() * 30_000) : Infinity));
    const bob = await connect(`ws://127.0.0.1:${lab.port}`, as("bob"));
    const client = await connect(`${scheme}://127.0.0.1:${network.port}`, as("alice"));
    try {
      const [here, there] = [await client.channel("/chat"), await bob.channel("/chat")];
      const [mine, his] = [here.events(), there.events()];
      const guard = await (await client.token("/robot/token")).grab();
      const read = async (events) => {
        const numbers = [];
        await until(events, (event) => {
          assert.notEqual(event.type, "link-down");
          if (event.type === "message" && event.name === "count") numbers.push(event.content);
          return event.type === "message" && event.name === "end";
        });
        return numbers;
      };
      const both = [read(mine), read(his)];
      const asked = [];
      let number = 0;
      while (made < cuts) {
        await here.send("count", number++);
        if (number % 7 === 0) await here.send("image", new Uint8Array(Math.floor(random() * 50_000)), { priority: -1, echo: false });
        if (number % 5 === 0) asked.push(here.sendAcknowledged("note", number));
        await new Promise((resolve) => setTimeout(resolve, client.peer?.outbox.bytes > 100_000 ? 10 : 1));
      }
      await here.send("end", null, { priority: -2 });
      const expected = Array.from({ length: number }, (_, place) => place);
      for (const numbers of await Promise.all(both)) assert.deepEqual(numbers, expected);
      for (const receipt of await Promise.all(asked)) assert.equal(receipt.delivered, 2);
      // The lease of three minutes has lasted.
      assert.equal(guard.isLost, null);
      await guard.release();
    } finally {
      await client.close();
      await bob.close();
      await network.stop();
    }
  });
}

test("a page that lost its WebSocket goes on through the tunnel", async () => {
  let websockets = true;
  const network = await faultyNetwork(lab.port, () => Infinity, (first) => websockets || !first.startsWith("GET /mom"));
  const client = await connect(`mom://127.0.0.1:${network.port}`, as("alice"));
  try {
    const [chat, states] = [await client.channel("/chat"), client.states()];
    assert.match((await until(states, (state) => state.state === "connected")).door, /^ws:/);
    const events = chat.events();
    websockets = false;
    network.cut();
    await until(states, (state) => state.state === "resuming");
    await chat.send("chat", "meanwhile");
    const { door, resumed } = await until(states, (state) => state.state === "connected");
    assert.deepEqual([door.split(":")[0], resumed], ["http", true]);
    await until(events, (event) => event.type === "message" && event.content === "meanwhile");
  } finally {
    await client.close();
    await network.stop();
  }
});

/** A client that the network lets into the tunnel only, as long as `websockets` is false. */
async function onTheTunnel(more) {
  const way = { websockets: false };
  const network = await faultyNetwork(lab.port, () => Infinity, (first) => !first.startsWith("GET /mom") || way.websockets);
  const client = await connect(`mom://127.0.0.1:${network.port}`, as("alice", more));
  assert.match(client.state.door, /^http:/);
  return Object.assign(way, { network, client, end: async () => (await client.close(), await network.stop()) });
}

test("a peer on the tunnel comes back by WebSocket when it has lost its connection", async () => {
  const way = await onTheTunnel({ seekWebSocket: 0 });
  try {
    const [chat, states] = [await way.client.channel("/chat"), way.client.states()];
    way.websockets = true;
    // A tunnel outlives lost connections of TCP.
    way.client.peer.endServing("by the test");
    await until(states, (state) => state.state === "resuming");
    const { door, resumed } = await until(states, (state) => state.state === "connected");
    assert.deepEqual([door.split(":")[0], resumed], ["ws", true]);
    // And the tunnel has its turn where the WebSocket opens and comes to nothing.
    way.websockets = 400;
    way.network.cut();
    await until(states, (state) => state.state === "resuming");
    assert.match((await until(states, (state) => state.state === "connected")).door, /^http:/);
    assert.equal((await chat.sendAcknowledged("chat")).delivered, 1);
  } finally {
    await way.end();
  }
});

test("a link on the tunnel moves to the WebSocket that works, and nothing is lost on the way", async () => {
  let [seed, left] = [5, 25];
  const random = () => (seed = (Math.imul(seed, 1103515245) + 12345) & 0x7fffffff) / 0x7fffffff;
  const way = await onTheTunnel({ seekWebSocket: 10 });
  const bob = await connect(`ws://127.0.0.1:${lab.port}`, as("bob"));
  try {
    const [here, there, states] = [await way.client.channel("/chat"), await bob.channel("/chat"), way.client.states()];
    const numbers = async (events, sender) => {
      const heard = [];
      await until(events, (event) => {
        assert.ok(event.type !== "link-down" && event.type !== "dropped", event.type);
        if (event.type === "message" && event.sender === sender) heard.push(event.content);
        return event.type === "message" && event.sender === sender && event.content === "end";
      });
      return heard.slice(0, -1);
    };
    const both = [numbers(here.events(), bob.name), numbers(there.events(), way.client.name)];
    const asked = [];
    let number = 0;
    let over = false;
    void until(states, (state) => left < 0 && state.state === "connected" && state.door.startsWith("ws:")).then(() => (over = true));
    // Cut in the middle of a move at any byte; then not any more.
    Object.defineProperty(way, "websockets", { get: () => (left-- > 0 ? 100 + Math.floor(random() * 2500) : true) });
    for (; !over; number++) {
      await Promise.all([here.send("count", number), there.send("count", number)]);
      if (number % 9 === 0) void here.send("image", new Uint8Array(70_000), { priority: -1, echo: false, to: ["nobody"] });
      if (number % 5 === 0) asked.push(way.client.lookup("/chat"));
      await new Promise((resolve) => setTimeout(resolve, 1));
      assert.ok(number < 20_000);
    }
    await Promise.all([here.send("count", "end"), there.send("count", "end")]);
    const expected = Array.from({ length: number }, (_, place) => place);
    for (const heard of await Promise.all(both)) assert.deepEqual(heard, expected);
    await Promise.all(asked);
  } finally {
    await bob.close();
    await way.end();
  }
});

test("a link does not move while its peer owns a token, and stays where the hub does not resume it", async () => {
  const way = await onTheTunnel({ seekWebSocket: 10 });
  const bob = await connect(`ws://127.0.0.1:${lab.port}`, as("bob"));
  try {
    const [chat, there, states] = [await way.client.channel("/chat"), await bob.channel("/chat"), way.client.states()];
    const arm = await bob.channel("/robot/arm");
    const [events, halts] = [chat.events(), arm.events()];
    const guard = await (await way.client.token("/robot/token")).grab();
    const { connector } = way.client.peer;
    const move = connector.move;
    let [moves, refused] = [0, () => undefined];
    connector.move = async (link, read) => {
      moves += 1;
      await read();
      await there.sendAcknowledged("chat", "meanwhile");
      refused();
      return null;
    };
    way.websockets = true;
    const { guards } = way.client.peer;
    // Five times it could have moved.
    await new Promise((resolve) => {
      let looked = 0;
      Object.defineProperty(guards, "isEmpty", { configurable: true, get: () => (++looked === 5 && resolve(), false) });
    });
    delete guards.isEmpty;
    assert.equal(moves, 0);
    const once = new Promise((resolve) => (refused = resolve));
    await guard.release();
    await once;
    await until(events, (event) => event.type === "message" && event.content === "meanwhile");
    assert.equal((await chat.sendAcknowledged("chat", "it stays")).delivered, 2);
    assert.match(way.client.state.door, /^http:/);
    connector.move = move;
    await until(states, (state) => state.state === "connected" && state.door.startsWith("ws:"));
    await arm.sendAcknowledged("note");
    const names = [];
    await until(halts, (event) => event.type === "message" && (names.push(event.name), event.name === "note"));
    // The release alone has halted it.
    assert.deepEqual(names, ["halt", "note"]);
  } finally {
    await bob.close();
    await way.end();
  }
});

test("a move of which the hub says nothing is a lost connection, and the link is resumed", async () => {
  const way = await onTheTunnel({ seekWebSocket: 10 });
  try {
    const [chat, states] = [await way.client.channel("/chat"), way.client.states()];
    const { connector } = way.client.peer;
    connector.move = async (link, read) => {
      delete connector.move;
      await read();
      // What is said now waits for the end of this.
      void chat.send("chat", "meanwhile");
      return new Promise(() => undefined);
    };
    await until(states, (state) => state.state === "resuming");
    assert.equal((await until(states, (state) => state.state === "connected")).resumed, true);
    assert.equal((await chat.sendAcknowledged("chat")).delivered, 1);
    await until(chat.events(), (event) => event.type === "message" && event.content === "meanwhile");
  } finally {
    await way.end();
  }
});

test("while a driver is lost the robot is safe, and he drives on with the same token", async () => {
  const network = await faultyNetwork(lab.port, () => Infinity);
  const bob = await connect(`ws://127.0.0.1:${lab.port}`, as("bob"));
  const alice = await connect(`ws://127.0.0.1:${network.port}`, as("alice"));
  try {
    const heard = (await bob.channel("/robot/arm")).events();
    const arm = await alice.channel("/robot/arm");
    const [guard, states] = [await (await alice.token("/robot/token")).grab(), alice.states()];
    await arm.sendAcknowledged("command", "grip open");
    await until(heard, (event) => event.type === "message" && event.name === "command");
    network.cut();
    await until(heard, (event) => event.type === "message" && event.name === "halt");
    const lost = await until(heard, (event) => event.type === "lost");
    assert.ok(lost.member.peer === "alice" && lost.within > 0);
    const refused = await (await bob.token("/robot/token")).grab().catch((error) => error);
    assert.deepEqual([refused.code, refused.owner], ["held", "alice"]);
    await until(states, (state) => state.state === "connected" && state.resumed);
    assert.equal((await until(heard, (event) => event.type === "resumed")).member.peer, "alice");
    await arm.sendAcknowledged("command", "grip close");
    const command = await until(heard, (event) => event.type === "message" && event.name === "command");
    assert.deepEqual([command.content, command.parcel.fence], ["grip close", guard.fence]);
    await guard.release();
  } finally {
    await alice.close();
    await bob.close();
    await network.stop();
  }
});

test("who is away for longer than the grace time logs in and joins anew", async () => {
  let there = true;
  const network = await faultyNetwork(lab.port, () => Infinity, () => there);
  const bob = await connect(`ws://127.0.0.1:${lab.port}`, as("bob"));
  const alice = await connect(`ws://127.0.0.1:${network.port}`, as("alice", { link: { grace: 100 } }));
  try {
    const [token, chat] = [await bob.token("/robot/token"), await alice.channel("/chat")];
    const [his, mine] = [token.events(), chat.events()];
    const guard = await (await alice.token("/robot/token")).grab();
    there = false;
    network.cut();
    assert.equal((await until(his, (event) => event.type === "released")).reason, "disconnected");
    assert.equal((await guard.lost).reason, "disconnected");
    await until(mine, (event) => event.type === "link-down");
    there = true;
    await until(mine, (event) => event.type === "rejoined");
    assert.ok((await chat.sendAcknowledged("chat", "back")).delivered >= 1);
  } finally {
    await alice.close();
    await bob.close();
    await network.stop();
  }
});

test("a peer whose page is gone is ended from elsewhere, however much it had read", async () => {
  let there = true;
  const network = await faultyNetwork(lab.port, () => Infinity, () => there);
  const [direct, bob] = [`ws://127.0.0.1:${lab.port}`, await connect(`ws://127.0.0.1:${lab.port}`, as("bob"))];
  const gone = await connect(`ws://127.0.0.1:${network.port}`, as("alice"));
  try {
    const his = (await bob.token("/robot/token")).events();
    const around = (await bob.channel("/chat")).events();
    await (await gone.token("/robot/token")).grab();
    const chat = await gone.channel("/chat");
    const mine = chat.events();
    // After 256 it acknowledges them.
    for (let number = 0; number < 600; number++) await chat.send("chat", number);
    await until(mine, (event) => event.type === "message" && event.content === 599);
    there = false;
    network.cut();
    await until(around, (event) => event.type === "lost");
    await endPeer(direct, gone.credential, as("alice"));
    const again = await connect(direct, as("alice"));
    assert.equal(again.name, "alice");
    await until(his, (event) => event.type === "released");
    await again.close();
  } finally {
    await gone.close();
    await bob.close();
    await network.stop();
  }
});
