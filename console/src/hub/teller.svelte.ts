// Who tells how something is, and since when nobody does: what was told before must not look like the present.
import type { Happening, HubEvent, Message } from "../worker/protocol.js";
import { fields, text } from "./fields.js";
import type { Hub } from "./hub.svelte.js";

export class Teller {
  /** When it told last, ms since 1970. */
  arrived = $state<number | undefined>(undefined);
  /** When it went, or its connection was lost. */
  gone = $state<number | undefined>(undefined);
  #peer: string | undefined;

  constructor(readonly hub: Hub) {}

  /** Takes a message that tells how it is. */
  tells({ sender, arrived }: Message): void {
    [this.#peer, this.gone] = [sender, undefined];
    // What is told again to who begins to watch has its own time.
    this.arrived = Math.max(arrived, this.arrived ?? 0);
  }

  /** Takes any other event of the channel. */
  happens(event: HubEvent): void {
    if (event.type !== "lost" && event.type !== "left") return;
    const { what, arrived } = event as Happening;
    if (this.#peer !== undefined && text(fields(what["member"]), "peer") === this.#peer) this.gone = arrived;
  }

  /** Since when nobody knows how it is: who told it has gone, or the link is down, or was, and nothing was told since. */
  get unknownSince(): number | undefined {
    return this.arrived === undefined ? undefined : (this.gone ?? this.hub.unknownSince(this.arrived));
  }
}
