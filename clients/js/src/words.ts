import type { Delivery, Family } from "./parcel.js";

export const FAMILIES: readonly Family[] = ["message", "login", "context", "token", "manager", "event", "reply", "error", "time"];
export const DELIVERIES: readonly Delivery[] = ["reliable", "latest", "fleeting"];

/** Names that are written as numbers; the table only grows, at its end. */
export const WORDS: readonly string[] = (
  "command state status image chat stop unstop halt login answer resume logout create lookup list info stats join leave delete " +
  "members invite expel grab release renew give accept decline request break inhibit uninhibit consult verdict joined left created " +
  "deleted grabbed released requested offer lapsed queued invited expelled dropped notice ok challenge ping pong hub inhibited uninhibited ack " +
  "resent lost resumed"
).split(" ");

/** The words that every hub of this major version knows: others may refuse the number, and none the text. */
const OLDEST = 56;

export const NUMBERS: ReadonlyMap<string, number> = new Map(WORDS.slice(0, OLDEST).map((word, number) => [word, number]));
