// Facts of the audit log (docs/audit.md), and what they are filtered by.
import { fields, number, text, time } from "../../hub/fields.js";
import type { Plain, PlainFields } from "../../worker/protocol.js";

/** In this order; that of the log. */
export const KEYS = [
  "at", "seq", "what", "peer", "user", "level", "verb", "context", "message", "rule", "code", "fence", "reason", "by", "text", "from", "version", "config", "sha256", "count",
] as const;

export const WHATS = [
  "refused", "granted", "lost", "login", "gone", "created", "deleted", "invited", "expelled", "inhibited", "uninhibited", "configured", "started", "stopped",
  "clock-stepped", "audit-lost", "fault",
] as const;

export interface Fact {
  seq: number;
  /** ms since 1970, by the hub's clock. */
  at: number | undefined;
  what: string;
  peer: string | undefined;
  user: string | undefined;
  verb: string | undefined;
  context: string | undefined;
  message: string | undefined;
  rule: string | undefined;
  code: string | undefined;
  reason: string | undefined;
  by: string | undefined;
  text: string | undefined;
  fence: number | bigint | undefined;
  count: number;
  all: PlainFields;
}

export function factOf(value: Plain): Fact {
  const all = fields(value);
  const { fence } = all;
  return {
    seq: number(all, "seq") ?? 0,
    at: time(all, "at"),
    what: text(all, "what") ?? "",
    peer: text(all, "peer"),
    user: text(all, "user"),
    verb: text(all, "verb"),
    context: text(all, "context"),
    message: text(all, "message"),
    rule: text(all, "rule"),
    code: text(all, "code"),
    reason: text(all, "reason"),
    by: text(all, "by"),
    text: text(all, "text"),
    fence: typeof fence === "number" || typeof fence === "bigint" ? fence : undefined,
    count: number(all, "count") ?? 1,
    all,
  };
}

/** The lower 20 bits, which people tell each other. */
export function lower(fence: number | bigint): string {
  return String(BigInt(fence) & 0xfffffn);
}

function plainText(value: Plain): unknown {
  if (value instanceof Date) return value.toISOString();
  // A fence has 51 bits.
  return typeof value === "bigint" ? Number(value) : value;
}

/** The fact as the log writes it, one line of JSON; keys of a newer hub stand at the end. */
export function jsonLine({ all }: Fact): string {
  const known: readonly string[] = KEYS;
  const keys = [...known.filter((key) => key in all), ...Object.keys(all).filter((key) => !known.includes(key))];
  return JSON.stringify(Object.fromEntries(keys.map((key) => [key, plainText(all[key]!)])));
}

export function jsonLines(facts: readonly Fact[]): string {
  return facts.map((fact) => `${jsonLine(fact)}\n`).join("");
}

/** As a person writes them: all texts. */
export interface Filter {
  peer: string;
  user: string;
  context: string;
  /** Words with commas between them. */
  what: string;
  verb: string;
  rule: string;
  code: string;
  text: string;
  /** `1h`: so long before now; `own`: the two that follow. */
  quick: string;
  since: string;
  until: string;
}

export const EMPTY: Filter = { peer: "", user: "", context: "", what: "", verb: "", rule: "", code: "", text: "", quick: "", since: "", until: "" };

export function filterOf(get: (key: string) => string): Filter {
  const filter = { ...EMPTY };
  for (const key of Object.keys(EMPTY) as (keyof Filter)[]) filter[key] = get(key);
  // A link may say when without saying that it does.
  if (!filter.quick && (filter.since || filter.until)) filter.quick = "own";
  return filter;
}

export function whatsOf(what: string): string[] {
  return what.split(",").map((word) => word.trim()).filter(Boolean);
}

const SPANS: { readonly [quick: string]: number } = { "15m": 900_000, "1h": 3_600_000, "24h": 86_400_000, "7d": 604_800_000 };

function date(words: string): Date | undefined {
  const parsed = new Date(words);
  return words && !Number.isNaN(parsed.getTime()) ? parsed : undefined;
}

/** What the hub is asked; `now` is by the hub's clock. */
export function contentOf(filter: Filter, now: number): PlainFields {
  const content: PlainFields = {};
  for (const key of ["peer", "user", "verb", "rule", "code", "text"] as const) {
    const words = filter[key].trim();
    if (words) content[key] = words;
  }
  const whats = whatsOf(filter.what);
  if (whats.length) content["what"] = whats.length === 1 ? whats[0]! : whats;
  const span = SPANS[filter.quick];
  if (span !== undefined) content["since"] = new Date(now - span);
  if (filter.quick === "own") {
    const [since, until] = [date(filter.since), date(filter.until)];
    if (since) content["since"] = since;
    if (until) content["until"] = until;
  }
  return content;
}

/** Whether nothing new is to be expected: the end is in the past. */
export function isOver(filter: Filter, now: number): boolean {
  const until = filter.quick === "own" ? date(filter.until) : undefined;
  return until !== undefined && until.getTime() <= now;
}

/** The question that the fact is about, where it is one that can be asked again. */
export function explainable(fact: Fact): { [key: string]: string | undefined } | undefined {
  const verb = fact.verb ?? (fact.what === "granted" ? "grab" : undefined);
  if (fact.context === undefined || verb === undefined || ["login", "answer", "resume", "logout", "verdict", "ping", "pong"].includes(verb)) return undefined;
  return { path: fact.context, user: fact.user, verb, message: verb === "send" ? fact.message : undefined };
}
