// Statements of a robot's script, typed field by field, with the ranges that the robots' gateway knows.
import { fleet as t } from "../../texts/fleet.js";
import { FARTHEST, LOWEST } from "./formation.js";

export type Verb = "goto" | "via" | "motor" | "leds" | "wait";

export interface Field {
  name: string;
  from: number;
  to: number;
  /** What stands there at first. */
  first: number;
}

const mm = (name: string): Field => ({ name, from: LOWEST, to: FARTHEST, first: 1000 });

export const verbs: { readonly [verb in Verb]: readonly Field[] } = {
  goto: [mm("x"), mm("y")],
  // Its points are one text.
  via: [],
  motor: [
    { name: "left", from: -1000, to: 1000, first: 200 },
    { name: "right", from: -1000, to: 1000, first: 200 },
    { name: "ms", from: 1, to: 60_000, first: 1000 },
  ],
  leds: [{ name: "mask", from: 0, to: 255, first: 255 }],
  wait: [{ name: "ms", from: 0, to: 60_000, first: 1000 }],
};

/** ms between two of a statement that is repeated. */
export const PERIOD: Field = { name: "period", from: 100, to: 3_600_000, first: 1000 };

/** A whole number within its range; or why it is none. */
export function wholeOf({ from, to }: Field, typed: string): { value: number } | { mistake: string } {
  const value = /^\s*[+-]?\d+\s*$/.test(typed) ? Number(typed) : NaN;
  return value >= from && value <= to ? { value } : { mistake: t.send.range(from, to) };
}

/** The points of `via`, as they are typed: x y pairs, with blanks, commas or lines between them. */
function pointsOf(typed: string): { text: string } | { mistake: string } {
  const words = typed.trim().split(/[\s,;]+/).filter(Boolean);
  if (!words.length || words.length % 2) return { mistake: t.send.pairs };
  for (const word of words) {
    const read = wholeOf(mm("x"), word);
    if ("mistake" in read) return { mistake: `${word}: ${read.mistake}` };
  }
  return { text: words.map(Number).join(" ") };
}

/** The statement, or what is wrong by field. */
export function statementOf(verb: Verb, typed: { readonly [name: string]: string | undefined }): { text: string } | { mistakes: { [name: string]: string } } {
  if (verb === "via") {
    const read = pointsOf(typed["points"] ?? "");
    return "text" in read ? { text: `via ${read.text}` } : { mistakes: { points: read.mistake } };
  }
  const mistakes: { [name: string]: string } = {};
  const values: number[] = [];
  for (const field of verbs[verb]) {
    const read = wholeOf(field, typed[field.name] ?? "");
    if ("value" in read) values.push(read.value);
    else mistakes[field.name] = read.mistake;
  }
  return Object.keys(mistakes).length ? { mistakes } : { text: [verb, ...values].join(" ") };
}

/** Where a script leads in the end, if it drives anywhere. */
export function goalOf(script: string): [x: number, y: number] | undefined {
  const last = script.split(/[;\n]/).map((statement) => statement.trim().split(/\s+/)).findLast(([verb]) => verb === "goto" || verb === "via");
  const [x, y] = last?.slice(-2).map(Number) ?? [];
  return x === undefined || y === undefined || Number.isNaN(x + y) ? undefined : [x, y];
}
