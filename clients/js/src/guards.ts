// The tokens that this peer owns: their leases, and why they ended.
import { Offers } from "./offers.js";
import { isWithin } from "./places.js";
import { type Fields, int, text } from "./value.js";

/** Why an ownership ended. */
export interface Lost {
  /** A word of docs/PROTOCOL.md, `disconnected` for a lost link, or the code of a refused renewal. */
  reason: string;
  /** The peer that caused it, if one did. */
  by?: string;
}

/** An ownership that another peer gave and that returns to it. */
export interface Loan {
  from: string;
  /** ms from the grant on. */
  time?: number;
  /** Guarded messages. */
  commands?: number;
}

/** One ownership, from a grant to its loss; a part in a shared hold has the fence 0. */
export class Hold {
  lease: number | null = null;
  deadman: number | null = null;
  readonly loan: Loan | undefined;
  is: Lost | null = null;
  readonly lost: Promise<Lost>;
  #lose!: (lost: Lost) => void;
  #timer: ReturnType<typeof setTimeout> | undefined;
  /** The last command that was said under it and of which no device has said how it ended, by its id. */
  #command: number | undefined;
  readonly #waiting: (() => void)[] = [];

  constructor(
    readonly path: string,
    readonly fence: number,
    grant: Fields,
    /** Asks the hub for another lease. */
    readonly renew: (hold: Hold) => void,
  ) {
    this.lost = new Promise((resolve) => (this.#lose = resolve));
    const [from, time, commands] = [text(grant, "from"), int(grant, "for"), int(grant, "commands")];
    if (from !== undefined) this.loan = { from, ...(time === undefined ? {} : { time }), ...(commands === undefined ? {} : { commands }) };
    this.terms(grant);
  }

  /** Takes the terms of a grant, and renews at a third of them, so that two renewals may fail. */
  terms(grant: Fields): void {
    this.lease = int(grant, "lease") ?? null;
    this.deadman = int(grant, "deadman") ?? null;
    clearTimeout(this.#timer);
    const shorter = Math.min(this.lease ?? Infinity, this.deadman ?? Infinity);
    if (!this.is && shorter < Infinity) this.#timer = setTimeout(() => this.renew(this), Math.min(shorter / 3, 2 ** 31 - 1));
  }

  /** A command is said under it. */
  said(id: number): void {
    this.#command = id;
  }

  /** A command has ended, or will not be carried out. */
  ended(id: number): void {
    if (this.#command !== id) return;
    this.#command = undefined;
    for (const done of this.#waiting.splice(0)) done();
  }

  /** Fulfilled when a device has said how the last command ended, or it was refused or lost. */
  done(): Promise<void> {
    return new Promise((resolve) => (this.#command === undefined ? resolve() : this.#waiting.push(resolve)));
  }

  lose(lost: Lost): void {
    if (this.is) return;
    this.is = lost;
    clearTimeout(this.#timer);
    this.#lose(lost);
  }
}

/** All of them. */
export class Guards {
  readonly #owned = new Map<string, Hold>();
  readonly #shared = new Map<string, Hold>();
  readonly offers = new Offers();

  constructor(readonly renew: (hold: Hold) => void) {}

  /** Notes a grant; the guards of one ownership share it. */
  granted(path: string, grant: Fields): Hold {
    const fence = int(grant, "fence") ?? 0;
    const known = this.#owned.get(path);
    if (known && known.fence === fence && !known.is) {
      known.terms(grant);
      return known;
    }
    known?.lose({ reason: "released" });
    const hold = new Hold(path, fence, grant, this.renew);
    this.#owned.set(path, hold);
    return hold;
  }

  shares(path: string): Hold {
    const known = this.#shared.get(path);
    if (known && !known.is) return known;
    const hold = new Hold(path, 0, {}, this.renew);
    this.#shared.set(path, hold);
    return hold;
  }

  /** Whether there is none. */
  get isEmpty(): boolean {
    return this.#owned.size + this.#shared.size === 0;
  }

  owned(path: string): Hold | undefined {
    return this.#owned.get(path);
  }

  /** A command has ended, or will not be carried out. */
  ended(id: number | undefined): void {
    if (id !== undefined) for (const hold of this.#owned.values()) hold.ended(id);
  }

  /** An ownership is over, whichever it is if no fence is named. */
  released(path: string, fence: number | null, lost: Lost): void {
    const hold = this.#owned.get(path);
    if (!hold || (fence !== null && hold.fence !== fence)) return;
    this.#owned.delete(path);
    hold.lose(lost);
  }

  unshared(path: string, lost: Lost): void {
    this.#shared.get(path)?.lose(lost);
    this.#shared.delete(path);
  }

  loseWithin(top: string, lost: Lost): void {
    for (const map of [this.#owned, this.#shared]) {
      for (const [path, hold] of map) {
        if (!isWithin(path, top)) continue;
        map.delete(path);
        hold.lose(lost);
      }
    }
    this.offers.endWithin(top);
  }
}
