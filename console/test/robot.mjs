// A mirrored robot that is none: a peer that says what the middle of one says in its channels, and obeys what is sent to it.
import { load } from "./bundle.mjs";

const { Latch, connect } = await load("../../clients/js/src/index.ts");

/** The contexts of a mirrored robot. */
const contextsOf = (path) => `
[[contexts]]
path = "${path}"
kind = "session"
[[contexts]]
path = "${path}/token"
kind = "token"
manager = "robot-token"
[[contexts]]
path = "${path}/robot"
kind = "channel"
guard = { token = "${path}/token", names = ["command"] }
[[contexts]]
path = "${path}/simulacrum"
kind = "channel"
delivery = "latest"
keep = { latest = true }
`;

/** The lab's configuration with such robots in it, which carol's peers may be. */
export const withRobots = (...paths) => (lab) => {
  const before = '[[managers.lab.rules]]\nname = "only those are devices';
  if (!lab.includes(before)) throw new Error("the lab has no such rule any more");
  const rule = `[[managers.lab.rules]]\nname = "mirrored robots"\nusers = ["carol"]\nwhere = ${JSON.stringify(paths.map((path) => `${path}/robot`))}\nallow = ["device"]\n\n`;
  return lab.replace(before, rule + before) + paths.map(contextsOf).join("");
};

/** CUBO's elements, in the order of the device map. */
export const CUBO = [
  { name: "left-wheel", kind: "effector", wanted: [0], value: [0], unit: ["mm/s"] },
  { name: "right-wheel", kind: "effector", wanted: [0], value: [0], unit: ["mm/s"] },
  { name: "joints", kind: "effector", wanted: [0, 0, 0], value: [0, 0, 0], unit: ["deg", "deg", "deg"] },
  { name: "lips", kind: "effector", wanted: [0], value: [0], unit: ["%"] },
  { name: "speaker", kind: "effector" },
  { name: "lcd", kind: "effector" },
  { name: "surroundings", kind: "sensor", value: [812, 340, 41.5, 0, 296.4, 11.9], unit: ["mm", "lx", "dB", "", "K", "V"] },
  { name: "pose", kind: "sensor", value: [120, -30, 12.5], unit: ["mm", "mm", "deg"] },
  { name: "service-button", kind: "event", events: 0 },
  { name: "message-button", kind: "event", events: 0 },
  { name: "microphone", kind: "sensor" },
  { name: "camera", kind: "sensor" },
  { name: "gesture", kind: "memory-command" },
  { name: "message-recorded", kind: "memory-event", events: 1, unit: ["", "s"] },
  { name: "posture", kind: "monitor", value: [0, 0, 0], unit: ["deg", "deg", "deg"] },
  { name: "motion", kind: "module" },
];

const SESSION = "a1b2c3d4e5f6";
const hex = (value, bytes) => value.toString(16).padStart(2 * bytes, "0");

/** The first bytes of a data packet with these bits. */
export function packetHex({ up = false, sequence = 0, stamp = 5000, last = 0xffff, buffers = 0, sealed = false, bits = [], payload = "" }) {
  const map = bits.reduce((text, place) => text.map((byte, index) => (index === place >> 3 ? byte | (0x80 >> (place & 7)) : byte)), [0, 0]);
  const header = ["01", "c0b0", sealed ? "01" : "00", up ? "81" : "01", hex(sequence, 2), hex(stamp, 4), SESSION, hex(last, 2), hex(buffers, 1)].join("");
  return header + (sealed ? "5e".repeat(24) : map.map((byte) => hex(byte, 1)).join("") + payload);
}

export const mapHex = (bits) => packetHex({ bits }).slice(40);

export class FakeRobot {
  /** What was sent to it: name, content, fence. */
  heard = [];
  /** What its middle was asked to write, and what it answers; nothing if that is undefined. */
  asked = [];
  answer = ({ language }) => ({ language, name: "cubo.rs", text: "// code\n" });
  packet = { linked: true, period: 20, confirmed: true, loss: 0.004, "round-trip": 1840, offset: -2350000, error: 1900, sent: 5000, received: 4980, "down-rate": 2950, "up-rate": 2600, "free-buffers": 3, accepted: 4980, dropped: {}, heard: 9000 };
  bits = { down: [0, 1], up: [7] };
  sealed = false;
  /** Why it takes no command now. */
  hindrance = undefined;
  /** Whether it does what it is told. */
  obeys = true;
  /** Called when it stops, and when it is let go. */
  onStop = () => undefined;
  #state = { moving: false, rest: "measured", reached: true, stopped: false, stop: 0, linked: true, fence: 0 };
  #sequence = 0;

  static async start(host, path, user = "carol", elements = CUBO) {
    const robot = new FakeRobot();
    robot.client = await connect(`http://${host}`, { user, password: user });
    robot.elements = new Map(elements.map((element, place) => [element.name, { place, activated: true, active: true, linked: true, since: 1_000_000, ...element }]));
    robot.mirror = await robot.client.channel(`${path}/simulacrum`);
    robot.channel = await robot.client.channel(`${path}/robot`, { device: true });
    void robot.#obey();
    void robot.#write();
    await robot.#tellState();
    for (const name of robot.elements.keys()) await robot.say(name);
    await robot.travel();
    return robot;
  }

  /** Tells it again and again, as a middle does, until it is ended. */
  run() {
    this.timer = setInterval(() => void this.travel().catch(() => undefined), 500);
    return this;
  }

  async say(name, change = {}) {
    const element = { ...this.elements.get(name), ...change };
    this.elements.set(name, element);
    const { name: _, ...content } = element;
    await this.mirror.sendAcknowledged(name, content, { delivery: "latest", echo: false });
  }

  /** Tells of packets. */
  async travel(change = {}) {
    Object.assign(this.packet, change);
    this.#sequence += 25;
    const { sealed, bits } = this;
    const [down, up] = [packetHex({ sequence: this.#sequence, last: this.#sequence - 1, bits: bits.down, payload: "00640064", sealed }), packetHex({ up: true, sequence: this.#sequence - 1, last: this.#sequence, buffers: 3, stamp: 2_355_000, bits: bits.up, payload: "0078ffe2007d", sealed })];
    const maps = sealed ? { "down-map": mapHex(bits.down), "up-map": mapHex(bits.up) } : {};
    await this.mirror.sendAcknowledged("packet", { ...this.packet, down, up, ...maps }, { delivery: "latest", echo: false });
  }

  async #tellState() {
    try {
      await this.channel.sendAcknowledged("state", this.#state, { echo: false });
    } catch (error) {
      // What ends it stops it as well, and then there is nobody to tell.
      if (!this.ended) throw error;
    }
  }

  async #obey() {
    const latch = new Latch();
    for await (const event of this.channel.events()) {
      if (latch.observe(event)) {
        [this.#state.stopped, this.#state.stop] = [latch.isStopped, latch.number];
        this.onStop(latch.isStopped);
        await this.#tellState();
      }
      // As devices do: who joins is told how it stands.
      if (event.type === "joined") await this.#tellState();
      if (event.type !== "message") continue;
      const { name, sender, content, parcel } = event;
      if (name !== "command") continue;
      this.heard.push({ content, fence: parcel.fence, permitted: this.channel.permits(parcel) });
      const status = (state, error, statement = 1) => this.channel.sendAcknowledged("status", { peer: sender, id: parcel.id, state, statement, of: 1, ...(error ? { error } : {}) }, { echo: false });
      if (this.hindrance) {
        await status("error", this.hindrance, 0);
        continue;
      }
      await status("executing");
      const error = this.obeys ? await this.#do(String(content)) : undefined;
      if (this.obeys) await status(error ? "error" : "finished", error);
    }
  }

  /** Writes code for who asks for it. */
  async #write() {
    for await (const { type, name, sender, content, parcel } of this.mirror.events()) {
      if (type !== "message" || name !== "generate") continue;
      this.asked.push(content);
      const answer = this.answer(content);
      if (answer) await this.mirror.sendAcknowledged("generated", answer, { to: [sender], reference: parcel.id, echo: false });
    }
  }

  /** Does what a statement says; why not. */
  async #do(statement) {
    const [verb, name, ...words] = statement.split(" ");
    const values = words.slice(0, words.includes("for") ? words.indexOf("for") : undefined).map(Number);
    if (verb === "period") return void (await this.travel({ period: Number(name) }));
    if (verb === "clear") return undefined;
    if (!this.elements.has(name)) return { name: "syntax", text: `there is no element \`${name}\`` };
    if (verb === "set" && !this.elements.get(name).unit) return { name: "syntax", text: `${name} takes no numbers` };
    if (verb === "set") await this.say(name, { wanted: values, value: values });
    if (verb === "activate" || verb === "deactivate") await this.say(name, { activated: verb === "activate", active: verb === "activate" });
    return undefined;
  }

  /** It moves, or rests. */
  moves(moving) {
    return this.tells({ moving, rest: moving ? undefined : "measured", reached: true, "unreached-since": undefined, pose: { x: 0, y: 0, z: 100, spin: 0, tilt: 0 } });
  }

  /** It says so of itself, as devices do: only the newest matters. What is undefined is not said. */
  async tells(change) {
    this.#state = Object.fromEntries(Object.entries({ ...this.#state, ...change }).filter(([, value]) => value !== undefined));
    await this.channel.sendAcknowledged("state", this.#state, { delivery: "latest", echo: false });
  }

  async end() {
    this.ended = true;
    clearInterval(this.timer);
    await this.client.close();
  }
}
