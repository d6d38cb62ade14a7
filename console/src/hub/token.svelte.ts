// A token as the page knows it: who owns it, until when, who waits, and what is asked.
import type { Failure, Happening, HubEvent, Owned, PlainFields } from "../worker/protocol.js";
import { failureOf } from "./failure.js";
import { fields, list, number, text } from "./fields.js";
import type { Hub } from "./hub.svelte.js";
import { visible } from "./said.js";
import { token as t } from "../texts/control.js";

/** Nobody is told of renewals, nor who waits: that is asked so often, in ms. */
const AGAIN = 5000;

export interface Waiter {
  peer: string;
  user: string;
  level: number;
}

/** A peer asks this page for a token, which it owns. */
export interface Asked {
  path: string;
  peer: string;
  user: string;
  level: number;
  until: number;
  text?: string | undefined;
}

/** The owner offers a token to this page. */
export interface Offer {
  path: string;
  by: string;
  until: number;
  for?: number | undefined;
  commands?: number | undefined;
}

/** A token; one for all of the page that show it: {@link tokenOf}. */
export class TokenState {
  owner = $state<string | null>(null);
  ownerLevel = $state<number | undefined>(undefined);
  fence = $state(0);
  /** ms since 1970; null = without end, undefined = not known. */
  leaseEnds = $state.raw<number | null | undefined>(undefined);
  waiting = $state.raw<readonly Waiter[]>([]);
  holders = $state.raw<readonly string[]>([]);
  /** This page waits: its place, and when its turn is to be expected. */
  place = $state<number | undefined>(undefined);
  expected = $state<number | undefined>(undefined);
  /** This page has asked the owner. */
  asking = $state(false);
  /** How this page lost it last, until it owns it again. */
  lost = $state<string | null>(null);
  /** To whom this page has offered it. */
  offered = $state<string | null>(null);
  /** The owner's connection is lost; when the hub gives it up. */
  ownerLost = $state<number | undefined>(undefined);
  /** The last refusal, and the request that was refused. */
  refusal = $state.raw<{ what: string; failure: Failure } | null>(null);
  known = $state(false);
  failure = $state.raw<Failure | null>(null);
  #users = 0;
  #end: (() => void) | undefined;

  constructor(
    readonly hub: Hub,
    readonly path: string,
    readonly tokens: Tokens,
  ) {}

  /** Who asks this page for it. */
  get asked(): readonly Asked[] {
    return this.tokens.asked.filter(({ path }) => path === this.path);
  }

  get offer(): Offer | null {
    return this.tokens.offers.find(({ path }) => path === this.path) ?? null;
  }

  /** Whether a grab takes it, by what is known here: it is free, its lease is over, or its owner's level is below this user's. */
  grabbable(now: number): boolean {
    const { hub, ownerLevel, leaseEnds } = this;
    if (!this.known || this.holders.length) return false;
    return this.owner === null || (typeof leaseEnds === "number" && leaseEnds < now) || (ownerLevel !== undefined && (hub.me?.level ?? 0) > ownerLevel);
  }

  get mine(): Owned | undefined {
    return this.hub.owned.get(this.path);
  }

  /** Watches it until the function that it gives is called; however many do, the hub is asked once. */
  start(): () => void {
    if (this.#users++ === 0) this.#end = this.#watch();
    return () => {
      if (--this.#users) return;
      this.#end?.();
      // Nobody tells from now on what becomes of it.
      this.known = false;
    };
  }

  #watch(): () => void {
    const end = this.hub.watch(
      { path: this.path, kind: "token" },
      {
        joined: (info) => this.#take(info),
        events: (events) => events.forEach((event) => this.#heard(event)),
        failed: (failure) => (this.failure = failure),
      },
    );
    const timer = setInterval(() => this.hub.isUp && this.known && void this.refresh(), AGAIN);
    return () => {
      clearInterval(timer);
      end();
    };
  }

  /** Takes all that the hub says of it. */
  #take(info: PlainFields): void {
    [this.known, this.failure] = [true, null];
    this.owner = text(info, "owner") ?? null;
    this.ownerLevel = number(info, "owner-level");
    this.fence = number(info, "fence") ?? 0;
    const left = number(info, "lease-left");
    this.leaseEnds = info["lease-left"] === null ? null : left === undefined ? undefined : Date.now() + left;
    this.holders = list(info, "holders").map(String);
    this.#waiters(info);
  }

  #waiters(info: PlainFields): void {
    this.waiting = list(info, "queue").map((waiter) => {
      const of = fields(waiter);
      return { peer: text(of, "peer") ?? "", user: text(of, "user") ?? "", level: number(of, "level") ?? 0 };
    });
  }

  /** Asks who waits, of which others are not told. */
  async refresh(): Promise<void> {
    const info = await this.hub.call("ask", "token", "info", this.path).catch(() => null);
    if (info) this.#take(info);
  }

  #heard(event: HubEvent): void {
    if (event.type === "message") return;
    const { type, what, arrived } = event as Happening;
    switch (type) {
      case "grabbed": {
        this.owner = text(what, "owner") ?? null;
        this.ownerLevel = number(what, "level");
        this.fence = number(what, "fence") ?? 0;
        const lease = number(what, "lease");
        this.leaseEnds = lease === undefined ? null : arrived + lease;
        this.ownerLost = undefined;
        break;
      }
      case "released":
        [this.owner, this.ownerLevel, this.leaseEnds, this.ownerLost] = [null, undefined, undefined, undefined];
        break;
      case "queued":
        // It may come behind the answer to the grab that waited.
        if (this.place === undefined) break;
        this.place = number(what, "place");
        this.expected = number(what, "expected") === undefined ? undefined : arrived + number(what, "expected")!;
        break;
      case "inhibited":
      case "uninhibited":
        this.holders = list(what, "holders").map(String);
        break;
      case "lost":
        if (text(fields(what["member"]), "peer") === this.owner) this.ownerLost = arrived + (number(what, "within") ?? 0);
        break;
      case "resumed":
        if (text(fields(what["member"]), "peer") === this.owner) this.ownerLost = undefined;
        break;
      case "rejoined":
        void this.refresh();
        break;
    }
  }

  async #try<T>(what: string, action: () => Promise<T>): Promise<T | undefined> {
    this.refusal = null;
    try {
      return await action();
    } catch (error) {
      const failure = failureOf(error);
      this.refusal = { what, failure };
      this.hub.note("error", failure.text, failure);
      return undefined;
    }
  }

  async grab(): Promise<void> {
    await this.#try("grab", () => this.hub.call("grab", this.path));
  }

  /** Waits in the queue until it is this page's turn, or until it leaves. */
  async wait(): Promise<void> {
    this.place = 0;
    await this.#try("wait", async () => {
      try {
        await this.hub.call("grab", this.path, "unlimited");
        this.hub.note("info", t.turn(this.path));
      } catch (error) {
        if (failureOf(error).code !== "withdrawn") throw error;
      }
    });
    [this.place, this.expected] = [undefined, undefined];
  }

  async withdraw(): Promise<void> {
    await this.#try("withdraw", () => this.hub.call("withdraw", this.path));
  }

  /** Asks the owner for it. */
  async request(text?: string): Promise<void> {
    this.asking = true;
    await this.#try("request", async () => {
      await this.hub.call("request", this.path, text);
      this.hub.note("info", t.granted(this.path));
    });
    this.asking = false;
  }

  async release(): Promise<void> {
    await this.#try("release", () => this.hub.call("release", this.path));
  }

  async give(to: string, terms: { for?: number; commands?: number }): Promise<void> {
    await this.#try("give", async () => {
      await this.hub.call("give", this.path, to, terms);
      this.offered = to;
    });
  }

  async accept(): Promise<void> {
    await this.#try("accept", () => this.hub.call("accept", this.path));
    this.tokens.over(this.path, this.offer?.by);
  }

  async decline(): Promise<void> {
    await this.#try("decline", () => this.hub.call("decline", this.path));
    this.tokens.over(this.path, this.offer?.by);
  }

  async answer(peer: string, yes: boolean): Promise<void> {
    await this.#try(yes ? "accept" : "decline", () => (yes ? this.hub.call("acceptRequest", this.path, peer) : this.hub.call("declineRequest", this.path, peer)));
    this.tokens.over(this.path, peer);
  }
}

/** Losses for one reason are told together that come within so many ms. */
const TOGETHER = 100;

/** All tokens that a page shows or owns: what is asked of it and offered to it, wherever in the page that is looked at. */
export class Tokens {
  asked = $state.raw<readonly Asked[]>([]);
  offers = $state.raw<readonly Offer[]>([]);
  readonly #all = new Map<string, TokenState>();
  /** By reason and by whom. */
  readonly #losses = new Map<string, string[]>();

  constructor(readonly hub: Hub) {
    hub.onAsked((event) => this.#hear(event));
    hub.onOwned((path, owned, reason, by) => this.#own(path, owned !== null, reason, by));
  }

  of(path: string): TokenState {
    let found = this.#all.get(path);
    if (!found) this.#all.set(path, (found = new TokenState(this.hub, path, this)));
    return found;
  }

  #hear({ type, path, what, arrived }: Happening): void {
    const me = this.hub.me?.peer;
    const until = arrived + (number(what, "within") ?? 0);
    if (type === "requested") {
      const asked = { path, peer: text(what, "peer") ?? "", user: text(what, "user") ?? "", level: number(what, "level") ?? 0, until, text: text(what, "text") };
      // Who asks hears of it as well.
      if (asked.peer === me) return;
      this.over(path, asked.peer);
      this.asked = [...this.asked, asked];
      this.hub.note("warning", t.askedFor(path, asked.peer, asked.text && visible(asked.text)));
    } else if (type === "offer") {
      if (text(what, "to") !== me) return;
      const offer = { path, by: text(what, "by") ?? "", until, for: number(what, "for"), commands: number(what, "commands") };
      this.over(path, offer.by);
      this.offers = [...this.offers, offer];
      this.hub.note("warning", t.offeredTo(path, offer.by, t.terms(offer.for, offer.commands)));
    } else if (type === "lapsed") {
      const [by, to, reason] = [text(what, "by"), text(what, "to"), text(what, "reason") ?? ""];
      const offer = text(what, "what") === "offer";
      // What this page has refused itself is not reported to it.
      const ours = offer ? this.offers.some((each) => each.path === path && each.by === by) : this.asked.some((each) => each.path === path && each.peer === by);
      this.over(path, by);
      if (offer && by === me) this.of(path).offered = null;
      if (offer && by === me) this.hub.note("info", t.offerOver(path, to ?? "", t.lapses[reason] ?? reason));
      else if (ours && reason !== "declined" && reason !== "lost") this.hub.note("info", t.over(path, by ?? "", offer, t.lapses[reason] ?? reason));
    } else if (type === "notice") this.hub.note("warning", t.ends(path, number(what, "within") ?? 0, number(what, "waiting") ?? 0));
  }

  /** Nobody asks or offers this any more. */
  over(path: string, peer: string | undefined): void {
    this.asked = this.asked.filter((asked) => asked.path !== path || asked.peer !== peer);
    this.offers = this.offers.filter((offer) => offer.path !== path || offer.by !== peer);
  }

  #own(path: string, owned: boolean, reason: string | undefined, by: string | undefined): void {
    // What was asked of this page ends with its ownership, and what was offered to it with the ownership of another.
    if (!owned) this.asked = this.asked.filter((asked) => asked.path !== path);
    if (owned) this.offers = this.offers.filter((offer) => offer.path !== path);
    const token = this.of(path);
    token.offered = null;
    token.lost = owned || reason === "released" ? null : t.lost(path, reason, by);
    if (token.lost === null) return;
    const key = JSON.stringify([reason, by]);
    const together = this.#losses.get(key);
    if (together) return void together.push(path);
    const paths = [path];
    this.#losses.set(key, paths);
    setTimeout(() => {
      this.#losses.delete(key);
      this.hub.note(reason === "given" ? "info" : "warning", t.lost(t.first(paths[0]!, paths.length), reason, by));
    }, TOGETHER);
  }
}

const all = new WeakMap<Hub, Tokens>();

export function tokensOf(hub: Hub): Tokens {
  let found = all.get(hub);
  if (!found) all.set(hub, (found = new Tokens(hub)));
  return found;
}

/** The one state of a token that all of a page share. */
export const tokenOf = (hub: Hub, path: string): TokenState => tokensOf(hub).of(path);
