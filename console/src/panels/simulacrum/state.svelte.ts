// A robot's mirror, as one channel tells it.
import type { Hub } from "../../hub/hub.svelte.js";
import { Teller } from "../../hub/teller.svelte.js";
import { robotOf } from "../../hub/mirrors.svelte.js";
import { whileVisible } from "../../hub/visible.js";
import type { Failure, HubEvent, Message } from "../../worker/protocol.js";
import { type Element, type Packet, elementOf, inOrder, isPlaced, packetOf } from "./element.js";
import { type Seen, seenOf } from "./packet.js";
import { Trail } from "./trail.js";

/** ms between two updates of an element, at the least. */
const EVERY = 100;
/** ms between two steps of the lines of the last minute. */
const TICK = 500;
/** Numbers of an element that have a line. */
const LINES = 6;

export type Way = "down" | "up";

/** What was in packets: how often each bit was seen to be 1, and whether it is in the newest. */
export interface Lights {
  times: readonly number[];
  bits: readonly boolean[];
}
const DARK: Lights = { times: [], bits: [] };

/** The lines of an element: what is wanted, and what is. */
interface Trails {
  wanted: Trail[];
  value: Trail[];
}

export class SimulacrumState {
  elements = $state.raw<ReadonlyMap<string, Element>>(new Map());
  packet = $state.raw<Packet | undefined>(undefined);
  lights = $state.raw<{ readonly [way in Way]: Lights }>({ down: DARK, up: DARK });
  joined = $state(false);
  failure = $state.raw<Failure | null>(null);
  /** The present, for lines: ms since 1970. */
  tick = $state(Date.now());
  readonly rates = { down: new Trail(), up: new Trail(), loss: new Trail() };
  readonly #trails = new Map<string, Trails>();
  #heard = 0;
  readonly #teller: Teller;

  constructor(
    readonly hub: Hub,
    readonly path: string,
  ) {
    this.#teller = new Teller(hub);
  }

  /** Since when nobody knows how the robot is, ms since 1970. */
  get unknownSince(): number | undefined {
    return this.#teller.unknownSince;
  }

  /** In the order of the device map. */
  readonly list = $derived(inOrder(this.elements.values()));
  readonly placed = $derived(isPlaced(this.list));
  readonly seen: { readonly [way in Way]: Seen | undefined } = $derived({
    down: this.packet && seenOf(this.packet.down, this.list.length, this.packet.downMap),
    up: this.packet && seenOf(this.packet.up, this.list.length, this.packet.upMap),
  });

  /** The robot's own channel, in which statements are sent to it. */
  get robot(): string {
    return `${robotOf(this.path)}/robot`;
  }

  /** Watches it until the function that it gives is called. */
  start(): () => void {
    const end = this.hub.watch(
      { path: this.path, kind: "channel", newest: true, every: EVERY, state: true },
      {
        joined: () => ([this.joined, this.failure] = [true, null]),
        events: (events) => this.#take(events),
        failed: (failure) => ([this.joined, this.failure] = [false, failure]),
      },
    );
    const stop = whileVisible(TICK, () => void (this.tick = Date.now()));
    return () => {
      end();
      stop();
    };
  }

  trails(name: string): Trails {
    let found = this.#trails.get(name);
    if (!found) this.#trails.set(name, (found = { wanted: [], value: [] }));
    return found;
  }

  #take(events: readonly HubEvent[]): void {
    const elements = new Map(this.elements);
    let changed = false;
    for (const event of events) {
      this.#teller.happens(event);
      if (event.type !== "message") continue;
      const message = event as Message;
      this.#teller.tells(message);
      const packet = packetOf(message);
      if (packet) this.#packet(packet, message.arrived);
      const element = packet ? undefined : elementOf(message, elements.get(message.name)?.heard ?? this.#heard++);
      // Said again to later members.
      if (!element || (elements.get(element.name)?.born ?? 0) > element.born + 60_000) continue;
      elements.set(element.name, element);
      changed = true;
      this.#draw(element, message.arrived);
    }
    if (changed) this.elements = elements;
  }

  #draw(element: Element, at: number): void {
    const trails = this.trails(element.name);
    const add = (to: Trail[], values: readonly number[] | undefined, known: boolean): void => {
      for (const [index, value] of (values ?? []).slice(0, LINES).entries()) (to[index] ??= new Trail()).add(at, known && Number.isFinite(value) ? value : null);
    };
    add(trails.wanted, element.wanted, true);
    add(trails.value, element.events === undefined ? element.value : [element.events], element.linked);
  }

  #packet(packet: Packet, at: number): void {
    if (this.packet && packet.born < this.packet.born) return;
    this.packet = packet;
    this.rates.down.add(at, packet.downRate ?? null);
    this.rates.up.add(at, packet.upRate ?? null);
    this.rates.loss.add(at, packet.loss ?? null);
    const { down, up } = this.seen;
    this.lights = { down: lit(this.lights.down, down), up: lit(this.lights.up, up) };
  }
}

function lit(before: Lights, seen: Seen | undefined): Lights {
  const bits = seen?.bits ?? [];
  return { bits, times: bits.map((bit, place) => (before.times[place] ?? 0) + (bit ? 1 : 0)) };
}
