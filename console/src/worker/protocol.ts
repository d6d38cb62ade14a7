// What page and worker say to each other.
import type { ContextInfo, ContextKind, Member, Report } from "mom-client";
import type { Rest } from "./rest.js";

/** Content that can be cloned: a time is a `Date`, a whole double a number. */
export type Plain = null | boolean | number | bigint | string | Date | Uint8Array | Plain[] | { [key: string]: Plain };
export type PlainFields = { [key: string]: Plain };

/** Why something failed, as the hub says it. */
export interface Failure {
  kind: string;
  code: string;
  text: string;
  rule?: string | undefined;
  owner?: string | undefined;
  retryAfter?: number | undefined;
  /** What to do, where that was said. */
  hint?: string | undefined;
  content: PlainFields;
}

/** What ends a peer that an earlier page has left behind. */
export interface Previous {
  id: string;
  secret: Uint8Array;
}

/** How to log in. `address` is one of mom-client, or several with blanks between them. */
export interface Login {
  address: string;
  user?: string | undefined;
  password?: string | undefined;
  key?: CryptoKey | undefined;
  guest?: boolean | undefined;
  /** A JWT of an issuer that the hub trusts. */
  token?: string | undefined;
  previous?: Previous | undefined;
}

/** Who is logged in. */
export interface Me {
  peer: string;
  user: string;
  level: number;
  groups: string[];
  link: Previous | null;
}

/** The state of the link, and what is measured of it. Times are ms. */
export interface Link {
  state: "out" | "trying" | "connected" | "stale" | "resuming" | "closed";
  door?: string | undefined;
  attempt?: number | undefined;
  error?: Failure | undefined;
  roundTrip?: number | undefined;
  /** How far the hub's clock is ahead of this one, and the error of that. */
  offset?: number | undefined;
  offsetError?: number | undefined;
}

/** A message. */
export interface Message {
  type: "message";
  name: string;
  sender: string;
  content: Plain | undefined;
  /** When its sender made it, by the sender's notion of the time, ms since 1970. */
  said: number | undefined;
  /** Whether content was left out because it is large. */
  cut: boolean;
  id: number | undefined;
  reference: number | undefined;
  /** Whether it was said before this watch began. */
  history: boolean;
  fence: number | undefined;
  /** Bytes of binary content. */
  size: number;
  /** When it was made, by this machine's clock, ms since 1970, and the error of that; undefined if it is not known. */
  born: number | undefined;
  error: number | undefined;
  /** By this machine's clock, ms since 1970. */
  arrived: number;
}

/** Anything else that happened in a context; `what` has the members of docs/PROTOCOL.md. A refusal of what was sent has a `failure`. */
export interface Happening {
  type: string;
  path: string;
  what: PlainFields;
  failure?: Failure | undefined;
  arrived: number;
}

export type HubEvent = Message | Happening;

/** An image, decoded. */
export interface Picture {
  bitmap: ImageBitmap;
  /** What the message says beside the bytes. */
  content: PlainFields;
  sender: string;
  size: number;
  born: number | undefined;
  error: number | undefined;
  arrived: number;
  /** Images since the last one that were not shown. */
  skipped: number;
  /** The watch that it is for. */
  watch: number;
}

/** What is watched, and how. */
export interface Watch {
  path: string;
  kind: ContextKind;
  /** Messages of these names only. */
  names?: string[] | undefined;
  /** Only the newest of each sender and name, so often at most. */
  rate?: string | undefined;
  newest?: boolean | undefined;
  /** At most so many messages a second go to the page, after a first burst; 200 at once, 20 times a second, if absent. */
  most?: number | undefined;
  /** Of each sender and name only the newest goes to the page, and not oftener than once in so many ms; for channels with many names, of which none is left out. */
  every?: number | undefined;
  /** Messages of these `names` answer what the page asked: they may be as large as answers of the hub. */
  answers?: boolean | undefined;
  /** Its messages tell how something is now: where some may be lost they are asked for again. */
  state?: boolean | undefined;
  /** Messages `image` are decoded, the newest when the page has shown the one before, at most so many pixels wide. */
  pictures?: number | undefined;
}

/** What became of a stop at one device. */
export interface StopAnswer {
  path: string;
  device: string;
  /** What is known of it: it says that it obeys, it has not said so in time, or its connection is lost. */
  word?: "obeys" | "silent" | "lost" | undefined;
  /** ms from the order until this page knew that it obeys. */
  after?: number | undefined;
  /** Of one that was stopped: what is known of its rest. */
  rest?: Rest | undefined;
  /** ms from the order until this page knew that it rests, or, as long as it does not, until it was last told so. */
  told?: number | undefined;
  /** Since when it is not reached, where it has said so, ms since 1970. */
  since?: number | undefined;
}

/** A stop that holds in a channel: who said it, when (ms since 1970), why, and for which devices if not for all. */
export interface StandingStop {
  path: string;
  number: number;
  by?: string | undefined;
  user?: string | undefined;
  since?: number | undefined;
  reason?: string | undefined;
  only: string[];
}

/** What an order says beside its place. */
export interface StopTerms {
  /** Why, of a stop. */
  reason?: string | undefined;
  /** Of an unstop: the newest stops that the page has shown, by channel. */
  stops?: { [path: string]: number } | undefined;
  /** For how many ms the hub waits for the devices' word. */
  within?: number | undefined;
}

export type Order = "stop" | "unstop";

/** How far an order to all devices of a place is. */
export interface StopReport {
  order: Order;
  top: string;
  /** When it was given, ms since 1970. */
  at: number;
  devices: StopAnswer[];
  /** Places to which it could not be said. */
  refused: { path: string; failure: Failure }[];
  /** Stops that the page had not seen when it let go, and that hold on. */
  newer: StandingStop[];
  /** Channels that a token guards, and that have no device. */
  empty: string[];
  /** Channels that this user may not stop. */
  denied: string[];
  /** Whether nothing more is to be expected. */
  over: boolean;
  /** Whether a hub has taken it. */
  taken: boolean;
  /** Whether the link has not taken it in time. */
  missed: boolean;
  /** Ways that are tried because of that. */
  trying: string[];
}

/**
 * Ids of messages that the page wants to know; those of the client itself are far below. A page that is loaded anew may get the name
 * of the one before, and what devices say of that one's messages must not be taken for its own. Even ones are the worker's, odd ones the
 * page's.
 */
export const firstId = (): number => Date.now() * 1024;

/** What a message says beside its content, by the names of mom-client. */
export interface SendOptions {
  /** Where the page wants to know it before the receipt. */
  id?: number;
  to?: string[];
  priority?: number;
  expires?: number;
  echo?: boolean;
  fence?: number;
  basedOn?: number;
  /** Of an `unstop`: the newest stop that the page has shown. */
  stop?: number;
}

/** A token that this peer owns. Times are ms since 1970 by this machine's clock. */
export interface Owned {
  path: string;
  fence: number;
  lease: number | null;
  from?: string | undefined;
  until?: number | undefined;
  commands?: number | undefined;
}

/** A hand that moves as long as it is told to: mm/s and degrees/s. */
export interface Jog {
  path: string;
  velocity: [number, number, number, number, number];
  fence: number;
}

/** What the page may ask of the worker. */
export interface Calls {
  connect(login: Login): Me;
  close(): void;
  watch(id: number, watch: Watch): void;
  unwatch(id: number): void;
  /** The page has shown the image of this watch. */
  shown(id: number): void;
  /** The file of the image that was decoded last for this watch. */
  pictureFile(id: number): { bytes: Uint8Array; type: string } | null;
  /** Sends a message and waits until each receiver's queue has taken it; gives its id. */
  send(path: string, name: string, content: Plain | undefined, options?: SendOptions): { id: number; delivered: number; dropped: string[] };
  /** Moves a hand at this velocity until told otherwise, or until the page has not said so again for 250 ms; null lets it rest. */
  jog(jog: Jog | null): void;
  stop(order: Order, top: string, terms: StopTerms): void;
  /** The same for one channel, without a report. */
  stopOne(order: Order, path: string, terms: StopTerms): void;
  /** The stops that hold in these channels by the hub's word; nothing of those of which it says none. */
  stopsOf(paths: string[]): StandingStop[];
  /** Any other request of docs/PROTOCOL.md; gives the content of its answer. */
  ask(family: "context" | "token", name: string, path: string, content?: PlainFields): PlainFields;
  /** What the device of a channel says that it can do, of docs/PROTOCOL.md; null if it says nothing, or the hub knows no cards. */
  card(path: string): PlainFields | null;
  /** Makes a context; joins its parent. */
  create(path: string, spec: PlainFields): void;
  list(path: string): ContextInfo[];
  members(path: string): Member[];
  grab(path: string, wait?: number | "unlimited"): Owned;
  /** Leaves the queue. */
  withdraw(path: string): void;
  request(path: string, text?: string): Owned;
  accept(path: string): Owned;
  decline(path: string): void;
  acceptRequest(path: string, peer: string): void;
  declineRequest(path: string, peer: string, text?: string): void;
  give(path: string, to: string, options: { for?: number; commands?: number }): void;
  release(path: string): void;
  breakHold(path: string): string[];
  /** Reports an error of the page to the hub at an address, without a login; whether the hub has taken it. */
  report(address: string, report: Report): boolean;
}

export type CallName = keyof Calls;

/** From the page to the worker. */
export interface Question {
  id: number;
  call: CallName;
  args: unknown[];
}

/** From the worker to the page. */
export type Word =
  | { word: "answer"; id: number; value: unknown }
  | { word: "failure"; id: number; failure: Failure }
  | { word: "link"; link: Link }
  | { word: "me"; me: Me }
  /** `skipped`: so many messages before these were left out, because more came than can be read. */
  | { word: "events"; watch: number; events: HubEvent[]; skipped: number }
  | { word: "picture"; watch: number; picture: Picture }
  /** An image that is not shown, and why. */
  | { word: "unshown"; watch: number; size: number; sender: string; why: "too-large" | "not-readable" }
  | { word: "joined"; watch: number; info: PlainFields }
  | { word: "failed"; watch: number; failure: Failure }
  | { word: "owned"; path: string; owned: Owned | null; reason?: string | undefined; by?: string | undefined }
  /** What a peer wants of this page: `requested`, `offer`, `lapsed`, `notice` of a token, or `expelled`. */
  | { word: "asked"; event: Happening }
  | { word: "stop"; report: StopReport }
  /** All stops that hold, as far as they are known. */
  | { word: "stops"; stops: StandingStop[] }
  /** What went wrong in a channel that is watched: of a device or with the command of a `peer`, or with what this page has said without waiting. */
  | { word: "trouble"; path: string; peer?: string | undefined; failure: Failure }
  /** What a jog came to that did not end by the page's word. */
  | { word: "jog-ended"; path: string; failure: Failure };
