// Scripts of a device: statements separated by `;` or by a new line, comments from `#` on.
import { type Fields, type Value, fieldsOf } from "../index.js";
import { DeviceError, syntax } from "./errors.js";
import { mostSimilar } from "./nearest.js";

/** The longest script, in bytes. */
export const MAX_BYTES = 64 * 1024;
/** The most statements of a script. */
export const MAX_STATEMENTS = 1000;
/** The most bytes that came with the scripts of one device that wait and are carried out. */
export const MAX_ATTACHED = 8 << 20;
/** The longest `wait`, in ms. */
export const MAX_WAIT = 60_000;
const WAIT = "wait";
/** The longest part of a wrong word that an error repeats, in letters. */
const LONGEST_WORD = 24;

const utf8 = new TextEncoder();

/** How many bytes a text has. */
function bytesOf(text: string): number {
  return utf8.encode(text).length;
}

/** A word of a script, and the byte at which it begins. */
export class Word {
  constructor(
    readonly text: string,
    readonly at: number,
  ) {}

  /** The word for an error's text, shortened. */
  short(): string {
    const letters = [...this.text];
    return letters.length > LONGEST_WORD ? `${letters.slice(0, LONGEST_WORD).join("")}…` : this.text;
  }

  /** The most similar of some known words, without regard to case. */
  nearest(known: readonly string[]): string {
    return mostSimilar(this.short().toLowerCase(), known);
  }
}

/** The words of one statement that are still to be read. */
export class Words {
  #rest: string;
  #at: number;

  constructor(rest: string, at: number) {
    [this.#rest, this.#at] = [rest, at];
  }

  /** The next word, if there is one. */
  next(): Word | undefined {
    const [blank, text] = /^(\p{White_Space}*)(\P{White_Space}*)/u.exec(this.#rest)!.slice(1) as [string, string];
    this.#at += bytesOf(blank);
    const word = new Word(text, this.#at);
    this.#at += bytesOf(text);
    this.#rest = this.#rest.slice(blank.length + text.length);
    return text ? word : undefined;
  }

  /** Whether none is left. */
  get isOver(): boolean {
    return !/\P{White_Space}/u.test(this.#rest);
  }

  /** The next word, which is `which` of what `verb` takes. */
  need(verb: string, takes: string, which: string): Word {
    const word = this.next();
    if (!word) throw syntax(this.#at, `\`${verb}\` takes ${takes}; ${which} is missing`);
    return word;
  }

  /** The next word as a number. */
  number(verb: string, takes: string, which: string): number {
    const word = this.need(verb, takes, which);
    const number = numberOf(word.text);
    if (number === undefined) throw syntax(word.at, `${which} is \`${word.short()}\`, which is not a number`);
    return number;
  }
}

/** A decimal number, if the text is one; what is too large to be finite is none. */
export function numberOf(text: string): number | undefined {
  const number = /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i.test(text) ? Number(text) : NaN;
  return Number.isFinite(number) ? number : undefined;
}

/** A whole number, if the text is one. */
export function wholeOf(text: string): number | undefined {
  const number = /^[+-]?\d+$/.test(text) ? Number(text) : NaN;
  // `-0` is 0 for who reads it.
  return Number.isSafeInteger(number) ? number + 0 : undefined;
}

/** Bytes that come with a script, by the names that its statements use. */
export class Attachments {
  readonly #bytes: ReadonlyMap<string, Uint8Array>;

  constructor(bytes: Iterable<[string, Uint8Array]> = []) {
    this.#bytes = new Map(bytes);
  }

  /** Those of a map of names to bytes. */
  static of(map: Fields): Attachments {
    const bytes = Object.entries(map).map(([name, value]): [string, Uint8Array] => {
      if (value instanceof Uint8Array) return [name, value];
      throw new DeviceError("syntax", `the attachment \`${name}\` must be bytes`);
    });
    return new Attachments(bytes);
  }

  /** How many bytes they have. */
  get size(): number {
    return [...this.#bytes.values()].reduce((sum, bytes) => sum + bytes.length, 0);
  }

  /** The bytes of this name. */
  get(name: string): Uint8Array {
    const bytes = this.#bytes.get(name);
    if (bytes) return bytes;
    const names = [...this.#bytes.keys()].sort();
    const missing = `\`${name}\` did not come with the script`;
    throw new DeviceError("syntax", names.length ? `${missing}, but ${names.join(", ")}` : `${missing}: it has no attachments`);
  }
}

/** One statement: what the device does, or for how many ms nothing is begun. */
export type Statement<A> = { readonly action: A } | { readonly wait: number };

/** A script: between 1 and {@link MAX_STATEMENTS} statements. */
export class Script<A> {
  constructor(
    readonly statements: readonly Statement<A>[],
    /** How many bytes came with it. */
    readonly attached = 0,
  ) {}

  /** What the device does, with the number of each statement (1 for the first). */
  actions(): [action: A, number: number][] {
    return this.statements.flatMap((statement, at) => ("action" in statement ? [[statement.action, at + 1] as [A, number]] : []));
  }
}

/** What reads the statements of a machine. */
export interface Reader<A> {
  /** The first words of its statements, without `wait`. */
  readonly verbs: readonly string[];
  /** What follows the verb; undefined if there is no such verb. Throws `syntax` at the word that is wrong. */
  read(verb: Word, words: Words): A | undefined;
  /** The action with the bytes that it names. Throws `syntax` if they did not come. */
  attach(action: A, attachments: Attachments): A;
  /** Whether it is the only statement of its script. */
  standsAlone?(action: A): boolean;
}

/**
 * Reads a script. Throws `syntax` with the statement's number, where the mistake begins, and the nearest known word where one is unknown.
 */
export function readScript<A>(text: string, reader: Reader<A>, attachments = new Attachments()): Script<A> {
  const statements = placed(text, () => statementsOf(text, reader)).map((statement, at): Statement<A> => {
    if (!("action" in statement)) return statement;
    return { action: atStatement(at + 1, () => reader.attach(statement.action, attachments)) };
  });
  return new Script(statements, attachments.size);
}

function statementsOf<A>(text: string, reader: Reader<A>): Statement<A>[] {
  const length = bytesOf(text);
  if (length > MAX_BYTES) throw syntax(MAX_BYTES, `the script has ${length} bytes, at most ${MAX_BYTES} are read`);
  const statements: Statement<A>[] = [];
  const alone: [verb: Word, statement: number][] = [];
  for (const words of split(text)) {
    const verb = words.next();
    if (!verb) continue;
    if (statements.length === MAX_STATEMENTS) throw syntax(verb.at, `the script has more than ${MAX_STATEMENTS} statements`);
    const statement = atStatement(statements.length + 1, () => statementOf(verb, words, reader));
    statements.push(statement);
    if ("action" in statement && reader.standsAlone?.(statement.action)) alone.push([verb, statements.length]);
  }
  if (!statements.length) throw syntax(0, "the script has no statement");
  const [first] = alone;
  if (first && statements.length > 1) throw syntax(first[0].at, `\`${first[0].text}\` stands alone in its script`).atStatement(first[1]);
  return statements;
}

/** The statements of a script as words, without their comments; some may have no word. */
function* split(text: string): Generator<Words> {
  let lineAt = 0;
  for (const line of text.split("\n")) {
    let at = lineAt;
    for (const rest of line.split("#", 1)[0]!.split(";")) {
      yield new Words(rest, at);
      at += bytesOf(rest) + 1;
    }
    lineAt += bytesOf(line) + 1;
  }
}

function statementOf<A>(verb: Word, words: Words, reader: Reader<A>): Statement<A> {
  const statement = verb.text === WAIT ? { wait: waitOf(words) } : actionOf(verb, words, reader);
  const word = words.next();
  if (word) throw syntax(word.at, `\`${verb.text}\` ends before \`${word.short()}\`; is a \`;\` or a new line missing?`);
  return statement;
}

function actionOf<A>(verb: Word, words: Words, reader: Reader<A>): Statement<A> {
  const action = reader.read(verb, words);
  if (action !== undefined) return { action };
  const nearest = verb.nearest([...reader.verbs, WAIT]);
  throw syntax(verb.at, `there is no \`${verb.short()}\`; did you mean \`${nearest}\`?`, { nearest });
}

function waitOf(words: Words): number {
  const word = words.need(WAIT, "a time in ms", "it");
  const ms = /^\+?\d+$/.test(word.text) ? Number(word.text) : NaN;
  if (!(ms <= MAX_WAIT)) throw syntax(word.at, `\`wait\` takes a whole number of ms from 0 to ${MAX_WAIT}, not \`${word.short()}\``);
  return ms;
}

/** What is thrown meanwhile is said of this statement. */
export function atStatement<T>(statement: number, act: () => T): T {
  try {
    return act();
  } catch (error) {
    throw error instanceof DeviceError ? error.atStatement(statement) : error;
  }
}

/** What is thrown meanwhile has the line and the column of its position in this script. */
function placed<T>(script: string, act: () => T): T {
  try {
    return act();
  } catch (error) {
    if (!(error instanceof DeviceError) || error.details.position === undefined) throw error;
    const before = new TextDecoder().decode(utf8.encode(script).subarray(0, error.details.position)).split("\n");
    const place = { line: before.length, column: [...before.at(-1)!].length + 1 };
    throw new DeviceError(error.word, error.text, { ...error.details, ...place });
  }
}

/** The script of a command's content, and the bytes that came with it. */
export function scriptOf(name: string, content: Value | undefined): { text: string; attachments: Attachments } {
  if (typeof content === "string") return { text: content, attachments: new Attachments() };
  const { script, attachments } = fieldsOf(content);
  if (typeof script !== "string") {
    throw new DeviceError("syntax", `the content of a command is a string, the script of ${name}, or {script, attachments}`);
  }
  if (attachments === undefined) return { text: script, attachments: new Attachments() };
  if (!isMap(attachments)) throw new DeviceError("syntax", "attachments are a map of names to bytes");
  return { text: script, attachments: Attachments.of(fieldsOf(attachments)) };
}

function isMap(value: Value): boolean {
  return value instanceof Map || (typeof value === "object" && value !== null && Object.getPrototypeOf(value) === Object.prototype);
}
