// What an author says of a device.
import type { Fields } from "../value.js";
import type { Arg, Verb } from "./declare.js";

/** A statement of a script that is to be planned; a `wait` is not among them. */
export interface Planned {
  readonly verb: string;
  /** By the names of its arguments. */
  readonly args: { readonly [name: string]: number | string | Uint8Array };
  /** Its number in the script, 1 for the first. */
  readonly statement: number;
}

/** What a device is and does. Its functions are called with it as `this`. */
export interface Spec {
  /** In plain words. */
  readonly does: string;
  /** By the first words of its statements. */
  readonly verbs: { readonly [name: string]: Verb };
  /**
   * Stands at once. It is called at each stop, each halt, each loss of the connection, and before the first command, also at rest. What
   * it throws, or its promise is rejected with, ends the device.
   */
  halt(): unknown;
  /**
   * Where it is: numbers by which it is known to rest, and on which commands are based. Degrees that go on from 359 at 0 are `heading`. A
   * device that does not measure gives none. What it throws ends the device.
   */
  position(): { readonly [name: string]: number };
  /** What else its state tells. */
  report?(): Fields;
  /**
   * Whether an emergency stop at the device itself is pressed, such as a button on it or its pendant. It is asked at each turn, each 150 ms
   * at the latest, and must not block. While it is pressed nothing is carried out, and when it was reset nothing either until an `unstop`
   * that was said after that. What it throws ends the device.
   */
  estop?(): boolean;
  /**
   * Tells its mechanism that its program is there, each 50 ms while a statement that moves it is carried out, and not otherwise. So motors
   * that stand by themselves when they have heard nothing for a moment, such as 0.3 s, stand where the program stands still. What it throws
   * ends the device.
   */
  keepAlive?(): void;
  /**
   * Throws a `DeviceError` where it cannot carry a script out from where those that were planned before lead; then nothing of it begins.
   */
  plan?(statements: readonly Planned[]): void;
  /** What `position` and `report` give, for the card. */
  readonly state?: { readonly [name: string]: Arg<number> | Arg<string> };
  /** At rest each number of its position differs by less than this, in its unit; 1 unless said. */
  readonly tolerance?: number;
  /** ms within which it stands once it is halted, whatever it did before; 1000 unless said. */
  readonly stopsWithin?: number;
  /** ms that a command may be old when it begins, whatever its sender says; without it that is its sender's business. */
  readonly maxAge?: number;
  /** Where its token is given away, and the hub sends no `halt`, the present statement comes to its end. Else it is halted then, too. */
  readonly completesOnGive?: boolean;
  /** The channels of cameras that see it. */
  readonly cameras?: readonly string[];
}
