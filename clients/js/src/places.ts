// The contexts that this peer wants to be in.
import type { Installation } from "./installation.js";
import { Latch } from "./latch.js";
import { type Fields, type Value, fieldsOf, int, list, text } from "./value.js";
import type { Delivery, Parcel } from "./parcel.js";

/** The token that guards a channel, as far as is known. */
export interface GuardState {
  token: string;
  /** The names of messages that only the owner may send; `*` is all. */
  names: string[];
  /** The present fence. */
  fence: number;
  owner?: string;
}

/** One of them. */
export interface Place {
  readonly path: string;
  /** What its join asks for. */
  terms: Fields | undefined;
  /** The reply of the hub, or why there is none. */
  joined: Promise<Fields>;
  kind: string;
  delivery: Delivery;
  guard: GuardState | null;
  /** What a device has heard of stops, for when it joins again. */
  readonly latch: Latch;
}

/** What a reply to a join, or the hub's `halt`, says of the token that guards the channel; what was known before if it does not speak of that. */
export function guardOf(told: Value | undefined, before: GuardState | null = null): GuardState | null {
  const fields = fieldsOf(told);
  if (!fields["guard"]) return before;
  const guard = fieldsOf(fields["guard"]);
  const [token, owner] = [text(guard, "token"), text(guard, "owner")];
  return token === undefined ? null : { token, names: list(guard, "names").map(String), fence: int(guard, "fence") ?? 0, ...(owner === undefined ? {} : { owner }) };
}

/** Whether this guard needs its token for messages of that name; to stop and to free a device needs none. */
function covers({ names }: GuardState, name: string): boolean {
  return name !== "stop" && name !== "unstop" && (names.includes("*") || names.includes(name));
}

/** Whether a device may obey a message: it needs no token, has the present owner's fence, or is the safe state that the hub itself sends. */
export function permits(guard: GuardState | null, { sender, name, fence }: Parcel): boolean {
  return !guard || sender === "hub" || !covers(guard, name) || (guard.owner !== undefined && fence === guard.fence);
}

/** Whether a path is this context or below it. */
export function isWithin(path: string, top: string): boolean {
  return top === "/" || path === top || path.startsWith(`${top}/`);
}

/** The path and those above it, the uppermost first, without the root. */
export function wayTo(path: string): string[] {
  const segments = path.split("/").slice(1);
  return path === "/" ? [] : segments.map((_, place) => `/${segments.slice(0, place + 1).join("/")}`);
}

export class Places {
  /** Which device this is, where it is one. */
  installation: Installation | undefined;
  /** What the devices that this peer is can do, by their channels. */
  readonly cards = new Map<string, Fields>();
  /** Whether the hub takes cards: one of an earlier version refuses what it does not know. */
  takesCards = false;

  readonly #all = new Map<string, Place>();
  /** What was heard of stops, also in channels that are gone: a hub that began anew without one knows no stop there. */
  readonly #latches: Record<string, Latch> = {};

  get(path: string): Place | undefined {
    return this.#all.get(path);
  }

  /** Parents come first, since they were entered first. */
  all(): Place[] {
    return [...this.#all.values()];
  }

  add(path: string, terms: Fields | undefined): Place {
    const place: Place = { path, terms, joined: Promise.resolve({}), kind: "", delivery: "reliable", guard: null, latch: (this.#latches[path] ??= new Latch()) };
    this.#all.set(path, place);
    return place;
  }

  /** Takes what the hub says to a join. */
  joined(place: Place, reply: Fields): void {
    place.kind = text(reply, "kind") ?? "";
    place.delivery = (text(reply, "delivery") ?? "reliable") as Delivery;
    place.guard = guardOf(reply);
  }

  remove(place: Place): void {
    if (this.#all.get(place.path) === place) this.#all.delete(place.path);
  }

  removeWithin(top: string): void {
    for (const path of [...this.#all.keys()]) if (isWithin(path, top)) this.#all.delete(path);
  }

  /** The channels that a token guards. */
  guardedBy(token: string): Place[] {
    return this.all().filter((place) => place.guard?.token === token);
  }

  /** What is said when a context is joined on these terms. */
  said(terms: Fields, { path, latch }: Place): Fields {
    const card = this.cards.get(path);
    return terms["device"] === true ? { ...terms, device: { ...latch.word(), ...this.installation, ...(this.takesCards && card ? { card } : {}) } } : terms;
  }

  /** The token that guards messages of this name there. */
  tokenOf(path: string | undefined, name: string): string | undefined {
    const guard = this.#all.get(path ?? "")?.guard;
    return guard && covers(guard, name) ? guard.token : undefined;
  }
}
