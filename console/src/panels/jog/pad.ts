// A gamepad: what its axes and buttons do.
import { NOTHING, type Vector } from "./machine.js";

/** What moves one axis of the hand. Numbers are those of the Gamepad API; -1 is none. */
export interface Source {
  axis: number;
  inverted: boolean;
  plus: number;
  minus: number;
}

export interface Mapping {
  /** For x, y, z, spin and tilt. */
  sources: [Source, Source, Source, Source, Source];
  /** Held, or the hand rests. */
  deadMan: number;
}

/** The standard layout: left stick over the table, right stick up and turning, cross for the tilt, and the right shoulder button to be held. */
export const STANDARD: Mapping = {
  sources: [
    { axis: 0, inverted: false, plus: -1, minus: -1 },
    { axis: 1, inverted: true, plus: -1, minus: -1 },
    { axis: 3, inverted: true, plus: -1, minus: -1 },
    { axis: 2, inverted: true, plus: -1, minus: -1 },
    { axis: -1, inverted: false, plus: 12, minus: 13 },
  ],
  deadMan: 5,
};

/** As much of a gamepad as is read. */
export interface Pad {
  axes: readonly number[];
  buttons: readonly { readonly pressed: boolean; readonly value: number }[];
}

/** What is left of an axis beyond the dead zone. */
export function beyond(value: number, zone: number): number {
  const size = Math.abs(value);
  if (!(size > zone) || zone >= 1) return 0;
  return (Math.sign(value) * Math.min(1, size - zone)) / (1 - zone);
}

export interface Pushed {
  wish: Vector;
  deadMan: boolean;
}

export function readPad(pad: Pad, mapping: Mapping, zone: number, scale: number): Pushed {
  const button = (number: number): number => {
    const found = pad.buttons[number];
    return found ? Math.max(found.pressed ? 1 : 0, beyond(found.value, zone)) : 0;
  };
  const wish = mapping.sources.map(({ axis, inverted, plus, minus }) => {
    const pushed = beyond(pad.axes[axis] ?? 0, zone) * (inverted ? -1 : 1) + button(plus) - button(minus);
    return Math.max(-1, Math.min(1, pushed)) * scale + 0;
  });
  return { wish: wish as Vector, deadMan: pad.buttons[mapping.deadMan]?.pressed ?? false };
}

export const NOT_PUSHED: Pushed = { wish: NOTHING, deadMan: false };

/** A mapping that was kept, if it still is one. */
export function mappingOf(value: unknown): Mapping | undefined {
  const { sources, deadMan } = (typeof value === "object" && value !== null ? value : {}) as { sources?: unknown; deadMan?: unknown };
  const isNumber = (each: unknown): boolean => Number.isInteger(each) && (each as number) >= -1 && (each as number) < 64;
  if (!Array.isArray(sources) || sources.length !== 5 || !isNumber(deadMan)) return undefined;
  const right = sources.every((each: unknown) => {
    const { axis, inverted, plus, minus } = (typeof each === "object" && each !== null ? each : {}) as { [key: string]: unknown };
    return isNumber(axis) && isNumber(plus) && isNumber(minus) && typeof inverted === "boolean";
  });
  return right ? (value as Mapping) : undefined;
}
