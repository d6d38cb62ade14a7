import type { Parcel } from "./parcel.js";
import { Time, wallMicros } from "./value.js";

/** Clocks drift apart by so many µs in a second at most. */
const DRIFT = 100;

/** How old something is, in µs. */
export interface Age {
  micros: number;
  error: number;
}

/** The hub's clock, as measured over this link. */
export class HubClock {
  #low = -Infinity;
  #high = Infinity;
  #at = 0;
  readonly #asked = new Map<number, number>();
  /** Messages that were not delivered because they had expired. */
  expired = 0;
  /** µs that the newest ping and its answer were on their way. */
  roundTrip: number | undefined;

  /** How far the hub's clock is ahead of this one, in µs, and the error of that; undefined as long as that is not known. */
  get offset(): Age | undefined {
    if (!this.#at) return undefined;
    const drift = ((wallMicros() - this.#at) / 1e6) * DRIFT;
    return { micros: (this.#low + this.#high) / 2, error: (this.#high - this.#low) / 2 + drift };
  }

  /** The present time by the hub's clock. */
  now(): Time | undefined {
    const offset = this.offset;
    return offset && new Time(BigInt(Math.round(wallMicros() + offset.micros)));
  }

  /** How old a message is now: its age on arrival at the hub and the time since then. */
  age(parcel: Parcel): Age | undefined {
    const offset = this.offset;
    if (!offset || !parcel.received || parcel.ageError === undefined) return undefined;
    const since = wallMicros() + offset.micros - Number(parcel.received.micros);
    return { micros: (parcel.age ?? 0) + since, error: parcel.ageError + offset.error };
  }

  /** Whether a message has expired, as far as is known; a `stop` never does. */
  isExpired(parcel: Parcel): boolean {
    if (parcel.expires === undefined || parcel.name === "stop") return false;
    const age = this.age(parcel);
    return age !== undefined && age.micros >= parcel.expires * 1000;
  }

  /** @internal */
  asks(id: number, at: number): void {
    if (this.#asked.size > 16) this.#asked.clear();
    this.#asked.set(id, at);
  }

  /** @internal Takes the answer to a ping. */
  answered(id: number | undefined, received: unknown, sent: unknown): void {
    const asked = this.#asked.get(id ?? -1);
    this.#asked.delete(id ?? -1);
    if (asked === undefined || !(received instanceof Time) || !(sent instanceof Time)) return;
    const now = wallMicros();
    this.roundTrip = Math.max(0, now - asked - Number(sent.micros - received.micros));
    const [low, high] = [Number(sent.micros) - now, Number(received.micros) - asked];
    const drift = ((now - this.#at) / 1e6) * DRIFT;
    const [older, newer] = [Math.max(low, this.#low - drift), Math.min(high, this.#high + drift)];
    // An exchange that contradicts the others shows that a clock was set.
    [this.#low, this.#high] = older <= newer ? [older, newer] : [Math.min(low, high), Math.max(low, high)];
    this.#at = now;
  }

  /** @internal Another hub may answer. */
  forget(): void {
    [this.#low, this.#high, this.#at] = [-Infinity, Infinity, 0];
    this.roundTrip = undefined;
    this.#asked.clear();
  }
}
