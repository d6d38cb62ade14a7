// The device's side of stops: what holds, by the order of causes, and what it waits for.
import type { Event, MessageEvent } from "./events.js";
import type { StopState } from "./stops.js";
import { type Fields, fieldsOf, text } from "./value.js";

/**
 * What a device does about an event: it halts (`stop`), and moves no more until it is told so; it may move again (`free`); it halts, and the
 * next command moves it again, as soon as it {@link Latch.mayMove} (`halt`); or nothing changes, and it says how it stands (`same`).
 */
export type Turn = { turn: "stop"; why: string } | { turn: "free" | "halt" | "same" };

/**
 * Why a device may not move: a peer has stopped it; it has stopped itself, and the hub has not given that a number yet (`own`); or it has
 * not heard on this connection how it stands (`unknown`).
 */
export interface Held {
  held: "stopped" | "own" | "unknown";
  /** For people. */
  text: string;
}

/** Words of the device for a stop. */
function stopText(by: string | undefined, reason: string | undefined): string {
  return `stopped by ${by ?? "a peer"}${reason ? `: ${reason}` : ""}`;
}

/**
 * Whether a device may move, by what it has heard: fed with the events of its channel in their order.
 *
 * Every stop has a number that only rises. An unstop below the newest stop frees nobody, whichever way it came. A device moves nothing before
 * it has heard on this connection how it stands, and a gap in its events counts as a stop of its own, because it may have contained one.
 */
export class Latch {
  #number = 0;
  /** What an unstop has lifted. */
  #lifted = 0;
  #held: Held | null = null;
  /** It has heard on this connection how it stands. */
  #known = false;

  /** Takes in an event of the device's channel; gives what it means for the device. */
  observe(event: Event): Turn | undefined {
    switch (event.type) {
      case "message":
        if (event.name === "stop") return this.#stop(event);
        return event.name === "unstop" ? this.#unstop(event.stop) : undefined;
      case "stops":
        return this.#learn(event.state);
      case "lagged":
        return this.stopItself(`it has missed ${event.count} events`);
      case "link-down":
        this.#known = false;
        return { turn: "halt" };
    }
    return undefined;
  }

  /** Why the device may not move, if it may not. */
  mayMove(): Held | null {
    return this.#held ?? (this.#known ? null : { held: "unknown", text: "the hub has not said yet whether it is stopped" });
  }

  /** The newest stop that it has heard of: the key `stop` of its states. */
  get number(): number {
    return this.#number;
  }

  get isStopped(): boolean {
    return this.#held !== null;
  }

  /** Whether it has stopped itself and the hub does not know: it says `stop` with itself as the only address. */
  get isOwn(): boolean {
    return this.#held?.held === "own";
  }

  /** Stops by itself, until a peer lifts that. */
  stopItself(why: string): Turn {
    this.#held ??= { held: "own", text: `stopped by itself: ${why}` };
    return { turn: "stop", why };
  }

  /** What it says of itself when it joins. */
  word(): { stop: number; stopped: boolean } {
    return { stop: this.#number, stopped: this.#held?.held === "stopped" };
  }

  #stop({ stop = this.#number, sender, content }: MessageEvent): Turn {
    const fields: Fields = fieldsOf(content);
    // So it tells a device that has come back how it stands.
    if (sender === "hub") this.#known = true;
    return this.#take(stop, text(fields, "by") ?? sender, text(fields, "reason") ?? (typeof content === "string" ? content : undefined));
  }

  #take(number: number, by: string | undefined, reason: string | undefined): Turn {
    this.#number = Math.max(this.#number, number);
    // It was lifted before it came: the cause is an old one. To halt is never wrong.
    if (number > 0 && number <= this.#lifted) return { turn: "halt" };
    this.#held = { held: "stopped", text: stopText(by, reason) };
    return { turn: "stop", why: this.#held.text };
  }

  /** There is no number from hubs that give stops none. */
  #unstop(upTo: number | undefined): Turn {
    // What it has stopped for itself has a higher number, which has not come yet.
    const lifts = upTo === undefined || (!this.isOwn && upTo >= this.#number);
    this.#lifted = Math.max(this.#lifted, upTo ?? 0);
    if (!lifts || !this.#held) return { turn: "same" };
    this.#held = null;
    return { turn: "free" };
  }

  #learn(state: StopState): Turn | undefined {
    // Of others: what concerns this device comes by a message.
    if (state.stopped && (state.only.length || state.except?.length)) return undefined;
    this.#known = true;
    return state.stopped ? this.#take(state.number, state.by, state.reason) : this.#unstop(state.number);
  }
}
