// Reading what others have said, of which nothing is certain.
import type { Plain, PlainFields } from "../worker/protocol.js";

export function fields(value: Plain | undefined): PlainFields {
  return typeof value === "object" && value !== null && !Array.isArray(value) && !(value instanceof Date) && !(value instanceof Uint8Array) ? value : {};
}

export function text(value: PlainFields, key: string): string | undefined {
  const member = value[key];
  return typeof member === "string" ? member : undefined;
}

export function number(value: PlainFields, key: string): number | undefined {
  const member = value[key];
  return typeof member === "number" ? member : typeof member === "bigint" ? Number(member) : undefined;
}

export function list(value: PlainFields, key: string): Plain[] {
  const member = value[key];
  return Array.isArray(member) ? member : [];
}

export function flag(value: PlainFields, key: string): boolean {
  return value[key] === true;
}

/** ms since 1970. */
export function time(value: PlainFields, key: string): number | undefined {
  const member = value[key];
  return member instanceof Date ? member.getTime() : undefined;
}
