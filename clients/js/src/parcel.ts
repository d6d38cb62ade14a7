import type { Time, Value } from "./value.js";
import type { MomError } from "./error.js";

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
