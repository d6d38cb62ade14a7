// What is known of a context, in words.
import { fields, flag, list, number, text } from "../hub/fields.js";
import { texts } from "../texts/index.js";
import { duration, fence, left } from "../texts/format.js";
import type { Plain, PlainFields } from "../worker/protocol.js";

/** What a channel keeps. */
export function keepWords(keep: PlainFields): string {
  const t = texts.tree.keep;
  const bounds = [
    flag(keep, "latest") ? t.latest : "",
    number(keep, "parcels") === undefined ? "" : t.parcels(number(keep, "parcels")!),
    number(keep, "bytes") === undefined ? "" : t.bytes(number(keep, "bytes")!),
    number(keep, "age") === undefined ? "" : t.age(number(keep, "age")!),
  ];
  return bounds.filter(Boolean).join(", ");
}

export function guardWords(guard: PlainFields): string {
  const token = text(guard, "token");
  return token === undefined ? "" : texts.tree.guarded(list(guard, "names").map(String).join(" "), token);
}

/** Who owns a token, and for how long still. */
export function ownerWords(info: PlainFields): string {
  const t = texts.tree;
  const holders = list(info, "holders").map(String);
  if (holders.length) return t.shared(holders.join(", "));
  const owner = text(info, "owner");
  if (owner === undefined) return "fence" in info ? t.free : "";
  const ms = number(info, "lease-left");
  return t.held(owner, number(info, "owner-level")) + (ms === undefined ? "" : t.lease(ms));
}

/** The last column of the tree. */
export function noteOf(kind: string, info: PlainFields | null): string {
  if (!info) return "";
  if (kind === "token") return ownerWords(info);
  const keep = keepWords(fields(info["keep"]));
  return [guardWords(fields(info["guard"])), keep ? texts.tree.keeps(keep) : ""].filter(Boolean).join("; ");
}

/** ms. */
const TIMES = new Set(["lease", "deadman", "held"]);
/** Shown elsewhere, or by another key. */
const HIDDEN = new Set(["path", "kind"]);

function factOf(key: string, value: Plain, info: PlainFields): string {
  const t = texts.context;
  if (value === null) return key === "lease" || key === "lease-left" ? t.never : "";
  if (typeof value === "boolean") return value ? t.yes : t.no;
  const words = typeof value === "string" ? t.values[key]?.[value] : undefined;
  if (words !== undefined) return words;
  const of = fields(value);
  switch (key) {
    case "keep":
      return keepWords(of);
    case "guard":
      return guardWords(of);
    case "fence":
      return `${fence(Number(value))} (${value})`;
    case "lease-left":
      return left(Number(value));
    case "holders":
      return list(info, key).map(String).join(", ");
    case "queue":
      return list(info, key)
        .map((waiter) => t.queued(text(fields(waiter), "peer") ?? "", number(fields(waiter), "level") ?? 0, number(fields(waiter), "waiting") ?? 0))
        .join(", ");
    case "requests":
      return list(info, key)
        .map((asker) => t.asked(text(fields(asker), "peer") ?? "", number(fields(asker), "within") ?? 0))
        .join(", ");
    case "delegated":
      return t.delegated(text(of, "from") ?? "", number(of, "left"), number(of, "commands"));
    case "offer":
      return t.offered(text(of, "to") ?? "", number(of, "within") ?? 0);
    case "rate":
      return typeof value === "number" ? `${value}/s` : String(value);
  }
  if (TIMES.has(key) && typeof value === "number") return duration(value);
  return typeof value === "object" ? JSON.stringify(value, (_, member: unknown) => (typeof member === "bigint" ? String(member) : member)) : String(value);
}

/** All keys of `info`, known ones in words, others as they are. */
export function factsOf(info: PlainFields): [key: string, value: string][] {
  return Object.entries(info)
    .filter(([key]) => !HIDDEN.has(key))
    .map(([key, value]): [string, string] => [texts.context.keys[key] ?? key, factOf(key, value, info)])
    .filter(([, value]) => value !== "");
}
