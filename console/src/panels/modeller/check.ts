// What is wrong in a model, at which field, in words: the same that `mom rsp check` finds, but all of it at once.
import { modeller as t } from "../../texts/modeller.js";
import { BOUNDS, DEFAULTS, type Draft, FIELDS, type Field, HEADER, type Kind, MODEL_FIELDS, MOST_ELEMENTS, MOTIONS, type ModelField, NUMBER_SIZES, type Payload, type Row, TAG, type Way, hasField, isKind, isNumber, isType, mapSize, packetSize, payloadSize, soundOf } from "./model.js";

const m = t.mistakes;
const LONGEST_NAME = 48;
const LONGEST_UNIT = 16;
const LONGEST_DOC = 4096;

export interface Checked {
  /** By field. */
  model: { readonly [field in ModelField]?: string };
  /** By element and field. */
  elements: readonly { readonly [field in Field]?: string }[];
  /** What is wrong with the whole. */
  whole: readonly string[];
  payloads: readonly (Payload | undefined)[];
  /** T, ms. */
  period: number;
  largest: number;
  count: number;
}

type Mistakes<Name extends string> = { [field in Name]?: string };

const isWord = (text: string): boolean => text.length <= LONGEST_NAME && /^[a-z][a-z0-9]*(-[a-z0-9]+)*$/.test(text);
/** A name as code tells it from others. */
const inCode = (name: string): string => name.replaceAll("-", "");

/** The values of a list, with commas between them; none of an empty text. */
export function listOf(text: string): string[] {
  return text.trim() === "" ? [] : text.split(",").map((value) => value.trim());
}

/** A number; NaN if it is none. */
export function numberOf(text: string): number {
  return /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i.test(text.trim()) ? Number(text) : NaN;
}

/** A whole number, also in hexadecimal; NaN if it is none. */
export function wholeOf(text: string): number {
  const trimmed = text.trim();
  return /^(\d+|0x[0-9a-f]+)$/i.test(trimmed) ? Number(trimmed) : NaN;
}

/** The ends of a range, `-90..90`; undefined if it is none. */
export function rangeOf(text: string): [least: number, most: number] | undefined {
  const ends = text.split("..").map(numberOf);
  return ends.length === 2 && !ends.some(Number.isNaN) ? [ends[0]!, ends[1]!] : undefined;
}

/** How many numbers an element has, and what they are called; NaN if that cannot be read. */
export function countOf(text: string): { count: number; parts: string[] | undefined } {
  const trimmed = text.trim();
  if (trimmed === "") return { count: 1, parts: undefined };
  if (/^\d/.test(trimmed)) return { count: wholeOf(trimmed), parts: undefined };
  const parts = listOf(trimmed);
  return { count: parts.length, parts };
}

function whole(text: string, least: number, most: number, usual: number | undefined): { value: number } | { mistake: string } {
  if (text.trim() === "") return usual === undefined ? { mistake: m.missing } : { value: usual };
  const value = wholeOf(text);
  return value >= least && value <= most ? { value } : { mistake: m.whole(least, most) };
}

/** Says a mistake, if it is the first at this field. */
function say<Name extends string>(mistakes: Mistakes<Name>, field: Name, text: string | undefined): void {
  if (text !== undefined) mistakes[field] ??= text;
}

/** What is said once for all numbers, or once for each. */
function each<T>(text: string, count: number, read: (text: string) => { value: T } | { mistake: string }): { values: T[] } | { mistake: string } {
  const words = listOf(text);
  if (words.length > 1 && words.length !== count) return { mistake: m.asMany(words.length, count) };
  const values: T[] = [];
  for (const word of words) {
    const one = read(word);
    if ("mistake" in one) return one;
    values.push(one.value);
  }
  return { values: values.length === 1 ? Array.from({ length: count }, () => values[0]!) : values };
}

const unit = (text: string): { value: string } | { mistake: string } =>
  text === "" || (text.length <= LONGEST_UNIT && /^[A-Za-z%1][A-Za-z0-9/*^%]*$/.test(text)) ? { value: text } : { mistake: m.unit(text, LONGEST_UNIT) };

function scale(text: string): { value: number } | { mistake: string } {
  const value = numberOf(text);
  return value >= 1e-12 && value <= 1e12 ? { value } : { mistake: m.scale };
}

function finite(text: string): { value: number } | { mistake: string } {
  const value = numberOf(text);
  return Number.isFinite(value) ? { value } : { mistake: m.number(text) };
}

function parts(names: readonly string[]): string | undefined {
  const known = new Set<string>();
  for (const name of names) {
    if (!isWord(name)) return m.word(name, LONGEST_NAME);
    if (known.has(inCode(name))) return m.partTwice(name);
    known.add(inCode(name));
  }
  return undefined;
}

/** Checks the fields of an element whose data are numbers. */
function numbers(row: Row, count: number, mistakes: Mistakes<Field>): void {
  const units = each(row.unit, count, unit);
  if ("mistake" in units) say(mistakes, "unit", units.mistake);
  const scales = each(row.scale, count, scale);
  if ("mistake" in scales) say(mistakes, "scale", scales.mistake);
  const of = (index: number): number => ("values" in scales ? (scales.values[index] ?? 1) : 1);
  const ranges = each(row.range, count, (text) => {
    const range = rangeOf(text);
    if (!range) return { mistake: m.range(text) };
    return range[0] > range[1] ? { mistake: m.upsideDown(range[0], range[1]) } : { value: range };
  });
  if ("mistake" in ranges) say(mistakes, "range", ranges.mistake);
  const [lowest, highest] = BOUNDS[row.type]!;
  const most = row.range.trim() || row.safe.trim() || row.scale.trim() ? Math.min(count, 65_535) : 1;
  const limits = Array.from({ length: most }, (_, index): [number, number] => ("values" in ranges ? ranges.values[index] : undefined) ?? [lowest * of(index), highest * of(index)]);
  if ("values" in scales && "values" in ranges) {
    const wire = (value: number, index: number): number => (row.type === "f32" ? value / of(index) : Math.round(value / of(index)));
    const wrong = ranges.values.findIndex(([least, greatest], index) => wire(least, index) < lowest || wire(greatest, index) > highest);
    if (wrong >= 0) say(mistakes, "range", m.doesNotFit(row.type, lowest * of(wrong), highest * of(wrong)));
  }
  if (row.kind !== "effector") return;
  safe(row, count, limits, mistakes);
  if (row.motion && !(MOTIONS as readonly string[]).includes(row.motion)) say(mistakes, "motion", m.motion(row.motion));
  if (!row.rate.trim()) return;
  if (!(numberOf(row.rate) > 0)) say(mistakes, "rate", m.rate);
  else if ("values" in scales && scales.values.some((one) => one !== scales.values[0])) say(mistakes, "rate", m.rateScales);
}

function safe(row: Row, count: number, limits: readonly [number, number][], mistakes: Mistakes<Field>): void {
  const safes = each(row.safe, count, finite);
  if ("mistake" in safes) return say(mistakes, "safe", safes.mistake);
  if ("range" in mistakes) return;
  for (const [index, [least, most]] of limits.entries()) {
    const value = safes.values[index] ?? 0;
    if (row.motion === "incremental" && value !== 0) say(mistakes, "safe", m.safeStep);
    if (value < least || value > most) say(mistakes, "safe", row.safe.trim() ? m.safe(value, least, most) : m.safeMissing(least, most));
  }
}

/** Why elements of a kind, with data of a type, do not have a field. */
function misplaced(kind: Kind, type: string, field: Field): string {
  if (!hasField(kind, "u8", field) && !hasField(kind, "bytes", field)) return m.notOfKind(t.kinds[kind]!);
  if (field === "max") return m.maxOfBytes;
  if (field === "sound") return m.soundOfBytes;
  // A field of numbers is in the way of bytes, or of no data at all.
  return type === "bytes" ? m.notOfBytes : m.needsType;
}

/** Checks one element by itself; its payload, as far as it can be read. */
function element(row: Row, mistakes: Mistakes<Field>): Payload | undefined {
  if (!row.name.trim()) say(mistakes, "name", m.missing);
  else if (!isWord(row.name.trim())) say(mistakes, "name", m.word(row.name, LONGEST_NAME));
  if (row.doc.length > LONGEST_DOC) say(mistakes, "doc", m.doc(LONGEST_DOC));
  const { kind, type } = row;
  if (!isKind(kind)) {
    say(mistakes, "kind", m.kind(kind));
    return undefined;
  }
  for (const field of FIELDS) {
    if (!row[field].trim() || hasField(kind, type, field)) continue;
    say(mistakes, field, misplaced(kind, type, field));
  }
  for (const field of ["period", "lasts"] as const) {
    if (!row[field].trim() || !hasField(kind, type, field)) continue;
    const ms = whole(row[field], 0, 60_000, 0);
    if ("mistake" in ms) say(mistakes, field, ms.mistake);
  }
  if (kind === "module") return { kind, data: 0, isBytes: false, isBlob: false };
  // Its effector's, which is looked up when all have been read.
  if (kind === "monitor") return undefined;
  if (!type) {
    if (kind === "effector" || kind === "sensor") say(mistakes, "type", m.missing);
    return kind === "effector" || kind === "sensor" ? undefined : { kind, data: 0, isBytes: false, isBlob: false };
  }
  if (!isType(type)) {
    say(mistakes, "type", m.type(type));
    return undefined;
  }
  if (!isNumber(type)) {
    const max = whole(row.max, 1, 65_535, undefined);
    if (row.sound.trim() && hasField(kind, type, "sound")) {
      const sound = soundOf(row.sound);
      if (!sound) say(mistakes, "sound", m.sound);
      else if ("value" in max && sound.block > max.value) say(mistakes, "sound", m.soundBlock(sound.block));
    }
    if ("value" in max) return { kind, data: 2 + max.value, isBytes: true, isBlob: false };
    say(mistakes, "max", max.mistake);
    return undefined;
  }
  const counted = countOf(row.count);
  if (!(counted.count >= 1 && counted.count <= 65_535)) {
    say(mistakes, "count", m.count);
    return undefined;
  }
  if (counted.parts) say(mistakes, "count", parts(counted.parts));
  numbers(row, counted.count, mistakes);
  return { kind, data: NUMBER_SIZES[type]! * counted.count, isBytes: false, isBlob: false };
}

function names(rows: readonly Row[], mistakes: Mistakes<Field>[]): void {
  const known = new Map<string, string>();
  for (const [place, { name }] of rows.entries()) {
    const other = known.get(inCode(name.trim()));
    if (!name.trim()) continue;
    if (other === undefined) known.set(inCode(name.trim()), name.trim());
    else say(mistakes[place]!, "name", other === name.trim() ? m.nameTwice : m.sameInCode(other));
  }
}

function monitors(rows: readonly Row[], mistakes: Mistakes<Field>[], payloads: (Payload | undefined)[]): void {
  for (const [place, row] of rows.entries()) {
    if (row.kind !== "monitor") continue;
    const name = row.of.trim();
    const at = rows.findIndex((other) => other.name.trim() === name);
    if (!name) say(mistakes[place]!, "of", m.missing);
    else if (at < 0) say(mistakes[place]!, "of", m.noElement(name));
    else if (rows[at]!.kind !== "effector") say(mistakes[place]!, "of", m.noEffector(name));
    else if (payloads[at]) payloads[place] = { ...payloads[at], kind: "monitor" };
  }
}

function modules(rows: readonly Row[], mistakes: Mistakes<Field>[]): void {
  const owners = new Map<string, number>();
  for (const [place, row] of rows.entries()) {
    if (row.kind !== "module") continue;
    const members = listOf(row.members);
    if (!members.length) say(mistakes[place]!, "members", m.missing);
    for (const member of members) {
      const found = rows.find(({ name }) => name.trim() === member);
      if (!found) say(mistakes[place]!, "members", m.noElement(member));
      else if (found.kind === "module") say(mistakes[place]!, "members", m.moduleInModule(member));
      else if (owners.get(member) === place) say(mistakes[place]!, "members", m.memberTwice(member));
      else if (owners.has(member)) say(mistakes[place]!, "members", m.memberOfOther(member, rows[owners.get(member)!]!.name));
      else owners.set(member, place);
    }
  }
}

/** Values that do not fit a packet travel in fragments; commands and events arrive as a whole. */
function fragments(payloads: (Payload | undefined)[], largest: number): void {
  const room = largest - HEADER - mapSize(payloads.length) - TAG;
  const values: readonly Kind[] = ["effector", "sensor", "monitor"];
  for (const [place, payload] of payloads.entries()) {
    if (payload?.isBytes && values.includes(payload.kind) && payload.data > room) payloads[place] = { ...payload, data: 2, isBlob: true };
  }
}

export function check(draft: Draft): Checked {
  const model: Mistakes<ModelField> = {};
  const wholeModel: string[] = [];
  for (const field of MODEL_FIELDS) if (field === "name" && !isWord(draft.name.trim())) say(model, "name", draft.name.trim() ? m.word(draft.name, LONGEST_NAME) : m.missing);
  const take = (field: ModelField, least: number, most: number, usual: number | undefined): number => {
    const read = whole(draft[field], least, most, usual);
    if ("value" in read) return read.value;
    say(model, field, read.mistake);
    return usual ?? least;
  };
  take("id", 0, 65_535, undefined);
  const period = take("period", 5, 1000, DEFAULTS.period);
  const largest = take("largest", 64, 65_507, DEFAULTS.largest);
  const watchdog = take("watchdog", 0, 65_535, Math.max(DEFAULTS.watchdog, 2 * period));
  if (draft.watchdog.trim() && watchdog !== 0 && watchdog < 2 * period) say(model, "watchdog", m.watchdog(2 * period));
  if (draft.doc.length > LONGEST_DOC) say(model, "doc", m.doc(LONGEST_DOC));

  const rows = draft.elements;
  if (!rows.length) wholeModel.push(m.noElements);
  if (rows.length > MOST_ELEMENTS) wholeModel.push(m.manyElements(rows.length, MOST_ELEMENTS));
  const mistakes: Mistakes<Field>[] = rows.map(() => ({}));
  const payloads = rows.map((row, place) => element(row, mistakes[place]!));
  names(rows, mistakes);
  monitors(rows, mistakes, payloads);
  modules(rows, mistakes);
  fragments(payloads, largest);
  for (const way of ["down", "up"] satisfies Way[]) {
    const size = packetSize(payloads, way) + TAG;
    if (size > largest) say(model, "largest", m.packet(t.ways[way], size, biggest(rows, payloads, way)));
  }
  const count = Object.keys(model).length + wholeModel.length + mistakes.reduce((sum, of) => sum + Object.keys(of).length, 0);
  return { model, elements: mistakes, whole: wholeModel, payloads, period, largest, count };
}

/** The element with the largest payload. */
function biggest(rows: readonly Row[], payloads: readonly (Payload | undefined)[], way: Way): string {
  let [name, most] = ["", -1];
  for (const [place, payload] of payloads.entries()) {
    const size = payload ? payloadSize(payload, way) : 0;
    if (size > most) [name, most] = [rows[place]!.name, size];
  }
  return name;
}
