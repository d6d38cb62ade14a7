// The counts of a link: what was said and is not known to be read, and what was read and is not told.
import type { Entry } from "./outbox.js";
import type { Parcel } from "./parcel.js";
import { type Fields, int } from "./value.js";

/** After so much that was read it is told at the latest. */
const PARCELS = 256;
const BYTES = 64 * 1024;

const BASIS = 0x811c9dc5;
const PRIME = 0x01000193;

/** How much one side has read, and a checksum of that, by which the other side sees whether both count the same; absent if it is not known. */
export interface Said {
  read: number;
  checksum?: number;
}

export const saidOf = (content: Fields): Said => {
  const [read = -1, checksum] = [int(content, "read"), int(content, "checksum")];
  return checksum === undefined ? { read } : { read, checksum };
};

const withParcel = (checksum: number, { id, reference }: Parcel): number => Math.imul(checksum ^ ((id ?? reference ?? 0) % 2 ** 32), PRIME) >>> 0;

/** Counts what goes both ways, so that a lost connection loses nothing. */
export class Ledger {
  /** Parcels of the hub that were read whole. */
  read = 0;
  /** Parcels that were sent whole. */
  sent = 0;
  /** Bytes that are kept until they are known to be read. */
  bytes = 0;
  /** Of what was read. */
  #checksum: number | undefined = BASIS;
  /** Of what was sent before what is kept. */
  #sentChecksum = BASIS;
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

  get said(): Said {
    const { read } = this;
    return this.#checksum === undefined ? { read } : { read, checksum: this.#checksum };
  }

  /** Counts what was read, null if nobody could; says whether it is time to tell. */
  heard(size: number, parcel: Parcel | null): boolean {
    this.read += 1;
    this.#checksum = this.#checksum === undefined || !parcel ? undefined : withParcel(this.#checksum, parcel);
    this.#untold += size;
    return this.read - this.#told >= PARCELS || this.#untold >= BYTES;
  }

  /** What is to be told, if anything is. */
  tell(): Said | null {
    if (this.read === this.#told) return null;
    [this.#told, this.#untold] = [this.read, 0];
    return this.said;
  }

  /** The hub has read so many; false for a count that cannot be, or that is of other parcels. */
  acknowledged({ read, checksum }: Said): boolean {
    const forgotten = read - (this.sent - this.#kept.length);
    if (forgotten < 0 || read > this.sent) return false;
    for (const { reliable, frame, parcel } of this.#kept.splice(0, forgotten)) {
      if (reliable) this.bytes -= frame.length;
      this.#sentChecksum = withParcel(this.#sentChecksum, parcel);
    }
    return checksum === undefined || checksum === this.#sentChecksum;
  }

  /** The link goes on, and the hub has read so many; gives the others in their order, as if they had never been sent. */
  resumed(said: Said): Entry[] | null {
    if (!this.acknowledged(said)) return null;
    const rest = this.#kept;
    [this.#kept, this.bytes, this.sent] = [[], 0, said.read];
    this.#told = this.read;
    this.#untold = 0;
    return rest;
  }
}
