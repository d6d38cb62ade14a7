// The cursor's handles in one picture: where they are seen, and what dragging one does.
import { type Matrix, type Pixel, type Point, along, depth, flow, NEAR, onCurve, onPlane, project, scaleAt } from "./matrix.js";
import { type Axis, AXES, type Degrees, tool } from "./workspace.js";

/** `tip` is dragged in the plane at its height. */
export type Grip = Axis | "tip";
export const GRIPS: readonly Grip[] = ["tilt", "spin", "z", "y", "x", "tip"];

/** Where a handle is. */
export interface Handle {
  grip: Grip;
  /** Where it is seen. */
  at: Pixel;
  /** The place in the room that it stands for, without the offset that keeps it apart from the others. */
  anchor: Pixel;
  /** Whether its direction is seen end-on, so that the pointer's way is taken instead of its place. */
  endOn: boolean;
}

/** How long the handles' arms are in the room, mm; they keep that while one is dragged. */
export interface Reach {
  x: number;
  y: number;
  z: number;
  spin: number;
  tilt: number;
  /** Pixels of the image: of an arm, and as far as a handle goes aside. */
  arm: number;
}

const WAYS: { readonly [axis in "x" | "y" | "z"]: Point } = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] };
/** A direction whose arm is seen shorter than this part of its length is taken as seen end-on. */
const END_ON = 0.25;
/** A ring is seen flat if its height is less than this part of its width. */
const FLAT = 0.5;
/** The cosine of the angle between two arrows in the image that are too near to each other. */
const BESIDE_Z = 0.9;
/** The handle of the spin stands so far from the jaw line, degrees, where no arrow is. */
const BESIDE = 225;
/** Degrees to which the ring is followed from where the handle is. */
const WINDOW = 120;

const plus = ([x, y, z]: Point, [dx, dy, dz]: Point, times = 1): Point => [x + dx * times, y + dy * times, z + dz * times];
const place = (pose: Readonly<Degrees>): Point => [pose[0], pose[1], pose[2]];
const cross = ([a, b]: Pixel, [c, d]: Pixel): number => a * d - b * c;
const length = ([u, v]: Pixel): number => Math.hypot(u, v);

/** Arms of about this many pixels; undefined if the cursor is behind the camera. */
export function reachOf(matrix: Matrix, pose: Readonly<Degrees>, arm: number): Reach | undefined {
  const tip = place(pose);
  const far = depth(matrix, tip);
  if (far < 4 * NEAR) return undefined;
  const scale = scaleAt(matrix, tip);
  // Not so long that an arm reaches the camera.
  const most = Math.max(20, far / 3);
  const upwards = flow(matrix, tip, WAYS.z);
  const arrow = (axis: "x" | "y" | "z"): number => {
    const way = flow(matrix, tip, WAYS[axis]);
    const seen = length(way) / scale;
    const cosine = (way[0] * upwards[0] + way[1] * upwards[1]) / Math.max(1e-12, length(way) * length(upwards));
    // One that is seen in the direction of another is shorter, so that both can be taken hold of.
    const part = axis !== "z" && cosine > BESIDE_Z ? 0.55 : 1;
    return part * Math.min(most, (arm / scale) * Math.min(2.5, 1 / Math.max(seen, 0.01)));
  };
  const plain = Math.min(most, arm / scale);
  // A ring that is seen flat goes around the arrows' heads, so that nowhere it comes near to the tip.
  const flat = Math.abs(cross(flow(matrix, tip, WAYS.x), flow(matrix, tip, WAYS.y))) / (scale * scale);
  return { x: arrow("x"), y: arrow("y"), z: arrow("z"), spin: plain * (flat < FLAT ? 1.3 : 0.7), tilt: plain * 1.55, arm };
}

/** A place of the ring around the tip, by the spin that it stands for. */
export function ringPoint(pose: Readonly<Degrees>, spin: number, radius: number, beside = BESIDE): Point {
  const angle = ((spin + beside) * Math.PI) / 180;
  return [pose[0] + radius * Math.cos(angle), pose[1] + radius * Math.sin(angle), pose[2]];
}

/** A place of the arc above the tip, by the tilt that it stands for. */
export function arcPoint([x, y, z, spin]: Readonly<Degrees>, tilt: number, radius: number): Point {
  return tool([x, y, z, spin, tilt], [0, 0, radius]);
}

/** Where a handle's place is in the room when its degree has this value. */
function curve(pose: Readonly<Degrees>, reach: Reach, grip: Axis): (value: number) => Point {
  switch (grip) {
    case "spin":
      return (value) => ringPoint(pose, value, reach.spin);
    case "tilt":
      return (value) => arcPoint(pose, value, reach.tilt);
    default:
      return (value) => plus(place(pose), WAYS[grip], reach[grip] + value - pose[AXES.indexOf(grip)]!);
  }
}

/** The flow of a handle's place when its degree changes by one. */
function tangent(matrix: Matrix, at: (value: number) => Point, value: number): { seen: Pixel; part: number } {
  const [before, point, after] = [at(value - 0.05), at(value), at(value + 0.05)];
  const way = plus(after, before, -1).map((part) => part * 10) as unknown as Point;
  const seen = flow(matrix, point, way);
  return { seen, part: length(seen) / (scaleAt(matrix, point) * Math.hypot(...way)) };
}

/** Away from the arrows that are seen. */
function aside(matrix: Matrix, pose: Readonly<Degrees>, grip: Axis, reach: Reach): Pixel {
  const tip = place(pose);
  const unit = (way: Pixel): Pixel => (length(way) > 1e-9 ? [way[0] / length(way), way[1] / length(way)] : [0, 0]);
  const [x, y] = [unit(flow(matrix, tip, WAYS.x)), unit(flow(matrix, tip, WAYS.y))];
  if (grip === "tilt") {
    const jaw = unit(flow(matrix, tip, plus(tool(pose, [1, 0, 0]), tip, -1)));
    const way = length(jaw) ? jaw : ([1, 0] as Pixel);
    return [-way[0] * reach.arm * 1.35, -way[1] * reach.arm * 1.35];
  }
  const between = unit([x[0] - y[0], x[1] - y[1]]);
  const way: Pixel = length(between) ? between : [Math.SQRT1_2, Math.SQRT1_2];
  return [way[0] * reach.arm, way[1] * reach.arm];
}

/** The handles of the cursor, those that are before the camera. */
export function handlesOf(matrix: Matrix, pose: Readonly<Degrees>, reach: Reach): Handle[] {
  const found: Handle[] = [];
  const tip = project(matrix, place(pose));
  if (!tip) return found;
  for (const grip of GRIPS) {
    if (grip === "tip") {
      found.push({ grip, at: tip, anchor: tip, endOn: false });
      continue;
    }
    const at = curve(pose, reach, grip);
    const value = pose[AXES.indexOf(grip)]!;
    const anchor = project(matrix, at(value));
    if (!anchor) continue;
    const { part } = tangent(matrix, at, value);
    const endOn = part < END_ON;
    // Nor does one lie upon the tip, where nobody can take hold of it.
    const middle = grip === "tilt" ? (project(matrix, at(0)) ?? anchor) : anchor;
    const covered = grip !== "spin" && Math.hypot(middle[0] - tip[0], middle[1] - tip[1]) < reach.arm * 0.4;
    const away: Pixel = endOn || covered ? aside(matrix, pose, grip, reach) : [0, 0];
    found.push({ grip, at: [anchor[0] + away[0], anchor[1] + away[1]], anchor, endOn });
  }
  return apart(found, reach.arm);
}

/** Puts handles that lie upon others where nothing is: the tip stays, then the arrows, and the others make room. */
function apart(handles: Handle[], arm: number): Handle[] {
  const gap = arm * 0.28;
  const placed: Handle[] = [];
  for (const handle of [...handles].reverse()) {
    const free = ([u, v]: Pixel): boolean => placed.every(({ at }) => Math.hypot(at[0] - u, at[1] - v) >= gap);
    let { at } = handle;
    for (let turn = 0; !free(at) && turn < 16; turn += 1) {
      const angle = (turn * Math.PI) / 4;
      const far = arm * (turn < 8 ? 0.55 : 0.9);
      const tried: Pixel = [handle.at[0] + far * Math.cos(angle), handle.at[1] + far * Math.sin(angle)];
      if (free(tried)) at = tried;
    }
    placed.push({ ...handle, at });
  }
  return placed.reverse();
}

/** One handle that is dragged. */
export class Drag {
  /** From the handle's place to the pointer. */
  readonly #held: Pixel;
  /** From the place in the room to the handle. */
  readonly #away: Pixel;
  readonly #before: Degrees;
  readonly #start: Pixel;
  /** The screen's direction in which a handle that is seen end-on is drawn, and its degrees for each pixel. */
  readonly #slope: { way: Pixel; gain: number };
  /** Where the pointer is. */
  pointer: Pixel;

  constructor(
    readonly handle: Handle,
    readonly reach: Reach,
    matrix: Matrix,
    pose: Readonly<Degrees>,
    pointer: Pixel,
  ) {
    this.#before = [...pose];
    this.#start = this.pointer = pointer;
    this.#held = [pointer[0] - handle.at[0], pointer[1] - handle.at[1]];
    this.#away = [handle.at[0] - handle.anchor[0], handle.at[1] - handle.anchor[1]];
    this.#slope = this.#slopeOf(matrix);
  }

  #slopeOf(matrix: Matrix): { way: Pixel; gain: number } {
    const { grip } = this.handle;
    if (grip === "tip") return { way: [0, 0], gain: 0 };
    // Upwards in the picture is more, as far as the handle lies aside it is away from the tip.
    const scale = scaleAt(matrix, place(this.#before));
    const size = length(this.#away);
    const way: Pixel = size ? [this.#away[0] / size, this.#away[1] / size] : [0, -1];
    const radius = grip === "spin" ? this.reach.spin : grip === "tilt" ? this.reach.tilt : 180 / Math.PI;
    return { way, gain: 180 / Math.PI / (radius * scale) };
  }

  /** The pose for a pointer at this pixel; what cannot be told stays. */
  to(matrix: Matrix, pose: Readonly<Degrees>, pointer: Pixel): Degrees {
    this.pointer = pointer;
    const { grip, endOn } = this.handle;
    const next: Degrees = [...pose];
    const wanted: Pixel = [pointer[0] - this.#held[0] - this.#away[0], pointer[1] - this.#held[1] - this.#away[1]];
    if (grip === "tip") {
      const found = onPlane(matrix, pose[2], wanted);
      if (found) [next[0], next[1]] = [found[0], found[1]];
      return next;
    }
    const index = AXES.indexOf(grip);
    if (endOn) {
      next[index] = this.#before[index]! + this.#moved() * this.#slope.gain;
      return next;
    }
    const value = pose[index]!;
    const at = curve(pose, this.reach, grip);
    if (grip === "spin") next[index] = onCurve((spin) => project(matrix, at(spin)), wanted, value, value - WINDOW, value + WINDOW);
    else if (grip === "tilt") next[index] = onCurve((tilt) => project(matrix, at(tilt)), wanted, value, -60, 60);
    else {
      const far = along(matrix, at(value), WAYS[grip], wanted);
      if (far !== undefined) next[index] = value + far;
    }
    return next;
  }

  /** Pixels along the direction of a handle that is seen end-on. */
  #moved(): number {
    const { way } = this.#slope;
    return (this.pointer[0] - this.#start[0]) * way[0] + (this.pointer[1] - this.#start[1]) * way[1];
  }

  /** Where the handle is drawn meanwhile, from where it would be otherwise: under the pointer. */
  shifted(at: Pixel, anchor: Pixel): Pixel {
    if (!this.handle.endOn) return [anchor[0] + this.#away[0], anchor[1] + this.#away[1]];
    const { way } = this.#slope;
    const moved = this.#moved();
    return this.handle.grip === "tip" ? at : [this.handle.at[0] + way[0] * moved, this.handle.at[1] + way[1] * moved];
  }
}
