// The machine of a declared device: its functions are promises, and it knows when they are done.
import type { Fields } from "../value.js";
import { type Call, attachTo, readCall } from "./declare.js";
import { DeviceError, deviceErrorOf } from "./errors.js";
import { Machine } from "./machine.js";
import { LOOK, LOOK_AT_REST, Motion, Sample } from "./rest.js";
import { copyOf } from "./sayable.js";
import type { Attachments, Script, Word, Words } from "./script.js";
import type { Spec } from "./spec.js";

/** µs that a promise of `halt` may take beyond the stopping time. */
const LATE = 1_000_000;

/** µs by which a mechanism is kept alive sooner where its device is asked for something else just then. */
const EARLY = 10_000;

/** One call of a verb's function. */
interface Running {
  readonly call: Call;
  readonly control: AbortController;
  /** Its function was called. */
  started: boolean;
  /** The device was halted although its function had not ended, so that this may actuate it still. */
  halted: boolean;
  /** When its function has ended, µs. */
  done?: number;
  /** Until when the velocity waits for its end to which it has given way, µs. 0: nothing waits for it (any more). NaN: whatever comes does. */
  yields: number;
}

/** What drives it: the time, what is done when a function has ended, and where to what goes wrong is logged. */
export interface Driver {
  now(): number;
  wake(): void;
  log(text: string, error: unknown): void;
}

/**
 * Carries statements out by the functions of a declaration. No function begins before the one before it has ended, whatever that does
 * with its signal, nor before a promise of `halt` is fulfilled; and what was halted meanwhile is halted once more when it has ended. A
 * velocity waits for the one that gives way to it for the stopping time only: the device is halted then, and it begins. Where
 * `halt`, `position` or `report` throw, or give what cannot be said, nothing is known of the device any more: it is `broken`, is said to
 * be out of reach, and takes no command.
 */
export class DeclaredMachine extends Machine<Call> {
  override readonly name: string;
  override readonly verbs: readonly string[];
  override readonly stoppingTime: number;
  override readonly tolerance: number;
  override readonly completes: boolean;
  /** Why nothing is known of it. */
  broken: { error: unknown } | undefined;
  #now = 0;
  #current: Running | undefined;
  /** The calls whose functions have not ended, and one that waits for them. */
  readonly #unsettled = new Set<Running>();
  /** Until when what was told to end has to, as another function waits for it. */
  #patient: number | undefined;
  /** A velocity goes on until the command begins that it has given way to; since when. */
  #yielding: number | undefined;
  /** The promises of `halt` that are not fulfilled yet: when each is late. */
  readonly #halts = new Set<{ readonly late: number }>();
  #failure: DeviceError | undefined;
  readonly #motion: Motion;
  /** What it was when it was looked at last, if it measures. */
  #sample: Sample | undefined;
  #lookedAt = 0;
  #position: Fields = {};
  #report: Fields = {};
  #isPressed: boolean | undefined;
  /** When its mechanism was kept alive last, µs. */
  #keptAt = -Infinity;

  constructor(
    readonly spec: Spec,
    name: string,
    readonly driver: Driver,
  ) {
    super();
    this.name = `the ${name}`;
    this.verbs = Object.keys(spec.verbs);
    this.stoppingTime = Math.round((spec.stopsWithin ?? 1000) * 1000);
    this.tolerance = spec.tolerance ?? 1;
    this.completes = spec.completesOnGive ?? false;
    this.#motion = new Motion(this.tolerance);
    // It may not do what is known of it.
    this.#brake();
  }

  // What its scripts say.

  override read(verb: Word, words: Words): Call | undefined {
    const found = Object.hasOwn(this.spec.verbs, verb.text) ? this.spec.verbs[verb.text] : undefined;
    return found && readCall(found, verb, words);
  }

  override attach(call: Call, attachments: Attachments): Call {
    return attachTo(call, attachments);
  }

  override isRelative({ verb: { kind } }: Call): boolean | undefined {
    return kind === "instant" ? undefined : kind === "relative";
  }

  override neverWaits({ verb: { kind } }: Call): boolean {
    return kind === "velocity";
  }

  override standsAlone({ verb: { kind } }: Call): boolean {
    return kind === "velocity";
  }

  override plan(script: Script<Call>): void {
    if (this.broken) throw new DeviceError("link", `${this.name} has failed, and takes no command`);
    if ([...this.#halts].some(({ late }) => late <= this.#now)) throw new DeviceError("link", `${this.name} was halted, and does not say that it stands`);
    const statements = script.actions().map(([{ name, values }, statement]) => ({ verb: name, args: values, statement }));
    try {
      atOnce(this.spec.plan?.(statements));
    } catch (error) {
      if (!(error instanceof DeviceError)) this.driver.log("its plan failed", error);
      throw deviceErrorOf("its plan", error);
    }
  }

  // What it does.

  override isMoving(): boolean {
    return this.isDriven() || [...this.#unsettled].some(({ call }) => call.verb.kind !== "instant");
  }

  /** A function that was halted may not move it. */
  override isDriven(): boolean {
    return this.#yielding !== undefined || this.#halts.size > 0 || [...this.#unsettled].some(({ call, halted }) => call.verb.kind !== "instant" && !halted);
  }

  override movedAt(): number | undefined {
    return this.#motion.movedAt;
  }

  override isAtRest(): boolean {
    return this.#yielding === undefined && this.#unsettled.size === 0 && this.#halts.size === 0;
  }

  override isReached(): boolean {
    return !this.broken;
  }

  override begin(call: Call, now: number): void {
    this.#now = now;
    if (this.#yielding !== undefined && call.verb.kind !== "velocity") this.#yieldInVain();
    this.#yielding = undefined;
    if (this.broken) throw new DeviceError("link", `${this.name} has failed`);
    const running: Running = { call, control: new AbortController(), started: false, halted: false, yields: 0 };
    this.#current = running;
    this.#unsettled.add(running);
    // However many wait one after the other, what is to end has its time once.
    this.#patient = this.#yieldsUntil(call) || (this.#patient ?? this.#patience(now));
    this.#startNext();
  }

  /** Until when what is to end may take for that. */
  #patience(now: number): number {
    return Math.max(now + this.patience, ...[...this.#halts].map(({ late }) => late));
  }

  /** Until when a velocity waits for those that have given way; 0 or NaN where it waits for nothing, or for something else, too. */
  #yieldsUntil({ verb: { kind } }: Call): number {
    return kind === "velocity" ? Math.max(...[...this.#unsettled].map(({ yields }) => yields)) : 0;
  }

  /** Calls the function that waits, if there is one, as soon as it has the device for itself: two would both drive it. */
  #startNext(): void {
    const all = [...this.#unsettled];
    const next = all.find(({ started }) => !started);
    const isFree = all.every((other) => other === next || (other.yields === 0 && next?.call.verb.kind === "velocity"));
    if (!next) this.#patient = undefined;
    else if (isFree && this.#halts.size === 0 && !this.broken) this.#start(next);
  }

  /** What has waited for another function to end waits no longer. */
  #losePatience(call: Call, now: number): void {
    this.#patient = undefined;
    if (this.#yieldsUntil(call)) {
      for (const running of this.#unsettled) running.yields = 0;
      this.#brake();
      this.#patient = this.#patience(now);
      this.#startNext();
    } else this.#failure ??= new DeviceError("link", `\`${call.name}\` could not begin: what was to end before it goes on`);
  }

  /** What waits for another function to end has not begun, and never will. */
  #forgetUnbegun(): void {
    for (const running of this.#unsettled) if (!running.started) this.#unsettled.delete(running);
  }

  #start(running: Running): void {
    const { call, control } = running;
    this.#patient = undefined;
    running.started = true;
    running.yields = NaN;
    try {
      const act = call.verb.act as (values: Call["values"], signal: AbortSignal) => unknown;
      const acts = act.call(this.spec, call.values, control.signal);
      if (!isPromise(acts)) {
        this.#heedStandstill();
        return this.#settle(running);
      }
      acts.then(
        () => this.#ended(running),
        (error: unknown) => this.#ended(running, { error }),
      );
    } catch (error) {
      this.#settle(running, { error });
    }
  }

  /** A function that gives no promise has ended: no stop could be heard meanwhile. */
  #heedStandstill(): void {
    const silence = this.driver.now() - this.#now;
    if (silence <= this.patience) return;
    this.#failure ??= new DeviceError("halted", `${this.name} was halted: its program stood still for ${Math.floor(silence / 1000)} ms`);
  }

  /** A promise of a function has ended. */
  #ended(running: Running, thrown?: { error: unknown }): void {
    this.#afterTime(() => this.#settle(running, thrown));
  }

  /** Takes something in behind the time that has passed: where the program stood still meanwhile, that is judged before. */
  #afterTime(act: () => void): void {
    this.driver.wake();
    this.#now = Math.max(this.#now, this.driver.now());
    act();
    this.driver.wake();
  }

  #settle(running: Running, thrown?: { error: unknown }): void {
    const { call, control } = running;
    this.#unsettled.delete(running);
    running.done = this.#now;
    if (!control.signal.aborted) {
      if (thrown) this.#fail(call, thrown.error);
      // Its time is over, and nobody else halts what it has begun.
      else if (call.verb.kind === "velocity") this.#brake();
    } else if (thrown && thrown.error !== control.signal.reason && !isAbort(thrown.error)) {
      this.driver.log(`\`${call.name}\` failed after it was to end`, thrown.error);
    }
    // It may have moved the device since that was halted.
    if (running.halted) this.#brake();
    this.#startNext();
  }

  #fail(call: Call, error: unknown): void {
    this.driver.log(`\`${call.name}\` failed`, error);
    this.#failure ??= deviceErrorOf(`\`${call.name}\``, error);
  }

  override doneAt(): number | undefined {
    return this.#current && !this.#failure ? this.#current.done : undefined;
  }

  override takeFailure(): DeviceError | undefined {
    const failure = this.#failure;
    this.#failure = undefined;
    return failure;
  }

  override givesWay(): boolean {
    const { call, control, done } = this.#current ?? {};
    return call?.verb.kind === "velocity" && done === undefined && !control!.signal.aborted;
  }

  /** The velocity that begins next goes on from its speed; before anything else it is halted. */
  override giveWay(now: number): void {
    this.#now = now;
    if (this.#current) this.#current.yields = now + this.stoppingTime;
    this.#current?.control.abort(new DOMException("it gives way to the next command", "AbortError"));
    this.#forgetUnbegun();
    this.#yielding = now;
  }

  /** No other velocity goes on from its speed. */
  #yieldInVain(): void {
    this.#brake();
    this.#patient = undefined;
  }

  override halt(now: number): void {
    this.#now = now;
    for (const running of this.#unsettled) {
      running.yields = NaN;
      running.control.abort(new DOMException("the device is halted", "AbortError"));
    }
    this.#forgetUnbegun();
    [this.#current, this.#failure, this.#patient] = [undefined, undefined, undefined];
    this.#brake();
  }

  /** Has it stand. */
  #brake(): void {
    this.#yielding = undefined;
    for (const running of this.#unsettled) running.halted ||= running.control.signal.aborted;
    this.#known("halt", () => {
      const halts: unknown = this.spec.halt();
      if (isPromise(halts)) this.#awaitHalt(halts);
    });
  }

  /** Until then it moves, and nothing begins. */
  #awaitHalt(halts: PromiseLike<unknown>): void {
    const pending = { late: this.#now + this.stoppingTime + LATE };
    this.#halts.add(pending);
    const end = (): void => {
      this.#halts.delete(pending);
      this.#startNext();
    };
    const fail = (error: unknown): void => {
      this.#break("halt", error);
      end();
    };
    halts.then(
      () => this.#afterTime(end),
      (error: unknown) => this.#afterTime(() => fail(error)),
    );
  }

  override advance(now: number): void {
    this.#now = Math.max(this.#now, now);
    this.#look();
    if (this.isDriven() && this.#now - this.#keptAt >= LOOK - EARLY) {
      this.#keptAt = this.#now;
      this.#known("keepAlive", () => this.spec.keepAlive?.());
    }
    // What it has given way to did not move it, such as a `wait`.
    if (this.#yielding !== undefined && now > this.#yielding) this.#yieldInVain();
    if (this.#patient !== undefined && now >= this.#patient && this.#current) this.#losePatience(this.#current.call, now);
  }

  override nextWake(): number | undefined {
    const next = this.#yielding === undefined ? this.#patient : this.#yielding + 1;
    if (this.broken || (!this.#sample && !this.spec.estop && this.isAtRest())) return next;
    const movedAt = this.#motion.movedAt ?? -Infinity;
    const stands = this.isAtRest() && this.#lookedAt - movedAt > LOOK_AT_REST + LOOK_AT_REST;
    return Math.min(next ?? Infinity, this.#lookedAt + (stands ? LOOK_AT_REST : LOOK));
  }

  /** Looks where it is: whatever may have moved it. */
  #look(): void {
    this.#lookedAt = this.#now;
    if (this.broken) return;
    this.#sample = Sample.of(this.position(), this.#now);
    if (this.#sample) this.#motion.look(this.#sample);
  }

  // How it stands.

  override position(): Fields {
    this.#known("position", () => {
      const position = copyOf(atOnce(this.spec.position()));
      for (const [key, value] of Object.entries(position)) if (typeof value !== "number") throw new TypeError(`${key} is not a number`);
      this.#position = position;
    });
    return this.#position;
  }

  override report(): Fields {
    this.#known("report", () => (this.#report = copyOf(atOnce(this.spec.report?.()) ?? {})));
    return this.#report;
  }

  override estop(): boolean | undefined {
    if (!this.spec.estop) return undefined;
    this.#known("estop", () => {
      const pressed: unknown = atOnce(this.spec.estop!());
      // An input may say so by a number; what says nothing is not taken for a button that is not pressed.
      if (typeof pressed !== "boolean" && !Number.isFinite(pressed)) throw new TypeError("it gives neither true nor false");
      this.#isPressed = Boolean(pressed);
    });
    return this.#isPressed ?? true;
  }

  override measured(at: number): Sample | undefined {
    return this.#sample?.at === at ? this.#sample : super.measured(at);
  }

  /** What it gave cannot be said: nothing more of that is. */
  unsayable(error: unknown): void {
    this.#break("state", error);
    [this.#position, this.#report] = [{}, {}];
  }

  /** Does what must not fail. */
  #known(what: string, act: () => void): void {
    // What is known last of a broken one is kept; it is to stand all the same.
    if (this.broken && what !== "halt") return;
    try {
      act();
    } catch (error) {
      this.#break(what, error);
    }
  }

  #break(what: string, error: unknown): void {
    if (this.broken) return;
    this.broken = { error };
    this.#failure ??= deviceErrorOf(`its ${what}`, error);
    this.driver.log(`its ${what} failed, and it obeys no more`, error);
  }
}

function isPromise(value: unknown): value is PromiseLike<unknown> {
  return typeof (value as PromiseLike<unknown> | undefined)?.then === "function";
}

/** What has to be known at once. */
function atOnce<T>(value: T): T {
  if (!isPromise(value)) return value;
  value.then(undefined, () => undefined);
  throw new TypeError("it gives a promise, and has to be known at once");
}

function isAbort(error: unknown): boolean {
  return (error as Error | undefined)?.name === "AbortError";
}
