// What others want of this page, whether or not it watches the context: its tokens, that it takes one, or that it goes.
import type { Client, Event } from "mom-client";
import { happeningOf } from "./feeds.js";
import type { Say } from "./port.js";

const NAMES = new Set(["requested", "offer", "lapsed", "notice", "expelled"]);

export class Asking {
  #client: Client | null = null;
  readonly #followed = new Set<string>();
  /** One event comes to all who have asked for events of its context. */
  readonly #told = new WeakSet<Event>();

  constructor(readonly say: Say) {}

  /** There is a new peer. */
  reset(client: Client): void {
    this.#client = client;
    this.#followed.clear();
    // An offer reaches also who has never joined the token.
    void this.#hear(client, client.unaddressed(), "/");
  }

  /** This page has joined a token: what is told of it goes nowhere else any more. */
  follow(path: string): void {
    const client = this.#client;
    if (!client || this.#followed.has(path)) return;
    this.#followed.add(path);
    void this.#hear(client, client.peer.events(path), path);
  }

  async #hear(client: Client, events: AsyncIterable<Event>, path: string): Promise<void> {
    for await (const event of events) {
      if (client !== this.#client) break;
      this.heard(path, event, client);
    }
  }

  heard(path: string, event: Event, client: Client): void {
    if (event.type === "message" || !NAMES.has(event.type) || this.#told.has(event)) return;
    this.#told.add(event);
    if (event.type === "expelled" && event.peer !== client.name) return;
    this.say({ word: "asked", event: happeningOf(event, path) });
  }
}
