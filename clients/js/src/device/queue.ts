// The queue: a state machine that takes commands and the time, and emits events.
import { type Command, type Order, type QueueEvent, type State, progressOf } from "./commands.js";
import { DeviceError, type DeviceErrorName, deviceErrorOf } from "./errors.js";
import type { Machine } from "./machine.js";
import { type AtRest, REST, Rest } from "./rest.js";
import { MAX_ATTACHED, type Script } from "./script.js";

/** The most commands that wait behind the one being carried out. */
export const MAX_WAITING = 64;
/** µs after which what was heard of a device that rests does not say that it still does. */
const OLD = 3_000_000;
/** µs that a new owner waits beyond twice the stopping time until the device rests. */
const INTERLOCK = 1_000_000;

/** The command being carried out. */
interface Active<A> {
  readonly command: Command<A>;
  /** How many statements have begun. */
  begun: number;
  /** When the present statement ends, if it is a `wait`, or none has begun; else its machine says when its action is done. */
  ends: number | undefined;
  /** Why no statement begins after the present one; undefined if the script goes on. */
  last: string | undefined;
}

/**
 * A device that carries out one command after the other. A driver calls {@link advance} whenever {@link nextWake} is due. Every method
 * that takes `now` (µs) first advances to it; a time before the latest one counts as the latest. What happens is added to `events`, in
 * order.
 */
export class CommandQueue<A> {
  #now = 0;
  #seq = 0;
  #stopped = false;
  #active: Active<A> | undefined;
  #waiting: Command<A>[] = [];
  /** When the next state is due, while it moves. */
  #publish = 0;
  /** What the last state that was told said: whether it moves, how it rests, whether it is reached. */
  #toldMoving = false;
  #toldRest: AtRest | undefined;
  #toldReached: boolean;
  /** Whether it was changing by itself when that was looked at last. */
  #wasChanging: boolean;
  readonly #rest: Rest;
  /** When the machine was last seen to have moved, as far as that was taken in. */
  #movedAt: number | undefined;
  /** It was to stand while it moved, and does not rest yet. */
  #halting = false;
  /** When it was told to stand last, or had something under way after that; none if an action has begun since. */
  #standsSince: number | undefined = 0;
  /** It has a new owner, whose first motion waits until it rests, and until then at most. */
  #changesHands = false;
  #waitsUntil: number | undefined;
  /** For how long the program has stood still, while that is made up for. */
  #silence: number | undefined;

  constructor(
    readonly machine: Machine<A>,
    /** How many times as fast as that of its program its time passes. */
    readonly pace = 1,
  ) {
    this.#toldReached = machine.isReached();
    this.#wasChanging = machine.isChanging();
    this.#rest = new Rest(machine.tolerance, machine.stoppingTime);
  }

  /** Lets something be done to the device that no command does; a state follows if it moves now, or stands. */
  note(now: number, what: () => void, events: QueueEvent[]): void {
    this.advance(now, events);
    what();
    this.#seq += 1;
    this.advance(this.#now, events);
    if (this.#toldMoving !== this.isMoving) this.#publishState(events);
  }

  /** Whether it moves, or is to stand and does not rest yet. Where it is not reached nobody knows. */
  get isMoving(): boolean {
    return this.machine.isMoving() || this.#halting || this.#rolls || !this.machine.isReached();
  }

  /** Whether it has moved lately, as what rolls on or is pushed does. */
  get #rolls(): boolean {
    const movedAt = this.machine.movedAt();
    return movedAt !== undefined && this.#now - movedAt < REST;
  }

  /** How it is known that it rests, if it is. */
  get #rests(): AtRest | undefined {
    return this.#rolls ? undefined : this.#rest.known;
  }

  /** Whether its position may change meanwhile: what is not reached tells nothing new. */
  get #isLively(): boolean {
    return this.machine.isReached() && (this.machine.isMoving() || this.machine.isChanging() || this.#halting || this.#rolls);
  }

  /** The latest time that was given. */
  get now(): number {
    return this.#now;
  }

  /** Whether a command is being carried out or waits, so that the device may be elsewhere soon. */
  get isBusy(): boolean {
    return this.#active !== undefined || this.#waiting.length > 0;
  }

  /** Whether a halt would change nothing. */
  get isAtRest(): boolean {
    return !this.isBusy && this.machine.isAtRest() && !this.#rolls;
  }

  /** Whose commands are being carried out or wait. */
  orders(): Order[] {
    return this.#commands().map((command) => command.order);
  }

  #commands(): Command<A>[] {
    return [...(this.#active ? [this.#active.command] : []), ...this.#waiting];
  }

  /** The state at the latest time given. */
  state(): State {
    const active = this.#active;
    return {
      seq: this.#seq,
      position: this.machine.position(),
      report: this.machine.report(),
      moving: this.isMoving,
      rest: this.#rests,
      reached: this.machine.isReached(),
      stopped: this.#stopped,
      executing: active && progressOf(active.command, active.begun),
      waiting: this.#waiting.length,
    };
  }

  // What comes in.

  /** Throws `stopped` or `queue-full` where no command could be taken now. */
  checkFree(): void {
    if (this.#stopped) throw new DeviceError("stopped", `${this.machine.name} is stopped and takes no command until the stop is released`);
    if (this.#waiting.length >= MAX_WAITING) {
      throw new DeviceError("queue-full", `${MAX_WAITING} commands are waiting already; try again when one has begun`);
    }
  }

  /**
   * Takes a command: has the machine check it, and queues it. It begins at once if nothing else is being carried out. Throws `stopped`,
   * `queue-full`, `busy`, `changing-hands`, or why the machine cannot carry it out; then nothing moves.
   */
  submit(command: Command<A>, now: number, events: QueueEvent[]): void {
    this.advance(now, events);
    this.checkFree();
    this.#checkAttached(command.script.attached);
    this.#checkTurn(command.script);
    this.machine.plan(command.script);
    // One that never waits takes the place of those like it that wait for rest.
    if (!this.#active && this.#neverWaits(command.script)) {
      for (const other of this.#waiting.splice(0)) events.push({ type: "finished", progress: progressOf(other, 0) });
    }
    events.push({ type: "waiting", progress: progressOf(command, 0) });
    this.#waiting.push(command);
    this.#seq += 1;
    this.advance(now, events);
  }

  /** Whether there is room for what came with a script. */
  #checkAttached(more: number): void {
    const held = this.#commands().reduce((sum, command) => sum + command.script.attached, 0);
    if (more === 0 || held + more <= MAX_ATTACHED) return;
    if (more > MAX_ATTACHED) throw new DeviceError("queue-full", `${more} bytes came with the command, and ${MAX_ATTACHED} at most are taken`);
    const text = `${held} bytes came with commands that wait already, and ${more} more are more than ${MAX_ATTACHED}; try again when one has ended`;
    throw new DeviceError("queue-full", text);
  }

  /**
   * Whether a script may be queued behind what is being carried out: not where its statement waits for nothing, and not where an old
   * owner's statement comes to its end, as where that leads is not where its script did.
   */
  #checkTurn(script: Script<A>): void {
    const { name } = this.machine;
    if (this.#active?.last !== undefined) {
      const text = `${name} is changing hands and still moves; send the command again when a state tells that it stands`;
      throw new DeviceError("changing-hands", text, { retry: true });
    }
    if (!this.#neverWaits(script) || !this.isBusy) return;
    // Until the device rests for its new owner the newest of them waits, though.
    const givesWay = this.#active ? this.machine.givesWay() && !this.#waiting.length : this.#waiting.every((other) => this.#neverWaits(other.script));
    if (!givesWay) throw new DeviceError("busy", `${name} carries out a script, behind which this does not wait; send it again when the device is at rest`);
  }

  #neverWaits(script: Script<A>): boolean {
    return script.actions().some(([action]) => this.machine.neverWaits(action));
  }

  // What ends commands.

  /** Stands, and drops every command with the error `halted`. Not latched: the next command is taken. */
  halt(now: number, reason: string, events: QueueEvent[]): void {
    this.advance(now, events);
    // What goes on after its command, as a wheel does, is halted too.
    if (this.isAtRest) {
      this.#doubtOldNews();
      this.#haltMachine();
    } else {
      const error = new DeviceError("halted", `${this.machine.name} was halted: ${reason}`);
      this.#end(error, error, events);
    }
  }

  /** Ends every command with this error, because the device cannot carry it out. */
  fail(now: number, error: DeviceError, events: QueueEvent[]): void {
    this.advance(now, events);
    this.#end(error, error, events);
  }

  /** Stands, drops every command with the error `stopped`, and takes none until {@link unstop}. */
  stop(now: number, reason: string, events: QueueEvent[], name: DeviceErrorName = "stopped"): void {
    this.advance(now, events);
    this.#doubtOldNews();
    if (this.#stopped) return this.#haltMachine();
    this.#stopped = true;
    const error = new DeviceError(name, `${this.machine.name} was stopped: ${reason}`);
    this.#end(error, error, events);
  }

  /** Takes commands again. Nothing moves by itself: the old commands are gone. */
  unstop(now: number, events: QueueEvent[]): void {
    this.advance(now, events);
    if (!this.#stopped) return;
    this.#stopped = false;
    this.#publishState(events);
  }

  /** It has a new owner: no motion of it begins before the device rests. */
  changeHands(now: number, events: QueueEvent[]): void {
    this.advance(now, events);
    this.#doubtOldNews();
    this.#changesHands = this.#rests === undefined;
    this.#waitsUntil = undefined;
  }

  /**
   * Drops the commands that wait, and lets the one that is being carried out come to the end of its present statement only. What would go
   * on until another command comes is halted, and no `wait` is waited for.
   */
  endStatement(now: number, reason: string, events: QueueEvent[]): void {
    this.advance(now, events);
    if (this.machine.givesWay()) return this.halt(now, reason, events);
    this.#failWaiting(new DeviceError("halted", `${this.machine.name} did not begin it: ${reason}`), events);
    const active = this.#active;
    if (!active) return;
    active.last = reason;
    if (active.ends !== undefined) active.ends = this.#now;
    this.advance(this.#now, events);
  }

  /** That it rests is found out anew where what is known of it is old: it may have moved since. */
  #doubtOldNews(): void {
    if (this.#now - (this.machine.knownAt() ?? this.#now) > OLD) this.#rest.disturb(this.#now);
  }

  /** Ends the active command with one error and those behind it with another. */
  #end(error: DeviceError, behind: DeviceError, events: QueueEvent[]): void {
    const began = this.#active !== undefined && this.#active.begun > 0;
    const wasMoving = began || !this.machine.isAtRest() || this.#rolls;
    this.#haltMachine();
    const [active, waiting] = [this.#active, this.#waiting];
    [this.#active, this.#waiting, this.#waitsUntil] = [undefined, [], undefined];
    if (wasMoving) {
      this.#halting = true;
      this.#rest.disturb(this.#now);
      this.#publish = Math.max(this.#publish, this.#now + this.machine.period);
    }
    this.#publishState(events);
    if (active) events.push({ type: "failed", progress: progressOf(active.command, active.begun), error });
    for (const command of waiting) events.push({ type: "failed", progress: progressOf(command, 0), error: behind });
  }

  #failWaiting(error: DeviceError, events: QueueEvent[]): void {
    for (const command of this.#waiting.splice(0)) events.push({ type: "failed", progress: progressOf(command, 0), error });
  }

  /** Ends all commands, as their program has stood still. */
  #endSilent(silence: number, events: QueueEvent[]): void {
    const error = new DeviceError("halted", `${this.machine.name} was halted: its program stood still for ${Math.floor(silence / 1000)} ms`);
    this.#end(error, error, events);
  }

  /** Ends the active command with an error of its present statement. Those behind it were checked from where it should have led. */
  #failStatement(error: DeviceError, events: QueueEvent[]): void {
    const begun = this.#active?.begun ?? 0;
    const behind = new DeviceError("halted", "the command before it failed, so this one was not begun");
    this.#end(begun ? error.atStatement(begun) : error, behind, events);
  }

  /** Ends all commands where the machine has failed. */
  #heedFailure(events: QueueEvent[]): boolean {
    const error = this.machine.takeFailure();
    if (!error || !this.isBusy) return false;
    this.#failStatement(error, events);
    return true;
  }

  // What time brings.

  /** When {@link advance} is to be called next; undefined while there is nothing to do. */
  nextWake(): number | undefined {
    const { machine } = this;
    const ends = this.#active && (this.#active.ends ?? machine.doneAt() ?? (this.#givesWay ? this.#now : undefined));
    const tell = this.#isLively ? this.#publish : undefined;
    // While it is carrying something out no rest is looked for, and none of what is not reached.
    const stands = !this.#active && !machine.isMoving() && machine.isReached();
    const look = stands ? this.#rest.nextLook(this.#now) : undefined;
    const waits = !this.#active && this.#waitsForRest ? this.#waitsUntil : undefined;
    const wakes = [ends, tell, look, waits, machine.nextWake()].filter((wake) => wake !== undefined);
    return wakes.length ? Math.min(...wakes) : undefined;
  }

  /**
   * Lets time pass until `now`. Where that is more than the machine's patience later than {@link nextWake}, the program has stood still:
   * no statement begins for which it would have had to be there, and all commands end.
   */
  advance(now: number, events: QueueEvent[]): void {
    const due = this.nextWake();
    const silence = due === undefined ? 0 : now - due;
    const patience = this.machine.patience * this.pace;
    if (silence > patience && this.isBusy) {
      this.#silence = silence;
      // For so long the mechanism has gone on by itself.
      this.#carryOn(now - silence + patience, events);
      if (this.isBusy) this.#endSilent(silence, events);
      this.#silence = undefined;
    }
    // What was measured meanwhile is heard only now, and would pass for new.
    if (silence > patience) this.#rest.disturb(now);
    this.#carryOn(now, events);
  }

  #carryOn(now: number, events: QueueEvent[]): void {
    while (this.#step(now, events));
    this.#pass(now);
    this.#heedFailure(events);
    this.#tellRest(events);
    const wasChanging = this.#wasChanging;
    this.#wasChanging = this.machine.isChanging();
    if (this.#isLively && this.#now >= this.#publish) {
      const { period } = this.machine;
      this.#publish += (Math.floor((this.#now - this.#publish) / period) + 1) * period;
      this.#publishState(events);
    } else if (wasChanging && !this.#wasChanging) this.#publishState(events);
  }

  /** Ends a statement or begins one; false where nothing more is to be done until then. */
  #step(now: number, events: QueueEvent[]): boolean {
    if (this.#active) {
      const ends = this.#pursue(this.#active, now);
      if (ends === undefined) return false;
      // An action that was done without word of it, or before it was looked at, ends now.
      this.#pass(ends);
      if (this.#heedFailure(events)) return true;
      if (this.machine.givesWay()) {
        this.machine.giveWay(this.#now);
        this.#standsSince = this.#now;
      }
      this.#beginStatement(events);
      return true;
    }
    if (!this.#waiting.length || this.#silence !== undefined) return false;
    if (this.#waitsForRest) {
      this.#pass(now);
      if (this.#waitsForRest) {
        this.#waitForRest(events);
        return false;
      }
      // That it rests is told before the new owner moves it.
      if (this.#toldRest === undefined) this.#publishState(events);
      return true;
    }
    this.#beginCommand(events);
    return true;
  }

  /** When the present statement ended, if it did until then. */
  #pursue(active: Active<A>, until: number): number | undefined {
    if (active.ends !== undefined) return active.ends <= until ? active.ends : undefined;
    return this.machine.pursue(until) ?? (this.#givesWay ? Math.min(this.#now, until) : undefined);
  }

  /** Whether what is being carried out ends as another command waits. */
  get #givesWay(): boolean {
    return this.machine.givesWay() && this.#waiting.length > 0;
  }

  /** Whether the first command of a new owner has to wait. The hub's own is the safe state, for which the device was halted. */
  get #waitsForRest(): boolean {
    const [first] = this.#waiting;
    return this.#changesHands && first !== undefined && first.order.peer !== "hub";
  }

  /** Lets a new owner's commands wait for rest, and refuses them where it does not come. */
  #waitForRest(events: QueueEvent[]): void {
    const { machine } = this;
    const longest = 2 * machine.stoppingTime + INTERLOCK;
    this.#waitsUntil ??= this.#now + longest;
    if (this.#now < this.#waitsUntil) return;
    this.#waitsUntil = undefined;
    const why = machine.isReached() ? "it still moves as its old owner had it move" : "it cannot be reached, so it is unknown whether it is at rest";
    const text = `${machine.name} is changing hands, and ${why} ${Math.floor(longest / 1000)} ms after the command`;
    this.#failWaiting(new DeviceError("changing-hands", text), events);
    // What was planned from is where those would have led.
    this.#haltMachine();
    this.#publishState(events);
  }

  #pass(until: number): void {
    if (this.#isLively && until > this.#now) this.#seq += 1;
    this.#now = Math.max(until, this.#now);
    this.machine.advance(this.#now);
    this.#watchRest();
    this.#insist();
  }

  /** Has it stand. */
  #haltMachine(): void {
    this.machine.halt(this.#now);
    this.#standsSince = this.#now;
  }

  /** Has it stand again where it was to, has nothing under way and does not rest by when it should: something moves it that no command began. */
  #insist(): void {
    const since = this.#standsSince;
    if (since === undefined) return;
    // Commands that wait were planned from where it stands; its own motion ends by itself.
    if (this.isBusy || this.machine.isDriven()) {
      this.#standsSince = this.#now;
      return;
    }
    const isDue = this.#now - since >= this.machine.stoppingTime + REST;
    if (isDue && this.#rests === undefined && this.machine.isReached()) this.#haltMachine();
  }

  /** Looks whether it rests: not while it is carrying something out, and not where nothing is heard of it. */
  #watchRest(): void {
    const movedAt = this.machine.movedAt();
    if (movedAt !== this.#movedAt) this.#rest.disturb(this.#now);
    this.#movedAt = movedAt;
    const acts = this.#active !== undefined && this.#active.begun > 0;
    if (acts || this.machine.isMoving() || !this.machine.isReached()) return this.#rest.disturb(this.#now);
    const measuredAt = this.machine.knownAt() ?? this.#now;
    this.#rest.observe(this.machine.measured(measuredAt), this.#now);
    if (this.#rests !== undefined) [this.#halting, this.#changesHands, this.#waitsUntil] = [false, false, undefined];
  }

  /** Tells when it has come to rest, and when it rests no more though nothing drives it. */
  #tellRest(events: QueueEvent[]): void {
    if (this.#toldReached !== this.machine.isReached()) this.#publishState(events);
    const known = this.#rests;
    const comes = known !== undefined && (known !== this.#toldRest || this.#toldMoving);
    // Such as by a push.
    const goes = known === undefined && this.#toldRest !== undefined;
    if ((comes || goes) && !this.isBusy) this.#publishState(events);
  }

  /** Takes the next command from the queue, unless it has become too old there. */
  #beginCommand(events: QueueEvent[]): void {
    // That it stands is told before it moves again.
    if (this.#toldMoving && !this.isMoving) this.#publishState(events);
    const command = this.#waiting.shift();
    if (!command) return;
    this.#waitsUntil = undefined;
    this.#active = { command, begun: 0, ends: this.#now, last: undefined };
    const late = command.useBy === undefined ? 0 : this.#now - command.useBy;
    if (late <= 0) return;
    const error = new DeviceError("too-old", `the command waited ${Math.floor(late / 1000)} ms longer than it is good for`);
    // Those behind it were checked from where it should have led.
    this.#end(error, new DeviceError("halted", "the command before it was too old, so this one was not begun"), events);
  }

  /** Begins what comes next of the active command, or finishes it. */
  #beginStatement(events: QueueEvent[]): void {
    this.#seq += 1;
    const active = this.#active;
    if (!active) return;
    const statement = active.command.script.statements[active.begun];
    if (!statement) return this.#finish(active, events);
    if (this.#silence !== undefined) return this.#endSilent(this.#silence, events);
    if (active.last !== undefined) {
      const error = new DeviceError("halted", `${this.machine.name} ended the script after statement ${active.begun}: ${active.last}`);
      return this.#end(error, error, events);
    }
    active.begun += 1;
    events.push({ type: "executing", progress: progressOf(active.command, active.begun) });
    if ("wait" in statement) {
      active.ends = this.#now + statement.wait * 1000;
      if (this.#toldMoving !== this.isMoving) this.#publishState(events);
      return;
    }
    active.ends = undefined;
    this.#standsSince = undefined;
    try {
      this.machine.begin(statement.action, this.#now);
    } catch (error) {
      return this.#failStatement(deviceErrorOf(this.machine.name, error), events);
    }
    // From here on it moves as this command says, not as one that was to stand.
    this.#halting &&= !this.machine.isMoving();
    if (this.#publish <= this.#now) this.#publish = this.#now + this.machine.period;
  }

  #finish({ command, begun }: Active<A>, events: QueueEvent[]): void {
    this.#active = undefined;
    // Who predicts goes on where it does.
    if (!this.machine.isMoving() || !this.#waiting.length) this.#publishState(events);
    events.push({ type: "finished", progress: progressOf(command, begun) });
  }

  #publishState(events: QueueEvent[]): void {
    this.#seq += 1;
    const state = this.state();
    [this.#toldMoving, this.#toldRest, this.#toldReached] = [state.moving, state.rest, state.reached];
    events.push({ type: "state", state });
  }
}
