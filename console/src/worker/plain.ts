// Content of messages as it can be cloned, within bounds.
import { Double, MomError, Time, type Value } from "mom-client";
import type { Failure, Plain, PlainFields } from "./protocol.js";

/** So much of one message goes to the page. */
const MOST_VALUES = 5000;
const MOST_TEXT = 64 * 1024;

/** Answers have bounds of their own, which the hub sets; these are above them. */
const MOST_OF_ANSWER = 400_000;
const MOST_TEXT_OF_ANSWER = 8 * 1024 * 1024;

/** What is left of the bounds. */
interface Budget {
  values: number;
  text: number;
  cut: boolean;
  /** Bytes of binary content that was met. */
  size: number;
  /** Whether binary content is passed on. */
  binary: boolean;
}

function convert(value: Value | undefined, budget: Budget): Plain {
  budget.values -= 1;
  if (budget.values < 0) {
    budget.cut = true;
    return null;
  }
  if (value === null || value === undefined) return null;
  switch (typeof value) {
    case "string": {
      const text = value.length > budget.text ? value.slice(0, budget.text) : value;
      budget.cut ||= text.length < value.length;
      budget.text -= text.length;
      return text;
    }
    case "boolean":
    case "number":
    case "bigint":
      return value;
  }
  if (value instanceof Time) return value.toDate();
  if (value instanceof Date) return value;
  if (value instanceof Double) return value.number;
  if (value instanceof Uint8Array) {
    budget.size += value.length;
    if (budget.binary && value.length <= MOST_TEXT) return value.slice();
    return null;
  }
  if (Array.isArray(value)) {
    const items: Plain[] = [];
    for (const item of value as readonly Value[]) {
      if (budget.values < 0) break;
      items.push(convert(item, budget));
    }
    return items;
  }
  const fields: PlainFields = {};
  for (const [key, member] of value instanceof Map ? value : Object.entries(value as { [key: string]: Value })) {
    if (budget.values < 0) break;
    // A key of a stranger must not be one of the language's own.
    Object.defineProperty(fields, key, { value: convert(member, budget), enumerable: true, writable: true, configurable: true });
  }
  return fields;
}

/** What is passed on of a content, within wider bounds if it is an answer; whether something was left out, and how many bytes of binary it has. */
export function plain(value: Value | undefined, binary = false, answer = false): { content: Plain | undefined; cut: boolean; size: number } {
  const budget: Budget = { values: answer ? MOST_OF_ANSWER : MOST_VALUES, text: answer ? MOST_TEXT_OF_ANSWER : MOST_TEXT, cut: false, size: 0, binary };
  const content = value === undefined ? undefined : convert(value, budget);
  return { content, cut: budget.cut, size: budget.size };
}

function fieldsOf(content: Plain | undefined): PlainFields {
  return typeof content === "object" && content !== null && !Array.isArray(content) && !(content instanceof Date) && !(content instanceof Uint8Array) ? content : {};
}

export function plainFields(value: Value | undefined): PlainFields {
  return fieldsOf(plain(value).content);
}

/** All that the hub answers: the statistics of a large one are more than a message may be. */
export function answerFields(value: Value | undefined): PlainFields {
  return fieldsOf(plain(value, true, true).content);
}

export function failure(error: unknown): Failure {
  if (!(error instanceof MomError)) {
    const text = error instanceof Error ? error.message : String(error);
    return { kind: "local", code: "internal", text, content: {} };
  }
  const { kind, code, text, rule, owner, retryAfter } = error;
  return { kind, code, text, rule, owner, retryAfter, content: plainFields(error.content) };
}
