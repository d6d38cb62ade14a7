// One task of an agent: whose it is, what is said of it, and whether it is still wanted.
import { type Driving, drive } from "../drive/index.js";
import type { Channel, Client, Fields, TokenGuard } from "../index.js";

/** A task that a peer has asked for. */
export class Task<W> {
  /** When it was asked for, ms of `performance.now()`. */
  readonly since = performance.now();
  /** The token, once it was lent. */
  guard: TokenGuard | undefined;
  /** @internal What is driven under it. */
  readonly driven: Driving[] = [];
  readonly #ends = new AbortController();

  /** @internal */
  constructor(
    /** Whose it is. */
    readonly peer: string,
    /** What is to be done, as `read` has it. */
    readonly what: W,
    /** This agent. */
    readonly client: Client,
    /** Its channel. */
    readonly channel: Channel,
    /** The id of the message that asked for it. */
    readonly asked: number | undefined,
  ) {}

  /** Aborted when the task is to end: its reason says why. */
  get signal(): AbortSignal {
    return this.#ends.signal;
  }

  /** Drives a device that the token guards. The kit ends that with the task. */
  async drive(path: string): Promise<Driving> {
    this.signal.throwIfAborted();
    if (!this.guard) throw new Error("nothing was lent yet");
    const driving = await drive(this.client, path, { guard: this.guard });
    this.driven.push(driving);
    return driving;
  }

  /** Tells all how far it is. */
  tell(text: string, more: Fields = {}): Promise<void> {
    return this.say("progress", { ...more, text, by: this.peer, state: "working" });
  }

  /** @internal Has it end; the first reason counts. */
  end(why: Error): void {
    if (!this.signal.aborted) this.#ends.abort(why);
  }

  /** @internal Says something to all, or to its peer as the answer to its message. */
  async say(name: string, content: Fields, to?: string[]): Promise<void> {
    const slots = to ? { to, ...(this.asked === undefined ? {} : { reference: this.asked }) } : {};
    // Who asked hears of the end by the token's return, too.
    await this.channel.send(name, content, { echo: false, ...slots }).catch((error: unknown) => console.warn(`${this.channel.path}: \`${name}\` was not sent`, error));
  }
}
