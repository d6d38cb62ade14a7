// The list of commands as data: each change makes a new list, and nothing here sends anything.
import type { Failure } from "../../worker/protocol.js";

/** The states of M42, one that waits in the device's own queue, and what became of what was under way when the page was loaded anew. */
export type ItemState = "waiting" | "sending" | "taken" | "executing" | "finished" | "error" | "unknown";

export interface Item {
  key: number;
  text: string;
  state: ItemState;
  /** The statement that runs, or ran last; 1 for the first, 0 before it. */
  statement: number;
  of: number;
  error?: Failure | undefined;
  /** Why it is tried again just now. */
  trying?: string | undefined;
  /** ms from sending to the end. */
  took?: number | undefined;
}

export type Items = readonly Item[];

/** Under way: what the device may be doing now. */
export function isUnderWay({ state }: Item): boolean {
  return state === "sending" || state === "taken" || state === "executing";
}

/** Still to be sent. */
export function isOpen({ state }: Item): boolean {
  return state === "waiting";
}

function fresh(key: number, text: string): Item {
  return { key, text, state: "waiting", statement: 0, of: 0 };
}

function nextKey(items: Items): number {
  return items.reduce((most, { key }) => Math.max(most, key), 0) + 1;
}

/** Adds commands at the end, or behind one of the list. */
export function add(items: Items, texts: readonly string[], behind?: number): Items {
  const key = nextKey(items);
  const added = texts.map((text, index) => fresh(key + index, text));
  const place = behind === undefined ? -1 : items.findIndex((item) => item.key === behind);
  return place < 0 ? [...items, ...added] : [...items.slice(0, place + 1), ...added, ...items.slice(place + 1)];
}

function change(items: Items, key: number, by: (item: Item) => Item): Items {
  return items.map((item) => (item.key === key ? by(item) : item));
}

/** Another text: it waits as if it had never been sent. What is under way is not changed. */
export function edit(items: Items, key: number, text: string): Items {
  return change(items, key, (item) => (isUnderWay(item) || item.text === text ? item : fresh(key, text)));
}

/** It is to be sent again. */
export function again(items: Items, key: number): Items {
  return change(items, key, (item) => (isUnderWay(item) ? item : fresh(key, item.text)));
}

export function duplicate(items: Items, key: number): Items {
  const item = items.find((item) => item.key === key);
  return item ? add(items, [item.text], key) : items;
}

export function remove(items: Items, key: number): Items {
  return items.filter((item) => item.key !== key || isUnderWay(item));
}

/** Moves one to a place, 0 for the first. */
export function moveTo(items: Items, key: number, place: number): Items {
  const item = items.find((item) => item.key === key);
  if (!item) return items;
  const rest = items.filter((item) => item.key !== key);
  const to = Math.max(0, Math.min(place, rest.length));
  return [...rest.slice(0, to), item, ...rest.slice(to)];
}

/** Moves one up (-1) or down (1). */
export function move(items: Items, key: number, by: number): Items {
  return moveTo(items, key, items.findIndex((item) => item.key === key) + by);
}

export function clearFinished(items: Items): Items {
  return items.filter(({ state }) => state !== "finished");
}

export function clearAll(items: Items): Items {
  return items.filter(isUnderWay);
}

/** It has come further. What has ended stays so, but for a word of the device itself. */
export function progress(items: Items, key: number, step: Partial<Omit<Item, "key" | "text">>): Items {
  return change(items, key, (item) => ({ ...item, ...step }));
}

/** The first that is to be sent. */
export function next(items: Items): Item | undefined {
  return items.find(isOpen);
}

/** The list that a text says: what begins and ends as before stays as it is, and so does what is under way. */
export function rewrite(items: Items, texts: readonly string[]): Items {
  let before = 0;
  while (before < items.length && before < texts.length && items[before]!.text === texts[before]) before += 1;
  let after = 0;
  const same = (back: number): boolean => items[items.length - back]!.text === texts[texts.length - back];
  while (after < Math.min(items.length, texts.length) - before && same(after + 1)) after += 1;
  const kept = items.slice(before, items.length - after).filter(isUnderWay);
  const key = nextKey(items);
  const added = texts.slice(before, texts.length - after).map((text, index) => fresh(key + index, text));
  return [...items.slice(0, before), ...kept, ...added, ...items.slice(items.length - after)];
}

/** The list as text: one command per line, as `mom run` reads it. */
export function asText(items: Items): string {
  return items.map(({ text }) => `${text}\n`).join("");
}

/** What is kept for the next page. */
export function save(items: Items): string {
  return JSON.stringify(items.map(({ text, state, statement, of, error }) => ({ text, state, statement, of, error: error && { code: error.code, text: error.text } })));
}

const STATES: readonly ItemState[] = ["waiting", "sending", "taken", "executing", "finished", "error", "unknown"];

/** The list of the page before; of what was under way then nothing is known. */
export function restore(saved: string | null): Items {
  let found: unknown;
  try {
    found = JSON.parse(saved ?? "[]");
  } catch {
    return [];
  }
  if (!Array.isArray(found)) return [];
  return found.flatMap((each: unknown, index): Item[] => {
    const { text, state, statement, of, error } = (typeof each === "object" && each !== null ? each : {}) as { [key: string]: unknown };
    if (typeof text !== "string") return [];
    const was = STATES.find((known) => known === state) ?? "waiting";
    const item: Item = { ...fresh(index + 1, text), state: was, statement: Number(statement) || 0, of: Number(of) || 0 };
    if (isUnderWay(item)) item.state = "unknown";
    if (was === "error") {
      const { code, text: words } = (typeof error === "object" && error !== null ? error : {}) as { [key: string]: unknown };
      item.error = { kind: "refused", code: String(code ?? ""), text: String(words ?? ""), content: {} };
    }
    return [item];
  });
}
