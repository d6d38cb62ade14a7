// What a device can do, declared once: from it come the reading of its scripts, the types of its functions, and its card.
import type { Fields, Value } from "../value.js";
import { DeviceError, defined, syntax } from "./errors.js";
import { type Attachments, Word, type Words, numberOf, wholeOf } from "./script.js";

/** What an argument may be on the card. */
export type ArgType = "number" | "whole" | "word" | "attachment";

/** What is said of an argument, or of a value of the state. */
export interface ArgTerms<T> {
  /** In plain words. */
  does?: string;
  /** Such as `mm`. */
  unit?: string;
  /** Of numbers: the least and the greatest. */
  min?: number;
  max?: number;
  /** Of words: what it may be. */
  choices?: readonly T[];
  /** What it is where the script does not say it; only behind all arguments that it has to say. */
  default?: T;
}

/** An argument, whose function gets a `T`. */
export interface Arg<T> {
  readonly type: ArgType;
  readonly terms: Readonly<ArgTerms<T>>;
}

/** A number. */
export function number(terms: Omit<ArgTerms<number>, "choices"> = {}): Arg<number> {
  return { type: "number", terms };
}

/** A whole number. */
export function whole(terms: Omit<ArgTerms<number>, "choices"> = {}): Arg<number> {
  return { type: "whole", terms };
}

/** A word without blanks, perhaps one of some. */
export function word<const T extends string = string>(terms: Pick<ArgTerms<T>, "does" | "choices" | "default"> = {}): Arg<T> {
  return { type: "word", terms };
}

/** The name of bytes that come with the script; its function gets the bytes. */
export function attachment(terms: Pick<ArgTerms<Uint8Array>, "does"> = {}): Arg<Uint8Array> {
  return { type: "attachment", terms };
}

/** Arguments by their names, in their order in a script. A name begins with a letter. */
export type Args = { readonly [name: string]: Arg<number> | Arg<string> | Arg<Uint8Array> };

/** What a function of a verb gets. */
export type ValuesOf<A extends Args> = { readonly [K in keyof A]: A[K] extends Arg<infer T> ? T : never };

/** Of which kind a verb is: it `moves` the device (the others do not), only says how far (`relative`), or how fast (`velocity`). */
type Kind = "moves" | "relative" | "velocity" | "instant";

/** A verb of a device: {@link verb} makes it. */
export interface Verb {
  readonly kind: Kind;
  readonly does: string;
  readonly args: Args;
  /** @internal */
  readonly act: (values: never, signal: AbortSignal) => unknown;
}

/**
 * Carries a statement out: it is done when the promise is fulfilled. `signal` is aborted when it is to end before, just before the device
 * is halted. What it throws ends the command as an error: a {@link DeviceError} as it is, anything else as `link`, as nothing is known of
 * the mechanism then.
 */
export type Act<A extends Args> = (values: ValuesOf<A>, signal: AbortSignal) => unknown;

function verbOf(kind: Kind): <const A extends Args>(does: string, args: A, act: Act<A>) => Verb {
  return (does, args, act) => ({ kind, does, args, act: act as Verb["act"] });
}

/**
 * Declares a verb, in plain words, with its arguments and the function that carries it out: `verb` moves the device to where its
 * arguments say; `verb.relative` says only how far it goes, so its command has to say on which state it is based; `verb.velocity` goes on
 * for its time or until the next command, waits behind no other, and halts the device when its time is over; `verb.instant` does not move
 * it.
 */
export const verb = Object.assign(verbOf("moves"), { relative: verbOf("relative"), velocity: verbOf("velocity"), instant: verbOf("instant") });

/** A statement that was read. */
export interface Call {
  readonly name: string;
  readonly verb: Verb;
  /** By the names of the arguments. */
  readonly values: { readonly [name: string]: number | string | Uint8Array };
}

const NAME = /^[A-Za-z][A-Za-z0-9_-]*$/;

/** Throws a TypeError for verbs that no script could name, or not as they are declared. */
export function checkVerbs(verbs: { readonly [name: string]: Verb }): void {
  for (const [name, { args, act }] of Object.entries(verbs)) {
    if (!NAME.test(name) || name === "wait") {
      throw new TypeError(`a verb is a word of letters, digits, - and _, and not \`wait\`, which all devices know: ${JSON.stringify(name)}`);
    }
    if (typeof act !== "function" || /Generator/.test(act.constructor.name)) {
      throw new TypeError(`the verb \`${name}\` has no function, or a generator, which does nothing`);
    }
    let optional = false;
    for (const [arg, { terms }] of Object.entries(args)) {
      if (!NAME.test(arg)) throw new TypeError(`an argument of \`${name}\` is a word of letters, digits, - and _: ${JSON.stringify(arg)}`);
      if (optional && terms.default === undefined) throw new TypeError(`\`${name}\`: ${arg} needs a default, as it stands behind an argument that has one`);
      optional = terms.default !== undefined;
      if (optional) checkDefault(name, arg, args[arg] as Arg<unknown>);
    }
  }
}

function checkDefault(name: string, arg: string, { type, terms }: Arg<unknown>): void {
  try {
    valueOf({ type, terms }, arg, new Word(String(terms.default), 0));
  } catch (error) {
    throw new TypeError(`the default of \`${name}\`: ${(error as DeviceError).text}`);
  }
}

/** Reads the arguments of a statement; an attachment's is its name still. */
export function readCall(verb: Verb, at: Word, words: Words): Call {
  const takes = takesOf(verb.args);
  const values: { [name: string]: number | string | Uint8Array } = {};
  for (const [name, arg] of Object.entries(verb.args) as [string, Arg<unknown>][]) {
    if (arg.terms.default !== undefined && words.isOver) values[name] = arg.terms.default as number | string;
    else values[name] = valueOf(arg, name, words.need(at.text, takes, name));
  }
  return { name: at.text, verb, values };
}

/** The same with the bytes that it names. */
export function attachTo(call: Call, attachments: Attachments): Call {
  const isName = (arg: string): boolean => call.verb.args[arg]?.type === "attachment";
  const values = Object.entries(call.values).map(([arg, value]) => [arg, isName(arg) ? attachments.get(String(value)) : value]);
  return { ...call, values: Object.fromEntries(values) as Call["values"] };
}

function takesOf(args: Args): string {
  const names = Object.entries(args).map(([name, { terms }]) => (terms.default === undefined ? name : `[${name}]`));
  return names.length ? names.join(" ") : "nothing";
}

function valueOf({ type, terms }: Arg<unknown>, name: string, word: Word): number | string {
  if (type === "attachment") return word.text;
  if (type === "word") {
    const choices = terms.choices as readonly string[] | undefined;
    if (!choices || choices.includes(word.text)) return word.text;
    const nearest = word.nearest(choices);
    throw syntax(word.at, `${name} is one of ${choices.join(", ")}, not \`${word.short()}\`; did you mean \`${nearest}\`?`, { nearest });
  }
  const number = type === "whole" ? wholeOf(word.text) : numberOf(word.text);
  const { min = -Infinity, max = Infinity } = terms;
  if (number !== undefined && number >= min && number <= max) return number;
  throw syntax(word.at, `${name} is ${type === "whole" ? "a whole number" : "a number"}${rangeOf(terms)}, not \`${word.short()}\``);
}

function rangeOf({ min, max, unit }: ArgTerms<unknown>): string {
  const of = unit === undefined ? "" : ` (${unit})`;
  if (min !== undefined && max !== undefined) return ` from ${min} to ${max}${of}`;
  if (min !== undefined) return ` of at least ${min}${of}`;
  return max === undefined ? of : ` of at most ${max}${of}`;
}

/** What a card is made of. */
export interface Declared {
  readonly name: string;
  readonly does: string;
  readonly verbs: { readonly [name: string]: Verb };
  readonly state?: { readonly [name: string]: Arg<number> | Arg<string> } | undefined;
  readonly stopsWithin: number;
  readonly cameras?: readonly string[] | undefined;
}

/** What the device can do, as a plain map; keys that say nothing are left out. */
export function cardOf({ name, does, verbs, state, stopsWithin, cameras }: Declared): Fields {
  const told = Object.entries(state ?? {}).map(([key, { type, terms }]) => defined({ name: key, type, unit: terms.unit, does: terms.does }));
  return defined({
    card: 1,
    name,
    does,
    verbs: Object.entries(verbs).map(([key, each]) => verbCard(key, each)),
    state: told.length ? told : undefined,
    "stops-within": stopsWithin,
    "on-loss": "halt",
    cameras: cameras?.length ? cameras : undefined,
  });
}

function verbCard(name: string, { kind, does, args }: Verb): Fields {
  const told = Object.entries(args).map(([key, arg]) => argCard(key, arg as Arg<Value>));
  const is = (which: Kind): true | undefined => (kind === which ? true : undefined);
  return defined({ name, does, args: told.length ? told : undefined, moves: kind !== "instant", relative: is("relative"), velocity: is("velocity") });
}

function argCard(name: string, { type, terms }: Arg<Value>): Fields {
  const { unit, min, max, choices } = terms;
  return defined({ name, type, unit, min, max, choices, default: terms.default });
}

/** A refusal that says which place the device cannot reach: for `plan`. */
export function outOfReach(text: string, reachable?: Fields): DeviceError {
  return new DeviceError("workspace-boundary", text, reachable ? { reachable } : {});
}
