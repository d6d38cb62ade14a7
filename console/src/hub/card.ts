// What a device says of itself, by the form of mom-proto/src/card.rs. It is the device's word only: it is shown, and nothing relies on it.
import type { Plain, PlainFields } from "../worker/protocol.js";
import { fields, flag, number, text } from "./fields.js";
import { visible } from "./said.js";

export type ArgType = "number" | "whole" | "word" | "attachment";

export interface CardArg {
  name: string;
  type: ArgType;
  unit: string;
  min?: number | undefined;
  max?: number | undefined;
  /** Words that may stand there: of a word the only ones, of a number beside numbers. */
  choices: readonly string[];
  /** What holds where it is left out, as a script would say it; empty where only that it may be left out is known. */
  default?: string | undefined;
}

export interface CardVerb {
  name: string;
  does: string;
  args: readonly CardArg[];
  /** So many of the last arguments may be said again and again. */
  repeats: number;
  moves: boolean;
  relative: boolean;
  velocity: boolean;
  inPlace: boolean;
  last: boolean;
}

/** A field of its state. */
export interface CardField {
  name: string;
  unit: string;
  does: string;
}

export interface Card {
  name: string;
  does: string;
  verbs: readonly CardVerb[];
  state: readonly CardField[];
}

const VERSION = 1;
const TYPES: readonly ArgType[] = ["number", "whole", "word", "attachment"];
/** Letters that are shown of what is for people, and of a unit. */
const MOST_WORDS = 400;
const MOST_UNIT = 24;

class Malformed extends Error {}

/** A word of a script. */
function nameOf(value: Plain | undefined): string {
  if (typeof value !== "string" || value === "" || /[\s;#]/u.test(value) || visible(value) !== value) throw new Malformed();
  return value;
}

function shown(value: PlainFields, key: string, most: number): string {
  const said = visible(text(value, key) ?? "");
  return said.length > most ? `${said.slice(0, most)}…` : said;
}

function bound(value: PlainFields, key: string): number | undefined {
  const found = number(value, key);
  return found !== undefined && Number.isFinite(found) ? found : undefined;
}

function listed(value: PlainFields, key: string): Plain[] {
  const found = value[key] ?? [];
  if (!Array.isArray(found)) throw new Malformed();
  return found;
}

function defaultOf(value: Plain | undefined): string | undefined {
  return value === undefined || value === null ? undefined : String(value);
}

function argOf(said: Plain): CardArg {
  const value = fields(said);
  const type = TYPES.find((known) => known === value["type"]);
  if (!type) throw new Malformed();
  return { name: nameOf(value["name"]), type, unit: shown(value, "unit", MOST_UNIT), min: bound(value, "min"), max: bound(value, "max"), choices: listed(value, "choices").map(nameOf), default: defaultOf(value["default"]) };
}

function verbOf(said: Plain): CardVerb {
  const value = fields(said);
  const args = listed(value, "args").map(argOf);
  const repeats = Math.min(Math.max(bound(value, "repeats") ?? 0, 0), args.length);
  const [moves, relative, velocity, inPlace, last] = ["moves", "relative", "velocity", "in-place", "last"].map((key) => flag(value, key)) as [boolean, boolean, boolean, boolean, boolean];
  return { name: nameOf(value["name"]), does: shown(value, "does", MOST_WORDS), args, repeats, moves, relative, velocity, inPlace, last };
}

function fieldOf(said: Plain): CardField {
  const value = fields(said);
  return { name: nameOf(value["name"]), unit: shown(value, "unit", MOST_UNIT), does: shown(value, "does", MOST_WORDS) };
}

/** The card that a content is; undefined for what is not of this form. */
export function cardOf(said: PlainFields): Card | undefined {
  if (number(said, "card") !== VERSION) return undefined;
  try {
    return { name: nameOf(said["name"]), does: shown(said, "does", MOST_WORDS), verbs: listed(said, "verbs").map(verbOf), state: listed(said, "state").map(fieldOf) };
  } catch (error) {
    if (error instanceof Malformed) return undefined;
    throw error;
  }
}

/** The statement as help shows it: `move x/mm y/mm [speed/mm/s]`. */
export function usageOf({ name, args, repeats }: CardVerb): string {
  const words = args.map((arg) => {
    const choices = arg.choices.join("|");
    const word = !choices ? (arg.unit ? `${arg.name}/${arg.unit}` : arg.name) : arg.type === "word" ? choices : `${choices}|${arg.name}`;
    return arg.default === undefined ? word : `[${word}]`;
  });
  return [name, ...words, ...(repeats ? ["…"] : [])].join(" ");
}

export function verbNamed(card: Card | undefined, name: string): CardVerb | undefined {
  return card?.verbs.find((verb) => verb.name === name);
}

/** Whether a verb has arguments of these names, each a number, and behind them only such as may be left out. */
function takes(verb: CardVerb | undefined, names: readonly string[]): boolean {
  return verb !== undefined && names.every((name, place) => verb.args[place]?.name === name && verb.args[place]?.type === "number") && verb.args.slice(names.length).every((arg) => arg.default !== undefined);
}

/** Whether it takes poses of a hand, as the lab's arm does. */
export function takesPoses(card: Card | undefined): boolean {
  return takes(verbNamed(card, "move"), ["x", "y", "z", "spin", "tilt"]);
}

/** Whether its hand is driven by velocities, as the lab's arm is. */
export function takesVelocities(card: Card | undefined): boolean {
  const jog = verbNamed(card, "jog");
  return jog?.velocity === true && takes(jog, ["vx", "vy", "vz", "vspin", "vtilt"]);
}
