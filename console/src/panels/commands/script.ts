// The devices' scripts, read as the devices read them (lab/arm/src/script.rs, lab/camera/src/pan/script.rs), so that mistakes show while one types.

export type Language = "arm" | "mount";

/** One statement, and where it stands in the text: from the first letter to behind the last. */
export interface Statement {
  verb: string;
  numbers: number[];
  words: string[];
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
/** mm/s and degrees/s of the hand. */
export const SPEED = 150;
export const TURN_SPEED = 90;
const MOST_JOG = 1000;

const GRIPS = ["open", "close"] as const;
const VERBS: Record<Language, readonly string[]> = {
  arm: ["move", "by", "grip", "wait", "jog", "home", "reset"],
  mount: ["look", "turn", "home", "wait"],
};
/** What each verb with numbers takes, in words. */
const TAKES: Record<string, { takes: string; names: string[] }> = {
  move: { takes: "five numbers, x y z spin tilt", names: ["x", "y", "z", "spin", "tilt"] },
  by: { takes: "five numbers, dx dy dz dspin dtilt", names: ["dx", "dy", "dz", "dspin", "dtilt"] },
  jog: { takes: "five velocities, vx vy vz vspin vtilt", names: ["vx", "vy", "vz", "vspin", "vtilt"] },
  look: { takes: "two angles, pan tilt", names: ["pan", "tilt"] },
  turn: { takes: "two angles, dpan dtilt", names: ["dpan", "dtilt"] },
};

const BLANK = "\\t-\\r \\u0085\\u00A0\\u1680\\u2000-\\u200A\\u2028\\u2029\\u202F\\u205F\\u3000";
const WORD = new RegExp(`[^${BLANK}]+`, "gu");
const NUMBER = /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i;
const WHOLE = /^\+?\d+$/;

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
  return letters.length > 24 ? `${letters.slice(0, 24).join("")}…` : word;
}

/** How many letters must be changed, added or left out to make one word of the other. */
function edits(word: string, known: string): number {
  const other = [...known];
  const row = Array.from({ length: other.length + 1 }, (_, place) => place);
  [...word].forEach((letter, place) => {
    let diagonal = row[0]!;
    row[0] = place + 1;
    other.forEach((wanted, column) => {
      const changed = diagonal + (letter === wanted ? 0 : 1);
      diagonal = row[column + 1]!;
      row[column + 1] = Math.min(changed, diagonal + 1, row[column]! + 1);
    });
  });
  return row[other.length]!;
}

function unknown(word: Word, known: readonly string[]): Fault {
  const lower = word.text.toLowerCase();
  const nearest = known.reduce((best, candidate) => (edits(lower, candidate) < edits(lower, best) ? candidate : best));
  return new Fault(word.at, `there is no \`${short(word.text)}\`; did you mean \`${nearest}\`?`, nearest);
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

  number(verb: string, takes: string, which: string): number {
    const word = this.need(verb, takes, which);
    const value = NUMBER.test(word.text) ? Number(word.text) : NaN;
    if (!Number.isFinite(value)) throw new Fault(word.at, `${which} is \`${short(word.text)}\`, which is not a number`);
    return value;
  }
}

function whole(word: Word, least: number, most: number): number | undefined {
  const value = WHOLE.test(word.text) ? Number(word.text) : NaN;
  return value >= least && value <= most ? value : undefined;
}

function readJog(words: Words): number[] {
  const at = words.end;
  const { takes, names } = TAKES["jog"]!;
  const numbers = names.map((name) => words.number("jog", takes, name));
  const [x, y, z, spin, tilt] = numbers as [number, number, number, number, number];
  const [linear, turn] = [Math.hypot(x, y, z), Math.max(Math.abs(spin), Math.abs(tilt))];
  if (linear > SPEED) throw new Fault(at, `${linear.toFixed(0)} mm/s is too fast, the hand moves at ${SPEED} at most`);
  if (turn > TURN_SPEED) throw new Fault(at, `${turn.toFixed(0)} degrees/s is too fast, the hand turns at ${TURN_SPEED} at most`);
  const word = words.next();
  if (!word) return numbers;
  const ms = whole(word, 1, MOST_JOG);
  if (ms === undefined) throw new Fault(word.at, `\`jog\` lasts a whole number of ms from 1 to ${MOST_JOG}, not \`${short(word.text)}\``);
  return [...numbers, ms];
}

function readStatement(verb: Word, words: Words, language: Language): Statement {
  const statement: Statement = { verb: verb.text, numbers: [], words: [], from: verb.at, to: verb.at + verb.text.length };
  if (!VERBS[language].includes(verb.text)) throw unknown(verb, VERBS[language]);
  const takes = TAKES[verb.text];
  if (verb.text === "jog") statement.numbers = readJog(words);
  else if (takes) statement.numbers = takes.names.map((name) => words.number(verb.text, takes.takes, name));
  else if (verb.text === "grip") {
    const word = words.need("grip", "`open` or `close`", "it");
    if (!GRIPS.some((grip) => grip === word.text)) throw unknown(word, GRIPS);
    statement.words = [word.text];
  } else if (verb.text === "wait") {
    const word = words.need("wait", "a time in ms", "it");
    const ms = whole(word, 0, MAX_WAIT);
    if (ms === undefined) throw new Fault(word.at, `\`wait\` takes a whole number of ms from 0 to ${MAX_WAIT}, not \`${short(word.text)}\``);
    statement.numbers = [ms];
  }
  statement.to = words.end > verb.at ? words.end : statement.to;
  const rest = words.next();
  if (rest) throw new Fault(rest.at, `\`${verb.text}\` ends before \`${short(rest.text)}\`; is a \`;\` or a new line missing?`);
  return statement;
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

function statementsOf(text: string, language: Language): Statement[] {
  const length = bytes(text);
  if (length > MAX_BYTES) throw new Fault(text.length, `the script has ${length} bytes, at most ${MAX_BYTES} are read`);
  const statements: Statement[] = [];
  for (const words of split(text)) {
    const verb = words.next();
    if (!verb) continue;
    if (statements.length === MAX_STATEMENTS) throw new Fault(verb.at, `the script has more than ${MAX_STATEMENTS} statements`);
    try {
      statements.push(readStatement(verb, words, language));
    } catch (fault) {
      if (fault instanceof Fault) fault.statement = statements.length + 1;
      throw fault;
    }
  }
  const jog = statements.length > 1 ? statements.findIndex(({ verb }) => verb === "jog") : -1;
  if (jog >= 0) {
    const fault = new Fault(0, "`jog` stands alone in its script");
    fault.statement = jog + 1;
    throw fault;
  }
  if (!statements.length) throw new Fault(0, "the script has no statement");
  return statements;
}

/** Reads a script. */
export function read(text: string, language: Language = "arm"): Reading {
  try {
    return { statements: statementsOf(text, language) };
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
export function isRelative(text: string, language: Language = "arm"): boolean {
  const { statements } = read(text, language);
  const first = statements?.find(({ verb }) => (language === "arm" ? ["move", "home", "reset", "by"] : ["look", "turn", "home"]).includes(verb));
  return first?.verb === "by" || first?.verb === "turn";
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

/** The mistakes of a text, each in its line of the whole. */
export function mistakesOf(text: string, language: Language = "arm"): Mistake[] {
  return commandsOf(text).flatMap(({ line, indent, at, text: command }) => {
    const { mistake } = read(command, language);
    return mistake ? [{ ...mistake, line, column: [...text.slice(at - indent, at)].length + mistake.column, index: at + mistake.index }] : [];
  });
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
export function replaced(text: string, statement: number, by: string, language: Language = "arm"): string {
  const found = read(text, language).statements?.[statement - 1];
  return found ? text.slice(0, found.from) + by + text.slice(found.to) : text;
}
