// The hub's side of a link, as docs/PROTOCOL.md has it, with a test at its controls.
import { createHmac, randomBytes } from "node:crypto";
import { createServer, connect as connectTcp } from "node:net";
import { WebSocketServer } from "ws";
import { Frames, PREFACE, Time, decode, encode } from "../dist/test/internals.js";

/** One connection at the fake hub. */
class Connection {
  frames = new Frames();
  link = null;
  #asked = null;

  constructor(hub, socket) {
    Object.assign(this, { hub, socket });
    socket.on("message", (bytes) => {
      for (const frame of this.frames.push(new Uint8Array(bytes))) this.#parcel(decode(frame), frame.length);
    });
    socket.on("close", () => hub.connections.delete(this));
    socket.on("error", () => undefined);
    socket.send(PREFACE);
  }

  post(parcel) {
    this.socket.send(encode({ sender: "hub", timestamp: Time.now(), ...parcel }));
  }

  reply(to, content = {}, name = "ok") {
    this.say({ family: "reply", name, reference: to.id, content });
  }

  error(code, name, to, content = {}) {
    this.say({ family: "error", name, ...(to ? { reference: to.id } : {}), content: { code, text: `${name} by the test`, ...content } });
  }

  /** Says what counts, once there is a link. */
  say(parcel, reliable = true) {
    if (this.link) this.link.say(parcel, reliable);
    else this.post(parcel);
  }

  #parcel(parcel, size) {
    const { hub } = this;
    hub.all.push(parcel);
    if (parcel.family === "time") {
      if (parcel.name === "ping" && !hub.deaf) this.post({ family: "time", name: "pong", reference: parcel.id, content: {} });
      if (parcel.name === "ack") this.link?.acknowledged(parcel.content.read);
      if (parcel.name === "resent") this.link.resent = true;
      return;
    }
    if (parcel.family === "login") return this.#login(parcel);
    if (this.link) this.link.heard(size);
    hub.heard.push(parcel);
    hub.onParcel(this, parcel);
  }

  #login(parcel) {
    const { hub } = this;
    hub.logins.push(parcel);
    if (parcel.name === "login") {
      if (hub.refuses && parcel.content.link !== undefined) return this.error(223, "bad-content", parcel, { slot: "content/link" });
      if (hub.onLogin(this, parcel)) return;
      const link = hub.links && parcel.content.link ? new Link(this) : null;
      const limits = { heartbeat: hub.heartbeat, gone: 3 * hub.heartbeat, outbox: 4 << 20 };
      const told = link && { link: { id: link.id, secret: new Uint8Array(link.secret), grace: hub.grace } };
      this.reply(parcel, { peer: "alice", user: "alice", level: 1, groups: [], limits, ...told });
      this.link = link;
    } else if (parcel.name === "resume") {
      this.#asked = { link: hub.known.get(parcel.content.link), nonce: randomBytes(32) };
      this.reply(parcel, { nonce: new Uint8Array(this.#asked.nonce), hub: "fake", context: "mom-link-1" }, "challenge");
    } else if (parcel.name === "answer") this.#resume(parcel);
    else if (parcel.name === "logout") {
      this.link?.heard(0);
      this.reply(parcel);
      this.socket.close();
    }
  }

  #resume(parcel) {
    const { link, nonce } = this.#asked;
    const proof = link && createHmac("sha256", link.secret).update(`mom-link-1\0fake\0${link.id}\0`).update(nonce).digest("hex");
    if (!link || this.hub.forgets || proof !== Buffer.from(parcel.content.proof).toString("hex")) return this.error(209, "not-resumed", parcel, { resumed: false });
    if (this.hub.miscounts) {
      this.error(408, "bad-count", parcel);
      return this.socket.close();
    }
    const dropped = link.resume(this, parcel.content.read);
    this.reply(parcel, { resumed: true, read: link.read, peer: "alice", user: "alice", level: 1, dropped, ...(this.hub.checksum === undefined ? {} : { checksum: this.hub.checksum }) });
    this.link = link;
    link.again();
  }
}

class Link {
  id = randomBytes(16).toString("hex");
  secret = randomBytes(32);
  read = 0;
  sent = 0;
  kept = [];
  resent = true;
  #unread = 0;
  #again = [];

  constructor(connection) {
    this.connection = connection;
    connection.hub.known.set(this.id, this);
    connection.hub.link = this;
  }

  say(parcel, reliable) {
    this.sent += 1;
    this.kept.push({ parcel, reliable });
    this.connection?.post(parcel);
  }

  heard(size) {
    this.read += 1;
    this.#unread += size;
    if (this.connection.hub.acknowledges && (this.read % 256 === 0 || this.#unread > 65536)) this.tell();
  }

  tell() {
    this.#unread = 0;
    this.connection.post({ family: "time", name: "ack", content: { read: this.read } });
  }

  acknowledged(read) {
    const first = this.sent - this.kept.length;
    if (read < first || read > this.sent) throw new Error(`the client says that it has read ${read} of ${first} to ${this.sent}`);
    this.kept.splice(0, read - first);
    this.connection?.hub.acks.push(read);
  }

  resume(connection, read) {
    this.acknowledged(read);
    this.connection = connection;
    this.resent = false;
    this.sent = read;
    this.#again = this.kept.splice(0);
    return this.#again.filter((one) => !one.reliable).length;
  }

  again() {
    for (const { parcel, reliable } of this.#again.splice(0)) if (reliable) this.say(parcel, true);
  }
}

export class FakeHub {
  /** All parcels that came; those that count; those of logins. */
  all = [];
  heard = [];
  logins = [];
  acks = [];
  known = new Map();
  connections = new Set();
  links = true;
  refuses = false;
  forgets = false;
  miscounts = false;
  /** What a resume is told that was read, if not the truth. */
  checksum = undefined;
  deaf = false;
  acknowledges = true;
  heartbeat = 10_000;
  grace = 30_000;
  onLogin = () => false;
  onParcel = (connection, parcel) => this.answer(connection, parcel);

  static async start(settings = {}) {
    const hub = Object.assign(new FakeHub(), settings);
    hub.server = new WebSocketServer({ host: "127.0.0.1", port: hub.port ?? 0, handleProtocols: () => "mom.bin.v1", perMessageDeflate: false });
    hub.server.on("connection", (socket) => hub.connections.add(new Connection(hub, socket)));
    await new Promise((resolve) => hub.server.once("listening", resolve));
    hub.port = hub.server.address().port;
    return hub;
  }

  get url() {
    return `ws://127.0.0.1:${this.port}`;
  }

  /** Answers requests as the lab would. */
  answer(connection, parcel) {
    const path = parcel.context;
    const [kind] = path === "/chat" ? ["channel"] : path === "/robot/token" ? ["token"] : path === "/robot/arm" ? ["channel"] : ["session"];
    const guard = path === "/robot/arm" ? { guard: { token: "/robot/token", names: ["command"], fence: 1 } } : {};
    if (parcel.name === "join") connection.reply(parcel, { path, kind, number: 7, ...guard });
    else if (parcel.name === "grab") connection.reply(parcel, { fence: 5, lease: 60_000 });
    else if (parcel.family !== "message") connection.reply(parcel);
    else if (parcel.receipt) connection.reply(parcel, { delivered: 1, dropped: [] });
  }

  /** Ends all connections without a word. */
  cut() {
    for (const connection of this.connections) connection.socket.terminate();
  }

  async stop() {
    this.cut();
    await new Promise((resolve) => this.server.close(resolve));
  }
}

/** A network that resets its connections after so many bytes: after as many as `passes` says to their first bytes, if that is a number, and at once if it is false. */
export async function faultyNetwork(port, next, passes = () => true) {
  const open = new Set();
  const server = createServer((near) => {
    const far = connectTcp(port, "127.0.0.1");
    let left = next();
    let first = true;
    for (const [from, to] of [[near, far], [far, near]]) {
      open.add(from);
      from.setNoDelay(true);
      from.on("data", (bytes) => {
        const passed = !first || from !== near || passes(bytes.toString("latin1"));
        if (passed !== true) left = Number(passed);
        first = false;
        to.write(bytes.subarray(0, Math.max(0, left)));
        left -= bytes.length;
        if (left <= 0) {
          // What was written still arrives.
          to.end();
          from.destroy();
        }
      });
      from.on("close", () => (open.delete(from), to.destroySoon()));
      from.on("error", () => undefined);
    }
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  const cut = () => open.forEach((socket) => socket.destroy());
  const stop = () => (cut(), new Promise((resolve) => server.close(resolve)));
  return { port: server.address().port, cut, stop };
}
