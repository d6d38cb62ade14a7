// What can be said at all: values that have a form on the wire.
import { Double, Time, type Value } from "../index.js";
import type { Fields } from "../value.js";

/** What no string may hold: control characters, and halves of surrogate pairs. */
const UNSAYABLE = /[^\t\n\r\x20-\ud7ff\ue000-\ufffd\u{10000}-\u{10ffff}]/gu;
/** The longest text of an error or a reason, in letters. */
const LONGEST_TEXT = 4096;
/** How deep lists and maps may be in a member of content. */
const MOST_DEPTH = 31;
/** The most bytes of what an author says of a device in its state. */
const MOST_BYTES = 1 << 20;
/** The first and the last year of a time, µs from 1970. */
const [FIRST_TIME, LAST_TIME] = [-62_167_219_200_000_000n, 253_402_300_799_999_999n];

/** A text of whatever it is, with nothing in it that no string may hold. */
export function sayable(text: unknown): string {
  return textOf(text).slice(0, LONGEST_TEXT).replace(UNSAYABLE, "\ufffd");
}

/** What was thrown, in words. */
export function textOf(thrown: unknown): string {
  try {
    return String(thrown instanceof Error ? thrown.message : thrown);
  } catch {
    return "something that has no text";
  }
}

/** A copy of members of content, which nobody changes any more. Throws a TypeError where one cannot be said. */
export function copyOf(fields: Fields): Fields {
  return new Copier().members(Object.entries(fields), MOST_DEPTH) as Fields;
}

/** Without members that cannot be said. */
export function sayableOf(fields: Fields): Fields {
  const isSayable = ([key, value]: [string, Value | undefined]): boolean => {
    try {
      copyOf({ [key]: value });
      return true;
    } catch {
      return false;
    }
  };
  return Object.fromEntries(Object.entries(fields).filter(isSayable));
}

/** Copies values as long as they are not too large, so that it comes to an end in those that hold themselves, too. */
class Copier {
  #left = MOST_BYTES;

  /** Those that are undefined are left out. */
  members(entries: Iterable<[string, unknown]>, depth: number): Value {
    const copies: [string, Value][] = [];
    for (const [key, value] of entries) if (value !== undefined) copies.push([this.#text(key), this.#value(value, key, depth)]);
    return Object.fromEntries(copies);
  }

  #value(value: unknown, key: string, depth: number): Value {
    this.#take(9);
    if (value === null || typeof value === "boolean") return value;
    if (typeof value === "string") return this.#text(value);
    if (typeof value === "bigint" && BigInt.asIntN(64, value) === value) return value;
    if (typeof value === "number" || value instanceof Double) {
      if (Number.isFinite(Number(value))) return value;
      throw new TypeError(`${key} is ${Number(value)}, which cannot be said`);
    }
    if (value instanceof Time || value instanceof Date) {
      const { micros } = value instanceof Date ? Time.of(value) : value;
      if (micros >= FIRST_TIME && micros <= LAST_TIME) return new Time(micros);
    } else if (value instanceof Uint8Array) {
      this.#take(value.length);
      return value.slice();
    } else if (typeof value === "object") return this.#deeper(value, key, depth);
    throw new TypeError(`${key} is a ${typeof value} that cannot be said`);
  }

  #deeper(value: object, key: string, depth: number): Value {
    if (depth === 0) throw new TypeError(`${key} nests too deep, or holds itself`);
    if (Array.isArray(value)) return Array.from(value, (item) => this.#value(item, key, depth - 1));
    return this.members(value instanceof Map ? value : Object.entries(value), depth - 1);
  }

  #text(text: unknown): string {
    if (typeof text !== "string") throw new TypeError(`a key is a ${typeof text}, and no string`);
    this.#take(text.length);
    if (text.search(UNSAYABLE) >= 0) throw new TypeError(`${JSON.stringify(text)} has a control character or half a surrogate pair`);
    return text;
  }

  #take(bytes: number): void {
    this.#left -= bytes;
    if (this.#left < 0) throw new TypeError(`it has more than ${MOST_BYTES} bytes`);
  }
}
