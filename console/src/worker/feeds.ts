// What the page watches: one membership of a context, and those who watch it.
import { type Client, type Event, type MessageEvent, type Parcel, type Thinning, type Value, MomError } from "mom-client";
import { Pictures } from "./pictures.js";
import { failure, plain, plainFields } from "./plain.js";
import type { Say } from "./port.js";
import type { Happening, HubEvent, Message, Watch } from "./protocol.js";

/** Events go to the page so often, in ms, and at most so many of one watch at once. */
const FLUSH = 50;
const MOST = 200;
/** Of a watch that has a bound per second so many may come together. */
const BURST = 500;
/** What was said last is kept for who begins to watch later: so many messages, each of so many bytes of binary at most. */
const KEPT = 64;
const KEPT_SIZE = 4096;
/** A channel whose states may be lost is asked for them again so often at most, ms. */
const ASK = 2000;
/** Drops after which something newer comes by itself, or that nobody shows. */
const HARMLESS = new Set(["rate", "replaced", "older-fence", "withdrawn"]);
/** Where all names matter, so many are kept and may wait; and so many go to the page at once. */
const NAMES = 10_000;
const PORTION = 500;

/** When a message was made, by this machine's clock. */
export function birth(client: Client, parcel: Parcel): { born: number | undefined; error: number | undefined } {
  const age = client.clock.age(parcel);
  return age ? { born: Date.now() - age.micros / 1000, error: age.error / 1000 } : { born: undefined, error: undefined };
}

function messageOf(client: Client, event: MessageEvent, answer: boolean): Message {
  const { parcel, name, sender, history } = event;
  const { content, cut, size } = plain(event.content, name !== "image", answer);
  const { id, reference, fence } = parcel;
  return { type: "message", name, sender, said: parcel.timestamp?.toDate().getTime(), content, cut, size, id, reference, fence, history, ...birth(client, parcel), arrived: Date.now() };
}

export function happeningOf(event: Exclude<Event, MessageEvent>, path: string): Happening {
  const arrived = Date.now();
  if (event.type === "refused") return { type: "refused", path: event.path ?? path, what: event.id === undefined ? {} : { id: event.id }, failure: failure(event.error), arrived };
  if (event.type === "other") return { type: event.parcel.name, path, what: plainFields(event.parcel.content), arrived };
  const { type, ...rest } = event;
  const { parcel: _parcel, ...what } = rest as { parcel?: unknown; [key: string]: unknown };
  return { type, path: "path" in event ? event.path : path, what: plainFields(what as { [key: string]: Value }), arrived };
}

const keyOf = ({ sender, name }: Message): string => `${sender}\n${name}`;

/** One who watches. */
class Watcher {
  #events: HubEvent[] = [];
  /** The newest by sender and name, of a watch that wants no more. */
  readonly #newest = new Map<string, HubEvent>();
  #skipped = 0;
  #timer: ReturnType<typeof setTimeout> | undefined;
  #flushed = 0;
  #left = BURST;
  #filled = performance.now();
  readonly pictures: Pictures | null;

  constructor(
    readonly id: number,
    readonly watch: Watch,
    readonly say: Say,
  ) {
    this.pictures = watch.pictures === undefined ? null : new Pictures(id, watch.pictures, say);
  }

  wants(event: HubEvent): boolean {
    const { names } = this.watch;
    return event.type !== "message" || names === undefined || names.includes((event as Message).name);
  }

  /** How many may wait: of a watch with a bound what is left of it. */
  #room(): number {
    const { most } = this.watch;
    if (most === undefined) return MOST;
    const now = performance.now();
    this.#left = Math.min(BURST, this.#left + ((now - this.#filled) * most) / 1000);
    this.#filled = now;
    return Math.max(1, Math.floor(this.#left));
  }

  /** The first event goes at once, what follows closely goes together. */
  take(event: HubEvent): void {
    const { every } = this.watch;
    if (every !== undefined && event.type === "message") this.#replace(event as Message);
    else this.#events.push(event);
    if (this.#events.length > this.#room()) {
      const message = this.#events.findIndex((event) => event.type === "message");
      this.#events.splice(Math.max(message, 0), 1);
      this.#skipped += 1;
    }
    this.#plan(every ?? FLUSH);
  }

  #replace(message: Message): void {
    // Its place stays, so that none waits for ever behind those that come more often.
    this.#newest.set(keyOf(message), message);
    if (this.#newest.size <= NAMES) return;
    this.#newest.delete(this.#newest.keys().next().value!);
    this.#skipped += 1;
  }

  #plan(every: number): void {
    if (this.#timer !== undefined) return;
    const wait = this.#flushed + every - performance.now();
    if (wait <= 0) this.#flush();
    else this.#timer = setTimeout(() => this.#flush(), wait);
  }

  #flush(): void {
    this.#timer = undefined;
    this.#flushed = performance.now();
    const [events, skipped] = [this.#events, this.#skipped];
    for (const [key, event] of this.#newest) {
      if (events.length >= PORTION) break;
      events.push(event);
      this.#newest.delete(key);
    }
    this.#left -= events.length;
    [this.#events, this.#skipped] = [[], 0];
    this.say({ word: "events", watch: this.id, events, skipped });
    if (this.#newest.size) this.#plan(FLUSH);
  }

  end(): void {
    clearTimeout(this.#timer);
    this.pictures?.end();
  }
}

/** A context that is watched. */
class Feed {
  readonly watchers = new Map<number, Watcher>();
  readonly #last = new Map<string, Message>();
  /** The membership, once it is there. */
  #entered: Promise<void> | null = null;
  #reads = false;
  #thinning = "";
  /** Of members that are gone, and have said what is kept here, what says so. */
  readonly #gone = new Map<string, HubEvent>();
  #asked = -Infinity;
  #asking: ReturnType<typeof setTimeout> | undefined;

  constructor(
    readonly client: Client,
    readonly path: string,
    readonly kind: Watch["kind"],
    readonly hears: (path: string, event: Event, client: Client) => void,
  ) {}

  /** The least thinning with which everybody gets what they want; undefined is none. */
  #wanted(): Thinning | undefined {
    const rates = [...this.watchers.values()].map(({ watch }) => watch);
    if (this.kind !== "channel" || rates.some(({ rate, newest }) => rate === undefined && !newest)) return undefined;
    if (rates.some(({ rate }) => rate === undefined)) return { newest: true };
    const perSecond = (rate: string): number => Number.parseFloat(rate) / (rate.endsWith("/min") ? 60 : 1);
    const rate = rates.map(({ rate }) => rate!).reduce((one, other) => (perSecond(one) >= perSecond(other) ? one : other));
    return { rate };
  }

  get #kept(): number {
    return [...this.watchers.values()].some(({ watch }) => watch.every !== undefined) ? NAMES : KEPT;
  }

  async add(watcher: Watcher): Promise<void> {
    this.watchers.set(watcher.id, watcher);
    await this.#enter();
    const info = await this.client.info(this.path).catch((error: unknown) => {
      // Of a token nothing is known then; a channel is heard nevertheless.
      if (this.kind === "token") throw error;
      return {};
    });
    if (!this.watchers.has(watcher.id)) return;
    watcher.say({ word: "joined", watch: watcher.id, info: plainFields(info) });
    for (const message of this.#last.values()) if (watcher.wants(message)) watcher.take({ ...message, history: true });
    for (const gone of this.#gone.values()) watcher.take(gone);
  }

  /** Hears how things are anew, from what the channel keeps and from devices, which tell who joins. */
  ask(): void {
    if (this.kind !== "channel" || this.#asking !== undefined || ![...this.watchers.values()].some(({ watch }) => watch.state)) return;
    this.#asking = setTimeout(() => {
      this.#asking = undefined;
      this.#asked = performance.now();
      // A link that is lost meanwhile is another reason to ask.
      if (this.watchers.size) void this.client.refresh(this.path).catch(() => undefined);
    }, Math.max(0, this.#asked + ASK - performance.now()));
  }

  /** What may have been lost, and who has gone. */
  #notes(event: Event): void {
    if (event.type === "lagged") return this.ask();
    if (event.type === "dropped") {
      const { receiver } = event as { receiver?: unknown };
      if (!HARMLESS.has(event.reason) && event.delivery !== "fleeting" && (receiver === undefined || receiver === this.client.name)) this.ask();
    } else if (event.type === "lost" || event.type === "left") {
      const { peer } = event.member;
      if ([...this.#last.values()].some(({ sender }) => sender === peer)) this.#gone.set(peer, happeningOf(event, this.path));
    } else if ((event.type === "resumed" || event.type === "joined") && this.#gone.has(event.member.peer)) this.ask();
  }

  /** Joins with the thinning that is wanted now. */
  async #enter(): Promise<void> {
    const thinning = this.#wanted();
    const said = JSON.stringify(thinning ?? {});
    // A second caller waits as well, and hears of a refusal.
    if (this.#entered && said === this.#thinning) return this.#entered;
    this.#thinning = said;
    const entering = this.#join(thinning);
    this.#entered = entering;
    try {
      await entering;
    } catch (error) {
      if (this.#entered === entering) this.#entered = null;
      throw error;
    }
    if (!this.#reads) void this.#read();
    this.#reads = true;
  }

  async #join(thinning: Thinning | undefined): Promise<void> {
    const { client, path, kind } = this;
    if (kind === "channel") await client.channel(path, thinning ?? {});
    else if (kind === "token") await client.token(path);
    else await client.session(path);
  }

  async #read(): Promise<void> {
    for await (const event of this.client.peer.events(this.path)) {
      this.hears(this.path, event, this.client);
      this.#notes(event);
      if (event.type === "message") this.#message(event);
      else this.#give(happeningOf(event, this.path));
      if (!this.watchers.size) break;
    }
  }

  /** Whether a caller waits for an answer of this name. */
  #isAnswer(name: string): boolean {
    for (const { watch } of this.watchers.values()) if (watch.answers && watch.names?.includes(name)) return true;
    return false;
  }

  #message(event: MessageEvent): void {
    const answer = this.#isAnswer(event.name);
    const message = messageOf(this.client, event, answer);
    const key = keyOf(message);
    this.#gone.delete(message.sender);
    if (message.size <= KEPT_SIZE && !message.cut && !answer) {
      this.#last.delete(key);
      this.#last.set(key, message);
      if (this.#last.size > this.#kept) this.#last.delete(this.#last.keys().next().value!);
    }
    for (const watcher of this.watchers.values()) {
      if (!watcher.wants(message)) continue;
      // What is kept comes again where states were asked for; others have it.
      if (message.history && this.#asked > 0 && !watcher.watch.state) continue;
      const isPicture = message.name === "image" && watcher.pictures?.take(event, message);
      if (!isPicture) watcher.take(message);
    }
  }

  #give(event: HubEvent): void {
    for (const watcher of this.watchers.values()) watcher.take(event);
  }

  /** Ends a watch; true if nobody watches any more. */
  remove(id: number): boolean {
    this.watchers.get(id)?.end();
    this.watchers.delete(id);
    if (this.watchers.size) void this.#enter().catch(() => undefined);
    return !this.watchers.size;
  }
}

export class Feeds {
  readonly #feeds = new Map<string, Feed>();
  readonly #paths = new Map<number, string>();
  #client: Client | null = null;

  constructor(
    readonly say: Say,
    /** Hears each event of what is watched. */
    readonly hears: (path: string, event: Event, client: Client) => void,
  ) {}

  /** There is a new peer: nobody watches anything. */
  reset(client: Client): void {
    for (const feed of this.#feeds.values()) for (const id of [...feed.watchers.keys()]) feed.remove(id);
    this.#feeds.clear();
    this.#paths.clear();
    this.#client = client;
  }

  async watch(id: number, watch: Watch): Promise<void> {
    const client = this.#client;
    if (!client) throw new MomError("local", "not-logged-in", "log in first");
    let feed = this.#feeds.get(watch.path);
    if (!feed) this.#feeds.set(watch.path, (feed = new Feed(client, watch.path, watch.kind, this.hears)));
    this.#paths.set(id, watch.path);
    try {
      await feed.add(new Watcher(id, watch, this.say));
    } catch (error) {
      this.unwatch(id);
      throw error;
    }
  }

  /** Something may have been lost: how things are is asked for anew. */
  ask(): void {
    for (const feed of this.#feeds.values()) feed.ask();
  }

  unwatch(id: number): void {
    const path = this.#paths.get(id);
    this.#paths.delete(id);
    const feed = path === undefined ? undefined : this.#feeds.get(path);
    if (!feed?.remove(id)) return;
    this.#feeds.delete(feed.path);
    // Sessions hold what is watched inside them, and the membership of a token says that it is owned.
    if (feed.kind === "channel") void this.#client?.peer.leave(feed.path).catch(() => undefined);
  }

  pictureFile(id: number): { bytes: Uint8Array; type: string } | null {
    const path = this.#paths.get(id);
    return this.#feeds.get(path ?? "")?.watchers.get(id)?.pictures?.file ?? null;
  }

  shown(id: number): void {
    const path = this.#paths.get(id);
    this.#feeds.get(path ?? "")?.watchers.get(id)?.pictures?.shown();
  }
}
