// How old the newest message of each peer was when this page heard it, and how well its clock is known.
import type { HubEvent, Message } from "../worker/protocol.js";

export interface Heard {
  /** ms. */
  age: number;
  error: number;
  /** When, ms since 1970. */
  at: number;
}

/** Peers that are remembered, the newest. */
const MOST = 1000;

export class HeardPeers {
  readonly #peers = new Map<string, Heard>();

  take(events: readonly HubEvent[]): void {
    for (const event of events) {
      if (event.type !== "message") continue;
      const { sender, born, error, arrived, history } = event as Message;
      if (born === undefined || error === undefined || history) continue;
      this.#peers.delete(sender);
      this.#peers.set(sender, { age: Math.max(0, arrived - born), error, at: arrived });
    }
    while (this.#peers.size > MOST) this.#peers.delete(this.#peers.keys().next().value!);
  }

  of(peer: string): Heard | undefined {
    return this.#peers.get(peer);
  }

  clear(): void {
    this.#peers.clear();
  }
}
