// A declared cart on a rail, by a clock that its machine moves.
import { DeclaredMachine, DeviceError, attachment, number, verb, whole, word } from "../dist/test/internals.js";

/** mm/s. */
export const SPEED = 100;

/** A rail with a cart, and a clock that its machine moves. */
export class Rail {
  now = 0;
  x = 0;
  speed = 0;
  planned = 0;
  told = [];
  /** When it was kept alive last, µs. */
  kept = -Infinity;
  #timers = [];

  /** Rejects when the signal is aborted. */
  sleep(micros, signal) {
    return new Promise((resolve, reject) => {
      const timer = { due: this.now + Math.round(micros), resolve };
      this.#timers.push(timer);
      signal.addEventListener("abort", () => {
        this.#timers = this.#timers.filter((other) => other !== timer);
        reject(signal.reason);
      });
    });
  }

  get due() {
    return this.#timers.length ? Math.min(...this.#timers.map(({ due }) => due)) : undefined;
  }

  advance(now) {
    this.x += (this.speed * Math.max(0, now - this.now)) / 1e6;
    this.now = Math.max(now, this.now);
    for (const { due, resolve } of this.#timers) if (due <= now) resolve();
    this.#timers = this.#timers.filter(({ due }) => due > now);
  }

  async drive(way, signal) {
    this.speed = SPEED * Math.sign(way);
    await this.sleep((Math.abs(way) / SPEED) * 1e6, signal);
    this.speed = 0;
  }
}

/** A declaration of the cart on this rail, with what is changed of it. */
export function specOf(rail, more = {}) {
  return {
    does: "A cart on a rail",
    verbs: {
      go: verb("Drives to a place", { x: number({ unit: "mm" }) }, ({ x }, signal) => rail.drive(x - rail.x, signal)),
      by: verb.relative("Drives so far", { way: number({ unit: "mm", min: -100, max: 100 }) }, ({ way }, signal) => rail.drive(way, signal)),
      jog: verb.velocity("Drives so fast", { speed: number({ unit: "mm/s" }) }, async ({ speed }, signal) => {
        rail.speed = speed;
        await rail.sleep(200_000, signal);
      }),
      beep: verb.instant("Says so", { times: whole({ min: 1, max: 3, default: 1 }) }, ({ times }) => rail.told.push(`beep ${times}`)),
      grip: verb("Opens or closes", { how: word({ choices: ["open", "close"] }) }, ({ how }) => rail.told.push(how)),
      play: verb.instant("Plays a sound", { sound: attachment() }, ({ sound }) => rail.told.push(`${sound.length} bytes`)),
    },
    halt() {
      rail.told.push("halt");
      [rail.speed, rail.planned] = [0, rail.x];
    },
    position: () => ({ x: rail.x }),
    keepAlive: () => (rail.kept = rail.now),
    plan(statements) {
      for (const { verb, args } of statements) {
        const planned = { go: args.x, by: rail.planned + args.way }[verb] ?? rail.planned;
        if (Math.abs(planned) > 1000) throw new DeviceError("workspace-boundary", "the rail ends before");
        rail.planned = planned;
      }
    },
    ...more,
  };
}

/** Its machine, by the clock of its rail. */
export class RailMachine extends DeclaredMachine {
  constructor(rail, more, logged = []) {
    super(specOf(rail, more), "cart", { now: () => rail.now, wake: () => undefined, log: (text) => logged.push(text) });
    Object.assign(this, { rail, logged });
  }

  advance(now) {
    this.rail.advance(now);
    super.advance(now);
  }

  /** As by a timer that a function has left behind. */
  push() {
    this.rail.speed = 50;
  }

  nextWake() {
    const wakes = [super.nextWake(), this.rail.due].filter((due) => due !== undefined);
    return wakes.length ? Math.min(...wakes) : undefined;
  }
}

/** One on a rail of its own. */
export const machine = (more) => new RailMachine(new Rail(), more);
/** Its functions are promises. */
export const settings = { settles: true };
