// A token as the page knows it: who owns it, until when, who waits, and what is asked.
import type { Failure, Happening, HubEvent, Owned, PlainFields } from "../worker/protocol.js";
import { failureOf } from "./failure.js";
import { fields, list, number, text } from "./fields.js";
import type { Hub } from "./hub.svelte.js";

/** Nobody is told of renewals, nor who waits: that is asked so often, in ms. */
const AGAIN = 5000;

export interface Waiter {
  peer: string;
  user: string;
  level: number;
}

/** Somebody asks this page for the token, which it owns. */
export interface Asked {
  peer: string;
  user: string;
  level: number;
  until: number;
  text?: string | undefined;
}

/** The owner offers it to this page. */
export interface Offer {
  by: string;
  until: number;
  for?: number | undefined;
  commands?: number | undefined;
}

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
  asked = $state.raw<readonly Asked[]>([]);
  offer = $state.raw<Offer | null>(null);
  /** The owner's connection is lost; when the hub gives it up. */
  ownerLost = $state<number | undefined>(undefined);
  /** The last refusal, and the request that was refused. */
  refusal = $state.raw<{ what: string; failure: Failure } | null>(null);
  known = $state(false);
  failure = $state.raw<Failure | null>(null);

  constructor(
    readonly hub: Hub,
    readonly path: string,
  ) {}

  get mine(): Owned | undefined {
    return this.hub.owned.get(this.path);
  }

  /** Watches it until the function that it gives is called. */
  start(): () => void {
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
        [this.ownerLost, this.offer] = [undefined, null];
        if (this.owner !== this.hub.me?.peer) this.asked = [];
        break;
      }
      case "released":
        [this.owner, this.ownerLevel, this.leaseEnds, this.ownerLost, this.offer, this.asked] = [null, undefined, undefined, undefined, null, []];
        break;
      case "queued":
        this.place = number(what, "place");
        this.expected = number(what, "expected") === undefined ? undefined : arrived + number(what, "expected")!;
        break;
      case "requested":
        if (text(what, "peer") !== this.hub.me?.peer) {
          const asked = { peer: text(what, "peer") ?? "", user: text(what, "user") ?? "", level: number(what, "level") ?? 0, until: arrived + (number(what, "within") ?? 0), text: text(what, "text") };
          this.asked = [...this.asked.filter(({ peer }) => peer !== asked.peer), asked];
        }
        break;
      case "offer":
        if (text(what, "to") === this.hub.me?.peer) this.offer = { by: text(what, "by") ?? "", until: arrived + (number(what, "within") ?? 0), for: number(what, "for"), commands: number(what, "commands") };
        break;
      case "lapsed":
        if (text(what, "what") === "offer") this.offer = null;
        this.asked = this.asked.filter(({ peer }) => peer !== text(what, "by"));
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
    await this.#try("request", () => this.hub.call("request", this.path, text));
    this.asking = false;
  }

  async release(): Promise<void> {
    await this.#try("release", () => this.hub.call("release", this.path));
  }

  async give(to: string, terms: { for?: number; commands?: number }): Promise<void> {
    await this.#try("give", () => this.hub.call("give", this.path, to, terms));
  }

  async accept(): Promise<void> {
    await this.#try("accept", () => this.hub.call("accept", this.path));
    this.offer = null;
  }

  async decline(): Promise<void> {
    await this.#try("decline", () => this.hub.call("decline", this.path));
    this.offer = null;
  }

  async answer(peer: string, yes: boolean): Promise<void> {
    await this.#try(yes ? "accept" : "decline", () => (yes ? this.hub.call("acceptRequest", this.path, peer) : this.hub.call("declineRequest", this.path, peer)));
    this.asked = this.asked.filter((asked) => asked.peer !== peer);
  }
}
