import { type ErrorKind, MomError } from "./error.js";
import { type Time, type Value, fieldsOf, int, text } from "./value.js";

/** The first half of a parcel's class. */
export type Family = "message" | "login" | "context" | "token" | "manager" | "event" | "reply" | "error" | "time";

/** What happens to a message when a receiver is slow. */
export type Delivery = "reliable" | "latest" | "fleeting";

/** A parcel: slots with values. docs/PROTOCOL.md says what each is for. */
export interface Parcel {
  family: Family;
  name: string;
  id?: number;
  reference?: number;
  sender?: string;
  address?: string[];
  timestamp?: Time;
  priority?: number;
  context?: string;
  expires?: number;
  delivery?: Delivery;
  fence?: number;
  received?: Time;
  /** µs from creation to `received`. */
  age?: number;
  ageError?: number;
  echo?: boolean;
  receipt?: boolean;
  content?: Value;
  /** All other slots, `history` and `trace` among them. */
  extra?: { [key: string]: Value } | Map<string, Value>;
  /** The number of the context, where the hub gave one. */
  number?: number;
  /** How many bytes it had, of one that was heard. */
  size?: number;
  /** Why the content cannot be read: the hub passes on what it was given. */
  fault?: MomError;
}

/** @internal The error that the hub has said. */
export function errorOf(parcel: Parcel, kind: ErrorKind = "refused"): MomError {
  const content = fieldsOf(parcel.content);
  const said = text(content, "text") ?? "the hub gives no reason";
  return new MomError(kind, parcel.name, said, int(content, "code") ?? 299, content);
}

/** What is said of a parcel that was dropped; after a loss, what had left is never said to be unsent. */
const DROPPED: Record<string, string> = {
  lost: "the connection was lost before it had left",
  unknown: "the connection was lost when it had left, and it is unknown whether the hub has read it",
  withdrawn: "a later stop withdrew it before it had left",
};

/** @internal */
export function dropped(parcel: Parcel, reason: string, cause?: MomError): MomError {
  const why = DROPPED[reason] ?? "it was dropped";
  return new MomError("connection", reason, `${nameOf(parcel)}: ${why}${cause ? ` (${cause.text})` : ""}`, 305);
}

/** @internal A parcel, as people are told of it. */
export function nameOf({ family, name, context }: Parcel): string {
  return `${family} ${name}${context === undefined ? "" : ` ${context}`}`;
}
