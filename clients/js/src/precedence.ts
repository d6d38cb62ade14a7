// Which parcel overtakes, replaces and outlives which: the table of docs/PROTOCOL.md, "What overtakes, replaces, outlives".
import type { Delivery, Parcel } from "./parcel.js";
import { isWithin } from "./places.js";
import { fieldsOf } from "./value.js";

/** What its sender knows of a parcel beside its slots. */
export interface Marks {
  /** The class of a message, by its own slot or its channel's. */
  delivery?: Delivery;
  /** The token that guards a message. */
  token?: string | undefined;
  /** Whether a caller waits for the answer. */
  awaited?: boolean;
}

/** Messages have their priority as their lane; all other lanes are above them. */
export const MOST_PRIORITY = 100;
export const CONTROL = 101;
/** What is sent again after a loss, and `time resent` behind it. */
export const AGAIN = 102;
export const SIGN = 103;
export const STOP = 104;

export function laneOf({ family, name, priority = 0 }: Parcel): number {
  if (family === "time") return SIGN;
  if (family === "context" && name === "stop") return STOP;
  if (family !== "message" || name === "unstop") return CONTROL;
  return name === "stop" ? STOP : Math.max(-MOST_PRIORITY, Math.min(MOST_PRIORITY, priority));
}

/** Whether it ends an ownership by consent. The answer to an offer gives nothing up, that to a request does. */
function handsOver({ family, name, content }: Parcel): boolean {
  return family === "token" && (name === "give" || name === "inhibit" || (name === "accept" && fieldsOf(content)["peer"] !== undefined));
}

/** Whether it must not be sent after a loss of the connection: the safe state has gone out, and others may have acted since. */
export function isPerishable(parcel: Parcel, token: string | undefined): boolean {
  const { family, name, fence } = parcel;
  if (family === "message") return name !== "stop" && (name === "unstop" || name === "command" || token !== undefined);
  // Without its fence it could give up a later ownership.
  if (family === "token" && name === "release") return fence === undefined;
  return family === "time" || (family === "context" && name === "unstop") || handsOver(parcel);
}

/** Which messages, said before it, leave before it does; undefined if it waits for none. */
export function waitsBehind(parcel: Parcel): ((message: { parcel: Parcel; token: string | undefined }) => boolean) | undefined {
  const { family, name, context = "/" } = parcel;
  const verb = `${family} ${name}`;
  if (verb === "message unstop") return (message) => message.parcel.context === context;
  if (verb === "token release" || handsOver(parcel)) return (message) => message.token === context;
  if (verb === "context leave" || verb === "context delete" || verb === "context unstop") return (message) => isWithin(message.parcel.context ?? "/", context);
  return verb === "login logout" ? () => true : undefined;
}

/** Whether a parcel passes another one that waits behind messages: an owner that lets go something else goes on owning its token. */
export function passes({ family, name, context }: Parcel, waiting: Parcel): boolean {
  if (family !== "token" || name !== "renew" || waiting.family === "login") return false;
  return waiting.family !== "token" || waiting.context !== context;
}

/** What a newer message shares with the one whose place it takes; undefined if it takes no place. */
export function keyOf({ family, name, context, address }: Parcel, delivery: Delivery): string | undefined {
  if (family !== "message" || (name !== "stop" && name !== "unstop" && delivery !== "latest")) return undefined;
  return JSON.stringify([context, name, address && [...new Set(address)].sort()]);
}

/** Whether this stop withdraws what waits: what frees a device that it stops. With requests nothing is: an unstop lifts nothing newer than it names. */
export function withdraws(stop: Parcel, { family, name, context, address }: Parcel): boolean {
  if (stop.family !== "message" || family !== "message" || name !== "unstop" || context !== stop.context) return false;
  return !address || !stop.address || address.some((peer) => stop.address?.includes(peer));
}
