// An answer of the hub to "who may do what", read and told.
import { flag, fields, list, number, text, time } from "../../hub/fields.js";
import { access as t } from "../../texts/access.js";
import { duration } from "../../texts/format.js";
import type { Plain, PlainFields } from "../../worker/protocol.js";

export type Word = "allow" | "deny" | "wait" | "ask";

/** Who asks for what; `message` `*` is any that no rule names. */
export interface Question {
  user: string;
  verb: string;
  path: string;
  message?: string | undefined;
  kind?: string | undefined;
}

export interface Answer {
  word: Word;
  rule: string | undefined;
  uncovered: boolean;
  file: string | undefined;
  line: number | undefined;
  key: string | undefined;
  manager: string | undefined;
  managedAt: string | undefined;
  code: string | undefined;
  text: string | undefined;
  guard: string | undefined;
  guardOwner: string | undefined;
  needs: readonly string[];
  displaces: boolean;
  /** ms since 1970. */
  until: number | undefined;
  stands: string | undefined;
  all: PlainFields;
}

const WORDS: readonly string[] = ["allow", "deny", "wait", "ask"];

export function answerOf(value: Plain | undefined): Answer {
  const all = fields(value);
  const word = text(all, "answer") ?? (flag(all, "allow") ? "allow" : "deny");
  return {
    // Whatever a newer hub may say, it is not a yes.
    word: WORDS.includes(word) ? (word as Word) : "deny",
    rule: text(all, "rule"),
    uncovered: flag(all, "uncovered"),
    file: text(all, "file"),
    line: number(all, "line"),
    key: text(all, "key"),
    manager: text(all, "manager"),
    managedAt: text(all, "managed-at"),
    code: text(all, "code"),
    text: text(all, "text"),
    guard: text(all, "guard"),
    guardOwner: text(all, "guard-owner"),
    needs: list(all, "needs").map(String),
    displaces: flag(all, "displaces"),
    until: time(all, "until"),
    stands: text(all, "stands"),
    all,
  };
}

/** Who it is about: `alice (level 1, operator)`. */
export function person(user: string, all: PlainFields): string {
  return t.person(user, t.level(number(all, "level"), list(all, "groups").map(String)));
}

/** The whole answer in one sentence. */
export function sentence(question: Question, answer: Answer): string {
  const who = person(text(answer.all, "user") ?? question.user, answer.all);
  const message = question.verb === "send" ? (question.message ?? "*") : undefined;
  return t.sentence(who, t.may[answer.word], t.doing(question.verb, message), question.path);
}

/** Where the rule stands: `lab.toml:77`. */
export function place(answer: Answer): string | undefined {
  if (answer.file === undefined) return undefined;
  return answer.line === undefined ? answer.file : `${answer.file}:${answer.line}`;
}

/** What decided, in words. */
export function decidedBy(answer: Answer): string {
  if (answer.uncovered) return t.noRule(answer.rule ?? answer.manager ?? "");
  if (answer.rule !== undefined) return answer.rule;
  return answer.line !== undefined ? t.asAWhole(answer.manager ?? "") : t.hubItself;
}

/** What has its own line, or is said in the sentence. */
const TOLD: ReadonlySet<string> = new Set([
  "allow", "answer", "rule", "uncovered", "file", "line", "key", "manager", "managed-at", "code", "text", "guard", "guard-owner",
  "needs", "asks", "displaces", "until", "stands", "user", "peer", "groups", "verb", "context", "kind", "message",
]);

function wordOf(value: Plain): string {
  if (value instanceof Date) return value.toISOString();
  if (Array.isArray(value)) return value.map(wordOf).join(", ");
  return typeof value === "object" && value !== null ? JSON.stringify(value) : String(value);
}

/** The reasons, line by line, as `mom-broker explain` prints them. */
export function reasons(answer: Answer, when: (ms: number) => string): [name: string, value: string][] {
  const lines: [string, string | undefined][] = [];
  const { all } = answer;
  const l = t.lines;
  const peer = text(all, "peer");
  lines.push([l.peer, peer]);
  if (answer.text !== undefined || answer.code !== undefined) lines.push([answer.code ?? l.says, answer.text ?? answer.code]);
  const told = Object.entries(all).filter(([key, value]) => !TOLD.has(key) && value !== null && !(key === "level" && answer.word === "allow"));
  if (answer.word !== "allow") lines.push([l.told, told.map(([key, value]) => `${key}=${wordOf(value)}`).join("  ") || undefined]);
  lines.push([l.rule, decidedBy(answer)]);
  const where = place(answer);
  lines.push([l.standsAt, where === undefined ? undefined : answer.key === undefined ? where : `${where}, ${answer.key}`]);
  const kind = text(all, "kind") ?? t.nothingThere;
  if (answer.manager !== undefined) lines.push([l.manager, t.managerOf(answer.manager, answer.managedAt ?? "/", kind)]);
  if (answer.guard !== undefined) lines.push([l.guard, t.guard(answer.guard, answer.guardOwner)]);
  const asks = fields(all["asks"]);
  const within = number(asks, "within");
  if (Object.keys(asks).length) lines.push([l.asks, t.asks(text(asks, "who") ?? "", list(asks, "users").map(String), within === undefined ? undefined : duration(within))]);
  if (answer.displaces) lines.push([l.takes, t.takes]);
  if (answer.until !== undefined) lines.push([l.until, when(answer.until)]);
  lines.push([l.holds, answer.stands]);
  if (answer.word !== "deny") lines.push([l.needs, answer.needs.join(", ") || undefined]);
  return lines.filter((line): line is [string, string] => line[1] !== undefined);
}

/** What a cell of the table says besides the word: that one has to own a token. */
export function condition(answer: Answer): string | undefined {
  if (answer.word === "deny") return undefined;
  const owning = answer.needs.find((need) => need.startsWith("ownership"));
  return owning === undefined ? undefined : t.with(owning);
}
