// A relay between pages and a hub, which is as bad as a network may be.
import { connect, createServer } from "node:net";

/** ms between two portions of a bounded uplink, and bytes of one connection in a row. */
const EVERY = 5;
const PORTION = 1400;

/** A server that listens, with what ends it and all its connections. */
export async function listening(server) {
  const sockets = new Set();
  server.on("connection", (socket) => {
    sockets.add(socket);
    socket.on("error", () => undefined);
    socket.on("close", () => sockets.delete(socket));
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  const { port } = server.address();
  const end = async () => {
    for (const socket of sockets) socket.destroy();
    await new Promise((resolve) => server.close(resolve));
  };
  return { port, origin: `http://127.0.0.1:${port}`, sockets, end, [Symbol.asyncDispose]: end };
}

/** One connection through the relay. */
class Passage {
  #waiting = Buffer.alloc(0);
  #frozen = false;
  #ended = false;
  hangs = false;

  constructor(relay, socket, passed) {
    Object.assign(this, { relay, socket, passed });
    passed.pipe(socket);
    socket.on("data", (bytes) => {
      this.#waiting = this.#waiting.length ? Buffer.concat([this.#waiting, bytes]) : bytes;
      if (relay.uplink === Infinity) this.write(Infinity);
      // What is more waits in the page's own machine, as behind a modem.
      else socket.pause();
    });
    socket.on("end", () => {
      this.#ended = true;
      this.write(0);
    });
  }

  get waits() {
    return this.#waiting.length > 0 && !this.#frozen;
  }

  /** Passes on so many bytes of the page's; how many it were. */
  write(most) {
    if (this.#frozen) return 0;
    const part = this.#waiting.subarray(0, most);
    this.#waiting = this.#waiting.subarray(part.length);
    if (part.length) this.passed.write(part);
    if (this.#waiting.length) return part.length;
    if (this.#ended) this.passed.end();
    else if (this.socket.isPaused()) this.socket.resume();
    return part.length;
  }

  freeze(fresh = false) {
    [this.#frozen, this.hangs] = [true, fresh];
    this.socket.pause();
    this.passed.unpipe(this.socket);
    this.passed.pause();
  }

  thaw() {
    if (!this.#frozen) return;
    [this.#frozen, this.hangs] = [false, false];
    this.passed.pipe(this.socket);
    this.write(this.relay.uplink === Infinity ? Infinity : 0);
    this.socket.resume();
  }
}

/**
 * Passes connections on to a hub. `cut` ends them, `closed` lets no other in, `freeze` has those that are there say and hear nothing more, though they are open,
 * until `thaw`; while it is `frozen` so have those that begin. `uplink` bounds what pages say, in bytes a second, which connections share alike.
 */
export async function startRelay() {
  const relay = { to: 0, closed: false, frozen: false, uplink: Infinity };
  const passages = new Set();
  const server = createServer((socket) => {
    if (relay.closed) return void socket.destroy();
    const passed = connect(relay.to, "127.0.0.1");
    const passage = new Passage(relay, socket, passed);
    passages.add(passage);
    if (relay.frozen) passage.freeze(true);
    for (const [one, other] of [[socket, passed], [passed, socket]]) {
      one.on("error", () => other.destroy());
      one.on("close", () => {
        passages.delete(passage);
        other.destroy();
      });
    }
  });
  let [last, left] = [performance.now(), 0];
  const timer = setInterval(() => {
    const now = performance.now();
    left = relay.uplink === Infinity ? Infinity : Math.min(relay.uplink / 10, left + ((now - last) * relay.uplink) / 1000);
    last = now;
    for (let waiting = [...passages].filter(({ waits }) => waits); waiting.length && left > 0; waiting = waiting.filter(({ waits }) => waits)) {
      for (const passage of waiting) left -= passage.write(PORTION);
    }
  }, EVERY);
  const { sockets, end, ...rest } = await listening(server);
  const ends = async () => {
    clearInterval(timer);
    await end();
  };
  Object.assign(relay, rest);
  const more = {
    end: ends,
    [Symbol.asyncDispose]: ends,
    cut() {
      for (const socket of sockets) socket.destroy();
    },
    freeze() {
      for (const passage of passages) passage.freeze();
    },
    /** How many have begun while it was frozen. */
    get hangs() {
      return [...passages].filter(({ hangs }) => hangs).length;
    },
    /** Whether something waits for the uplink. */
    get waits() {
      return [...passages].some(({ waits }) => waits);
    },
    thaw() {
      for (const passage of passages) passage.thaw();
    },
  };
  return Object.defineProperties(relay, Object.getOwnPropertyDescriptors(more));
}
