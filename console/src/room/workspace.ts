// Where the hand may be, and how a hand stands there.
import type { Point } from "./matrix.js";

/** mm and degrees. */
export type Degrees = [x: number, y: number, z: number, spin: number, tilt: number];
export type Axis = "x" | "y" | "z" | "spin" | "tilt";

export const AXES: readonly Axis[] = ["x", "y", "z", "spin", "tilt"];

export interface Limit {
  low: number;
  high: number;
  unit: "mm" | "°";
}

/** The box above the table, and the cone in which the hand leans. */
export const LIMITS: { readonly [axis in Axis]: Limit } = {
  x: { low: -300, high: 300, unit: "mm" },
  y: { low: -300, high: 300, unit: "mm" },
  z: { low: 0, high: 450, unit: "mm" },
  spin: { low: -180, high: 180, unit: "°" },
  tilt: { low: -45, high: 45, unit: "°" },
};

/** The pose inside that is nearest to this one, and the degrees that were outside. */
export function clamp(pose: Readonly<Degrees>): { pose: Degrees; outside: Axis[] } {
  const outside: Axis[] = [];
  const inside = AXES.map((axis, at) => {
    const { low, high } = LIMITS[axis];
    const wanted = pose[at]!;
    if (Number.isNaN(wanted)) {
      outside.push(axis);
      return Math.max(low, Math.min(high, 0));
    }
    // A whole turn is none.
    const value = axis === "spin" && Number.isFinite(wanted) && Math.abs(wanted) > 180 ? wanted - 360 * Math.round(wanted / 360) : wanted;
    if (value >= low && value <= high) return value;
    outside.push(axis);
    return Math.max(low, Math.min(high, value));
  });
  return { pose: inside as Degrees, outside };
}

/** To a tenth of a mm or degree, as commands are written. */
export function rounded(pose: Readonly<Degrees>): Degrees {
  return pose.map((value) => Math.round(value * 10) / 10 + 0) as Degrees;
}

const radians = (degrees: number): number => (degrees * Math.PI) / 180;

/** A point given along the jaw line, across it, and from the tip towards the wrist, mm: `Rz(spin) Rx(tilt)`. */
export function tool([x, y, z, spin, tilt]: Readonly<Degrees>, [jaw, across, up]: Point): Point {
  const [cs, ss, ct, st] = [Math.cos(radians(spin)), Math.sin(radians(spin)), Math.cos(radians(tilt)), Math.sin(radians(tilt))];
  const [level, high] = [ct * across - st * up, st * across + ct * up];
  return [x + cs * jaw - ss * level, y + ss * jaw + cs * level, z + high];
}

/** A pose as a line: along the gripper to its tip, and from jaw to jaw. */
export function poseMark(pose: Readonly<Degrees>): Point[] {
  return ([[0, 0, 60], [0, 0, 0], [-30, 0, 0], [30, 0, 0]] as const).map((mark) => tool(pose, mark));
}

/** A gripper with open jaws, as lines: two fingers, the palm between them, and the axis above it. */
export function gripperMarks(pose: Readonly<Degrees>): Point[][] {
  const at = (...mark: [number, number, number]): Point => tool(pose, mark);
  return [
    [at(-40, 0, 0), at(-40, 0, 60), at(40, 0, 60), at(40, 0, 0)],
    [at(0, 0, 0), at(0, 0, 136)],
    [at(-40, -10, 0), at(-40, 10, 0)],
    [at(40, -10, 0), at(40, 10, 0)],
  ];
}

/** How far apart two poses' tips are, mm. */
export function distance(one: readonly number[], other: readonly number[]): number {
  return Math.hypot(one[0]! - other[0]!, one[1]! - other[1]!, one[2]! - other[2]!);
}
