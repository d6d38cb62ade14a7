// Whether the device rests: measured, not meant.
import { Double, type Fields, type Value } from "../index.js";

/** Measurements that differ by less than the tolerance over so long, in µs, are those of a device at rest. */
export const REST = 300_000;
/** µs between two looks at a device that may be coming to rest. */
export const LOOK = 50_000;
/** µs between two looks at a device that rests. */
export const LOOK_AT_REST = 150_000;
/** The key of a position that is an angle, degrees. */
const HEADING = "heading";

/** How it is known that the device rests: by measurements, or as it does not measure and its stopping time has passed. */
export type AtRest = "measured" | "not-measured";

/** What is measured of the device at one time: between `at` and `until`, µs. */
export class Sample {
  constructor(
    /** Always in the same order. */
    readonly values: readonly number[],
    readonly at: number,
    readonly until = at,
  ) {}

  /** Of a position; undefined if that has no number. */
  static of(position: Fields, at: number): Sample | undefined {
    const values: number[] = [];
    for (const [key, value] of Object.entries(position)) {
      const number = numberIn(value);
      if (number === undefined) continue;
      // Degrees that go on from 359 at 0: on a circle on which a small turn is as long as its angle.
      const turn = (number * Math.PI) / 180;
      if (key === HEADING) values.push((Math.sin(turn) * 180) / Math.PI, (Math.cos(turn) * 180) / Math.PI);
      else values.push(number);
    }
    return values.length ? new Sample(values, at) : undefined;
  }

  /**
   * Whether it has moved by less than this, all of its numbers together: a turn must not hide behind two that each change a little less.
   */
  isNear(other: Sample, tolerance: number): boolean {
    return this.values.length === other.values.length && Math.hypot(...this.values.map((value, at) => value - other.values[at]!)) < tolerance;
  }
}

function numberIn(value: Value | undefined): number | undefined {
  if (value instanceof Double) return value.number;
  return typeof value === "number" || typeof value === "bigint" ? Number(value) : undefined;
}

/** Watches whether a device has moved lately, whatever has moved it. */
export class Motion {
  /** Those of the last 0.3 s, since it has moved; and the last one, however long ago it was. */
  #seen: Sample[] = [];
  #movedAt: number | undefined;

  constructor(readonly tolerance: number) {}

  /** Takes in what is measured now. */
  look(sample: Sample): void {
    this.#seen = this.#seen.filter((other, place, { length }) => place === length - 1 || sample.at - other.at < REST);
    if (this.#seen.some((other) => !sample.isNear(other, this.tolerance))) [this.#seen, this.#movedAt] = [[], sample.at];
    this.#seen.push(sample);
  }

  /** When it was last seen to have moved by its tolerance or more, if it was. */
  get movedAt(): number | undefined {
    return this.#movedAt;
  }
}

/** Watches a device come to rest. What was measured before it was to stand is worth nothing. */
export class Rest {
  /** When something moved it last, or it was to stand. */
  #since: number | undefined;
  /** The first of the measurements that differ by less than the tolerance. */
  #first: Sample | undefined;
  #known: AtRest | undefined;

  constructor(
    readonly tolerance: number,
    /** µs. */
    readonly stoppingTime: number,
  ) {}

  /** Something moves it, or may: that it rests is to be found out anew. */
  disturb(now: number): void {
    [this.#since, this.#first, this.#known] = [now, undefined, undefined];
  }

  /** Takes in what is measured now; without a measurement its stopping time is waited for. */
  observe(sample: Sample | undefined, now: number): void {
    const since = (this.#since ??= now);
    // What is not a number is not a measurement.
    if (!sample?.values.every(Number.isFinite)) {
      this.#first = undefined;
      this.#known = now - since >= this.stoppingTime ? "not-measured" : undefined;
      return;
    }
    if (sample.at < since) return;
    if (!this.#first || !sample.isNear(this.#first, this.tolerance)) [this.#first, this.#known] = [sample, undefined];
    else if (sample.at - this.#first.until >= REST) this.#known = "measured";
    // It is not known yet, or was before it stopped to measure.
    else if (this.#known !== "measured") this.#known = undefined;
  }

  /** How it is known that it rests, if it is. */
  get known(): AtRest | undefined {
    return this.#known;
  }

  /** When it is to be looked at next; undefined once it rests. */
  nextLook(now: number): number | undefined {
    return this.#known === undefined ? now + LOOK : undefined;
  }
}
