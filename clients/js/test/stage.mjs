// Dialogues with a device's server, as tests/cases/README.md has their lines: with a clock and a gate that they move.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { setImmediate as turn } from "node:timers/promises";
import { DeviceServer, Time, permits } from "../dist/test/internals.js";

const CHANNEL = "/robot/arm";
const TOKEN = "/robot/token";
const MS = 1000;

/** A device's server with a clock and a gate. `settles`: its machine goes on by promises, which are waited for after each call. */
export class Stage {
  now = 0;
  guard = null;
  age = undefined;
  out = [];
  /** The ids of the states that were told, and what the newest one said. */
  states = [];
  said = {};
  /** The ids of the stops that it has said, and that have not come back. */
  stops = [];
  /** The newest fence under which it has said that it stands. */
  fence = undefined;
  gate = { permits: (parcel) => permits(this.guard, parcel) };

  constructor(machine, { settles = false, options = {} } = {}) {
    Object.assign(this, { machine, settles, options });
    this.server = new DeviceServer(machine, CHANNEL, new Time(0n), options);
    Object.defineProperty(this.gate, "guard", { get: () => this.guard });
  }

  /** Of a device that rests under fence 5. */
  static async of(machine, settings) {
    const stage = new Stage(machine, settings);
    for (const [line, heard] of [["told 0", "state free"], ["grabbed 5", "state free, fence 5"], ["rests", "state free at rest"]]) {
      await stage.act(line);
      assert.deepEqual(stage.heard(), [heard]);
    }
    return stage;
  }

  /** Lets promises of the machine go on, and the server hear of them. */
  async settle() {
    if (!this.settles) return;
    await turn();
    this.server.advance(this.now, this.out);
  }

  async tell(event) {
    const age = this.age === undefined ? undefined : { micros: this.age * MS, error: 10_000 };
    this.server.handle(event, this.gate, age, this.now, this.out);
    await this.settle();
  }

  /** Lets ms pass as a punctual driver does. */
  async pass(ms) {
    const until = this.now + ms * MS;
    for (let due; (due = this.server.nextWake()) !== undefined && due <= until; ) {
      this.now = Math.max(this.now, due);
      this.server.advance(due, this.out);
      await this.settle();
    }
    this.now = until;
    this.server.advance(until, this.out);
    await this.settle();
  }

  async passUntil(what, isSo) {
    for (let most = (2 * this.machine.stoppingTime) / MS + 70_000; most > 0; most--) {
      if (isSo(this.server.state())) return;
      await this.pass(1);
    }
    assert.fail(`${what} never: ${JSON.stringify(this.server.state())}`);
  }

  /** Does one line of a dialogue. */
  async act(line) {
    if (line.startsWith("unheard ")) {
      await this.act(line.slice("unheard ".length));
      this.heard();
      return;
    }
    const [, before, script = ""] = /^(.*?)(?:: (.*))?$/s.exec(line);
    const words = before.split(" ");
    const [first, second] = words;
    if (second === "command") return this.#command(first, words.slice(2), script);
    switch (first) {
      case "max-age":
        this.options.maxAge = Number(second) * MS;
        return;
      case "name":
        this.server.name = second;
        return;
      case "age":
        this.age = Number(second);
        return;
      case "after":
        return this.pass(Number(second));
      // The driver had no turn meanwhile.
      case "frozen":
        this.now += Number(second) * MS;
        return this.server.advance(this.now, this.out);
      case "rests":
        // It may begin what has waited for that at once.
        await this.passUntil("it rests", ({ rest, moving }) => (rest !== undefined && !moving) || this.out.some(({ name, content }) => name === "state" && content.rest !== undefined));
        return this.#leaveOutMotion();
      case "ends":
        await this.passUntil("all ends", ({ executing, waiting }) => executing === undefined && waiting === 0);
        return this.#leaveOutMotion();
      case "said":
        return assert.equal(String(this.said[second] ?? "-"), words[2], `${second} of the newest state`);
      case "fill":
        for (let id = 1; id <= Number(second); id++) await this.#command("alice", [String(id), "5"], "wait 1000");
        this.out = [];
        return;
      case "pushed":
        return this.server.note(this.now, () => this.server.machine.push(), this.out);
      case "pressed":
      case "reset":
        this.server.machine.isPressed = first === "pressed";
        return;
      case "kept":
        return assert.equal(this.now - this.server.machine.rail.kept <= 100 * MS, second === "alive", `it was kept alive at ${this.server.machine.rail.kept} of ${this.now}`);
      case "report":
        return this.server.report(this.out);
      case "gate":
        this.guard = { token: TOKEN, names: ["command"], fence: Number(words[2]), ...(second === "-" ? {} : { owner: second }) };
        return;
      default:
        return this.tell(this.#event(words, line));
    }
  }

  /** Leaves out the states that do not tell of rest: bodies roll for different times. */
  #leaveOutMotion() {
    this.states.push(...this.out.filter(({ name }) => name === "state").map(({ id }) => id));
    this.out = this.out.filter(({ name, content }) => name !== "state" || content.rest !== undefined);
  }

  #event([first, second, third], line) {
    const path = TOKEN;
    switch (first) {
      case "down":
        return { type: "link-down" };
      case "told":
        return { type: "stops", path: CHANNEL, state: { number: Number(second), stopped: third === "stopped", only: [] } };
      case "rejoined":
        // What it had said before does not come back.
        this.stops = [];
        return { type: "rejoined" };
      case "resumed":
        return { type: "link-resumed" };
      case "lagged":
        return { type: "lagged", count: 3 };
      case "count":
        return { type: "count", path: CHANNEL, count: 300 };
      case "joined":
        return { type: "joined", path: CHANNEL, member: { peer: second, user: second, level: 1, device: false } };
      case "grabbed":
        return { type: "grabbed", path, owner: "bob", level: 1, fence: Number(second), lease: null };
      case "released":
      case "given":
      case "returned":
      case "expired":
        return { type: "released", path, owner: "bob", reason: first, fence: Number(second) };
      case "expelled":
        return { type: "expelled", path: CHANNEL, peer: second, text: "arm~2 is the device here now" };
    }
    assert.ok(second, `no such line: ${line}`);
    const id = second === "stop" && first === this.server.name ? this.stops.shift() : undefined;
    return message(first, second, { ...(third === undefined ? {} : { extra: { stop: Number(third) } }), ...(id === undefined ? {} : { id }) });
  }

  /** `[id fence [expires ms | on state]]` of a command. */
  #command(sender, [id, fence, slot, value], script) {
    const slots = id === undefined ? {} : { content: script };
    if (Number(id) >= 0) slots.id = Number(id);
    if (Number(fence) >= 0) slots.fence = Number(fence);
    if (slot === "expires") slots.expires = Number(value);
    if (slot === "on") slots.extra = { "based-on": this.#stateOf(value) };
    return this.tell(message(sender, "command", slots));
  }

  /** The id of a state that a dialogue names. */
  #stateOf(word) {
    const { states } = this;
    return { newest: states.at(-1), next: states.at(-1) + 1, before: states.at(-2), first: states[0] }[word] ?? word;
  }

  /** What was said since, one line each; states while the device carries something out and moves are left out. */
  heard() {
    const lines = [];
    for (const parcel of this.out.splice(0)) {
      assert.equal(parcel.context, CHANNEL);
      if (parcel.name === "state") {
        // Of those that were passed over it is known already.
        if (!this.states.includes(parcel.id)) {
          assert.ok(this.states.length === 0 || this.states.at(-1) < parcel.id, "ids of states rise");
          this.states.push(parcel.id);
        }
        this.said = parcel.content;
      }
      if (parcel.name === "stop") this.stops.push(parcel.id);
      let line = lineOf(parcel);
      if (line === undefined) continue;
      const { fence } = parcel.content;
      if (parcel.name === "state" && fence !== this.fence) {
        // Fences of two tokens say nothing of each other.
        assert.ok(!(fence < this.fence), "fences rise");
        this.fence = fence;
        line += fence === undefined ? ", no fence" : `, fence ${fence}`;
      }
      // While it comes to rest it says so again and again.
      if (lines.at(-1) !== line || !line.endsWith(" moving")) lines.push(line);
    }
    return lines;
  }
}

function message(sender, name, slots) {
  const parcel = { family: "message", name, sender, context: CHANNEL, ...slots };
  const stop = slots.extra?.stop;
  return { type: "message", name, sender, content: slots.content, history: false, ...(stop === undefined ? {} : { stop }), parcel };
}

/** A parcel of a device as a line; undefined of a state while it carries something out and moves. */
function lineOf({ name, content, address = [], delivery, echo, reference }) {
  const to = address.map((peer) => ` to ${peer}`).join("");
  if (name === "stop") return `stop${to}`;
  assert.equal(echo, false);
  if (name === "state") {
    assert.equal(delivery, "latest");
    for (const key of ["moving", "stopped", "reached"]) assert.equal(typeof content[key], "boolean");
    if (content.moving && content.executing) return undefined;
    // Until it is known that it rests, it is not said to stand.
    const rests = content.moving ? " moving" : content.rest === undefined ? "" : " at rest";
    return `state${to} ${content.stopped ? "stopped" : "free"}${content.estop ? " estop" : ""}${rests}`;
  }
  assert.equal(delivery, undefined);
  assert.equal(reference, content.id, "it answers the command");
  const { peer, id = "-", state, statement, of, error } = content;
  if (error) assert.ok(error.text);
  return `status ${peer}/${id} ${state} ${statement}/${of}${error ? ` ${error.name} ${error.code}` : ""}`;
}

/** Plays lines on a stage: those with `>` are what must have been said since the line before. */
export async function check(stage, title, dialogue) {
  const lines = dialogue.split("\n").map((line) => line.trim()).filter(Boolean);
  while (lines.length) {
    const line = lines.shift();
    await stage.act(line).catch((error) => assert.fail(`${title}: at \`${line}\`: ${error.stack}`));
    const expected = [];
    while (lines[0]?.startsWith("> ")) expected.push(lines.shift().slice(2));
    const heard = stage.heard();
    // ` *` stands for whatever a state tells of motion.
    const fits = (said, wanted) => said === wanted || ["", " moving", " at rest"].some((motion) => said === wanted.replace(" *", motion));
    if (heard.length !== expected.length || !heard.every((said, place) => fits(said, expected[place]))) assert.deepEqual(heard, expected, `${title}: after \`${line}\``);
  }
}

/**
 * Plays each dialogue of tests/cases/device.txt over machines that are made anew for each; gives how many. `statements` has what a
 * machine is told where a dialogue has a word in braces: `go`, `back`, `wrong`, and where it has them `beyond`, `beyond-error`,
 * `relative`, `velocity`.
 */
export async function replay(make, statements, settings = {}) {
  const text = readFileSync(new URL("../../../tests/cases/device.txt", import.meta.url), "utf8").replace(/^#.*\n/gm, "");
  let played = 0;
  for (const dialogue of `\n${text}`.split("\n== ").slice(1)) {
    const [title, ...all] = dialogue.split("\n");
    const word = (key) => all.find((line) => line.startsWith(`${key} `))?.slice(key.length + 1);
    const { completes, stoppingTime } = make();
    const has = { completes, "halts-on-give": !completes, pushes: "push" in make(), estop: make().estop() !== undefined, "keep-alive": make().rail !== undefined, ...Object.fromEntries(["beyond", "relative", "velocity"].map((key) => [key, key in statements])) };
    const needed = word("needs");
    assert.ok(needed === undefined || needed in has, `no dialogue can need ${needed}`);
    if (needed !== undefined && !has[needed]) continue;
    const lines = all.filter((line) => !/^(needs|each) /.test(line)).join("\n");
    for (const each of (word("each") ?? "").split(" | ")) {
      const words = { ...statements, each, "stops-within": stoppingTime / MS };
      const filled = lines.replace(/\{([a-z-]+)\}/g, (_, key) => words[key]);
      await check(await Stage.of(make(), { ...settings, options: {} }), `${title} (${each})`, filled);
      played += 1;
    }
  }
  return played;
}
