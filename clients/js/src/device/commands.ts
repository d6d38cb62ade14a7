// Commands as a device keeps them, and what its queue tells of them and of itself.
import type { Fields } from "../value.js";
import type { DeviceError } from "./errors.js";
import type { AtRest } from "./rest.js";
import type { Script } from "./script.js";

/** Whose command it is: who sent it, its id, and the fence under which it was sent, if it has them. */
export interface Order {
  readonly peer: string;
  readonly id: number | undefined;
  readonly fence: number | undefined;
}

/** A command in the queue. */
export interface Command<A> {
  readonly order: Order;
  readonly script: Script<A>;
  /** When it is too old to begin, µs of the device's time. */
  readonly useBy: number | undefined;
}

/**
 * How far a command has come: the statement being carried out, or the last one begun (1 for the first, 0 before it), and how many it has.
 */
export interface Progress {
  readonly order: Order;
  readonly statement: number;
  readonly of: number;
}

/** What is known of the device at one time. */
export interface State {
  /** Rises with every change. */
  seq: number;
  /** Where it is: what commands are based on. */
  position: Fields;
  /** What else is told of it. */
  report: Fields;
  /** Whether it moves, or does not rest yet though it is to stand. */
  moving: boolean;
  /** How it is known that it rests, if it is. */
  rest: AtRest | undefined;
  /** Whether it can tell its mechanism what to do. */
  reached: boolean;
  /** Whether it takes no command until it is released. */
  stopped: boolean;
  /** The command being carried out. */
  executing: Progress | undefined;
  /** How many commands wait behind it. */
  waiting: number;
}

/** The events of a queue, in order. Each accepted command ends in exactly one `finished` or `failed`. */
export type QueueEvent =
  | { readonly type: "waiting" | "executing" | "finished"; readonly progress: Progress }
  | { readonly type: "failed"; readonly progress: Progress; readonly error: DeviceError }
  | { readonly type: "state"; readonly state: State };

/** How far a command has come of which so many statements have begun. */
export function progressOf<A>({ order, script }: Command<A>, begun: number): Progress {
  return { order, statement: begun, of: script.statements.length };
}
