// The counts of a link: what was said and is not known to be read, and what was read and is not told.
import type { Entry } from "./outbox.js";

/** After so much that was read it is told at the latest. */
const PARCELS = 256;
const BYTES = 64 * 1024;

/** Counts what goes both ways, so that a lost connection loses nothing. */
export class Ledger {
  /** Parcels of the hub that were read whole. */
  read = 0;
  /** Parcels that were sent whole. */
  sent = 0;
  /** Bytes that are kept until they are known to be read. */
  bytes = 0;
  #told = 0;
  #untold = 0;
  /** What follows parcel number `sent - kept.length`; of what is not reliable only the place. */
  #kept: Entry[] = [];

  /** What the hub has not acknowledged, in its order. */
  get kept(): readonly Entry[] {
    return this.#kept;
  }

  /** Counts what was sent whole. */
  wrote(entry: Entry): void {
    this.sent += 1;
    this.#kept.push(entry);
    if (entry.reliable) this.bytes += entry.frame.length;
  }

  /** Counts what was read; says whether it is time to tell. */
  heard(size: number): boolean {
    this.read += 1;
    this.#untold += size;
    return this.read - this.#told >= PARCELS || this.#untold >= BYTES;
  }

  /** What is to be told, if anything is. */
  tell(): number | null {
    if (this.read === this.#told) return null;
    [this.#told, this.#untold] = [this.read, 0];
    return this.read;
  }

  /** The hub has read so many; false for a count that cannot be. */
  acknowledged(read: number): boolean {
    const forgotten = read - (this.sent - this.#kept.length);
    if (forgotten < 0 || read > this.sent) return false;
    for (const entry of this.#kept.splice(0, forgotten)) if (entry.reliable) this.bytes -= entry.frame.length;
    return true;
  }

  /** The link goes on, and the hub has read so many; gives the others in their order, as if they had never been sent. */
  resumed(read: number): Entry[] | null {
    if (!this.acknowledged(read)) return null;
    const rest = this.#kept;
    [this.#kept, this.bytes, this.sent] = [[], 0, read];
    this.#told = this.read;
    this.#untold = 0;
    return rest;
  }
}
