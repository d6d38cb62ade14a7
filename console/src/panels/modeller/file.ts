// A model as a TOML file: read into fields as they are typed, and written from them.
import { modeller as t } from "../../texts/modeller.js";
import { countOf, listOf, numberOf, rangeOf, wholeOf } from "./check.js";
import { DEFAULTS, type Draft, type Row, blank, hasField, isKind } from "./model.js";

/** The most bytes of a model's file. */
export const LONGEST_FILE = 1 << 20;

export type Loaded = { draft: Draft; notes: readonly string[] } | { mistake: string };

type Table = { readonly [key: string]: unknown };

const isTable = (value: unknown): value is Table => typeof value === "object" && value !== null && !Array.isArray(value) && !(value instanceof Date);

/** A value as it is typed into a field: what cannot be right there stands as it was, and is found by the check. */
function typed(value: unknown): string {
  if (Array.isArray(value)) return value.map(typed).join(", ");
  if (typeof value === "string") return value;
  if (typeof value === "number" || typeof value === "bigint" || typeof value === "boolean") return String(value);
  return value === undefined ? "" : t.file.otherValue;
}

function typedRange(value: unknown): string {
  if (!Array.isArray(value)) return typed(value);
  return value.some(Array.isArray) ? value.map(typedRange).join(", ") : value.map(typed).join("..");
}

const ROOT = new Set(["name", "id", "doc", "period", "largest-packet", "watchdog", "element"]);
const ELEMENT = new Set(["name", "kind", "type", "count", "max", "sound", "parts", "unit", "scale", "range", "safe", "rate", "motion", "interpolate", "period", "lasts", "of", "members", "doc"]);

function rowOf(table: Table, key: number, notes: string[]): Row {
  const name = typed(table["name"]);
  for (const other of Object.keys(table)) if (!ELEMENT.has(other)) notes.push(t.file.unknownKey(other, name));
  const named = table["parts"] !== undefined;
  if (named && table["count"] !== undefined && Array.isArray(table["parts"]) && Number(table["count"]) !== table["parts"].length) notes.push(t.file.countAndParts(name));
  const interpolates = table["interpolate"] === true;
  const motion = typed(table["motion"]);
  if (interpolates && motion === "incremental") notes.push(t.file.interpolatedSteps(name));
  return blank(key, {
    name,
    kind: typed(table["kind"]),
    type: typed(table["type"]),
    count: typed(named ? table["parts"] : table["count"]),
    max: typed(table["max"]),
    sound: typed(table["sound"]),
    unit: typed(table["unit"]),
    scale: typed(table["scale"]),
    range: typedRange(table["range"]),
    safe: typed(table["safe"]),
    rate: typed(table["rate"]),
    motion: motion === "incremental" ? motion : interpolates ? "interpolated" : motion === "absolute" ? "" : motion,
    period: typed(table["period"]),
    lasts: typed(table["lasts"]),
    of: typed(table["of"]),
    members: typed(table["members"]),
    doc: typed(table["doc"]).trim(),
  });
}

/** Reads a file. What it holds is checked afterwards, field by field; here only what is not a model at all is refused. */
export async function read(text: string): Promise<Loaded> {
  if (text.length > LONGEST_FILE) return { mistake: t.file.tooLarge(LONGEST_FILE) };
  const { parse, TomlError } = await import("smol-toml");
  let root: Table;
  try {
    root = parse(text, { integersAsBigInt: true });
  } catch (error) {
    if (error instanceof TomlError) return { mistake: t.file.syntax(error.line, error.column, error.message.split("\n")[0]!.replace(/^Invalid TOML document: /, "")) };
    return { mistake: String(error) };
  }
  const elements = root["element"] ?? [];
  if (!Array.isArray(elements) || !elements.every(isTable)) return { mistake: t.file.elements };
  const notes: string[] = [];
  for (const key of Object.keys(root)) if (!ROOT.has(key)) notes.push(t.file.unknownKey(key, undefined));
  const id = root["id"];
  const draft: Draft = {
    name: typed(root["name"]),
    id: typeof id === "bigint" && id > 255n ? `0x${id.toString(16)}` : typed(id),
    period: typed(root["period"]),
    largest: typed(root["largest-packet"]),
    watchdog: typed(root["watchdog"]),
    doc: typed(root["doc"]).trim(),
    elements: elements.map((table, index) => rowOf(table, index + 1, notes)),
  };
  if (/^\s*#/m.test(text)) notes.push(t.file.comments);
  return { draft, notes };
}

/** A text of TOML. */
export function quoted(text: string): string {
  return JSON.stringify(text).replaceAll("\u007f", "\\u007f");
}

const list = (values: readonly string[]): string => `[${values.join(", ")}]`;
const oneOrList = (values: readonly string[]): string => (values.length === 1 ? values[0]! : list(values));
const plain = (text: string): string => String(numberOf(text));

function range(text: string): string {
  return oneOrList(listOf(text).map((one) => list((rangeOf(one) ?? []).map(String))));
}

function keysOf(row: Row): [key: string, value: string][] {
  const keys: [string, string][] = [
    ["name", quoted(row.name.trim())],
    ["kind", quoted(row.kind)],
  ];
  const has = (field: Parameters<typeof hasField>[2]): boolean => isKind(row.kind) && row[field].trim() !== "" && hasField(row.kind, row.type, field);
  const add = (key: string, value: string): void => void keys.push([key, value]);
  if (has("of")) add("of", quoted(row.of.trim()));
  if (has("type")) add("type", quoted(row.type));
  if (has("max")) add("max", String(wholeOf(row.max)));
  if (has("sound")) add("sound", quoted(row.sound.trim()));
  if (has("count")) {
    const { count, parts } = countOf(row.count);
    if (parts) add("parts", list(parts.map(quoted)));
    else if (count !== 1) add("count", String(count));
  }
  if (has("unit")) add("unit", oneOrList(listOf(row.unit).map(quoted)));
  if (has("scale")) add("scale", oneOrList(listOf(row.scale).map(plain)));
  if (has("range")) add("range", range(row.range));
  if (has("safe")) add("safe", oneOrList(listOf(row.safe).map(plain)));
  if (has("members")) add("members", list(listOf(row.members).map(quoted)));
  if (has("rate")) add("rate", plain(row.rate));
  if (has("motion") && row.motion === "incremental") add("motion", quoted("incremental"));
  if (has("motion") && row.motion === "interpolated") add("interpolate", "true");
  if (has("period")) add("period", String(wholeOf(row.period)));
  if (has("lasts")) add("lasts", String(wholeOf(row.lasts)));
  if (row.doc.trim()) add("doc", quoted(row.doc.trim()));
  return keys;
}

/** A checked model as a file. */
export function write(draft: Draft): string {
  const number = (text: string): string => (/^0x/i.test(text.trim()) ? text.trim().toLowerCase() : String(wholeOf(text)));
  const lines = [`name = ${quoted(draft.name.trim())}`, `id = ${number(draft.id)}`];
  if (draft.doc.trim()) lines.push(`doc = ${quoted(draft.doc.trim())}`);
  lines.push("# T, in ms", `period = ${number(draft.period || String(DEFAULTS.period))}`);
  if (draft.largest.trim()) lines.push("# bytes, with the tag of a sealed one", `largest-packet = ${number(draft.largest)}`);
  if (draft.watchdog.trim()) lines.push("# ms; 0 for none", `watchdog = ${number(draft.watchdog)}`);
  for (const row of draft.elements) lines.push("", "[[element]]", ...keysOf(row).map(([key, value]) => `${key} = ${value}`));
  return `${lines.join("\n")}\n`;
}

/** What writes code for the robot and for its middle, from a model that was downloaded. */
export function commandOf(name: string): string {
  const of = name.trim() || "robot";
  return `mom rsp generate ${of}.toml --rust ${of}.rs --c ${of}.h --docs ${of}.md`;
}
