// Tokens that this peer has offered to others, as far as they may come back.
import type { Event } from "./events.js";
import type { Parcel } from "./parcel.js";
import { isWithin } from "./places.js";

/** A token that was offered to another peer. */
export interface Offer {
  readonly path: string;
  /** Takes in what the hub says of the token; whether nothing more follows. */
  heard(event: Event, parcel: Parcel): boolean;
  /** It does not come back. */
  end(): void;
}

export class Offers {
  readonly #open = new Set<Offer>();

  add(offer: Offer): void {
    this.#open.add(offer);
  }

  /** It does not come back. */
  end(offer: Offer): void {
    this.#open.delete(offer);
    offer.end();
  }

  /** Who is not there any more hears nothing of tokens there. */
  endWithin(top: string): void {
    for (const offer of this.#open) if (isWithin(offer.path, top)) this.end(offer);
  }

  heard(path: string, event: Event, parcel: Parcel): void {
    for (const offer of this.#open) if (offer.path === path && offer.heard(event, parcel)) this.#open.delete(offer);
  }
}
