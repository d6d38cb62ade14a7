// The way out to the hub, over lost links too.
import type { Parcel } from "../index.js";

/** The most parcels that are held back; a whole queue of commands that ends at once is far below. */
const MOST = 4096;

/**
 * Sends what a device says. Here waits, while the link is down, what has to be said all the same: who sent a command wants to hear how it
 * ended. A state is told anew when the link is back.
 */
export class Outlet {
  #held: Parcel[] = [];
  #down = false;

  constructor(
    readonly send: (parcel: Parcel) => Promise<void>,
    /** What to do where something cannot be said at all. */
    readonly failed: (error: unknown) => void = () => undefined,
  ) {}

  /** Takes what is to be sent. */
  push(parcels: readonly Parcel[]): void {
    for (const parcel of parcels) {
      if (!this.#down) this.#send(parcel);
      else this.#hold(parcel);
    }
  }

  /** Takes back what was dropped before it had left. */
  keep(parcel: Parcel): void {
    if (parcel.delivery === "latest" || parcel.name === "stop") return;
    if (this.#down) this.#hold(parcel);
    else this.#send(parcel);
  }

  /** Holds everything back, or no more. */
  set down(down: boolean) {
    this.#down = down;
    if (!down) for (const parcel of this.#held.splice(0)) this.#send(parcel);
  }

  #hold(parcel: Parcel): void {
    // The newer one goes to the end, not to the older one's place: it must not overtake what led to it.
    if (parcel.delivery === "latest") this.#held = this.#held.filter((older) => !replaces(parcel, older));
    this.#held.push(parcel);
    this.#held.splice(0, this.#held.length - MOST);
  }

  #send(parcel: Parcel): void {
    this.send(parcel).catch((error: { kind?: string }) => {
      // The event that tells of it is on its way.
      if (error.kind === "connection" && this.#down) this.keep(parcel);
      else if (error.kind === "local") this.failed(error);
    });
  }
}

/** Whether a newer state makes an older one useless. */
function replaces(newer: Parcel, older: Parcel): boolean {
  return older.delivery === "latest" && older.name === newer.name && String(older.address) === String(newer.address);
}
