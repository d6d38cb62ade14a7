// What a device itself can do.
import type { Fields } from "../value.js";
import type { DeviceError } from "./errors.js";
import { Sample } from "./rest.js";
import type { Attachments, Script, Word, Words } from "./script.js";

/**
 * A device without its queue, its owner and its link: what its actions are, and how it carries one out. Times are µs, whole numbers, and
 * never go back; the machine knows the time of the latest call.
 */
export abstract class Machine<A> {
  /** What it is called in texts, such as `the camera`. */
  abstract readonly name: string;
  /** The first words of its statements, for the nearest one to a wrong word; without `wait`. */
  abstract readonly verbs: readonly string[];
  /** µs between two states while it moves. */
  readonly period: number = 50_000;
  /** µs within which it stands once it is halted, whatever it did before. It says that it rests by this only where it does not measure. */
  readonly stoppingTime: number = 1_000_000;
  /** µs for which what was begun may go on while the program stands still, and by which a later statement may begin too late. */
  readonly patience: number = 1_000_000;
  /** The numbers of its position differ by less than this, each in its unit, while it rests. */
  readonly tolerance: number = 1;
  /**
   * Whether what its owner began may come to the end of the present statement where its token is given away, and the hub sends no `halt`.
   * Else it is halted then, too.
   */
  readonly completes: boolean = false;

  /** Reads what follows the verb of a statement; undefined if there is no such verb. Throws `syntax` at the word that is wrong. */
  abstract read(verb: Word, words: Words): A | undefined;

  /** The action with the bytes that it names, of those that came with its script. Throws `syntax` if they did not come. */
  attach(action: A, _attachments: Attachments): A {
    return action;
  }

  /** Whether an action says only how far it goes from where the device is; undefined of one that takes it nowhere. */
  isRelative(_action: A): boolean | undefined {
    return false;
  }

  /** Whether an action waits behind no other: it takes the place of one that gives way, and is refused as `busy` behind any other. */
  neverWaits(_action: A): boolean {
    return false;
  }

  /** Whether an action is the only statement of its script, as what would follow it would begin nobody knows where. */
  standsAlone(_action: A): boolean {
    return false;
  }

  /** Whether it is busy with something that no command began, or moves on after one. */
  abstract isMoving(): boolean;

  /** Whether it moves, or comes to a stand, as it was told to: if not, it is halted again where it does not rest in time. */
  isDriven(): boolean {
    return this.isMoving();
  }

  /** When it was last seen to have moved by its tolerance, whatever has moved it: for 0.3 s it moves then. Undefined if nobody looks. */
  movedAt(): number | undefined {
    return undefined;
  }

  /** Whether a halt would change nothing. */
  isAtRest(): boolean {
    return !this.isMoving();
  }

  /** Whether it can tell its mechanism what to do, and hears of it. What is not reached is never said to rest. */
  isReached(): boolean {
    return true;
  }

  /** Whether an emergency stop at the device itself is pressed; undefined if it knows of none. It is asked at each turn of its server. */
  estop(): boolean | undefined {
    return undefined;
  }

  /** Whether what it reports changes by itself although it does not move. States follow meanwhile. */
  isChanging(): boolean {
    return false;
  }

  /**
   * Checks a script from where the device will be after those that were planned before, and plans on from its end. Throws what cannot be
   * carried out, with the statement's number; then nothing is planned.
   */
  abstract plan(script: Script<A>): void;

  /** Begins an action. Throws why it cannot be begun; then all commands end. */
  abstract begin(action: A, now: number): void;

  /** When the action that was begun last is done, as far as that is known. */
  abstract doneAt(): number | undefined;

  /** Goes on with the action that was begun last, until then at most, and says when it was done, if it was. */
  pursue(until: number): number | undefined {
    const done = this.doneAt();
    return done !== undefined && done <= until ? done : undefined;
  }

  /** Why everything has to end that is being carried out or waits, if it has; once. */
  takeFailure(): DeviceError | undefined {
    return undefined;
  }

  /** Whether what was begun goes on until another command comes. Then it gives way, and its command is finished. */
  givesWay(): boolean {
    return false;
  }

  /** Gives way to the command that begins next. */
  giveWay(now: number): void {
    this.halt(now);
  }

  /** Comes to a stand at once, and forgets what was planned. Each stop and each halt comes here, also at rest. */
  abstract halt(now: number): void;

  /** Lets time pass until `now`. */
  abstract advance(now: number): void;

  /** When {@link advance} has to be called next; undefined if it changes by commands only. */
  nextWake(): number | undefined {
    return undefined;
  }

  /** Since when what the state tells may have been so, if that is not now: of a device that is asked, when it was. */
  knownAt(): number | undefined {
    return undefined;
  }

  /** What commands may be based on: where the device is, as it stands in the state, key by key. */
  abstract position(): Fields;

  /** What is measured of all of it that can move, at this time; undefined where something that may have moved is not measured. */
  measured(at: number): Sample | undefined {
    return Sample.of(this.position(), at);
  }

  /** What else stands in the state. */
  report(): Fields {
    return {};
  }
}
