import type { MomError } from "./error.js";
import type { Parcel } from "./parcel.js";
import { Queue } from "./queue.js";
import { type StopState, stopSlot, stopStateOf } from "./stops.js";
import { type Fields, type Value, fieldsOf, int, list, text } from "./value.js";

/** The kind of a context. */
export type ContextKind = "session" | "channel" | "token";

/** A member of a context. */
export interface Member {
  peer: string;
  user: string;
  level: number;
  /** Whether it obeys `stop` there and says so. */
  device: boolean;
}

/** What is known of a context. */
export interface ContextInfo {
  path: string;
  kind: ContextKind;
  number: number;
  /** The last segment of the path, in lists. */
  name?: string;
  /** How many members it has, in lists. */
  members?: number;
  /** Who has stopped its devices, in lists and of stopped channels only. */
  stop?: StopState;
}

/** A message, as the hub forwarded it. */
export interface MessageEvent {
  type: "message";
  name: string;
  sender: string;
  content: Value | undefined;
  /** Whether it was said before this peer joined. */
  history: boolean;
  /** The number of a `stop`, or the newest that an `unstop` lifts. */
  stop?: number;
  /** All slots. */
  parcel: Parcel;
}

/** A token has a new owner. */
export interface GrabbedEvent {
  type: "grabbed";
  path: string;
  owner: string;
  level: number;
  fence: number;
  /** ms without renewal, or null without end. */
  lease: number | null;
}

/** A token's owner lost it or gave it back; `reason` is a word of docs/PROTOCOL.md. */
export interface ReleasedEvent {
  type: "released";
  path: string;
  owner: string;
  reason: string;
  by?: string;
  fence: number;
}

/** What happened in a context or to the link. `path` is the context; durations are ms. */
export type Event =
  | MessageEvent
  | GrabbedEvent
  | ReleasedEvent
  | { type: "joined" | "left"; path: string; member: Member }
  /** Large contexts tell how many members they have instead. */
  | { type: "count"; path: string; count: number }
  | { type: "created"; path: string; kind: ContextKind; number: number; by?: string }
  | { type: "deleted"; path: string; by?: string }
  /** A peer asks the owner of a token for it: {@link Token.acceptRequest} or {@link Token.declineRequest}. */
  | { type: "requested"; path: string; peer: string; user: string; level: number; within: number; text?: string }
  /** An owner offers its token: {@link Token.accept} or {@link Token.decline}. */
  | { type: "offer"; path: string; by: string; to: string; level: number; within: number; for?: number; commands?: number }
  | { type: "lapsed"; path: string; what: string; by: string; to: string; reason: string }
  /** A grab of this peer waits; `place` is 1 for the next. */
  | { type: "queued"; path: string; place: number; expected?: number }
  | { type: "notice"; path: string; within: number; waiting: number }
  | { type: "inhibited" | "uninhibited"; path: string; peer: string; holders: string[]; reason?: string }
  | { type: "invited"; path: string; by: string; kind?: ContextKind }
  | { type: "expelled"; path: string; peer: string; by?: string; text?: string }
  /** A member has lost its connection, and may come back within so long. */
  | { type: "lost"; path: string; member: Member; within: number }
  /** A member that had lost its connection is back. */
  | { type: "resumed"; path: string; member: Member }
  /**
   * Messages were dropped on their way: at the hub, or here with `count`, `parcel` and `reason`. After a loss of the connection that is `lost`
   * for what had not left, and `unknown` where nobody can say whether the hub has read it.
   */
  | { type: "dropped"; path: string; reason: string; count: number; delivery?: string; parcel?: Parcel }
  /**
   * How the devices of this channel stand by the hub's books: when this peer joins as a device or has come back, when it joins a channel where
   * something was stopped, and where a stop began or ended without a message to this peer.
   */
  | { type: "stops"; path: string; state: StopState; unstoppedBy?: string }
  /** Something that this peer sent without awaiting an answer was refused. */
  | { type: "refused"; path: string | undefined; error: MomError; id: number | undefined }
  /** So many events were dropped here, because nobody took them in time. */
  | { type: "lagged"; count: number }
  /** The link to the hub is lost, and memberships and tokens with it. */
  | { type: "link-down" }
  /** There is a link again, and this context is joined again. */
  | { type: "rejoined" }
  /** Anything else that the hub says. */
  | { type: "other"; parcel: Parcel };

/** Events that say all by their content. */
const PLAIN = new Set(["created", "deleted", "grabbed", "released", "requested", "offer", "lapsed", "queued", "notice", "inhibited", "uninhibited", "invited", "expelled", "dropped"]);
const OF_MEMBERS = new Set(["joined", "left", "lost", "resumed"]);

/** @internal */
export function memberOf(fields: Fields): Member {
  return { peer: text(fields, "peer") ?? "", user: text(fields, "user") ?? "", level: int(fields, "level") ?? 0, device: fields["device"] === true };
}

/** @internal */
export function contextOf(fields: Fields): ContextInfo {
  const info: ContextInfo = { path: text(fields, "path") ?? "", kind: (text(fields, "kind") ?? "session") as ContextKind, number: int(fields, "number") ?? 0 };
  const [name, members] = [text(fields, "name"), int(fields, "members")];
  if (name !== undefined) info.name = name;
  if (members !== undefined) info.members = members;
  if (fields["stop"] !== undefined) info.stop = stopStateOf(fields["stop"]);
  return info;
}

/** @internal */
export function eventOf(parcel: Parcel): Event {
  const path = parcel.context ?? "/";
  if (parcel.family === "message") {
    const extra = parcel.extra instanceof Map ? parcel.extra.get("history") : parcel.extra?.["history"];
    const stop = stopSlot(parcel);
    return { type: "message", name: parcel.name, sender: parcel.sender ?? "", content: parcel.content, history: extra === true, ...(stop === undefined ? {} : { stop }), parcel };
  }
  const fields = fieldsOf(parcel.content);
  if (parcel.family !== "event") return { type: "other", parcel };
  if (OF_MEMBERS.has(parcel.name)) {
    const count = int(fields, "count");
    if (count !== undefined) return { type: "count", path, count };
    const member = memberOf(fields);
    if (parcel.name === "lost") return { type: "lost", path, member, within: int(fields, "within") ?? 0 };
    return { type: parcel.name as "joined", path, member };
  }
  if (parcel.name === "stopped" || parcel.name === "unstopped") {
    const by = text(fields, "unstopped-by");
    return { type: "stops", path, state: stopStateOf(fields), ...(by === undefined ? {} : { unstoppedBy: by }) };
  }
  if (!PLAIN.has(parcel.name)) return { type: "other", parcel };
  const event = { path, ...fields, type: parcel.name } as unknown as Event;
  if (event.type === "inhibited" || event.type === "uninhibited") event.holders = list(fields, "holders").map(String);
  if (event.type === "dropped") event.parcel = parcel;
  return event;
}

/** The events of one context, or all that no other subscription takes; for `for await`. Leaving the loop ends it. */
export type Events = Queue<Event>;

/** Kept from a join on for who has not asked yet. */
const EARLY = 4096;

/** What stops and frees devices is never dropped here, unless its sender has said the same again. */
function ofStops(event: Event): string | undefined {
  // Of states only the newest matters, but those of some devices say nothing of the others; a loss of the connection counts in its place among them.
  if (event.type === "stops") return `stops ${event.path} ${event.state.stopped} ${event.state.only.length > 0}`;
  if (event.type === "link-down") return event.type;
  if (event.type !== "message" || !/^(stop|unstop|halt)$/.test(event.name)) return undefined;
  return `${event.name} ${event.sender} ${event.parcel.context}`;
}

/** @internal Who hears what. */
export class Subscribers {
  readonly #paths = new Map<string, Set<Events>>();
  readonly #early = new Map<string, Events>();
  readonly #rest = new Set<Events>();

  constructor(
    readonly most: number,
    readonly skips: (event: Event) => boolean,
  ) {}

  #queue(most: number, ends: (queue: Events) => void): Events {
    return new Queue<Event>(most, (count) => ({ type: "lagged", count }), ends, this.skips, ofStops, (event) => (event.type === "message" ? (event.parcel.size ?? 0) : 0));
  }

  /** Keeps what comes from now on for the first subscriber, unless there is one. */
  keepEarly(path: string): void {
    if (this.#paths.has(path)) return;
    const early = this.#early.get(path) ?? this.#queue(EARLY, () => undefined);
    early.most = EARLY;
    this.#early.set(path, early);
  }

  subscribe(path: string): Events {
    const early = this.#early.get(path);
    this.#early.delete(path);
    const queue = this.#queue(this.most, () => this.#forget(path, queue));
    for (let event = early?.tryNext(); event; event = early?.tryNext()) queue.push(event);
    const known = this.#paths.get(path) ?? new Set();
    this.#paths.set(path, known.add(queue));
    return queue;
  }

  subscribeRest(): Events {
    const queue = this.#queue(this.most, () => this.#rest.delete(queue));
    this.#rest.add(queue);
    return queue;
  }

  #forget(path: string, queue: Events): void {
    const known = this.#paths.get(path);
    known?.delete(queue);
    if (known?.size === 0) this.#paths.delete(path);
  }

  /** Gives an event to the subscribers of these contexts, or else to the rest. */
  deliver(paths: readonly string[], event: Event): void {
    const queues = new Set<Events>();
    for (const path of paths) {
      for (const queue of this.#paths.get(path) ?? []) queues.add(queue);
      const early = this.#early.get(path);
      // Whom nobody asks for so long has the newest stops only.
      if (early && early.length >= EARLY) early.most = 0;
      if (early?.most) queues.add(early);
      else early?.push(event);
    }
    for (const queue of queues.size ? queues : this.#rest) queue.push(event);
  }

  deliverAll(event: Event): void {
    for (const queue of [...[...this.#paths.values()].flatMap((known) => [...known]), ...this.#early.values(), ...this.#rest]) queue.push(event);
  }

  /** Ends the subscriptions of this context and all below it. */
  closeWithin(top: string): void {
    const inside = (path: string): boolean => top === "/" || path === top || path.startsWith(`${top}/`);
    for (const path of [...this.#early.keys()].filter(inside)) this.#early.delete(path);
    for (const [path, queues] of [...this.#paths].filter(([path]) => inside(path))) {
      this.#paths.delete(path);
      for (const queue of queues) queue.close();
    }
  }

  closeAll(): void {
    this.closeWithin("/");
    for (const queue of this.#rest) queue.close();
    this.#rest.clear();
  }
}
