// A peer of the JSON form over a socket: enough to create, to say, and to say much.
import { connect } from "node:net";

export class RawPeer {
  #socket;
  #asked = new Map();
  #nextId = 1;
  #rest = "";
  /** The newest error that answers nothing. */
  #last = "";

  constructor(socket) {
    this.#socket = socket;
    socket.setEncoding("utf8");
    // One that a failed test leaves behind does not keep the tests from ending.
    socket.unref();
    socket.on("data", (text) => {
      const lines = (this.#rest + text).split("\n");
      this.#rest = lines.pop();
      for (const line of lines.filter(Boolean)) this.#heard(JSON.parse(line));
    });
    this.ended = new Promise((resolve) => socket.on("close", resolve));
    void this.ended.then(() => this.#asked.forEach(({ reject }) => reject(new Error(`the hub has closed the connection: ${this.#last}`))));
    socket.on("error", () => undefined);
  }

  /** Logs in at `HOST:PORT`. */
  static login(address, user, password = user) {
    return RawPeer.#enter(address, { name: user, password });
  }

  static guest(address) {
    return RawPeer.#enter(address, { guest: true });
  }

  static async #enter(address, proof) {
    const [host, port] = address.split(":");
    const socket = connect(Number(port), host);
    await new Promise((resolve, reject) => socket.once("connect", resolve).once("error", reject));
    const peer = new RawPeer(socket);
    const { content } = await peer.ask("login", "login", undefined, proof);
    peer.name = content.peer;
    return peer;
  }

  #heard(parcel) {
    if (parcel.family === "time" && parcel.name === "ping") return this.write({ family: "time", name: "pong", reference: parcel.id });
    if (parcel.family === "error" && parcel.reference === undefined) this.#last = `${parcel.name}: ${parcel.content?.text}`;
    const asked = this.#asked.get(parcel.reference);
    if (!asked || (parcel.family !== "reply" && parcel.family !== "error")) return;
    this.#asked.delete(parcel.reference);
    if (parcel.family === "reply") asked.resolve(parcel);
    else asked.reject(new Error(`${parcel.name}: ${parcel.content?.text}`));
  }

  write(parcel) {
    return this.#socket.write(`${JSON.stringify(parcel)}\n`);
  }

  ask(family, name, context, content) {
    const id = this.#nextId++;
    const parcel = { family, name, id };
    if (context !== undefined) parcel.context = context;
    if (content !== undefined) parcel.content = content;
    return new Promise((resolve, reject) => {
      this.#asked.set(id, { resolve, reject });
      this.write(parcel);
    });
  }

  /** Says it, and waits until the hub has taken it. */
  async say(context, name, content) {
    const id = this.#nextId++;
    return new Promise((resolve, reject) => {
      this.#asked.set(id, { resolve, reject });
      this.write({ family: "message", name, id, context, receipt: true, content });
    });
  }

  /** Says it so often a second, or as fast as the hub reads, until the function that it gives is called; that one gives how often it was said. */
  flood(context, name, content, rate) {
    const line = `${JSON.stringify({ family: "message", name, context, echo: false, content })}\n`;
    let [count, ended] = [0, false];
    const begun = performance.now();
    const round = () => {
      if (ended) return;
      const due = Math.min(2000, Math.ceil(((performance.now() - begun) / 1000) * rate) - count);
      if (due <= 0) return void setTimeout(round, 5);
      count += due;
      if (this.#socket.write(line.repeat(due))) setTimeout(round, 5);
      else this.#socket.once("drain", round);
    };
    round();
    return () => {
      ended = true;
      return count;
    };
  }

  close() {
    this.#socket.destroy();
  }
}
