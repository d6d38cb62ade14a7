// The stops that hold, as far as this page knows of them: who stopped what, and why.
import { type Client, type ContextInfo, type Event, type StopState, MomError, fieldsOf } from "mom-client";
import type { Say } from "./port.js";
import type { StandingStop } from "./protocol.js";

/** Contexts are looked for anew so often, in ms: nobody tells who is not in a channel of its stops. */
const WALK = 20_000;
/** What changes at once is told together, in ms. */
const TOGETHER = 30;

/** What an event says of its channel's stops; undefined if that is not enough to know how it stands now. */
function stateOf(event: Event): StopState | null | undefined {
  if (event.type === "stops") return event.state;
  if (event.type !== "message" || event.history || event.stop === undefined) return null;
  const { name, sender, content, parcel, stop: number } = event;
  if (name === "unstop") return parcel.address ? undefined : { number, stopped: false, only: [] };
  if (name !== "stop") return null;
  const { by, reason } = typeof content === "string" ? { by: undefined, reason: content } : fieldsOf(content);
  const state: StopState = { number, stopped: true, by: typeof by === "string" ? by : sender, only: parcel.address ?? [] };
  if (typeof reason === "string") state.reason = reason;
  if (parcel.timestamp) state.since = parcel.timestamp;
  return state;
}

const standingStop = (path: string, { number, by, user, reason, since, only }: StopState): StandingStop => ({ path, number, by, user, reason, since: since?.toDate().getTime(), only });

export class Standing {
  readonly #stops = new Map<string, StopState>();
  #client: Client | null = null;
  #walker: ReturnType<typeof setInterval> | undefined;
  #walking = false;
  #again = false;
  #telling: ReturnType<typeof setTimeout> | undefined;

  constructor(
    readonly say: Say,
    readonly isUp: () => boolean,
  ) {}

  /** There is a new peer: what holds is asked for anew. */
  reset(client: Client): void {
    this.#client = client;
    this.#stops.clear();
    this.#changed();
    clearInterval(this.#walker);
    this.#walker = setInterval(() => this.look(), WALK);
    void this.#hear(client);
    this.look();
  }

  /** There is no peer any more, whom anything could be asked of or told. */
  end(): void {
    this.#client = null;
    clearInterval(this.#walker);
  }

  /** What is told of channels that this page watches only by their tokens. */
  async #hear(client: Client): Promise<void> {
    for await (const event of client.unaddressed()) if (client === this.#client && event.type === "stops") this.heard(event.path, event);
  }

  /** Takes in an event of a channel. */
  heard(path: string, event: Event): void {
    const state = stateOf(event);
    if (state === undefined) this.look();
    else if (state) this.learn(path, state);
  }

  /** The newest word counts, whichever way it came: numbers only rise. */
  learn(path: string, state: StopState): void {
    const known = this.#stops.get(path);
    if (known && known.number > state.number) return;
    // The same stop may be told again with less.
    if (state.stopped) this.#stops.set(path, { ...(known?.number === state.number ? known : {}), ...state });
    else if (!this.#stops.delete(path)) return;
    this.#changed();
  }

  #changed(): void {
    this.#telling ??= setTimeout(() => {
      this.#telling = undefined;
      const stops = [...this.#stops].map(([path, state]) => standingStop(path, state));
      this.say({ word: "stops", stops: stops.sort((one, other) => one.path.localeCompare(other.path)) });
    }, TOGETHER);
  }

  /** The stops that hold in these channels, by the hub's word now; nothing of those of which it says none. */
  async ask(paths: readonly string[]): Promise<StandingStop[]> {
    const client = this.#client;
    if (!client) throw new MomError("local", "not-logged-in", "log in first");
    const asked = paths.map(async (path) => {
      const state = await client.stops(path);
      this.learn(path, state);
      return state.stopped ? [standingStop(path, state)] : [];
    });
    return (await Promise.allSettled(asked)).flatMap((answer) => (answer.status === "fulfilled" ? answer.value : []));
  }

  /** Asks the hub which channels are stopped. */
  look(): void {
    this.#again = true;
    if (this.#walking || !this.#client || !this.isUp()) return;
    const client = this.#client;
    this.#walking = true;
    this.#again = false;
    void this.#walk(client)
      .catch(() => undefined)
      .then(() => {
        this.#walking = false;
        if (this.#again) this.look();
      });
  }

  async #walk(client: Client): Promise<void> {
    const before = new Map(this.#stops);
    const unseen: string[] = [];
    const found = new Map<string, StopState>();
    const waiting: Pick<ContextInfo, "path" | "kind">[] = [{ path: "/", kind: "session" }];
    for (let context = waiting.pop(); context; context = waiting.pop()) {
      const children = await client.list(context.path).catch(() => (unseen.push(context!.path), []));
      for (const child of children) {
        if (child.stop?.stopped) found.set(child.path, child.stop);
        if (child.kind === "session") waiting.push(child);
      }
    }
    if (client !== this.#client) return;
    for (const [path, state] of found) this.learn(path, state);
    // What is not listed as stopped any more, unless it was heard of meanwhile.
    for (const [path, state] of before) {
      if (found.has(path) || this.#stops.get(path) !== state || unseen.some((top) => top === "/" || path.startsWith(`${top}/`))) continue;
      this.#stops.delete(path);
      this.#changed();
    }
  }
}
