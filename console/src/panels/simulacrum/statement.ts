// Statements of a mirrored robot's scripts, from what is typed.
import { simulacrum as t } from "../../texts/simulacrum.js";

/** ms for which a value may be set, and of the period between two packets. */
export const LONGEST = 60_000;
export const PERIODS = { least: 5, most: 200, marks: [20, 40] } as const;

export type Read<T> = { value: T } | { mistake: string };

/** Numbers with blanks, commas or semicolons between them; `count` of them, where that is known. */
export function numbersOf(typed: string, count: number | undefined): Read<number[]> {
  const words = typed.trim().split(/[\s,;]+/).filter(Boolean);
  for (const word of words) if (!/^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i.test(word) || !Number.isFinite(Number(word))) return { mistake: t.mistakes.number(word) };
  if (count !== undefined && words.length !== count) return { mistake: t.mistakes.count(count, words.length) };
  return { value: words.map(Number) };
}

/** ms; undefined for nothing typed, which is a mistake where it is `needed`. */
export function timeOf(typed: string, needed: boolean): Read<number | undefined> {
  const text = typed.trim();
  if (text === "") return needed ? { mistake: t.mistakes.needsTime } : { value: undefined };
  const ms = /^\d+$/.test(text) ? Number(text) : NaN;
  return ms >= 1 && ms <= LONGEST ? { value: ms } : { mistake: t.mistakes.time(LONGEST) };
}

/** `set left-wheel 100 for 1000`. */
export function setOf(name: string, values: readonly number[], ms?: number): string {
  return ["set", name, ...values, ...(ms === undefined ? [] : ["for", ms])].join(" ");
}

/** `do gesture 3`. */
export const doOf = (name: string, values: readonly number[]): string => ["do", name, ...values].join(" ");

/** `activate motion`, `deactivate motion`. */
export const switchOf = (name: string, active: boolean): string => `${active ? "activate" : "deactivate"} ${name}`;

/** `ask camera`. */
export const askOf = (name: string): string => `ask ${name}`;

/** `period 40`. */
export const periodOf = (ms: number): string => `period ${Math.max(PERIODS.least, Math.min(PERIODS.most, Math.round(ms)))}`;

export const CLEAR = "clear";
