// Many devices in one process, each with a socket of its own, which note when they hear of a stop. Arguments: the hub's host, the session with a channel N/robot for each, the first and the last N; in HERD_KEY the
// key of the user "herd", PKCS #8 in base64. It reads as little as it can before it has noted the time: what is measured is not this program.
import { createPrivateKey, sign } from "node:crypto";
import { connect } from "node:net";

const [, , address, session, first, last] = process.argv;
const [host, port] = address.split(":");
const key = createPrivateKey({ key: Buffer.from(process.env.HERD_KEY, "base64"), format: "der", type: "pkcs8" });
/** So many come at the same time: the hub takes only some that have not logged in yet. */
const ABREAST = 20;
const now = () => performance.timeOrigin + performance.now();

/** What a word of the hub's is, without reading all of it. */
const nameOf = (line) => /"name":"([a-z-]+)"/.exec(line)?.[1];

class Device {
  #asked = new Map();
  #id = 0;
  #rest = "";

  constructor(path, heard) {
    Object.assign(this, { path, heard });
  }

  async come() {
    this.socket = connect({ port: Number(port), host, noDelay: true });
    await new Promise((resolve, reject) => this.socket.once("connect", resolve).once("error", reject));
    this.socket.setEncoding("utf8");
    this.socket.on("data", (text) => this.#read(text, now()));
    this.socket.on("close", () => process.exit(1));
    const { nonce, hub } = await this.ask({ family: "login", name: "login", content: { name: "herd", key: true } });
    const said = Buffer.concat([Buffer.from(`mom-login-1\0${hub}\0herd\0`), Buffer.from(nonce.$binary, "base64")]);
    await this.ask({ family: "login", name: "answer", content: { signature: { $binary: sign(null, said, key).toString("base64") } } });
    for (let at = this.path.indexOf("/", 1); at > 0; at = this.path.indexOf("/", at + 1)) await this.ask({ family: "context", name: "join", context: this.path.slice(0, at) });
    await this.ask({ family: "context", name: "join", context: this.path, content: { device: true } });
  }

  ask(parcel) {
    const id = ++this.#id;
    return new Promise((resolve, reject) => {
      this.#asked.set(id, { resolve, reject });
      this.#write({ ...parcel, id });
    });
  }

  #write(parcel) {
    this.socket.write(`${JSON.stringify(parcel)}\n`);
  }

  #read(text, at) {
    const lines = (this.#rest + text).split("\n");
    this.#rest = lines.pop();
    for (const line of lines) if (line) this.#hear(line, at);
  }

  #hear(line, at) {
    const name = nameOf(line);
    if (name === "stop" || name === "unstop") return this.#stop(name, line, at);
    const { family, id, reference, content } = JSON.parse(line);
    if (family === "time" && name === "ping") return this.#write({ family: "time", name: "pong", reference: id });
    const asked = this.#asked.get(reference);
    if (!asked || (family !== "reply" && family !== "error")) return;
    this.#asked.delete(reference);
    if (family === "reply") asked.resolve(content);
    else asked.reject(new Error(`${this.path}: ${name}: ${content?.text}`));
  }

  /** It stands already, and says so at once. */
  #stop(name, line, at) {
    const stop = Number(/"stop":(\d+)/.exec(line)?.[1]);
    this.heard(name, this.path, stop, at, line);
    this.#write({ family: "message", name: "state", context: this.path, delivery: "latest", echo: false, content: { stopped: name === "stop", stop, moving: false, reached: true, rest: "measured" } });
  }
}

/** What was heard of one order; told when all have heard it. */
let round = { name: "", at: new Map(), numbers: {}, busy: 0 };
const count = Number(last) - Number(first) + 1;
const heard = (name, path, stop, at, line) => {
  if (round.name !== name) round = { name, at: new Map(), numbers: {}, said: line, idle: performance.eventLoopUtilization() };
  if (round.at.has(path)) return;
  round.at.set(path, at);
  round.numbers[path] = stop;
  if (round.at.size < count) return;
  const times = [...round.at.values()];
  const { active } = performance.eventLoopUtilization(round.idle);
  process.send({ heard: name, first: Math.min(...times), last: Math.max(...times), times, numbers: round.numbers, busy: active, said: round.said });
};

process.once("disconnect", () => process.exit());
const coming = Array.from({ length: count }, (_, at) => new Device(`${session}/${Number(first) + at}/robot`, heard));
const come = async () => {
  for (let device = coming.shift(); device; device = coming.shift()) await device.come();
};
await Promise.all(Array.from({ length: ABREAST }, come));
process.send({ heard: "ready" });
