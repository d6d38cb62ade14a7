// Live driving as data: from what is held to a velocity, or to the reason why the hand rests. Nothing here looks at a clock or sends anything.
import { common } from "../../texts/common.js";

/** x, y, z, spin, tilt: parts of the greatest speed from -1 to 1, or mm/s and degrees/s. */
export type Vector = [number, number, number, number, number];

export const NOTHING: Vector = [0, 0, 0, 0, 0];
/** mm/s: the arm takes 150, and rounding must not make more of it. */
export const FASTEST = 149.8;
export const FASTEST_TURN = 90;

export type Reason =
  | "no-token"
  | "token-lost"
  | "stop"
  | "stopped"
  | "unknown"
  | "link"
  | "hidden"
  | "blurred"
  | "no-picture"
  | "old-picture"
  | "pad-gone"
  | "dead-man"
  | "refused";

export interface Why {
  reason: Reason;
  /** In the words of who refused it. */
  text?: string | undefined;
}

/** All that counts now. Times are ms. */
export interface Inputs {
  now: number;
  /** Whether anything is held: a key, a button, a stick. */
  held: boolean;
  owns: boolean;
  /** When the newest STOP was ordered. */
  stopAt: number | undefined;
  /** Whether the device says that it is stopped. */
  stopped: boolean;
  /** Since when nobody knows how the device is; undefined if it has told. */
  unknownSince: number | undefined;
  linked: boolean;
  visible: boolean;
  focused: boolean;
  /** How old the newest picture is; undefined if there is none. */
  age: number | undefined;
  limit: number;
  /** The person sees the robot itself. */
  unseen: boolean;
  /** A gamepad is pushed, its dead-man button is held, it is gone. */
  pad: { pushed: boolean; deadMan: boolean; gone: boolean };
  /** Why a device or the hub has ended it, and when. */
  refused: { at: number; text: string } | undefined;
}

/** `why`: why it rests or rested last, until something is held again. */
export type Drive = { phase: "rest"; why?: Why | undefined } | { phase: "drive"; since: number } | { phase: "locked"; why: Why };

export const REST: Drive = { phase: "rest" };

/** What stands in the way; the first is said. */
function obstacle(before: Drive, inputs: Inputs): Why | undefined {
  const since = before.phase === "drive" ? before.since : inputs.now;
  const is = (reason: Reason, wrong: boolean, text?: string): Why | undefined => (wrong ? { reason, text } : undefined);
  return (
    is("stop", (inputs.stopAt ?? 0) >= since) ??
    is("link", !inputs.linked) ??
    is(before.phase === "drive" ? "token-lost" : "no-token", !inputs.owns) ??
    is("stopped", inputs.stopped) ??
    is("unknown", inputs.unknownSince !== undefined, inputs.unknownSince === undefined ? undefined : common.unknownSince(inputs.unknownSince)) ??
    is("hidden", !inputs.visible) ??
    is("blurred", !inputs.focused) ??
    is("pad-gone", before.phase === "drive" && inputs.pad.gone) ??
    is("dead-man", inputs.pad.pushed && !inputs.pad.deadMan) ??
    is("no-picture", !inputs.unseen && inputs.age === undefined) ??
    is("old-picture", !inputs.unseen && (inputs.age ?? 0) > inputs.limit) ??
    is("refused", (inputs.refused?.at ?? -Infinity) >= since, inputs.refused?.text)
  );
}

/** Whether a reason of before says what is not so any more, and tells a person to do what is done. What has come to pass, as a hidden page, stays said. */
function isStale({ reason }: Why, inputs: Inputs): boolean {
  switch (reason) {
    case "no-token":
    case "token-lost":
      return inputs.owns;
    case "stopped":
      return !inputs.stopped;
    case "link":
      return inputs.linked;
    case "unknown":
      return inputs.unknownSince === undefined;
    case "no-picture":
      return inputs.unseen || inputs.age !== undefined;
    case "dead-man":
      return inputs.pad.deadMan;
    default:
      return false;
  }
}

/** A rest with its reason, as far as that still holds. */
function rest(why: Why | undefined, inputs: Inputs): Drive {
  if (!why) return REST;
  // A user who has pressed STOP is told that it holds, and no more when it is let go.
  if (why.reason === "stop" && inputs.stopped) return { phase: "rest", why: { reason: "stopped", text: undefined } };
  return isStale(why, inputs) ? REST : { phase: "rest", why };
}

/** What follows from the present. Once locked it stays so until everything is let go. */
export function step(before: Drive, inputs: Inputs): Drive {
  if (before.phase === "locked") return inputs.held ? before : { phase: "rest", why: before.why };
  if (before.phase === "rest" && !inputs.held) {
    const now = rest(before.why, inputs);
    return now.phase === "rest" && now.why === before.why ? before : now;
  }
  const why = obstacle(before, inputs);
  if (why) return { phase: "locked", why };
  if (!inputs.held) return REST;
  return before.phase === "drive" ? before : { phase: "drive", since: inputs.now };
}

/** Which way is forward on the table: a direction of length 1. The default is that of the table's y. */
export type Forward = readonly [x: number, y: number];
export const TABLE: Forward = [0, 1];

/** The wish as a velocity: no faster in two directions than in one. */
export function velocity(wish: Vector, speed: number, turn: number, forward: Forward = TABLE): Vector {
  const [right, away, up, spin, tilt] = wish;
  const size = Math.max(1, Math.hypot(right, away, up));
  const way = Math.min(speed, FASTEST) / size;
  const angle = (part: number): number => Math.max(-1, Math.min(1, part)) * Math.min(turn, FASTEST_TURN);
  const [fx, fy] = forward;
  const made = [(right * fy + away * fx) * way, (away * fy - right * fx) * way, up * way, angle(spin), angle(tilt)];
  return made.map((part) => Math.round(part * 10) / 10 + 0) as Vector;
}

export function sum(...all: readonly Vector[]): Vector {
  return NOTHING.map((_, axis) => all.reduce((whole, each) => whole + each[axis]!, 0)) as Vector;
}

export function isNothing(wish: Vector): boolean {
  return wish.every((part) => part === 0);
}

/**
 * Forward as a camera sees it, by its 3×4 matrix: away from the viewer, on the table. The third row is the camera's own direction; for one that
 * looks straight down it is upward in the image.
 */
export function forwardOf(matrix: readonly number[]): Forward | undefined {
  if (matrix.length !== 12 || !matrix.every(Number.isFinite)) return undefined;
  const row = (number: number): [number, number, number] => [matrix[number * 4]!, matrix[number * 4 + 1]!, matrix[number * 4 + 2]!];
  const unit = (vector: readonly number[]): number[] | undefined => {
    const size = Math.hypot(...vector);
    return size > 1e-9 ? vector.map((part) => part / size) : undefined;
  };
  const direction = unit(row(2));
  if (!direction) return undefined;
  let level = direction.slice(0, 2);
  if (Math.hypot(...level) < 0.35) {
    const down = row(1);
    const along = down.reduce((whole, part, axis) => whole + part * direction[axis]!, 0);
    const straight = unit(down.map((part, axis) => part - along * direction[axis]!));
    if (!straight) return undefined;
    level = [-straight[0]!, -straight[1]!];
  }
  const forward = unit(level);
  return forward && [forward[0]!, forward[1]!];
}

/** The directions by the keys that move there. */
export const KEYS: Readonly<Record<string, Direction>> = {
  w: "away",
  ArrowUp: "away",
  s: "near",
  ArrowDown: "near",
  a: "left",
  ArrowLeft: "left",
  d: "right",
  ArrowRight: "right",
  r: "up",
  f: "down",
  q: "spin-left",
  e: "spin-right",
  t: "tilt-up",
  g: "tilt-down",
};

export type Direction = "away" | "near" | "left" | "right" | "up" | "down" | "spin-left" | "spin-right" | "tilt-up" | "tilt-down";

export const WAYS: Readonly<Record<Direction, Vector>> = {
  away: [0, 1, 0, 0, 0],
  near: [0, -1, 0, 0, 0],
  left: [-1, 0, 0, 0, 0],
  right: [1, 0, 0, 0, 0],
  up: [0, 0, 1, 0, 0],
  down: [0, 0, -1, 0, 0],
  "spin-left": [0, 0, 0, 1, 0],
  "spin-right": [0, 0, 0, -1, 0],
  "tilt-up": [0, 0, 0, 0, 1],
  "tilt-down": [0, 0, 0, 0, -1],
};

/** The direction of a key: by its letter, or by its place where the keyboard has other letters. */
export function directionOf(key: string, code: string): Direction | undefined {
  const lower = key.length === 1 ? key.toLowerCase() : key;
  const own = Object.hasOwn(KEYS, lower) ? KEYS[lower] : undefined;
  if (own || /^[a-z]$/.test(lower)) return own;
  const place = /^Key([A-Z])$/.exec(code)?.[1]?.toLowerCase();
  return place !== undefined && Object.hasOwn(KEYS, place) ? KEYS[place] : undefined;
}
