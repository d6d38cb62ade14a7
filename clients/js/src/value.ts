/**
 * What a slot or content may hold.
 *
 * A `number` that is whole is an int and any other a double; a whole double is written as {@link Double}. An int beyond 2⁵³ − 1
 * comes as a `bigint`. A time comes as a {@link Time}, and a `Date` is sent as one. Members of objects that are `undefined` are left out.
 */
export type Value =
  | null
  | boolean
  | number
  | bigint
  | string
  | Time
  | Date
  | Double
  | Uint8Array
  | readonly Value[]
  | Map<string, Value>
  | { readonly [key: string]: Value | undefined };

/** A map of content. */
export type Fields = { [key: string]: Value | undefined };

/** A double that is written as one even if it is whole: `new Double(1)`. */
export class Double {
  constructor(readonly number: number) {}
  valueOf(): number {
    return this.number;
  }
}

/**
 * An instant, exact to the microsecond from year 0 to 9999. A `Date` is exact to the millisecond and a `number` of microseconds
 * to the year 2255 only, so neither could pass on what it was given.
 */
export class Time {
  /** @param micros microseconds since 1970, without leap seconds */
  constructor(readonly micros: bigint) {}

  /** A time of a `Date`, or of text as `2026-11-21T10:00:00.000123Z`. */
  static of(when: Date | string): Time {
    if (typeof when !== "string") return new Time(BigInt(when.getTime()) * 1000n);
    const [, seconds, fraction = ""] = /^(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.(\d{1,6}))?Z$/.exec(when) ?? [];
    const millis = Date.parse(`${seconds}Z`);
    if (Number.isNaN(millis)) throw new RangeError(`a time is 2026-11-21T10:00:00.000123Z, not ${JSON.stringify(when)}`);
    return new Time(BigInt(millis) * 1000n + BigInt(fraction.padEnd(6, "0")));
  }

  /** The present time of this machine. */
  static now(): Time {
    return new Time(BigInt(Math.round(wallMicros())));
  }

  /** The same, to the millisecond. */
  toDate(): Date {
    return new Date(Number(this.micros / 1000n));
  }

  toString(): string {
    const seconds = (this.micros - (((this.micros % 1000000n) + 1000000n) % 1000000n)) / 1000000n;
    const fraction = this.micros - seconds * 1000000n;
    const whole = new Date(Number(seconds) * 1000).toISOString().slice(0, 19);
    return `${whole}.${fraction.toString().padStart(6, "0")}Z`;
  }

  toJSON(): string {
    return this.toString();
  }
}

let offset = 0;

/**
 * Microseconds since 1970. `Date.now()` alone would be wrong by up to a millisecond, by which measured clocks would contradict
 * each other; the fine clock alone stands still while a machine sleeps.
 */
export function wallMicros(): number {
  const fine = performance.now();
  const coarse = Date.now();
  if (Math.abs(coarse - fine - offset) > 20) {
    const origin = performance.timeOrigin;
    offset = Math.abs(coarse - fine - origin) > 20 ? coarse - fine : origin;
  }
  return (offset + fine) * 1000;
}

/** The members of a map, or none. */
export function fieldsOf(value: Value | undefined): Fields {
  if (value instanceof Map) return Object.fromEntries(value);
  return isFields(value) ? value : {};
}

/** @internal */
export function isFields(value: unknown): value is Fields {
  return (
    typeof value === "object" &&
    value !== null &&
    !Array.isArray(value) &&
    !(value instanceof Uint8Array) &&
    !(value instanceof Time) &&
    !(value instanceof Date) &&
    !(value instanceof Double) &&
    !(value instanceof Map)
  );
}

/** @internal */
export function text(fields: Fields, key: string): string | undefined {
  const value = fields[key];
  return typeof value === "string" ? value : undefined;
}

/** @internal */
export function int(fields: Fields, key: string): number | undefined {
  const value = fields[key];
  return typeof value === "number" ? value : value instanceof Double ? value.number : undefined;
}

/** @internal */
export function list(fields: Fields, key: string): readonly Value[] {
  const value = fields[key];
  return Array.isArray(value) ? (value as readonly Value[]) : [];
}
