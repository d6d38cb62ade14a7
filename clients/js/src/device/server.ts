// The device's server: reacts to the events of its channel, without IO and without a clock.
import { type Delivery, type Event, type GuardState, type Held, Latch, type MessageEvent, type Parcel, type Time, type Turn } from "../index.js";
import { fieldsOf } from "../index.js";
import type { Fields, Value } from "../value.js";
import type { Order, Progress, QueueEvent, State } from "./commands.js";
import { DeviceError, type DeviceErrorName, defined, deviceErrorOf } from "./errors.js";
import { Estop } from "./estop.js";
import type { Machine } from "./machine.js";
import { type DeviceAge, NEXT, Pull } from "./pull.js";
import { CommandQueue } from "./queue.js";
import { sayable } from "./sayable.js";
import { readScript, scriptOf } from "./script.js";
import { Refusal, StateGate, basedOn } from "./states.js";

/** The message that carries a script. */
export const COMMAND = "command";
/** The message that tells how far a command has come. */
export const STATUS = "status";
/** The message that tells the device's state. */
export const STATE = "state";
/** The key of a full state for ms within which the device stands. */
const STOPS_WITHIN = "stops-within";
const HUB = "hub";
/** Why commands end at the hub's safe state. */
const SAFE = "the hub ordered the safe state, because the token's owner lost it or gave it up";

/** What is known of the token that guards the device's channel: a `Channel` is one. */
export interface Gate {
  /** The last known state of the token; null = none guards it. */
  readonly guard: GuardState | null;
  /** Whether a message may be obeyed now. */
  permits(parcel: Parcel): boolean;
}

/** What a device hears: the events of its channel, and that its link goes on where it was. */
export type DeviceEvent = Event | { type: "link-resumed" };

/** How a server is set. */
export interface ServerOptions {
  /** µs that a command may be old when it begins, whatever its sender says. An unknown age fails it. */
  maxAge?: number;
  /** How many times as fast as that of its users the device's time passes, as a simulated one's may. */
  pace?: number;
  /** It asks for its commands, each time for so many µs, and takes none that is not an answer or may be too old. */
  pulling?: number;
}

/**
 * The decisions of a device's peer. {@link handle} takes an event of the device's channel, {@link advance} lets time pass; the driver
 * calls that whenever {@link nextWake} is due. What is to be sent is added to `out`, in order. Times are µs, whole numbers.
 *
 * - A command is obeyed if the gate lets it pass, if the state that it was based on (a relative one has to name it) still holds, if it is
 *   not too old, and if the device takes its script. Otherwise, and at every later change, a `status` is broadcast.
 * - Whenever the owner changes, another token guards the channel, the hub sends `halt`, or the link is lost, all commands end and the
 *   device stands at once. Where owners hand over by agreement and the hub sends no `halt`, the present statement comes to its end in a
 *   device that completes.
 * - An emergency stop at the device itself is a stop of its own, too. While it is pressed nothing is carried out, whatever is lifted.
 * - The first motion of a new owner waits until the device rests, at most twice its stopping time and a second.
 * - Anybody's `stop` ends all commands too, and holds until an `unstop` that names it or a newer one. A gap in the events is a stop of
 *   its own.
 */
export class DeviceServer<A> {
  readonly #queue: CommandQueue<A>;
  /** Whether it may move. */
  readonly #latch = new Latch();
  readonly #states: StateGate;
  /** Where the device was in the last state that was told. */
  #told: Fields | undefined;
  /** The token that guards its channel, once that was looked at; null = none. */
  #guard: string | null | undefined;
  /** The newest fence of it that was heard of, and that of the command that was taken last. */
  #fence = 0;
  #commanded = 0;
  /** Whether its owner has given the token away, and nobody has it yet. */
  #handingOver = false;
  readonly #estop = new Estop();
  readonly #pull: Pull | undefined;
  readonly #pace: number;
  /** What it is called at the hub, so that it can stop itself there. */
  name: string | undefined;
  /** Why it moves nothing although no stop holds, such as that the hub is silent. */
  held: string | undefined;

  /** `start` is the time of day at which the device starts: no state of an earlier start passes for one of this. */
  constructor(
    readonly machine: Machine<A>,
    readonly channel: string,
    start: Time,
    /** It may be changed at any time, but for `pulling` and `pace`. */
    readonly options: ServerOptions = {},
  ) {
    this.#pace = Math.max(1, options.pace ?? 1);
    this.#queue = new CommandQueue(machine, this.#pace);
    this.#states = new StateGate(start);
    this.#pull = options.pulling === undefined ? undefined : new Pull(options.pulling);
  }

  /** Why the device may not move, if it may not. */
  mayMove(): Held | null {
    if (this.#estop.owed !== undefined) return { held: "own", text: `stopped by itself: ${this.#estop.owed}` };
    return this.#latch.mayMove() ?? (this.held === undefined ? null : { held: "unknown", text: this.held });
  }

  get isStopped(): boolean {
    return this.#latch.isStopped || this.#estop.owed !== undefined;
  }

  /** How it stands. */
  state(): State {
    return this.#queue.state();
  }

  /** When {@link advance} is to be called next; undefined while the device has nothing to do. */
  nextWake(): number | undefined {
    return this.#queue.nextWake();
  }

  /** Handles an event. `age` is how old a message is, µs, as far as that is known. */
  handle(event: DeviceEvent, gate: Gate, age: DeviceAge | undefined, now: number, out: Parcel[]): void {
    this.advance(now, out);
    this.#watchGuard(gate, now, out);
    const turn = event.type === "link-resumed" ? undefined : this.#latch.observe(event);
    this.#estop.hear(event, this.name);
    if (turn) this.#react(event, turn, now, out);
    switch (event.type) {
      case "message":
        return this.#message(event, gate, age, now, out);
      case "joined":
        out.push({ ...this.#fullState(), address: [event.member.peer] });
        return;
      // Without names of who joined, all are told.
      case "count":
        return this.report(out);
      case "dropped":
        if (fieldsOf(event.parcel?.content)["sender"] === HUB) this.report(out);
        return;
      case "rejoined":
      case "link-resumed":
        this.report(out);
        this.#tellOwnStop(out);
        return this.#tellEstop(out);
      case "expelled":
        if (event.peer === this.name) this.halt(`this device was put out of its channel: ${event.text ?? "nobody says why"}`, now, out);
        return;
      case "grabbed":
        return this.#takeOwner(event.fence, now, out);
      case "released":
        this.#handingOver = this.machine.completes && (event.reason === "given" || event.reason === "returned");
        return this.#endOlder(event.fence + 1, now, out);
    }
  }

  /** Lets time pass until `now`. */
  advance(now: number, out: Parcel[]): void {
    this.#watchEstop(now, out);
    this.#act(out, (events) => this.#queue.advance(now, events));
  }

  /** Lets something be done to the device that no command does, such as that news of it have come. */
  note(now: number, what: () => void, out: Parcel[]): void {
    this.#act(out, (events) => this.#queue.note(now, what, events));
  }

  /** Ends every command with this error, because the device cannot carry it out. */
  fail(now: number, error: DeviceError, out: Parcel[]): void {
    this.#act(out, (events) => this.#queue.fail(now, error, events));
  }

  /** Ends every command, for a reason in plain words. */
  halt(reason: string, now: number, out: Parcel[]): void {
    this.#act(out, (events) => this.#queue.halt(now, reason, events));
  }

  /** Tells all members of the channel the state. */
  report(out: Parcel[]): void {
    this.#watchEstop(this.#queue.now, out);
    out.push(this.#fullState());
  }

  /** Stops by itself, as at a bumper, until a peer lifts that, and tells the hub. */
  stopItself(why: string, now: number, out: Parcel[]): void {
    this.#react(undefined, this.#latch.stopItself(sayable(why)), now, out);
    this.#tellOwnStop(out);
  }

  /** Asks for the next command, if that is due and the token has an owner. */
  ask(gate: Gate, now: number, out: Parcel[]): void {
    const due = this.asksAt(gate);
    if (!this.#pull || due === undefined || due > now) return;
    const id = this.#states.next(false);
    this.#pull.ask(id, now);
    out.push({ ...this.#parcel(NEXT, { wait: Math.floor(this.#pull.wait / 1000) }), delivery: "latest", id });
  }

  /** When {@link ask} has to be called next. */
  asksAt(gate: Gate): number | undefined {
    if (!this.#pull || this.#queue.isBusy || gate.guard?.owner === undefined || this.#refusesAll()) return undefined;
    return this.#pull.due;
  }

  #refusesAll(): boolean {
    try {
      this.#queue.checkFree();
      return false;
    } catch {
      return true;
    }
  }

  // Commands.

  #message(event: MessageEvent, gate: Gate, age: DeviceAge | undefined, now: number, out: Parcel[]): void {
    const { name, sender, parcel } = event;
    // Only the hub may say `halt`; a peer that wants the device to stop has `stop`. The safe state that the token declares ends what the
    // owner began, as `halt` does, and then moves the device.
    if (sender === HUB && (name === "halt" || name === COMMAND)) this.halt(SAFE, now, out);
    // What was said before it joined was said to nobody.
    if (name !== COMMAND || event.history) return;
    const order: Order = { peer: sender, id: parcel.id, fence: parcel.fence };
    try {
      if (!gate.permits(parcel)) throw staleFence(parcel, gate.guard);
      this.#obey(order, event, age, now, out);
    } catch (error) {
      const content = error instanceof Refusal ? error.content : deviceErrorOf(this.machine.name, error).content();
      out.push(this.#status({ order, statement: 0, of: 0 }, "error", content));
    }
  }

  /** Throws why the command is refused. */
  #obey(order: Order, { parcel, content }: MessageEvent, age: DeviceAge | undefined, now: number, out: Parcel[]): void {
    const { machine } = this;
    // The token's events may still be under way; the command's fence has the same information.
    this.#takeOwner(order.fence ?? 0, now, out);
    this.#states.check(parcel, this.#queue.isBusy || this.#queue.isMoving);
    this.#pull?.check(parcel, age);
    const { text, attachments } = scriptOf(machine.name, content);
    if (order.id !== undefined && this.#queue.orders().some((other) => isSame(other, order))) {
      throw new DeviceError("duplicate-id", `command ${order.id} of ${order.peer} is still waiting or executing; choose another id`);
    }
    if (this.#estop.isPressed) throw new DeviceError("estop", `the emergency stop of ${machine.name} is pressed: reset it there, and then lift the stop`);
    this.#queue.checkFree();
    const held = this.mayMove();
    if (held) throw new DeviceError("stopped", `${machine.name} may not move: ${held.text}`);
    const script = readScript(text, machine, attachments);
    const first = script.actions().map(([action]) => machine.isRelative(action)).find((relative) => relative !== undefined);
    if (first === true && basedOn(parcel) === undefined) {
      throw new DeviceError("no-state", "a relative command requires the slot `based-on`: the id of the state that it is based on");
    }
    const command = { order, script, useBy: this.#useBy(parcel, age, now) };
    this.#act(out, (events) => this.#queue.submit(command, now, events));
    this.#commanded = order.fence ?? 0;
    this.#pull?.renew(now);
  }

  /** Until when a command may begin: until it expires, and until it is older than the device allows. Throws `too-old`. */
  #useBy({ sender, expires: life }: Parcel, age: DeviceAge | undefined, now: number): number | undefined {
    // The hub's own command is the safe state, which does not grow old.
    if (sender === HUB) return undefined;
    const { machine: { name }, options: { maxAge } } = this;
    const later = (micros: number): number => now + Math.floor(micros * this.#pace);
    const expires = life === undefined ? undefined : later(life * 1000 - (age?.micros ?? 0));
    if (maxAge === undefined) return expires;
    const most = Math.floor(maxAge / 1000);
    if (age?.error === undefined) {
      const text = `${name} takes commands of at most ${most} ms, and the age of this one is not known: its sender has not measured its clock yet`;
      throw new DeviceError("too-old", text, { retry: true });
    }
    const oldest = Math.max(0, age.micros) + age.error;
    if (oldest > maxAge) throw new DeviceError("too-old", `the command is ${Math.floor(oldest / 1000)} ms old, and ${name} takes those of at most ${most} ms`);
    return Math.min(expires ?? Infinity, later(maxAge - oldest));
  }

  // Stops and owners.

  /** Does what an event about stops means. */
  #react(event: DeviceEvent | undefined, turn: Turn, now: number, out: Parcel[]): void {
    if (turn.turn === "stop") this.#obeyStop(out, (events) => this.#queue.stop(now, turn.why, events));
    // It was said before the stop that the hub does not know yet.
    else if (turn.turn === "free" && this.#estop.owed !== undefined) this.report(out);
    else if (turn.turn === "free") this.#obeyStop(out, (events) => this.#queue.unstop(now, events));
    else if (turn.turn === "same") this.report(out);
    else if (event?.type === "link-down") this.halt("the link to the hub was lost", now, out);
    else this.#obeyStop(out, (events) => this.#queue.halt(now, "a stop has come that was lifted before", events));
    if (event?.type === "lagged") this.#tellOwnStop(out);
  }

  /**
   * Looks at the emergency stop of the device itself. Each press and each reset is a stop of its own: who resets it does not set the device
   * in motion, nor does a velocity that is still being sent, nor an `unstop` that was said before.
   */
  #watchEstop(now: number, out: Parcel[]): void {
    const why = this.#estop.look(this.machine.estop());
    if (why === undefined) return;
    const name: DeviceErrorName = this.#estop.isPressed ? "estop" : "stopped";
    this.#obeyStop(out, (events) => this.#queue.stop(now, why, events, name));
    this.#tellEstop(out);
  }

  /** Tells the hub that its emergency stop was pressed or reset, as long as the hub does not know. */
  #tellEstop(out: Parcel[]): void {
    const why = this.#estop.toSay();
    if (why === undefined || this.name === undefined) return;
    const id = this.#states.next(false);
    this.#estop.said(id);
    out.push({ ...this.#ownStop(`stopped by itself: ${why}`, this.name), id });
  }

  /** Tells the hub that it has stopped itself, if the hub does not know: from then on it is a stop like any other. */
  #tellOwnStop(out: Parcel[]): void {
    if (this.name === undefined || !this.#latch.isOwn) return;
    out.push(this.#ownStop(this.#latch.mayMove()?.text ?? "", this.name));
  }

  /** A stop that it says to itself. */
  #ownStop(reason: string, name: string): Parcel {
    return { family: "message", name: "stop", context: this.channel, content: { reason }, address: [name] };
  }

  /** Stops, or does so no more, and says how the device stands, changed or not. */
  #obeyStop(out: Parcel[], action: (events: QueueEvent[]) => void): void {
    const before = out.length;
    this.#act(out, action);
    if (!out.slice(before).some((parcel) => parcel.name === STATE)) this.report(out);
  }

  /**
   * Ends all commands where another token guards the channel than before, or one where none did: fences of two tokens say nothing of each
   * other, and who was allowed before may not be now.
   */
  #watchGuard(gate: Gate, now: number, out: Parcel[]): void {
    const [before, token] = [this.#guard, gate.guard?.token ?? null];
    this.#guard = token;
    if (before === undefined || before === token) return;
    [this.#fence, this.#commanded, this.#handingOver] = [0, 0, false];
    this.halt("another token guards its channel from now on", now, out);
  }

  /** The token has an owner of this fence, perhaps a new one. */
  #takeOwner(fence: number, now: number, out: Parcel[]): void {
    if (fence <= this.#fence) return;
    // Before anything is told: each state from now on says that it stands for the new owner.
    this.#fence = fence;
    this.#pull?.renew(now);
    const before = out.length;
    this.#endOlder(fence, now, out);
    this.#handingOver = false;
    this.#act(out, (events) => this.#queue.changeHands(now, events));
    if (!out.slice(before).some((parcel) => parcel.name === STATE)) this.report(out);
  }

  /** Ends what older owners have begun, also what their commands left behind: its sender no longer owns the token. */
  #endOlder(fence: number, now: number, out: Parcel[]): void {
    // What was sent without a fence, before the channel was guarded, is older than any; the hub's own is the safe state of a change.
    const isOlder = (order: Order): boolean => (order.fence ?? 0) < fence && order.peer !== HUB;
    const isLeft = !this.#queue.isBusy && !this.#queue.isAtRest && this.#commanded < fence;
    if (!isLeft && !this.#queue.orders().some(isOlder)) return;
    const reason = "the token changed hands";
    if (this.#handingOver) this.#act(out, (events) => this.#queue.endStatement(now, reason, events));
    else this.halt(reason, now, out);
  }

  // What it says.

  /** Lets the device act, and reports the outcome, also where it throws. */
  #act(out: Parcel[], action: (events: QueueEvent[]) => void): void {
    const events: QueueEvent[] = [];
    try {
      action(events);
    } finally {
      for (const event of events) {
        if (event.type === "state") out.push(this.#state(event.state));
        else if (event.type === "failed") out.push(this.#status(event.progress, "error", event.error.content()));
        else out.push(this.#status(event.progress, event.type));
      }
    }
  }

  /** `{id?, peer, state, statement, of, fence?, error?}`. */
  #status({ order, statement, of }: Progress, state: string, error?: Fields): Parcel {
    const { id, peer, fence } = order;
    const parcel = this.#parcel(STATUS, { id, peer, state, statement, of, fence, error });
    return id === undefined ? parcel : { ...parcel, reference: id };
  }

  /** The state with what never changes, for who has just come. */
  #fullState(): Parcel {
    const parcel = this.#state(this.#queue.state());
    return { ...parcel, content: { ...fieldsOf(parcel.content), [STOPS_WITHIN]: Math.floor(this.machine.stoppingTime / 1000) } };
  }

  /** `{…position, …report, seq, moving, rest?, reached, stopped, estop?, stop, executing {id?, peer, statement, of}?, waiting, fence?}`. */
  #state({ seq, position, report, moving, rest, reached, stopped, executing, waiting }: State): Parcel {
    const { order, statement, of } = executing ?? {};
    const carriedOut = order && defined({ id: order.id, peer: order.peer, statement, of });
    // What the author says overwrites none of these.
    const { known: estop, owed } = this.#estop;
    const told = { seq, moving, rest, reached, stopped: stopped || owed !== undefined, estop, stop: this.#latch.number, executing: carriedOut, waiting, fence: this.#fence || undefined, [STOPS_WITHIN]: undefined };
    const moved = !this.#told || !isSame(this.#told, position);
    if (moved) this.#told = position;
    const delivery: Delivery = "latest";
    return { ...this.#parcel(STATE, { ...position, ...report, ...told }), delivery, id: this.#states.next(moved) };
  }

  /** A broadcast without echo. */
  #parcel(name: string, content: Fields): Parcel {
    return { family: "message", name, context: this.channel, echo: false, content: defined(content) };
  }
}

/** Of a command that was not sent by the token's present owner. */
function staleFence({ fence }: Parcel, guard: GuardState | null): Refusal {
  const owner = guard?.owner;
  const now = owner === undefined ? "nobody owns its token now" : `${owner} owns its token now, with fence ${guard!.fence}`;
  const given = fence === undefined ? "without a fence" : `under fence ${fence}`;
  return new Refusal(defined({ name: "older-fence", code: 205, text: `the command was sent ${given}, and ${now}`, owner }));
}

/** Whether two values are equal, member by member. */
function isSame(one: unknown, other: unknown): boolean {
  if (one === other) return true;
  if (typeof one !== "object" || typeof other !== "object" || !one || !other) return false;
  const [keys, others] = [Object.keys(one), Object.keys(other)];
  return keys.length === others.length && keys.every((key) => isSame((one as { [key: string]: Value })[key], (other as { [key: string]: Value })[key]));
}
