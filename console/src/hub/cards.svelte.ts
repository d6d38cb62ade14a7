// The cards of devices: each is asked for once somebody looks at its channel, and again whenever another device may be there.
import type { HubEvent, PlainFields } from "../worker/protocol.js";
import { type Card, cardOf } from "./card.js";
import type { Hub } from "./hub.svelte.js";

/** Many may come and go: a channel is asked so often at most, ms. */
const AGAIN = 1000;

export class Carded {
  /** What its device can do; undefined if that is not known. */
  card = $state.raw<Card | undefined>(undefined);
  /** Whether the hub has answered. */
  known = $state(false);
  #users = 0;
  #end: (() => void) | undefined;
  #timer: ReturnType<typeof setTimeout> | undefined;
  #asked = -Infinity;
  /** Numbers the questions, of which only the newest answer counts. */
  #number = 0;
  /** The newest answer as text: another one that says the same changes nothing. */
  #said = "";

  constructor(
    readonly hub: Hub,
    readonly path: string,
  ) {}

  /** Somebody looks at it until the function that this gives is called. */
  start(): () => void {
    this.#users += 1;
    this.#end ??= this.hub.watch({ path: this.path, kind: "channel", names: [] }, { joined: () => this.ask(), events: (events) => events.forEach((event) => this.#heard(event)), failed: () => (this.known = true) });
    return () => {
      this.#users -= 1;
      if (this.#users) return;
      clearTimeout(this.#timer);
      this.#end?.();
      [this.#timer, this.#end] = [undefined, undefined];
    };
  }

  #heard({ type }: HubEvent): void {
    if (type === "joined") this.ask();
  }

  /** Another device may be there, or another card; it is asked for soon, if somebody looks at it. */
  ask(): void {
    if (!this.#users || this.#timer !== undefined) return;
    this.#timer = setTimeout(() => {
      [this.#timer, this.#asked] = [undefined, performance.now()];
      void this.#read();
    }, Math.max(0, this.#asked + AGAIN - performance.now()));
  }

  async #read(): Promise<void> {
    const number = ++this.#number;
    let said: PlainFields | null | undefined;
    try {
      said = await this.hub.call("card", this.path);
    } catch {
      // Who may not ask, or cannot now, goes on with what is known.
    }
    if (number !== this.#number) return;
    this.known = true;
    if (said !== undefined) this.#take(said ?? {});
  }

  #take(said: PlainFields): void {
    const text = JSON.stringify(said, (_, value: unknown) => (typeof value === "bigint" ? String(value) : value));
    if (text === this.#said) return;
    this.#said = text;
    this.card = cardOf(said);
  }
}

const all = new WeakMap<Hub, Map<string, Carded>>();

/** What is known of the card of the device in a channel. */
export function carded(hub: Hub, path: string): Carded {
  let of = all.get(hub);
  if (!of) all.set(hub, (of = new Map()));
  let found = of.get(path);
  if (!found) of.set(path, (found = new Carded(hub, path)));
  return found;
}
