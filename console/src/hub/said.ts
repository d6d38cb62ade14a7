// What was said in a channel, bounded; and content as lines, of whatever depth and size it is.
import type { Plain } from "../worker/protocol.js";

export interface Said {
  /** Counts up. */
  key: number;
  /** A message, an image that was shown, one that was not, or something that happened. */
  sort: "message" | "picture" | "unshown" | "event";
  name: string;
  sender: string;
  /** On one line. */
  line: string;
  content: Plain | undefined;
  cut: boolean;
  size: number;
  history: boolean;
  born: number | undefined;
  error: number | undefined;
  arrived: number;
  id?: number | undefined;
  reference?: number | undefined;
  fence?: number | undefined;
}

/** Letters of the one line of a message. */
const LINE = 240;
/** Levels and members that are shown of a content. */
export const DEPTH = 24;
export const MEMBERS = 200;

interface Budget {
  left: number;
}

/** Control characters would change what others are read as. */
export function visible(text: string): string {
  return text.replace(/[\u0000-\u001f\u007f-\u009f\u200e\u200f\u202a-\u202e\u2066-\u2069]/g, (letter) => (letter === "\n" ? "⏎" : letter === "\t" ? "⇥" : `\\u{${letter.codePointAt(0)!.toString(16)}}`));
}

/** The same of what may have several lines. */
export const visibleLines = (text: string): string => text.split("\n").map(visible).join("\n");

function write(value: Plain | undefined, budget: Budget, depth: number): string {
  if (budget.left <= 0) return "…";
  const spend = (text: string): string => {
    budget.left -= text.length;
    return text;
  };
  if (value === undefined) return "";
  if (value === null) return spend("null");
  if (typeof value === "string") return spend(visible(value.slice(0, Math.max(budget.left, 1))));
  if (value instanceof Date) return spend(Number.isNaN(value.getTime()) ? "" : value.toISOString());
  if (value instanceof Uint8Array) return spend(`<${value.length} B>`);
  if (typeof value !== "object") return spend(String(value));
  if (depth > 3) return spend(Array.isArray(value) ? "[…]" : "{…}");
  if (Array.isArray(value)) {
    const parts: string[] = [];
    for (const item of value) {
      if (budget.left <= 0) break;
      parts.push(write(item, budget, depth + 1));
    }
    return `[${parts.join(" ")}${parts.length < value.length ? " …" : ""}]`;
  }
  const parts: string[] = [];
  for (const key of Object.keys(value)) {
    if (budget.left <= 0) {
      parts.push("…");
      break;
    }
    const name = spend(visible(key.slice(0, 40)));
    parts.push(`${name}=${write(value[key], budget, depth + 1)}`);
  }
  const all = parts.join(" ");
  return depth ? `{${all}}` : all;
}

/** Content on one line, however large it is. */
export function lineOf(content: Plain | undefined): string {
  const line = write(content, { left: LINE }, 0);
  return line.length > LINE + 40 ? `${line.slice(0, LINE)}…` : line;
}

/** Bytes that a content has, about; of binary content exactly. */
export function sizeOf(content: Plain | undefined, most = 200_000): number {
  let size = 0;
  const waiting: (Plain | undefined)[] = [content];
  for (let looks = 0; waiting.length && looks < most; looks += 1) {
    const value = waiting.pop();
    if (value === undefined) continue;
    if (typeof value === "string") size += value.length;
    else if (value instanceof Uint8Array) size += value.length;
    else if (value === null || typeof value === "boolean") size += 1;
    else if (typeof value !== "object" || value instanceof Date) size += 9;
    else if (Array.isArray(value)) waiting.push(...value.slice(0, most));
    else for (const key of Object.keys(value)) (size += key.length), waiting.push(value[key]);
  }
  return size;
}

/** A member of a content as a tree shows it. */
export type Shape =
  | { kind: "leaf"; text: string; type: string }
  | { kind: "branch"; label: string; count: number; members: [key: string, value: Plain][] };

export function shapeOf(value: Plain | undefined): Shape {
  if (value === undefined || value === null) return { kind: "leaf", text: "null", type: "null" };
  if (typeof value === "string") return { kind: "leaf", text: visible(value), type: "string" };
  if (value instanceof Date) return { kind: "leaf", text: Number.isNaN(value.getTime()) ? "" : value.toISOString(), type: "time" };
  if (value instanceof Uint8Array) return { kind: "leaf", text: "", type: "binary" };
  if (typeof value !== "object") return { kind: "leaf", text: String(value), type: typeof value };
  if (Array.isArray(value)) return { kind: "branch", label: `[${value.length}]`, count: value.length, members: value.slice(0, MEMBERS).map((item, index): [string, Plain] => [String(index), item]) };
  const keys = Object.keys(value);
  return { kind: "branch", label: `{${keys.length}}`, count: keys.length, members: keys.slice(0, MEMBERS).map((key): [string, Plain] => [key, value[key]!]) };
}

/** Text for the clipboard: JSON, where binary is its size. */
export function jsonOf(content: Plain | undefined): string {
  if (typeof content === "string") return content;
  const replace = (_: string, value: unknown): unknown => (typeof value === "bigint" ? value.toString() : value instanceof Uint8Array ? `<${value.length} B>` : value);
  return JSON.stringify(content ?? null, replace, 2);
}

/** The newest so many, in their order. */
export class Bounded<T> {
  items: readonly T[] = [];

  constructor(readonly most: number) {}

  add(more: readonly T[]): void {
    if (more.length) this.items = [...this.items, ...more].slice(-this.most);
  }
}

/** How many there are in a second, of what comes in pieces: over the last whole seconds. */
export class Meter {
  readonly #seconds = new Map<number, number>();

  constructor(readonly over = 3) {}

  add(at: number, count: number): void {
    const second = Math.floor(at / 1000);
    this.#seconds.set(second, (this.#seconds.get(second) ?? 0) + count);
    for (const old of this.#seconds.keys()) if (old < second - this.over) this.#seconds.delete(old);
  }

  rate(at: number): number {
    const second = Math.floor(at / 1000);
    let sum = 0;
    for (const [when, count] of this.#seconds) if (when >= second - this.over && when < second) sum += count;
    return sum / this.over;
  }
}
