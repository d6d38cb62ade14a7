// Scripts, read by the card of their device as kit/device/src/carded.rs reads them: mistakes show while one types. The device decides.
import { type Card, type CardArg, type CardVerb, usageOf, verbNamed } from "../../hub/card.js";

/** One statement, and where it stands in the text: from the first letter to behind the last. */
export interface Statement {
  verb: string;
  /** What the card says of it; undefined of `wait`, which every device has. */
  said: CardVerb | undefined;
  from: number;
  to: number;
}

/** A mistake, as the device would say it. */
export interface Mistake {
  text: string;
  /** 1 for the first; undefined where it concerns the whole. */
  statement?: number;
  /** The byte of the script. */
  position: number;
  /** The same in the text as this language counts. */
  index: number;
  /** 1 for the first, columns in characters. */
  line: number;
  column: number;
  nearest?: string;
}

export type Reading = { statements: Statement[]; mistake?: undefined } | { statements?: undefined; mistake: Mistake };

export const MAX_BYTES = 64 * 1024;
export const MAX_STATEMENTS = 1000;
export const MAX_WAIT = 60_000;

/** What every device has, and no card says. */
const WAIT = "wait";
/** Of a wrong word so many letters are repeated. */
const LONGEST_WORD = 24;
/** Of known words so many are compared with an unknown one, those of so many letters at most, as mom-nearest does. */
const CANDIDATES = 128;
const LONGEST_CANDIDATE = 64;
/** A card may have a verb with thousands of choices: so much of its usage is told. */
const LONGEST_USAGE = 300;

const BLANK = "\\t-\\r \\u0085\\u00A0\\u1680\\u2000-\\u200A\\u2028\\u2029\\u202F\\u205F\\u3000";
const WORD = new RegExp(`[^${BLANK}]+`, "gu");
const NUMBER = /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i;
const WHOLE = /^[+-]?\d+$/;
const MS = /^\+?\d+$/;

interface Word {
  text: string;
  at: number;
}

const bytes = (text: string): number => new TextEncoder().encode(text).length;

class Fault extends Error {
  statement: number | undefined;

  constructor(
    readonly at: number,
    readonly words: string,
    readonly nearest?: string,
  ) {
    super(words);
  }
}

/** The word for an error's text, shortened. */
function short(word: string): string {
  const letters = [...word];
  return letters.length > LONGEST_WORD ? `${letters.slice(0, LONGEST_WORD).join("")}…` : word;
}

/** How many letters must be changed, added, left out or swapped with the next to make one word of the other. */
function edits(word: readonly string[], known: readonly string[]): number {
  let [before, last]: [number[], number[]] = [[], known.map((_, place) => place).concat(known.length)];
  word.forEach((letter, row) => {
    const now = [row + 1];
    known.forEach((wanted, column) => {
      const least = Math.min(last[column]! + (letter === wanted ? 0 : 1), last[column + 1]! + 1, now[column]! + 1);
      const swapped = row > 0 && column > 0 && letter === known[column - 1] && word[row - 1] === wanted;
      now.push(swapped ? Math.min(least, before[column - 1]! + 1) : least);
    });
    [before, last] = [last, now];
  });
  return last[known.length]!;
}

/** What is wrong with a word that is none of those that are known. */
function unknown(word: string, known: readonly string[]): { words: string; nearest: string } {
  const meant = [...short(word).toLowerCase()];
  let [nearest, least] = ["", Infinity];
  for (const candidate of known.slice(0, CANDIDATES)) {
    if (bytes(candidate) > LONGEST_CANDIDATE) continue;
    const count = edits(meant, [...candidate]);
    if (count < least) [nearest, least] = [candidate, count];
  }
  return { words: `there is no \`${short(word)}\`; did you mean \`${nearest}\`?`, nearest };
}

/** The words of one statement that are still to be read. */
class Words {
  readonly #words: Word[];
  #end: number;
  #next = 0;

  constructor(text: string, offset: number) {
    this.#words = [...text.matchAll(WORD)].map((match) => ({ text: match[0], at: offset + match.index }));
    this.#end = offset;
    this.length = offset + text.length;
  }

  /** Where the statement's text ends. */
  readonly length: number;

  get isOver(): boolean {
    return this.#next >= this.#words.length;
  }

  next(): Word | undefined {
    const word = this.#words[this.#next];
    if (word) {
      this.#next += 1;
      this.#end = word.at + word.text.length;
    } else this.#end = this.length;
    return word;
  }

  /** Behind the last word that was read. */
  get end(): number {
    return this.#end;
  }

  need(verb: string, takes: string, which: string): Word {
    const word = this.next();
    if (!word) throw new Fault(this.#end, `\`${verb}\` takes ${takes}; ${which} is missing`);
    return word;
  }
}

/** A whole number has 64 bits. */
function wholeOf(word: string): number | undefined {
  if (!WHOLE.test(word) || word.length > LONGEST_WORD) return undefined;
  const whole = BigInt(word.replace("+", ""));
  return BigInt.asIntN(64, whole) === whole ? Number(whole) : undefined;
}

function numberOf(type: CardArg["type"], word: string): number | undefined {
  if (type === "whole") return wholeOf(word);
  const number = NUMBER.test(word) ? Number(word) : NaN;
  return Number.isFinite(number) ? number : undefined;
}

/** The numbers that an argument takes, such as `0 to 100 mm`; undefined if it takes all. */
export function rangeOf({ min, max, unit }: CardArg): string | undefined {
  if (min === undefined && max === undefined) return undefined;
  const range = max === undefined ? `${min} and more` : min === undefined ? `${max} and less` : `${min} to ${max}`;
  return unit ? `${range} ${unit}` : range;
}

/** What is wrong with a word as this argument of a verb, undefined if nothing is. */
export function faultOf(verb: CardVerb, arg: CardArg, word: string): { words: string; nearest?: string } | undefined {
  const { name, type, choices, min = -Infinity, max = Infinity } = arg;
  if (choices.includes(word)) return undefined;
  if (type === "word" || type === "attachment") return choices.length ? unknown(word, choices) : undefined;
  const number = numberOf(type, word);
  if (number === undefined) return { words: `${name} is \`${short(word)}\`, which is not a ${type === "whole" ? "whole number" : "number"}` };
  return number < min || number > max ? { words: `${name} is ${short(word)}, \`${verb.name}\` takes ${rangeOf(arg)}` } : undefined;
}

function readArgument(verb: CardVerb, arg: CardArg, words: Words): void {
  const usage = words.isOver ? usageOf(verb) : "";
  const word = words.need(verb.name, `\`${usage.length > LONGEST_USAGE ? `${usage.slice(0, LONGEST_USAGE)}…` : usage}\``, arg.name);
  const fault = faultOf(verb, arg, word.text);
  if (fault) throw new Fault(word.at, fault.words, fault.nearest);
}

function readArguments(verb: CardVerb, words: Words): void {
  for (const arg of verb.args) {
    if (words.isOver && arg.default !== undefined) return;
    readArgument(verb, arg, words);
  }
  const again = verb.args.slice(verb.args.length - verb.repeats);
  while (again.length && !words.isOver) for (const arg of again) readArgument(verb, arg, words);
}

function readWait(words: Words): void {
  const { text, at } = words.need(WAIT, "a time in ms", "it");
  if (!MS.test(text) || Number(text) > MAX_WAIT) throw new Fault(at, `\`wait\` takes a whole number of ms from 0 to ${MAX_WAIT}, not \`${short(text)}\``);
}

function readStatement(card: Card, verb: Word, words: Words): Statement {
  const said = verb.text === WAIT ? undefined : verbNamed(card, verb.text);
  if (said) readArguments(said, words);
  else if (verb.text === WAIT) readWait(words);
  else {
    const { words: why, nearest } = unknown(verb.text, [...card.verbs.slice(0, CANDIDATES).map(({ name }) => name), WAIT]);
    throw new Fault(verb.at, why, nearest);
  }
  const to = Math.max(words.end, verb.at + verb.text.length);
  const rest = words.next();
  if (rest) throw new Fault(rest.at, `\`${verb.text}\` ends before \`${short(rest.text)}\`; is a \`;\` or a new line missing?`);
  return { verb: verb.text, said, from: verb.at, to };
}

/** The statements of a text as words, without comments; some may have no word. */
function* split(text: string): Generator<Words> {
  let line = 0;
  for (const whole of text.split("\n")) {
    const comment = whole.indexOf("#");
    let at = line;
    for (const part of (comment < 0 ? whole : whole.slice(0, comment)).split(";")) {
      yield new Words(part, at);
      at += part.length + 1;
    }
    line += whole.length + 1;
  }
}

/** That each statement may stand where it does. */
function checkPlaces(statements: readonly Statement[]): void {
  const count = statements.length;
  const place = statements.findIndex(({ said }, place) => (said?.velocity && count > 1) || (said?.last && place + 1 !== count));
  const stray = statements[place];
  if (!stray) return;
  const fault = new Fault(stray.from, `\`${stray.verb}\` ${stray.said?.velocity ? "stands alone in" : "must be the last statement of"} its script`);
  fault.statement = place + 1;
  throw fault;
}

function statementsOf(text: string, card: Card): Statement[] {
  const length = bytes(text);
  if (length > MAX_BYTES) throw new Fault(text.length, `the script has ${length} bytes, at most ${MAX_BYTES} are read`);
  const statements: Statement[] = [];
  for (const words of split(text)) {
    const verb = words.next();
    if (!verb) continue;
    if (statements.length === MAX_STATEMENTS) throw new Fault(verb.at, `the script has more than ${MAX_STATEMENTS} statements`);
    try {
      statements.push(readStatement(card, verb, words));
    } catch (fault) {
      if (fault instanceof Fault) fault.statement = statements.length + 1;
      throw fault;
    }
  }
  if (!statements.length) throw new Fault(0, "the script has no statement");
  checkPlaces(statements);
  return statements;
}

/** Reads a script as the device of this card would; it may refuse more, such as what is out of its reach. */
export function read(text: string, card: Card): Reading {
  try {
    return { statements: statementsOf(text, card) };
  } catch (fault) {
    if (!(fault instanceof Fault)) throw fault;
    const before = text.slice(0, fault.at);
    const { statement, nearest } = fault;
    const mistake: Mistake = {
      text: statement === undefined ? fault.words : `statement ${statement}: ${fault.words}`,
      position: bytes(before),
      index: fault.at,
      line: before.split("\n").length,
      column: [...before.slice(before.lastIndexOf("\n") + 1)].length + 1,
    };
    if (statement !== undefined) mistake.statement = statement;
    if (nearest !== undefined) mistake.nearest = nearest;
    return { mistake };
  }
}

/** Whether a script is right from one place only: its first motion says only how far it goes. */
export function isRelative(text: string, card: Card): boolean {
  const first = read(text, card).statements?.find(({ said }) => said?.moves && !said.inPlace);
  return first?.said?.relative ?? false;
}

/** One command of a text: a line without its comment. */
export interface Command {
  /** 1 for the first. */
  line: number;
  /** How many letters of the line are before the text. */
  indent: number;
  /** Where it begins in the whole text. */
  at: number;
  text: string;
  /** The same with its comment. */
  whole: string;
}

/** The commands of a text, one for each line; lines with nothing but blanks and comments are none. */
export function commandsOf(text: string): Command[] {
  const found: Command[] = [];
  let at = 0;
  text.split("\n").forEach((line, index) => {
    const comment = line.indexOf("#");
    const code = comment < 0 ? line : line.slice(0, comment);
    const trimmed = code.trim();
    const indent = code.length - code.trimStart().length;
    if (trimmed.replace(/[; \t]/g, "") !== "") found.push({ line: index + 1, indent, at: at + indent, text: trimmed, whole: line.trim() });
    at += line.length + 1;
  });
  return found;
}

/** The first mistakes of a text, each in its line of the whole. */
export function mistakesOf(text: string, card: Card, most = Infinity): Mistake[] {
  const found: Mistake[] = [];
  for (const { line, indent, at, text: command } of commandsOf(text)) {
    if (found.length >= most) break;
    const { mistake } = read(command, card);
    if (mistake) found.push({ ...mistake, line, column: [...text.slice(at - indent, at)].length + mistake.column, index: at + mistake.index });
  }
  return found;
}

/** A number as a person would write it, with one decimal at most. */
export function tenth(value: number): string {
  return String(Math.round(value * 10) / 10 + 0);
}

/** `move x y z spin tilt` for a pose. */
export function moveTo(pose: readonly number[]): string {
  return `move ${pose.map(tenth).join(" ")}`;
}

/** The text with one of its statements replaced. */
export function replaced(text: string, statement: number, by: string, card: Card): string {
  const found = read(text, card).statements?.[statement - 1];
  return found ? text.slice(0, found.from) + by + text.slice(found.to) : text;
}
