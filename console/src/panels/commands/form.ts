// A statement made of what stands in the fields of its verb, as data.
import type { CardArg, CardVerb } from "../../hub/card.js";
import { texts } from "../../texts/index.js";
import { faultOf } from "./script.js";

/** A verb with more fields than this is written, not filled in; and a list of more words than this is a field to write in. */
export const MOST_FIELDS = 40;
export const MOST_CHOICES = 100;
/** So many verbs are offered. */
export const MOST_VERBS = 500;

const t = texts.commands.form;

/** The fields of a verb whose last arguments are said so many times more. */
export function fieldsOf({ args, repeats }: CardVerb, more = 0): CardArg[] {
  const again = args.slice(args.length - repeats);
  return [...args, ...Array.from({ length: repeats ? more : 0 }, () => again).flat()];
}

/** What the field of an argument is. */
export function inputOf({ type, choices }: CardArg): "select" | "number" | "text" {
  if (type === "word" && choices.length > 0 && choices.length <= MOST_CHOICES) return "select";
  return (type === "number" || type === "whole") && !choices.length ? "number" : "text";
}

/** What is wrong with each field, and the statement if nothing is. */
export interface Made {
  text: string | undefined;
  faults: (string | undefined)[];
}

/** The statement of a verb with these values, one for each field; empty ones are left out where they may be. */
export function statementOf(verb: CardVerb, values: readonly string[], more = 0): Made {
  const args = fieldsOf(verb, more);
  const words = args.map((_, place) => (values[place] ?? "").trim());
  // What is behind the last that is said, and may be left out, is left out; what is before it is said.
  const count = more ? args.length : words.reduce((least, word, place) => (word === "" ? least : place + 1), 0);
  const faults = args.map((arg, place) => {
    const word = words[place]!;
    if (word === "") return arg.default === undefined ? t.missing(arg.name) : arg.default === "" && place < count ? t.before(arg.name) : undefined;
    if (/[\s;#]/u.test(word)) return t.oneWord(arg.name);
    return faultOf(verb, arg, word)?.words;
  });
  if (faults.some((fault) => fault !== undefined)) return { text: undefined, faults };
  const said = args.slice(0, count).map((arg, place) => words[place] || arg.default!);
  return { text: [verb.name, ...said].join(" "), faults };
}
