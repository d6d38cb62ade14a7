import type { Thinning } from "./client.js";
import type { Delivery, Parcel } from "../parcel.js";
import { type GuardState, permits } from "../places.js";
import { Joined } from "./session.js";
import { type Fields, type Value, fieldsOf, int, list } from "../value.js";

/** What a message says beside its content. */
export interface MessageOptions {
  /** Only to these members; if one is not there, nobody gets it. */
  to?: string[];
  /** From −100 to 100; higher leaves sooner. */
  priority?: number;
  /** ms after which it is worthless. */
  expires?: number;
  /** What happens when a receiver is slow; absent = the channel's. */
  delivery?: Delivery;
  /** `false`: it does not come back to this peer. */
  echo?: boolean;
  /** Valid only under this ownership of the guarding token. */
  fence?: number;
  /** The id of the message that this answers. */
  reference?: number;
  /** The id of the device's state that this is based on: if it has moved since, it refuses. */
  basedOn?: number;
  /** Of an `unstop`: the newest stop that its user has seen. */
  stop?: number;
  /** The trace that it is part of, as W3C's `traceparent`. */
  trace?: string;
  /** Any other slots. */
  extra?: { [key: string]: Value };
}

/** What became of an acknowledged message. */
export interface Receipt {
  /** Receivers whose queue took it. */
  delivered: number;
  /** Receivers for which it was dropped. */
  dropped: string[];
}

/** A channel: where messages are exchanged. */
export class Channel extends Joined {
  /**
   * Sends a message to all members, or to some, and does not wait for an answer. A refusal comes as an event `refused`.
   *
   * @throws MomError `connection` while there is no link, and with `lost` for a guarded message, a `command` or an `unstop` while one is resumed.
   */
  send(name: string, content?: Value, options: MessageOptions = {}): Promise<void> {
    return this.client.peer.post(this.#message(name, content, options));
  }

  /** Sends a message and waits until the queue of every receiver took or dropped it. */
  async sendAcknowledged(name: string, content?: Value, options: MessageOptions = {}): Promise<Receipt> {
    const reply = await this.client.peer.request({ ...this.#message(name, content, options), receipt: true });
    const fields = fieldsOf(reply.content);
    return { delivered: int(fields, "delivered") ?? 0, dropped: list(fields, "dropped").map(String) };
  }

  #message(name: string, content: Value | undefined, options: MessageOptions): Parcel {
    const { to, basedOn, stop, trace, extra, ...slots } = options;
    const parcel: Parcel = { family: "message", name, context: this.path, ...slots };
    const others: { [key: string]: Value } = { ...extra };
    if (basedOn !== undefined) others["based-on"] = basedOn;
    if (stop !== undefined) others["stop"] = stop;
    if (trace !== undefined) others["trace"] = trace;
    if (Object.keys(others).length) parcel.extra = others;
    if (to) parcel.address = to;
    if (content !== undefined) parcel.content = content;
    return parcel;
  }

  /** Asks the hub for fewer messages of others from now on, also after a new login; `{}` ends it. */
  async thin(thinning: Thinning): Promise<void> {
    const { device } = this.client.peer.places.get(this.path)?.terms ?? {};
    const terms: Fields = { ...thinning, device };
    await this.client.peer.enter(this.path, "channel", terms);
  }

  /** The last known state of the token that guards it; null = none does. */
  get guard(): GuardState | null {
    return this.client.peer.places.get(this.path)?.guard ?? null;
  }

  /**
   * Whether a device may obey a message: it must not if the token has changed hands since. What the hub itself sends is the safe state,
   * and always to be obeyed.
   */
  permits(parcel: Parcel): boolean {
    return permits(this.guard, parcel);
  }
}
