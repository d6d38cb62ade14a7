import type { Client } from "./client.js";
import { asyncDispose } from "../disposal.js";
import { MomError } from "../error.js";
import type { Event } from "../events.js";
import type { Hold, Loan, Lost } from "../guards.js";
import type { Parcel } from "../parcel.js";
import { Joined } from "./session.js";
import { type Fields, fieldsOf, int, list } from "../value.js";

/** How to grab a token. */
export interface GrabOptions {
  /** ms to wait in the queue, or `unlimited`; absent = not at all. */
  wait?: number | "unlimited";
  /** Called whenever the place in the queue changes; 1 is the next. `expected` is in ms. */
  onPlace?: (place: number, expected: number | undefined) => void;
  /** Leaves the queue. */
  signal?: AbortSignal;
}

/** How to give a token away. */
export interface GiveOptions {
  /** ms that the other may take to accept; 10 000. */
  within?: number;
  /** It returns by itself after so many ms. */
  for?: number;
  /** It returns by itself after so many guarded messages. */
  commands?: number;
}

/** A token: what one peer at a time owns. */
export class Token extends Joined {
  /**
   * Grabs it, at once or by way of the queue.
   *
   * @throws MomError `refused` with `held` (`owner`, `retryAfter`), `timed-out` after the wait, or `denied` (`rule`).
   */
  async grab(options: GrabOptions = {}): Promise<TokenGuard> {
    const { wait, onPlace, signal } = options;
    const { peer } = this.client;
    const most = wait === "unlimited" ? Infinity : (peer.options.requestTimeout ?? 40_000) + (wait ?? 0);
    let waits = true;
    const withdraw = (): void => void this.#withdraw(() => waits);
    signal?.throwIfAborted();
    signal?.addEventListener("abort", withdraw, { once: true });
    if (onPlace) peer.onQueued.set(this.path, onPlace);
    try {
      return await this.#obtain("grab", wait === undefined ? {} : { wait }, most);
    } finally {
      waits = false;
      signal?.removeEventListener("abort", withdraw);
      peer.onQueued.delete(this.path);
    }
  }

  /** Asks its owner to hand it over, and waits for the answer; a free token is granted at once. */
  request(options: { within?: number; text?: string } = {}): Promise<TokenGuard> {
    return this.#obtain("request", { ...options }, (this.client.peer.options.requestTimeout ?? 40_000) + (options.within ?? 30_000));
  }

  /** Accepts the owner's offer. */
  accept(): Promise<TokenGuard> {
    return this.#obtain("accept", {});
  }

  /** Declines an offer. */
  async decline(): Promise<void> {
    await this.#ask("decline");
  }

  /** Hands it over to a peer that has asked for it; the owner's guard is lost with the reason `given`. */
  async acceptRequest(peer: string): Promise<void> {
    await this.#ask("accept", { peer });
  }

  /** Declines a peer's request. */
  async declineRequest(peer: string, text?: string): Promise<void> {
    await this.#ask("decline", { peer, text });
  }

  /** Takes it away from its owner, or ends all parts in its shared hold; gives the peers that had it. */
  async breakHold(): Promise<string[]> {
    const had = await this.#ask("break");
    return [...list(had, "holders").map(String), ...(typeof had["owner"] === "string" ? [had["owner"]] : [])];
  }

  /** Joins its shared hold: nobody can own it meanwhile. */
  async inhibit(): Promise<InhibitGuard> {
    await this.#ask("inhibit");
    return new InhibitGuard(this.client, this.client.peer.guards.shares(this.path));
  }

  /** Leaves the queue. There is no fence yet, so a lost connection drops that, and it is said again as long as the grab waits. */
  async #withdraw(waits: () => boolean): Promise<void> {
    for await (const { state } of this.client.peer.states()) {
      if (!waits()) return;
      if (state !== "connected" && state !== "stale") continue;
      const error: unknown = await this.#ask("release").catch((error: unknown) => error);
      if (!(error instanceof MomError) || (error.code !== "lost" && error.code !== "unknown")) return;
    }
  }

  #ask(name: string, content?: Fields): Promise<Fields> {
    return this.client.ask("token", name, this.path, content);
  }

  async #obtain(name: string, content: Fields, timeout?: number): Promise<TokenGuard> {
    const { peer } = this.client;
    const parcel: Parcel = { family: "token", name, context: this.path };
    if (Object.keys(content).length) parcel.content = content;
    // What is granted when nobody waits for it any more is not kept.
    const late = (reply: Parcel): void => {
      const fence = int(fieldsOf(reply.content), "fence");
      void peer.request({ family: "token", name: "release", context: this.path, ...(fence === undefined ? {} : { fence }) }).catch(() => undefined);
    };
    const reply = await peer.request(parcel, timeout, late);
    return new TokenGuard(this.client, peer.guards.granted(this.path, fieldsOf(reply.content)));
  }
}

/** What is held, until it is given up or lost. */
abstract class Guard {
  /** @internal */
  constructor(
    readonly client: Client,
    /** @internal */
    readonly hold: Hold,
  ) {}

  /** The token. */
  get path(): string {
    return this.hold.path;
  }

  /** Why it is over, or null while it is not. */
  get isLost(): Lost | null {
    return this.hold.is;
  }

  /** Fulfilled when it is over. */
  get lost(): Promise<Lost> {
    return this.hold.lost;
  }

  /** Gives it up, after all messages that were sent before; does nothing if it is lost already. */
  abstract release(): Promise<void>;

  /** The same, for `await using`. */
  async [asyncDispose](): Promise<void> {
    await this.release();
  }
}

/**
 * Exclusive control of what a token guards. It renews at a third of its lease, or of its deadman time if that is shorter. It is lost when
 * the hub says so, when a renewal is refused, and with the link; a connection that is resumed in time keeps it.
 */
export class TokenGuard extends Guard {
  /** The fence of this ownership. */
  get fence(): number {
    return this.hold.fence;
  }

  /** ms that it lasts without a renewal; null = without end. */
  get lease(): number | null {
    return this.hold.lease;
  }

  /** ms after which it ends without a renewal; null = no such limit. */
  get deadman(): number | null {
    return this.hold.deadman;
  }

  /** The terms of the loan, if another peer gave it for a time or a number of commands. */
  get delegation(): Loan | undefined {
    return this.hold.loan;
  }

  /**
   * Offers the token to another peer. This guard owns it until that one accepts; then it is lost with the reason `given`. Events of the token
   * tell what becomes of the offer. Where it returns by itself, {@link Given.returned} gives the next guard.
   */
  async give(to: string, options: GiveOptions = {}): Promise<Given> {
    const { offers } = this.client.peer.guards;
    const given = new Given(this.client, this, to, options.for !== undefined || options.commands !== undefined);
    // The other may answer before the hub's own answer is taken here.
    offers.add(given);
    try {
      await this.client.ask("token", "give", this.path, { to, ...options });
    } catch (error) {
      offers.end(given);
      throw error;
    }
    return given;
  }

  /**
   * Gives it up, after all messages that were sent before; does nothing if it is lost already. That halts the device, and what has not left
   * the hub by then does not leave it any more: `after: "done"` waits until the device has said by `status` how the last command ended, for
   * `within` ms at most.
   */
  async release({ after, within = 10_000 }: { after?: "done"; within?: number } = {}): Promise<void> {
    const late = after === "done" && !(await this.#done(within));
    await this.#release();
    if (late) throw new MomError("timed-out", "timed-out", `the outcome of the last command was not reported within ${within} ms; ${this.path} is released`);
  }

  /** Whether the last command has ended in time. */
  async #done(within: number): Promise<boolean> {
    let timer: ReturnType<typeof setTimeout> | undefined;
    const over = new Promise<boolean>((resolve) => (timer = setTimeout(() => resolve(false), within)));
    const done = Promise.race([this.hold.done(), this.lost]).then(() => true);
    const result = await Promise.race([done, over]);
    clearTimeout(timer);
    return result;
  }

  async #release(): Promise<void> {
    if (this.hold.is) return;
    await this.client.ask("token", "release", this.path).catch((error: MomError) => {
      // It has another owner by now, or none.
      if (error.code !== "older-fence") throw error;
    });
    this.client.peer.guards.released(this.path, this.fence, { reason: "released" });
  }
}

/** Ends of the other's ownership behind which the token does not come back; behind all others it does. */
const FOR_GOOD = new Set(["preempted", "broken", "deleted"]);

/** A token that was offered to another peer. */
export class Given {
  #stage: "offered" | "leaving" | "lent" | "over" = "offered";
  /** Of this peer's ownership, then of the other's. */
  #fence: number;
  #back: TokenGuard | null = null;
  #wanted: ((guard: TokenGuard | null) => void) | null = null;

  /** @internal */
  constructor(
    private readonly client: Client,
    readonly guard: TokenGuard,
    private readonly to: string,
    private readonly isLoan: boolean,
  ) {
    this.#fence = guard.fence;
  }

  get path(): string {
    return this.guard.path;
  }

  /** @internal */
  heard(event: Event, parcel: Parcel): boolean {
    const me = this.client.peer.me?.peer;
    if (event.type === "lapsed") {
      if (this.#stage === "offered" && event.what === "offer" && event.by === me && event.to === this.to) this.end();
    } else if (event.type === "released" && event.fence === this.#fence) {
      if (this.#stage === "offered" && event.reason === "given") this.#stage = "leaving";
      else if (this.#stage === "offered" || FOR_GOOD.has(event.reason)) this.end();
    } else if (event.type === "grabbed" && event.fence > this.#fence) {
      if (this.#stage === "leaving" && event.owner === this.to && this.isLoan) [this.#stage, this.#fence] = ["lent", event.fence];
      else if (this.#stage === "lent" && event.owner === me) this.#comesBack(fieldsOf(parcel.content));
      else this.end();
    }
    return this.#stage === "over";
  }

  /** @internal */
  end(): void {
    this.#stage = "over";
    this.#wanted?.(null);
  }

  /** What nobody waits for is released. */
  #comesBack(grant: Fields): void {
    this.#stage = "over";
    this.#back = new TokenGuard(this.client, this.client.peer.guards.granted(this.path, grant));
    if (this.#wanted) this.#wanted(this.#back);
    else void this.#back.release().catch(() => undefined);
  }

  /**
   * Waits until the token has returned, or `null` if it does not: it was not taken, was given for good, another peer has it, or this one hears
   * of it no more. One that returns while nobody waits is released.
   */
  returned(): Promise<TokenGuard | null> {
    if (this.#stage === "over") return Promise.resolve(this.#back);
    return new Promise((resolve) => (this.#wanted = resolve));
  }
}

/** A part in a token's shared hold: nobody can own it meanwhile. */
export class InhibitGuard extends Guard {
  async release(): Promise<void> {
    if (this.hold.is) return;
    await this.client.ask("token", "uninhibit", this.path);
    this.client.peer.guards.unshared(this.path, { reason: "released" });
  }
}
