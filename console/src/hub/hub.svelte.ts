// The hub as panels see it: who is logged in, how the link is, what is owned, and what is watched.
import type { CallName, Calls, Failure, Happening, HubEvent, Link, Login, Me, Owned, Picture, PlainFields, Previous, StandingStop, StopReport, Watch, Word } from "../worker/protocol.js";
import { HubError, failureOf } from "./failure.js";
import { HeardPeers } from "./heard.js";
import { OrderedStops, isWithin } from "../worker/ordered.js";
import { troublesOf } from "./order.js";
import { forgetNotices, keepNotices, keptNotices } from "./noted.js";
import { type Port, open } from "./port.js";
import { visible } from "./said.js";
import { whyNot } from "./why.js";
import { texts } from "../texts/index.js";

/** What one who watches hears. */
export interface Handlers {
  events?(events: HubEvent[], skipped: number): void;
  picture?(picture: Picture): void;
  unshown?(size: number, why: "too-large" | "not-readable", sender: string): void;
  /** It has begun, or begun again after a new login. */
  joined?(info: PlainFields): void;
  failed?(failure: Failure): void;
}

/** Something that a person should know of: an error, or what became of a token. */
export interface Notice {
  at: number;
  tone: "error" | "warning" | "info";
  text: string;
  failure?: Failure;
}

const MOST_NOTICES = 200;
/** Notices are kept so long after the first of them, ms: many may come at once. */
const KEEP = 200;
/** What is the same within so many ms is noted once. */
const REPEATED = 10_000;
/** ms until a watch that was refused for now is tried again. */
const AGAIN = 3000;

type Result<Name extends CallName> = ReturnType<Calls[Name]>;

export class Hub {
  me = $state.raw<Me | null>(null);
  link = $state.raw<Link>({ state: "out" });
  /** The tokens of this page, by path. */
  owned = $state.raw<ReadonlyMap<string, Owned>>(new Map());
  /** The newest order to stop or to let go, and what became of it. */
  order = $state.raw<StopReport | null>(null);
  /** The stops that hold, as far as they are known; only these are let go. */
  stops = $state.raw<readonly StandingStop[]>([]);
  /** The newest first. */
  notices = $state.raw<readonly Notice[]>([]);
  /** Why a login failed. */
  refusal = $state.raw<Failure | null>(null);
  /** By whom this page was put out of the hub, and why. */
  expelled = $state.raw<{ by: string | undefined; text: string | undefined } | null>(null);
  /** Whether a login is under way. */
  connecting = $state(false);
  /** Where the hub is, as `mom-connection` says. */
  address = $state("");
  /** Whether a login that was kept has been tried, so that a person is to be asked. */
  asked = $state(false);
  /** Whether a frame tells on every page what is asked of this page, so that panels need not. */
  framed = $state(false);
  /** Of whom something was heard, how old. */
  readonly heard = new HeardPeers();
  /** How this page has logged in. */
  login: Login | null = null;
  /** Whether the user has logged out. */
  left = false;
  /** Called when the link's credential has changed. */
  onMe: (me: Me | null) => void = () => undefined;
  readonly #port: Port;
  readonly #asked = new Map<number, { resolve: (value: never) => void; reject: (error: HubError) => void }>();
  readonly #watches = new Map<number, { watch: Watch; handlers: Handlers }>();
  readonly #jogEnds = new Set<(path: string, failure: Failure) => void>();
  readonly #ordered = new OrderedStops();
  #orderedStops = $state(0);
  /** Since when the link says nothing, ms since 1970, and the newest loss of it that is over. */
  #silent = $state<number | undefined>(undefined);
  #loss = $state.raw<{ from: number; to: number } | undefined>(undefined);
  readonly #stopListeners = new Set<(top: string) => void>();
  #lastId = 0;
  /** Where a login is under way that has not been explained. */
  #trying: string | null = null;
  /** What the hub says to pages of this origin, where it lets none in. */
  #origin: Failure | null = null;

  constructor(readonly name = "") {
    this.#port = open();
    this.#port.onWord = (word) => this.#heard(word);
    this.#port.onFault = (text) => this.noteOnce("error", texts.shell.fault(text));
    globalThis.addEventListener?.("pagehide", () => this.#keepNotices());
  }

  /** Whether requests can be answered now. */
  get isUp(): boolean {
    return this.link.state === "connected" || this.link.state === "stale";
  }

  call<Name extends CallName>(call: Name, ...args: Parameters<Calls[Name]>): Promise<Result<Name>> {
    const id = ++this.#lastId;
    return new Promise((resolve, reject) => {
      this.#asked.set(id, { resolve, reject });
      this.#port.ask({ id, call, args });
    });
  }

  async connect(login: Login): Promise<Me> {
    this.connecting = true;
    [this.refusal, this.expelled, this.#origin, this.#trying] = [null, null, null, login.address];
    this.left = false;
    try {
      const me = await this.call("connect", login);
      [this.me, this.login] = [me, login];
      // What another user was told is not told to this one.
      if (this.#user !== me.user) this.notices = [...(this.#user === undefined ? this.notices : []), ...keptNotices(this.name, me.user)];
      this.#user = me.user;
      this.onMe(me);
      for (const id of this.#watches.keys()) this.#begin(id);
      return me;
    } catch (error) {
      if (this.#trying === login.address && this.#origin === null) await this.#explain();
      this.refusal = this.#origin ?? failureOf(error);
      this.note("error", texts.login.refused(this.refusal.text), this.refusal);
      throw error;
    } finally {
      this.#trying = null;
      this.connecting = false;
    }
  }

  /** A browser does not say why it reaches no hub. Where the hub refuses pages of this origin, trying again is in vain. */
  async #explain(): Promise<void> {
    const address = this.#trying;
    if (address === null) return;
    this.#trying = null;
    const text = await whyNot(address);
    if (text === null || !this.connecting) return;
    this.#origin = { kind: "connection", code: "origin", text, content: {} };
    await this.call("close");
  }

  /** Logs out. */
  async close(): Promise<void> {
    [this.me, this.left, this.login] = [null, true, null];
    this.owned = new Map();
    this.#forgetNotices();
    this.onMe(null);
    await this.call("close");
  }

  /** Hears what happens in a context until the function that it gives is called; begins as soon as a user is logged in. */
  watch(watch: Watch, handlers: Handlers): () => void {
    const id = ++this.#lastId;
    this.#watches.set(id, { watch, handlers });
    if (this.me) this.#begin(id);
    return () => {
      this.#watches.delete(id);
      if (this.me) void this.call("unwatch", id).catch(() => undefined);
    };
  }

  #begin(id: number): void {
    const wanted = this.#watches.get(id);
    if (!wanted) return;
    this.call("watch", id, wanted.watch).catch((error: unknown) => {
      const failure = failureOf(error);
      wanted.handlers.failed?.(failure);
      // It may be there, or permitted, later.
      if (this.#watches.has(id)) setTimeout(() => this.me && this.#watches.has(id) && this.#begin(id), AGAIN);
    });
  }

  /** The stops that hold in a place. */
  stopsIn(top: string): StandingStop[] {
    return this.stops.filter(({ path }) => isWithin(path, top));
  }

  /** Stops all devices of a place. */
  stop(reason: string, top = "/"): void {
    const asked = this.call("stop", "stop", top, { reason });
    this.#stopOrdered(top);
    asked.catch((error: unknown) => this.note("error", failureOf(error).text, failureOf(error)));
  }

  /** Lets go of these stops, which were shown to the user, in a place. */
  free(stops: readonly StandingStop[], top = "/"): void {
    const numbers = Object.fromEntries(stops.map(({ path, number }) => [path, number]));
    this.call("stop", "unstop", top, { stops: numbers }).catch((error: unknown) => this.note("error", failureOf(error).text, failureOf(error)));
  }

  /** Stops the devices of some channels, without a report of all; what fails, fails. */
  stopEach(paths: readonly string[], reason: string): Promise<void>[] {
    const asked = paths.map((path) => this.call("stopOne", "stop", path, { reason }));
    for (const path of paths) this.#stopOrdered(path);
    return asked;
  }

  /** The order has gone to the worker: what is under way ends after it, and never keeps it waiting. */
  #stopOrdered(top: string): void {
    this.#ordered.add(top);
    this.#orderedStops += 1;
    for (const listener of this.#stopListeners) listener(top);
  }

  /** How many stops of a path this page has ordered: what is under way for it ends when that number rises. */
  stopsOrdered(path: string): number {
    void this.#orderedStops;
    return this.#ordered.count(path);
  }

  /** When the newest of them was ordered. */
  stopOrderedAt(path: string): number | undefined {
    void this.#orderedStops;
    return this.#ordered.newest(path);
  }

  /** Hears each stop that this page orders, as it is ordered. */
  onStop(listener: (top: string) => void): () => void {
    this.#stopListeners.add(listener);
    return () => this.#stopListeners.delete(listener);
  }

  onJogEnd(ends: (path: string, failure: Failure) => void): () => void {
    this.#jogEnds.add(ends);
    return () => this.#jogEnds.delete(ends);
  }

  note(tone: Notice["tone"], text: string, failure?: Failure): void {
    if (failure) this.#noted.add(failure);
    if (tone === "error") for (const listener of this.#errorListeners) listener(text, failure);
    this.notices = [{ at: Date.now(), tone, text, ...(failure ? { failure } : {}) }, ...this.notices].slice(0, MOST_NOTICES);
    this.#keeping ??= setTimeout(() => this.#keepNotices(), KEEP);
  }

  /** Notes what a panel shows, or what may come again and again: not a failure that is a notice already, nor what was said just now. */
  noteOnce(tone: Notice["tone"], text: string, failure?: Failure): void {
    if (failure && this.#noted.has(failure)) return;
    const since = Date.now() - REPEATED;
    if (!this.notices.some((notice) => notice.at > since && notice.tone === tone && notice.text === text)) this.note(tone, text, failure);
  }

  readonly #noted = new WeakSet<Failure>();
  readonly #errorListeners = new Set<(text: string, failure: Failure | undefined) => void>();

  /** Hears each error that is noted. */
  onError(listener: (text: string, failure: Failure | undefined) => void): () => void {
    this.#errorListeners.add(listener);
    return () => this.#errorListeners.delete(listener);
  }

  #keeping: ReturnType<typeof setTimeout> | undefined;
  /** Whose notices they are. */
  #user: string | undefined;

  #keepNotices(): void {
    clearTimeout(this.#keeping);
    this.#keeping = undefined;
    // Only the frame shows them after a reload; a page of others keeps its storage.
    if (this.#user !== undefined && this.framed && this.notices.length) keepNotices(this.name, this.#user, this.notices);
  }

  #forgetNotices(): void {
    clearTimeout(this.#keeping);
    [this.notices, this.#keeping, this.#user] = [[], undefined, undefined];
    forgetNotices(this.name);
  }

  clearNotices(): void {
    this.notices = [];
    forgetNotices(this.name);
  }

  /** The present time by the hub's clock, ms since 1970, if it is known. */
  hubTime(): number | undefined {
    return this.link.offset === undefined ? undefined : Date.now() + this.link.offset;
  }

  #heard(word: Word): void {
    switch (word.word) {
      case "answer":
        this.#asked.get(word.id)?.resolve(word.value as never);
        return void this.#asked.delete(word.id);
      case "failure":
        this.#asked.get(word.id)?.reject(new HubError(word.failure));
        return void this.#asked.delete(word.id);
      case "link":
        return this.#linked(word.link);
      case "me":
        this.me = word.me;
        return this.onMe(word.me);
      case "owned":
        return this.#own(word.path, word.owned, word.reason, word.by);
      case "asked":
        return this.#isAsked(word.event);
      case "stop":
        if (word.report.over && !(this.order?.over && this.order.at === word.report.at)) for (const { tone, text, failure } of troublesOf(word.report)) this.note(tone, text, failure);
        this.order = word.report;
        return;
      case "stops":
        this.stops = word.stops;
        return;
      case "trouble":
        return this.noteOnce(word.peer === undefined ? "error" : "warning", texts.notices.trouble(word.path, word.peer, visible(word.failure.text)), word.failure);
      case "jog-ended":
        for (const ends of this.#jogEnds) ends(word.path, word.failure);
        return;
    }
    const handlers = this.#watches.get(word.watch)?.handlers;
    switch (word.word) {
      case "events":
        this.heard.take(word.events);
        return handlers?.events?.(word.events, word.skipped);
      case "picture":
        if (handlers?.picture) handlers.picture(word.picture);
        else word.picture.bitmap.close();
        return void this.call("shown", word.watch).catch(() => undefined);
      case "unshown":
        return handlers?.unshown?.(word.size, word.why, word.sender);
      case "joined":
        return handlers?.joined?.(word.info);
      case "failed":
        return handlers?.failed?.(word.failure);
    }
  }

  #isAsked(event: Happening): void {
    const { type, path, what } = event;
    if (type === "expelled") {
      const [by, text] = [what["by"], what["text"]].map((said) => (typeof said === "string" ? visible(said) : undefined));
      if (path === "/") this.expelled = { by, text };
      return this.note("warning", texts.login.expelled(path, by, text));
    }
    for (const listener of this.#askedListeners) listener(event);
  }

  readonly #askedListeners = new Set<(event: Happening) => void>();

  /** Hears what others want of this page's tokens, and what they offer to it. */
  onAsked(listener: (event: Happening) => void): () => void {
    this.#askedListeners.add(listener);
    return () => this.#askedListeners.delete(listener);
  }

  /** Since when it is not known whether what came at a time still holds: the link is down, or was since. */
  unknownSince(arrived: number): number | undefined {
    return this.#silent ?? (this.#loss && arrived < this.#loss.to ? this.#loss.from : undefined);
  }

  #hearLink({ state }: Link, before: Link["state"]): void {
    if (state !== "connected") {
      this.#silent ??= Date.now();
    } else if (this.#silent !== undefined) {
      // A link that was merely silent has lost nothing.
      if (before !== "stale") this.#loss = { from: this.#silent, to: Date.now() };
      this.#silent = undefined;
    }
  }

  #linked(link: Link): void {
    const before = this.link;
    this.#hearLink(link, before.state);
    this.link = link;
    if (link.state === "trying" && link.error) void this.#explain();
    if (link.state === "closed" && before.state !== "closed" && this.me) {
      this.me = null;
      this.owned = new Map();
      this.refusal = link.error ?? null;
      this.onMe(null);
    }
    if (link.state === "connected" && (before.state === "resuming" || before.state === "trying") && this.me) this.note("info", texts.notices.back);
    if (link.error && link.error.text !== before.error?.text) this.note("warning", link.error.text, link.error);
    for (const listener of this.#linkListeners) listener(link);
  }

  readonly #linkListeners = new Set<(link: Link) => void>();

  /** Hears how the link is, whenever that is told. */
  onLink(listener: (link: Link) => void): () => void {
    this.#linkListeners.add(listener);
    return () => this.#linkListeners.delete(listener);
  }

  #own(path: string, owned: Owned | null, reason: string | undefined, by: string | undefined): void {
    const all = new Map(this.owned);
    if (owned) all.set(path, owned);
    else all.delete(path);
    this.owned = all;
    for (const listener of this.#ownedListeners) listener(path, owned, reason, by);
  }

  readonly #ownedListeners = new Set<(path: string, owned: Owned | null, reason: string | undefined, by: string | undefined) => void>();

  /** Hears what becomes of this page's tokens. */
  onOwned(listener: (path: string, owned: Owned | null, reason: string | undefined, by: string | undefined) => void): () => void {
    this.#ownedListeners.add(listener);
    return () => this.#ownedListeners.delete(listener);
  }
}

export type { Previous };

const hubs = new Map<string, Hub>();

/** The hub of this name; a page with one connection names none. */
export function hubOf(name = ""): Hub {
  let hub = hubs.get(name);
  if (!hub) hubs.set(name, (hub = new Hub(name)));
  return hub;
}
