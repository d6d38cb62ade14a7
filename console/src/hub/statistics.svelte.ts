// The statistics of a hub or of one context, asked for each second while a panel shows them, with their history.
import type { Failure } from "../worker/protocol.js";
import { failureOf } from "./failure.js";
import { History } from "./history.js";
import type { Hub } from "./hub.svelte.js";
import { ownFigures } from "./own.js";
import { type ChannelRates, type ChannelStats, type Rates, type Sample, channelRates, ratesBetween, sampleOf, spread } from "./rates.js";
import { whileVisible } from "./visible.js";

const EVERY = 1000;
/** Where the whole may not be asked for, or is more than one answer, its parts are: so many at most. */
const PARTS = 32;
/** So often the parts are looked for anew. */
const LOOK = 10_000;
/** Of so many channels a history is kept. */
const CHANNELS = 64;
/** Histories of contexts that nobody looks at any more. */
const KEPT = 16;

export class Statistics {
  /** The newest answer; what is missing in it is empty. */
  sample = $state.raw<Sample | null>(null);
  rates = $state.raw<Rates | null>(null);
  channelRates = $state.raw<ReadonlyMap<string, ChannelRates>>(new Map());
  /** By path. */
  channels = $state.raw<ReadonlyMap<string, ChannelStats>>(new Map());
  /** Why the whole is not known. */
  failure = $state.raw<Failure | null>(null);
  readonly history = new History();
  /** Counts what was added to the history. */
  version = $state(0);
  #users = 0;
  #end: (() => void) | undefined;
  #parts: string[] = [];
  #looked = -Infinity;
  #asked = -Infinity;

  constructor(
    readonly hub: Hub,
    readonly path: string,
    /** What else is written into the history. */
    readonly extra: () => { [name: string]: number | undefined } = () => ({}),
  ) {}

  get inUse(): boolean {
    return this.#users > 0;
  }

  /** Asks until the function that it gives is called. */
  use(): () => void {
    this.#users += 1;
    this.#end ??= whileVisible(EVERY, () => this.#ask());
    return () => {
      this.#users -= 1;
      if (this.#users) return;
      this.#end?.();
      this.#end = undefined;
      // What was between is not known.
      this.rates = null;
    };
  }

  async #ask(): Promise<void> {
    const { hub, path } = this;
    // Rates over a moment tell nothing: pages come and go quickly.
    if (performance.now() - this.#asked < EVERY / 2) return;
    this.#asked = performance.now();
    if (!hub.isUp) return this.#take(null, null);
    let [sample, failure]: [Sample | null, Failure | null] = [null, null];
    try {
      sample = sampleOf(await hub.call("ask", "context", "stats", path), performance.now());
    } catch (error) {
      failure = failureOf(error);
    }
    if (failure?.kind === "refused" || sample?.more) sample = await this.#together(sample);
    this.#take(sample, failure);
  }

  /** The parts of a session, as one. */
  async #together(whole: Sample | null): Promise<Sample | null> {
    const { hub, path } = this;
    const now = performance.now();
    if (now - this.#looked > LOOK) {
      this.#looked = now;
      const children = await hub.call("list", path).catch(() => []);
      this.#parts = children.filter(({ kind }) => kind !== "token").map(({ path }) => path).slice(0, PARTS);
    }
    const known = new Set(whole?.channels.map(({ path }) => path));
    const answers = await Promise.all(this.#parts.map((part) => hub.call("ask", "context", "stats", part).catch(() => null)));
    const found = answers.filter((answer) => answer !== null).map((answer) => sampleOf(answer, now));
    if (!whole && !found.length) return null;
    const channels = [...(whole?.channels ?? []), ...found.flatMap(({ channels }) => channels).filter(({ path }) => !known.has(path))];
    return { at: performance.now(), members: [], peers: [], morePeers: 0, memory: undefined, ...whole, channels, more: found.some(({ more }) => more) };
  }

  #take(sample: Sample | null, failure: Failure | null): void {
    const before = this.sample;
    this.failure = failure;
    let rates: Rates | null = null;
    if (sample) {
      // An answer from before a pause tells nothing of now.
      if (before && sample.at - before.at < 5 * EVERY) {
        this.channelRates = channelRates(before, sample);
        rates = ratesBetween(before, sample);
      }
      this.sample = sample;
      this.channels = new Map(sample.channels.map((channel) => [channel.path, channel]));
    } else if (failure?.kind === "refused") {
      // What another user saw before is nobody's now.
      [this.sample, this.channels, this.channelRates] = [null, new Map(), new Map()];
    }
    this.rates = rates;
    this.#remember(sample, rates);
    this.version += 1;
  }

  #remember(sample: Sample | null, rates: Rates | null): void {
    const row: { [name: string]: number | undefined } = { ...this.extra() };
    if (rates) Object.assign(row, rates);
    if (sample) {
      const trips = spread(sample.peers.map(({ roundTrip }) => roundTrip));
      Object.assign(row, { "trip p50": trips?.p50, "trip p99": trips?.p99, "trip most": trips?.most, memory: sample.memory?.used, bound: sample.memory?.bound });
      for (const { path, counts } of sample.channels.slice(0, CHANNELS)) {
        const own = this.channelRates.get(path);
        row[`messages ${path}`] = rates ? own?.messages : undefined;
        row[`delivered ${path}`] = rates ? own?.delivered : undefined;
        row[`dropped ${path}`] = rates ? own?.dropped : undefined;
        row[`bytes ${path}`] = rates ? own?.bytes : undefined;
        row[`age ${path}`] = counts.age?.p99;
      }
    }
    this.history.push(Date.now(), row);
  }
}

const all = new WeakMap<Hub, Map<string, Statistics>>();

/** The statistics of a context, the same ones for all who look. */
export function statisticsOf(hub: Hub, path: string): Statistics {
  const known = all.get(hub) ?? new Map<string, Statistics>();
  all.set(hub, known);
  let found = known.get(path);
  if (!found) {
    found = new Statistics(hub, path, path === "/" ? () => ownFigures(hub) : undefined);
    known.set(path, found);
    for (const [key, other] of known) if (known.size > KEPT && key !== "/" && other !== found && !other.inUse) known.delete(key);
  }
  return found;
}
