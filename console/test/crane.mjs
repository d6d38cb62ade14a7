// A device that nothing of this project has ever heard of, by the kit for JavaScript, as `npm run build` there has made it: a crane.
import { connect } from "../../clients/js/dist/mom-client.js";
import { device, number, sleep, verb, word } from "../../clients/js/dist/device.js";

/** The lab's configuration with a place for it, where carol's peers may be devices. */
export function withYard(lab) {
  const before = '[[managers.lab.rules]]\nname = "only those are devices';
  if (!lab.includes(before)) throw new Error("the lab has no such rule any more");
  const rule = '[[managers.lab.rules]]\nname = "the crane"\nusers = ["carol"]\nwhere = ["/yard/crane"]\nallow = ["device"]\n\n';
  return `${lab.replace(before, rule + before)}
[[contexts]]
path = "/yard"
kind = "session"
[[contexts]]
path = "/yard/token"
kind = "token"
manager = "robot-token"
[[contexts]]
path = "/yard/crane"
kind = "channel"
guard = { token = "/yard/token", names = ["command"] }
`;
}

/** mm/s and degrees/s, and how often it moves on, ms. */
const SPEED = 100;
const EVERY = 20;

export class Crane {
  height = 0;
  angle = 0;
  magnet = "off";
  isPressed = false;
  /** Statements that have begun. */
  begun = [];
  #client;
  #obeying;

  static async start(host, { more = {}, carded = true } = {}) {
    const crane = new Crane();
    crane.#client = await connect(`http://${host}`, { user: "carol", password: "carol" });
    // As a device of a kit that knows no cards.
    if (!carded) crane.#client.peer.places.takesCards = false;
    crane.#obeying = await crane.#client.obey("/yard/crane", crane.#device(more));
    return crane;
  }

  /** Moves on until it is there, or is to end. */
  async #go(key, to, signal) {
    while (!signal.aborted && this[key] !== to) {
      const step = (SPEED * EVERY) / 1000;
      this[key] += Math.sign(to - this[key]) * Math.min(step, Math.abs(to - this[key]));
      await sleep(EVERY, signal);
    }
  }

  #device(more) {
    return device("crane", {
      does: "A crane in the yard",
      verbs: {
        hoist: verb("Hoists the hook to a height", { height: number({ unit: "mm", min: 0, max: 1200 }) }, ({ height }, signal) => this.#go("height", height, this.#begin("hoist", signal))),
        swing: verb.relative("Turns by so much", { angle: number({ unit: "°", min: -180, max: 180 }) }, ({ angle }, signal) => this.#go("angle", this.angle + angle, this.#begin("swing", signal))),
        magnet: verb.instant("Switches the magnet", { to: word({ choices: ["on", "off"] }) }, ({ to }) => {
          this.#begin("magnet");
          this.magnet = to;
        }),
        creep: verb.velocity("Hoists at a speed for 300 ms", { speed: number({ unit: "mm/s", min: -50, max: 50 }) }, async ({ speed }, signal) => {
          this.#begin("creep");
          for (const end = performance.now() + 300; !signal.aborted && performance.now() < end; ) {
            this.height += (speed * EVERY) / 1000;
            await sleep(EVERY, signal);
          }
        }),
        ...more,
      },
      halt: () => undefined,
      estop: () => this.isPressed,
      position: () => ({ height: this.height, angle: this.angle }),
      report: () => ({ magnet: this.magnet }),
      state: { height: number({ unit: "mm", does: "Where the hook is" }), angle: number({ unit: "°" }), magnet: word({ does: "Whether it holds" }) },
      stopsWithin: 200,
    });
  }

  #begin(name, signal) {
    this.begun.push(name);
    return signal;
  }

  async end() {
    await this.#obeying?.leave();
    await this.#client.close();
  }
}

/** Another statement that a crane may have. */
export const horn = verb.instant("Sounds the horn", { times: number({ min: 1, max: 5, default: 2 }) }, () => undefined);
