// The device's check of states: a command is valid only if the state that it was based on still holds.
import { type Fields, type Parcel, type Time, type Value } from "../index.js";

/** The slot of a command that names the state which it was based on, by the id of that state's parcel. */
export const BASED_ON = "based-on";
/** The ids of states lie in this half of all. */
const FIRST = 2 ** 52;

/** A refusal with the words of the hub's own errors. */
export class Refusal extends Error {
  constructor(readonly content: Fields) {
    super(String(content["text"]));
  }
}

/** The slot `based-on` of a command. */
export function basedOn({ extra }: Parcel): Value | undefined {
  return extra instanceof Map ? extra.get(BASED_ON) : extra?.[BASED_ON];
}

/** Gives states their ids, and refuses commands that are based on an outdated one. */
export class StateGate {
  #newest: number;
  /** The newest state that told of a motion. */
  #moved: number;

  /**
   * `start` is when the device started: its ids are higher than all of an earlier start, so that old states cannot be mistaken for new
   * ones.
   */
  constructor(start: Time) {
    this.#newest = FIRST + (Math.max(0, Number(start.micros)) % FIRST);
    // None of the states before the first one holds.
    this.#moved = this.#newest + 1;
  }

  /** The id of a state that is about to be said. `moved` tells whether the device is in another position than in the state before. */
  next(moved: boolean): number {
    this.#newest = Math.min(this.#newest + 1, Number.MAX_SAFE_INTEGER);
    if (moved) this.#moved = this.#newest;
    return this.#newest;
  }

  /** Throws `stale-state` or `bad-slot` where the state of a command does not hold. `moving`: it moves now, or has motions ahead of it. */
  check(command: Parcel, moving: boolean): void {
    const given = basedOn(command);
    if (given === undefined) return;
    if (typeof given !== "number" || !Number.isSafeInteger(given) || given < 0) {
      const text = `the slot ${BASED_ON} is the id of a state, a number from 0 to ${Number.MAX_SAFE_INTEGER}`;
      throw new Refusal({ name: "bad-slot", code: 220, text, slot: BASED_ON });
    }
    const text = this.#fault(given, moving);
    if (text) throw new Refusal({ name: "stale-state", code: 208, text, state: this.#newest });
  }

  #fault(given: number, moving: boolean): string | undefined {
    if (given > this.#newest) return "the device has not published this state since it was started";
    if (given < this.#moved) return "the device has moved since the state that this was based on";
    return moving ? "the device is still moving, so no state of it holds" : undefined;
  }
}
