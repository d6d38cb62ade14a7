// A declared device at a hub: it hears its channel, lets time pass, and says what is to be said.
import { type Channel, type Client, type Event, type Events, type Held, type LinkState, type Obeys, type Parcel, Time } from "../index.js";
import type { Fields } from "../value.js";
import type { State } from "./commands.js";
import { type Call, cardOf, checkVerbs } from "./declare.js";
import { DeclaredMachine } from "./declared.js";
import { type DeviceError, deviceErrorOf } from "./errors.js";
import { Outlet } from "./outlet.js";
import type { DeviceAge } from "./pull.js";
import { type DeviceEvent, DeviceServer } from "./server.js";
import type { Spec } from "./spec.js";

const SILENT = "the connection to the hub is silent or lost";
const GONE = "it is no longer a device of its channel";
/** No timer waits longer, ms. */
const LONGEST = 2 ** 31 - 1;

/** A device that is declared, and can be taken to a channel by {@link Client.obey}. */
export class Device implements Obeys<Obeying> {
  /** In texts it has `the` in front. */
  readonly name: string;
  readonly spec: Spec;
  #obeying: Obeying | undefined;

  /** @internal */
  constructor(name: string, spec: Spec) {
    for (const method of ["halt", "position"] as const) {
      if (typeof spec[method] !== "function") throw new TypeError(`the device ${name} has no function \`${method}\`, without which it must not move`);
    }
    for (const key of ["stopsWithin", "tolerance", "maxAge"] as const) {
      if (spec[key] !== undefined && !(spec[key] > 0 && spec[key] < Infinity)) throw new TypeError(`${key} of the device ${name} is a number above 0`);
    }
    checkVerbs(spec.verbs);
    [this.name, this.spec] = [name, spec];
  }

  /** What it can do, as a plain map. */
  card(): Fields {
    return cardOf({ ...this.spec, name: this.name, stopsWithin: this.spec.stopsWithin ?? 1000 });
  }

  /** Throws where it obeys in a channel already, or what it began there has not ended: two owners would move it. */
  check(): void {
    const [obeying, { name }] = [this.#obeying, this];
    if (!obeying) return;
    if (!obeying.isOver) throw new TypeError(`${name} obeys in ${obeying.channel.path} already`);
    if (!obeying.hasEnded) throw new TypeError(`what ${name} began in ${obeying.channel.path} has not ended yet`);
  }

  /** Begins to obey what is heard in a channel; {@link Client.obey} calls it. */
  start(channel: Channel, events: Events): Obeying {
    this.check();
    return (this.#obeying = new Obeying(this, channel, events));
  }
}

/**
 * Declares a device: what it does, its verbs, how it is halted and where it is. `client.obey(path, device)` makes it one of a channel.
 *
 * @throws TypeError for one without `halt` or `position`, and for verbs that no script could name.
 */
export function device(name: string, spec: Spec): Device {
  return new Device(name, spec);
}

/**
 * What a device is in its channel: it carries out the commands of its token's owner, and halts at each stop, each loss of the connection,
 * each gap in what it has heard, and whenever its owner changes. Only an unstop frees it that names the newest stop. What it says, it
 * says by itself.
 */
export class Obeying {
  /** Fulfilled when it is not a device there any more; rejected with why it broke. */
  readonly ended: Promise<void>;
  readonly #machine: DeclaredMachine;
  readonly #server: DeviceServer<Call>;
  readonly #events: Events;
  readonly #outlet: Outlet;
  readonly #begin = performance.now();
  #timer: ReturnType<typeof setTimeout> | undefined;
  #silent = false;
  /** Whether the server acts, and might be asked how it stands by what it calls. */
  #acts = false;
  /** Why it is not a device any more. */
  #over: string | undefined;
  /** Called when all that it began has ended, too. */
  #settle: () => void = () => undefined;

  /** @internal */
  constructor(
    readonly device: Device,
    readonly channel: Channel,
    events: Events,
  ) {
    const { name, spec } = device;
    const { client, path } = channel;
    this.#events = events;
    this.#outlet = new Outlet(
      (parcel) => client.sendParcel(parcel),
      (error) => this.#do(() => this.#machine.unsayable(error)),
    );
    this.#machine = new DeclaredMachine(spec, name, {
      now: () => this.#now(),
      wake: () => {
        this.#do(() => undefined);
        if (this.hasEnded) this.#settle();
      },
      log: (text, error) => console.error(`${name}: ${text}:`, error),
    });
    this.#server = new DeviceServer(this.#machine, path, Time.now(), spec.maxAge === undefined ? {} : { maxAge: spec.maxAge * 1000 });
    this.#server.name = client.name;
    const { devices } = client.peer;
    devices.add(this);
    this.#do((out) => this.#server.report(out));
    this.ended = this.#obey().finally(() => devices.delete(this));
    // It is logged, and need not end the program.
    this.ended.catch(() => undefined);
    if (client.state.state !== "connected") this.link(client.state);
  }

  /** Why it may not move, if it may not. */
  mayMove(): Held | null {
    return this.#over === undefined ? this.#server.mayMove() : { held: "unknown", text: this.#over };
  }

  get isStopped(): boolean {
    return this.#server.isStopped;
  }

  /** Whether it is not a device there any more. */
  get isOver(): boolean {
    return this.#over !== undefined;
  }

  /** Whether it is not a device there any more, and all functions of its verbs have ended, as the promises of its `halt` have. */
  get hasEnded(): boolean {
    return this.isOver && this.#machine.isAtRest();
  }

  /** How it stands. */
  state(): State {
    if (!this.#acts) this.#do(() => undefined);
    return this.#server.state();
  }

  /** Stops by itself, as at a bumper, until a peer lifts that. */
  stopItself(why: string): void {
    this.#do((out, now) => this.#server.stopItself(why, now, out));
  }

  /** Ends every command with this error, because the device cannot carry it out, and halts. */
  fail(error: DeviceError): void {
    this.#do((out, now) => this.#server.fail(now, deviceErrorOf("it", error), out));
  }

  /** Says how it stands, after something has changed what its `position` or `report` give; to these peers, or to all. */
  report(to?: string[]): void {
    this.#do((out, now) => {
      this.#server.note(now, () => undefined, out);
      const before = out.length;
      this.#server.report(out);
      if (to) for (const parcel of out.slice(before)) parcel.address = to;
    });
  }

  /** Halts, and leaves the channel. */
  async leave(): Promise<void> {
    this.#end(GONE);
    await this.channel.leave();
    await this.ended;
  }

  /** @internal Has it stand once more, at its end. Fulfilled when all that it began has ended. */
  halt(): Promise<void> {
    this.#machine.halt(this.#now());
    return new Promise((resolve) => {
      this.#settle = resolve;
      if (this.hasEnded) resolve();
    });
  }

  /** @internal The link has another state. A loss goes through the events, so that what was heard before it counts as before it. */
  link({ state, ...more }: LinkState): void {
    const [silent, wasSilent] = [state !== "connected", this.#silent];
    this.#silent = silent;
    this.#server.held = silent ? "the hub is silent" : undefined;
    if (silent && !wasSilent) this.#do((out, now) => this.#server.halt(SILENT, now, out));
    const isDown = silent && state !== "stale";
    if (isDown) {
      this.#outlet.down = true;
      this.#events.push({ type: "link-down" });
    } else if ("resumed" in more && more.resumed) {
      this.#outlet.down = false;
      this.#hear({ type: "link-resumed" });
    } else if (!silent && wasSilent) this.#do((out) => this.#server.report(out));
  }

  #now(): number {
    return Math.floor((performance.now() - this.#begin) * 1000);
  }

  async #obey(): Promise<void> {
    try {
      for await (const event of this.#events) this.#hear(event);
    } finally {
      this.#end(GONE);
    }
    const { broken } = this.#machine;
    if (broken) throw broken.error;
  }

  #hear(event: DeviceEvent): void {
    const { client } = this.channel;
    if (this.#over !== undefined) return;
    // It may have come back as another peer, by whose name it is put out and says its own stops.
    if (event.type === "rejoined") {
      this.#server.name = client.name;
      this.#outlet.down = false;
    }
    const age = event.type === "message" ? ageOf(client, event.parcel) : undefined;
    this.#do((out, now) => this.#server.handle(event, this.channel, age, now, out));
    if (event.type === "expelled" && event.peer === client.name) this.#end(`it was expelled from its channel${event.text ? `: ${event.text}` : ""}`);
    else if (event.type === "dropped") this.#dropped(event);
  }

  /** What had not left before the connection was lost is said when it is back. */
  #dropped({ reason, parcel }: Event & { type: "dropped" }): void {
    if (reason === "lost" && parcel?.sender === undefined && parcel?.family === "message") this.#outlet.keep(parcel);
  }

  /** Lets the server act, says what it gives out, and comes back when it has to. Whatever fails ends the device. */
  #do(act: (out: Parcel[], now: number) => void): void {
    if (this.#over !== undefined) return;
    const out: Parcel[] = [];
    const [now, acts] = [this.#now(), this.#acts];
    this.#acts = true;
    try {
      act(out, now);
      this.#server.advance(now, out);
    } catch (error) {
      console.error(`${this.#machine.name} failed, and obeys no more:`, error);
      this.#machine.broken ??= { error };
    } finally {
      this.#acts = acts;
    }
    this.#outlet.push(out);
    if (this.#machine.broken) {
      this.#end(GONE);
      this.channel.leave().catch(() => undefined);
      return;
    }
    this.#wake(now);
  }

  #wake(now: number): void {
    clearTimeout(this.#timer);
    const due = this.#server.nextWake();
    if (due === undefined) return;
    this.#timer = setTimeout(() => this.#do(() => undefined), Math.min(Math.max(0, Math.ceil((due - now) / 1000)), LONGEST));
  }

  /** Halts, says so, and obeys no more. */
  #end(why: string): void {
    if (this.#over !== undefined) return;
    this.#over = why;
    clearTimeout(this.#timer);
    const out: Parcel[] = [];
    try {
      this.#server.halt(why, this.#now(), out);
    } catch (error) {
      console.error(`${this.#machine.name} failed as it ended:`, error);
      this.#machine.halt(this.#now());
    }
    this.#outlet.push(out);
    const { client, path } = this.channel;
    client.peer.places.cards.delete(path);
    void this.#events.return();
  }
}

/** How old a message is; where the hub does not know its sender's clock, how long ago it came to the hub, without an error. */
function ageOf({ clock }: Client, parcel: Parcel): DeviceAge | undefined {
  const [age, now] = [clock.age(parcel), clock.now()];
  if (age || !now || !parcel.received) return age;
  return { micros: Number(now.micros - parcel.received.micros) };
}
