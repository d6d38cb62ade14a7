// The peer at the hub: its login, its link and the tokens that it owns.
import { Key, type Client, type LinkState, MomError, type Proof, type TokenGuard, connect, endPeer } from "mom-client";
import { failure } from "./plain.js";
import type { Say } from "./port.js";
import type { Link, Login, Me, Owned } from "./protocol.js";

/** A page that is gone keeps its name for so long, in ms; one that is loaded anew ends its earlier peer itself. */
const GRACE = 20_000;
/** A dead connection is noticed after three of these. */
const HEARTBEAT = 1000;
const REPORT = 1000;

function groupsOf(client: Client): string[] {
  const { groups } = client.welcome;
  return Array.isArray(groups) ? groups.map(String) : [];
}

function meOf(client: Client): Me {
  return { peer: client.name, user: client.user, level: client.level, groups: groupsOf(client), link: client.credential };
}

/** How a login proves who it is. */
export function proofOf({ user, password, key, guest, token }: Login): Proof & { user?: string } {
  return { ...(user === undefined ? {} : { user }), ...(password === undefined ? {} : { password }), ...(key ? { key: Key.of(key) } : {}), ...(guest ? { guest } : {}), ...(token === undefined ? {} : { token }) };
}

export class Session {
  #client: Client | null = null;
  #login: Login | null = null;
  #state: LinkState | null = null;
  #reporter: ReturnType<typeof setInterval> | undefined;
  readonly #owned = new Map<string, TokenGuard>();
  #giveUp: AbortController | null = null;

  constructor(
    readonly say: Say,
    /** Called when there is a new peer. */
    readonly onClient: (client: Client) => void,
    /** Called when a link that was lost goes on: what was under way to this page may be gone. */
    readonly onResumed: () => void,
  ) {}

  get client(): Client {
    if (!this.#client) throw new MomError("local", "not-logged-in", "log in first");
    return this.#client;
  }

  /** How the page has logged in, for ways around a link that is down. */
  get login(): Login | null {
    return this.#login;
  }

  get isUp(): boolean {
    return this.#state?.state === "connected";
  }

  async connect(login: Login): Promise<Me> {
    await this.close();
    const giveUp = new AbortController();
    this.#giveUp = giveUp;
    // The name is free then, and nobody is asked to wait for the tokens of a page that is gone.
    if (login.previous) await endPeer(login.address, login.previous).catch(() => undefined);
    const client = await connect(login.address, {
      ...proofOf(login),
      link: { grace: GRACE },
      heartbeat: HEARTBEAT,
      connectWithin: 15_000,
      signal: giveUp.signal,
      onState: (state) => this.#heard(state),
    });
    [this.#client, this.#login] = [client, login];
    this.#reporter = setInterval(() => this.#report(), REPORT);
    this.onClient(client);
    this.#report();
    return meOf(client);
  }

  async close(): Promise<void> {
    clearInterval(this.#reporter);
    this.#giveUp?.abort();
    const client = this.#client;
    this.#client = null;
    this.#login = null;
    this.#owned.clear();
    await client?.close();
    this.#state = null;
    this.say({ word: "link", link: { state: "out" } });
  }

  #heard(state: LinkState): void {
    const before = this.#state?.state;
    this.#state = state;
    this.#report();
    if (state.state === "connected" && state.resumed) this.onResumed();
    // A new login may have given another name and another link.
    if (state.state === "connected" && before !== "stale" && this.#client) this.say({ word: "me", me: meOf(this.#client) });
  }

  #report(): void {
    const state = this.#state;
    if (!state) return;
    const link: Link = { state: state.state };
    if (state.state === "connected") link.door = state.door;
    if ("attempt" in state) link.attempt = state.attempt;
    if ("error" in state && state.error) link.error = failure(state.error);
    const clock = this.#client?.clock;
    const offset = clock?.offset;
    if (clock?.roundTrip !== undefined) link.roundTrip = clock.roundTrip / 1000;
    if (offset) [link.offset, link.offsetError] = [offset.micros / 1000, offset.error / 1000];
    this.say({ word: "link", link });
  }

  /** Keeps a token that was granted, and tells the page of it until it is lost. */
  own(guard: TokenGuard): Owned {
    this.#owned.set(guard.path, guard);
    const { path, fence, lease, delegation } = guard;
    const owned: Owned = { path, fence, lease };
    if (delegation) {
      owned.from = delegation.from;
      if (delegation.time !== undefined) owned.until = Date.now() + delegation.time;
      if (delegation.commands !== undefined) owned.commands = delegation.commands;
    }
    this.say({ word: "owned", path, owned });
    void guard.lost.then(({ reason, by }) => {
      if (this.#owned.get(path)?.fence !== fence) return;
      this.#owned.delete(path);
      this.say({ word: "owned", path, owned: null, reason, by });
    });
    return owned;
  }

  owned(path: string): TokenGuard {
    const guard = this.#owned.get(path);
    if (!guard) throw new MomError("local", "not-owner", `this page does not own ${path}`);
    return guard;
  }
}
