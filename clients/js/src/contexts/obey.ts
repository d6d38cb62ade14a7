// A device: a peer that moves something, and stops it when it is told to.
import type { Channel } from "./channel.js";
import { MomError } from "../error.js";
import type { Event, Events, MessageEvent } from "../events.js";
import { type Held, Latch, type Turn } from "../latch.js";
import type { LinkState } from "../options.js";
import { fieldsOf, type Fields, type Value } from "../value.js";

/** What a device moves. */
export interface Machine {
  /** Comes to rest at once, and says nothing about it; `why` is for people. It is also called when nothing moves. */
  halt(why: string): void;
  /** Carries out a command that may be obeyed; what it throws is told to the sender. The next event does not wait for it. */
  move(command: Value | undefined, event: MessageEvent): unknown;
  /** What its messages `state` say beside `stopped` and `stop`. */
  state?(): Fields;
  /** It may move again: nothing has to be done. */
  free?(): void;
}

/**
 * A device side of a channel, from {@link Client.obey}. It halts at each stop, each loss of the connection and each gap in what it has heard,
 * lets only an unstop free it that names the newest stop, and says how it stands after each.
 */
export class Device {
  /** Fulfilled when it is not a device there any more. */
  readonly ended: Promise<void>;
  readonly #latch = new Latch();
  readonly #events: Events;
  #silent = false;
  /** Why it is not a device any more. */
  #over: string | null = null;

  /** @internal */
  constructor(
    readonly channel: Channel,
    readonly machine: Machine,
    events: Events,
  ) {
    this.#events = events;
    const { devices } = channel.client.peer;
    devices.add(this);
    this.ended = this.#obey().finally(() => devices.delete(this));
  }

  /** Why it may not move, if it may not. */
  mayMove(): Held | null {
    if (this.#over !== null) return { held: "unknown", text: this.#over };
    return this.#latch.mayMove() ?? (this.#silent ? { held: "unknown", text: "the hub is silent" } : null);
  }

  get isStopped(): boolean {
    return this.#latch.isStopped;
  }

  /** Stops by itself, as at a bumper, until a peer lifts that. */
  stopItself(why: string): void {
    this.#take(this.#latch.stopItself(why));
    this.#tellOwnStop();
  }

  /** Says how it stands: after each stop and unstop it does so by itself, after what else has changed `state()` its machine has it do so. */
  report(to?: string[]): void {
    const content: Fields = { ...this.machine.state?.(), stopped: this.#latch.isStopped, stop: this.#latch.number };
    this.#say("state", content, { delivery: "latest", echo: false, ...(to ? { to } : {}) });
  }

  /** @internal The link has another state. A loss goes through the events, so that what was heard before it counts as before it. */
  link({ state }: LinkState): void {
    const silent = state !== "connected";
    if (silent && !this.#silent) this.machine.halt("the connection to the hub is silent or lost");
    this.#silent = silent;
    if (silent && state !== "stale") this.#events.push({ type: "link-down" });
  }

  async #obey(): Promise<void> {
    try {
      for await (const event of this.#events) this.#heard(event);
    } finally {
      // Also where its machine has failed.
      this.#over ??= "it is no longer a device of its channel";
      this.machine.halt(this.#over);
    }
  }

  #heard(event: Event): void {
    const turn = this.#latch.observe(event);
    if (turn) this.#take(turn);
    if (event.type === "expelled" && event.peer === this.channel.client.name) this.#over = `it was expelled from its channel${event.text ? `: ${event.text}` : ""}`;
    if (event.type === "lagged") this.#tellOwnStop();
    else if (event.type === "joined") this.report([event.member.peer]);
    // Without names of who joined, all are told.
    else if (event.type === "count" || (event.type === "dropped" && fieldsOf(event.parcel?.content)["sender"] === "hub")) this.report();
    else if (event.type === "rejoined") {
      this.report();
      this.#tellOwnStop();
    } else if (event.type === "released") this.#halt("its owner no longer owns it");
    else if (event.type === "message") this.#message(event);
  }

  #take(turn: Turn): void {
    if (turn.turn === "stop") this.machine.halt(turn.why);
    else if (turn.turn === "halt") this.machine.halt("the connection was lost, or a stop has come that was lifted before");
    else if (turn.turn === "free") this.machine.free?.();
    this.report();
  }

  #halt(why: string): void {
    this.machine.halt(why);
    this.report();
  }

  #message(event: MessageEvent): void {
    const { name, sender, content, parcel } = event;
    // What the hub itself sends is the safe state of the token: it ends what the owner began, and may move the device then.
    if (sender === "hub" && (name === "halt" || name === "command")) this.#halt("safe state");
    if (name !== "command" || event.history) return;
    void (async () => {
      const held = this.mayMove();
      if (held) throw new MomError("local", "stopped", held.text);
      if (!this.channel.permits(parcel)) throw new MomError("local", "older-fence", "its sender no longer owns the token");
      await this.machine.move(content, event);
    })().catch((error: unknown) => {
      const [code, text] = error instanceof MomError ? [error.code, error.text] : ["failed", String(error)];
      this.#say("status", { peer: sender, id: parcel.id, state: "error", statement: 0, of: 0, error: { name: code, text } }, { echo: false, ...(parcel.id === undefined ? {} : { reference: parcel.id }) });
    });
  }

  /** Tells the hub that it has stopped itself, if the hub does not know: from then on it is a stop like any other. */
  #tellOwnStop(): void {
    if (this.#latch.isOwn) this.#say("stop", { reason: this.#latch.mayMove()?.text }, { to: [this.channel.client.name] });
  }

  /** What cannot be said now is said when the channel is joined again. */
  #say(name: string, content: Fields, options: Parameters<Channel["send"]>[2]): void {
    this.channel.send(name, content, options).catch(() => undefined);
  }

  /** Halts, and leaves the channel. */
  async leave(): Promise<void> {
    await this.channel.leave();
    await this.ended;
  }
}
