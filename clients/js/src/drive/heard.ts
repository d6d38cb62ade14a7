// What a device says of itself and of commands, as far as its commander has to know.
import { type Fields, type MessageEvent, type Value, fieldsOf } from "../index.js";
import { visible } from "./visible.js";

/** What of a device's state matters to its commander. */
export interface StateNews {
  /** The id of the message, which a relative command is based on. */
  id?: number | undefined;
  /** Whether it moves, or may do so. */
  moving: boolean;
  /** Whether it is stopped. */
  stopped?: boolean | undefined;
  /** Whether its mechanism is in reach. */
  linked: boolean;
  /** The newest fence that it has heard of; undefined of a device that says nothing of fences. */
  fence?: number | undefined;
}

/** What a device says of a command: a message `status`. */
export interface CommandReport {
  /** The command's id. */
  id?: number | undefined;
  /** Whose it is. */
  peer: string;
  /** Under which it came. */
  fence?: number | undefined;
  /** `waiting`, `sending`, `executing`, `finished` or `error`. */
  state: string;
  /** The statement that is carried out, 0 before the first. */
  statement: number;
  /** How many there are. */
  of: number;
  /** `name`, `code`, `text` and more, where the state is `error`. */
  error?: Fields | undefined;
}

/** Thrown by what reads a key that has another type. */
const WRONG = new TypeError("a key has another type");

function key(fields: Fields, name: string, type: "number", absent?: number): number | undefined;
function key(fields: Fields, name: string, type: "boolean", absent: boolean): boolean;
function key(fields: Fields, name: string, type: "string"): string;
function key(fields: Fields, name: string, type: string, absent?: Value): Value | undefined {
  const value = fields[name] ?? undefined;
  if (value === undefined && type !== "string") return absent;
  if (typeof value !== type || (type === "number" && !(Number.isInteger(value) && (value as number) >= 0))) throw WRONG;
  return value;
}

/** What a map says; undefined of what cannot be read. */
function reads<T>(content: Value | undefined, read: (fields: Fields) => T): T | undefined {
  const fields = fieldsOf(content);
  if (fields !== content && !(content instanceof Map)) return undefined;
  try {
    return read(fields);
  } catch (error) {
    if (error === WRONG) return undefined;
    throw error;
  }
}

/** Reads a message `state`; undefined if its content is none. */
export function stateOf({ content, parcel }: MessageEvent): StateNews | undefined {
  return reads(content, (fields) => {
    const [linked, reached] = [key(fields, "linked", "boolean", true), key(fields, "reached", "boolean", true)];
    const [moving, stopped] = [key(fields, "moving", "boolean", false), key(fields, "stopped", "boolean", false)];
    return { id: parcel.id, moving, stopped, linked: linked && reached, fence: key(fields, "fence", "number") };
  });
}

/** Reads a message `status`; undefined if its content is none. */
export function reportOf({ content }: MessageEvent): CommandReport | undefined {
  return reads(content, (fields) => ({
    id: key(fields, "id", "number"),
    peer: key(fields, "peer", "string"),
    fence: key(fields, "fence", "number"),
    state: key(fields, "state", "string"),
    statement: key(fields, "statement", "number", 0)!,
    of: key(fields, "of", "number", 0)!,
    error: (fields["error"] ?? undefined) === undefined ? undefined : fieldsOf(fields["error"]),
  }));
}

/** Whether a device rests, and has heard that its token's owner has this fence. */
export function standsFor({ moving, fence: known }: StateNews, fence: number): boolean {
  return !moving && (known === undefined || known >= fence);
}

/** Whether a report is the last one of its command. */
export function isLast({ state }: CommandReport): boolean {
  return state === "finished" || state === "error";
}

/** What the error of a report is called. */
export function errorName({ error }: CommandReport): string | undefined {
  const name = error?.["name"];
  return typeof name === "string" ? name : undefined;
}

/** The device's words for its error. */
export function errorText({ error }: CommandReport): string {
  const text = error?.["text"];
  return visible(typeof text === "string" ? text : "it failed, and the device does not say why");
}

/** Whether the device has begun the command by it. */
export function hasBegun({ state, statement }: CommandReport): boolean {
  return statement > 0 || state === "executing";
}

/** Whether the device has not begun the command, as it came or waited too long. */
export function wasTooLate(report: CommandReport): boolean {
  return ["expired", "too-old"].includes(errorName(report) ?? "");
}

/** The same with the statement, the name and the number (M53): `statement 2: too far [joint-limit 5005]`. */
export function errorWords(report: CommandReport): string {
  const [text, name, { code, statement: at } = {} as Fields] = [errorText(report), errorName(report), report.error];
  const statement = typeof at === "number" ? at : report.statement;
  const place = statement > 0 && !text.startsWith("statement ") ? `statement ${statement}: ` : "";
  const known = [...(name === undefined ? [] : [visible(name)]), ...(typeof code === "number" ? [code] : [])];
  return `${place}${text}${known.length ? ` [${known.join(" ")}]` : ""}`;
}
