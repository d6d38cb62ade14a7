// What waits to be sent.
import { encode } from "./binary.js";
import { local } from "./error.js";
import { chunk } from "./frames.js";
import type { Parcel } from "./parcel.js";
import type { Pipe } from "./pipe.js";

/** So much is given to a pipe ahead of time; the rest waits here, where what is urgent can overtake it. */
const AHEAD = 64 * 1024;
/** The timers of a page that nobody sees come once a second. */
const AHEAD_HIDDEN = 1024 * 1024;
const PIECE = 16 * 1024;
/** Streams of chunks that are open at once; a hub takes eight. */
const STREAMS = 4;
/** Above it are lanes of what is no data. */
export const MOST_PRIORITY = 100;
/** Before what is sent again, and before all else. */
const STOP = 3e9;
const AGAIN = 2e9;
const CONTROL = 1e9;
/** Behind everything else. */
const LAST = -1e9;

/** One parcel on its way. */
export interface Entry {
  readonly parcel: Parcel;
  readonly frame: Uint8Array;
  /** Whether it is kept until the hub has read it. */
  readonly reliable: boolean;
  /** Whether a token guards it: it must not be sent after its owner lost the connection. */
  readonly guarded: boolean;
  lane: number;
  /** How much of it has been sent in chunks. */
  at: number;
  stream: number;
}

/** A message that will not be sent, and why. */
export type Loss = (parcel: Parcel, reason: string) => void;

/** Lanes by urgency; a large parcel goes in chunks, and what is more urgent between them. */
export class Outbox {
  #lanes = new Map<number, Entry[]>();
  #open = new Set<Entry>();
  #streams = 0;
  #full: (() => void)[] = [];
  /** Bytes that wait. */
  bytes = 0;
  /** Where it is full. */
  most = 4 * 1024 * 1024;
  parcelLimit = 8 * 1024 * 1024;
  /** Whether more may be sent at this moment. */
  permits: (entry: Entry) => boolean = () => true;
  wrote: (entry: Entry) => void = () => undefined;

  constructor(readonly lost: Loss) {}

  /** Puts a parcel where it belongs, or behind all others. */
  put(parcel: Parcel, marks: { reliable: boolean; guarded: boolean }, last = false): Entry {
    const message = parcel.family === "message";
    const lane = last ? LAST : !message ? CONTROL : parcel.name === "stop" ? STOP : Math.max(-MOST_PRIORITY, Math.min(MOST_PRIORITY, parcel.priority ?? 0));
    const entry: Entry = { parcel, frame: encode(parcel), ...marks, lane, at: 0, stream: 0 };
    if (entry.frame.length - 4 > this.parcelLimit) {
      throw local("too-large", `the parcel has ${entry.frame.length - 4} bytes, and the hub takes ${this.parcelLimit}`);
    }
    if (message && parcel.delivery === "latest" && this.#replace(entry)) return entry;
    this.#push(entry);
    while (message && this.bytes > this.most && this.#dropFleeting());
    return entry;
  }

  /** Something new of `latest` takes the place of what waits. */
  #replace(entry: Entry): boolean {
    const key = ({ context, name, address }: Parcel): string => JSON.stringify([context, name, address]);
    const lane = this.#lanes.get(entry.lane) ?? [];
    const wanted = key(entry.parcel);
    const place = lane.findIndex((old) => old.at === 0 && old.parcel.delivery === "latest" && key(old.parcel) === wanted);
    const old = lane[place];
    if (!old) return false;
    lane[place] = entry;
    this.bytes += entry.frame.length - old.frame.length;
    this.lost(old.parcel, "replaced");
    return true;
  }

  #dropFleeting(): boolean {
    for (const lane of this.#lanes.values()) {
      const place = lane.findIndex((entry) => entry.at === 0 && entry.parcel.delivery === "fleeting");
      const [entry] = place < 0 ? [] : lane.splice(place, 1);
      if (!entry) continue;
      this.bytes -= entry.frame.length;
      this.lost(entry.parcel, "queue-full");
      return true;
    }
    return false;
  }

  #push(entry: Entry): void {
    const lane = this.#lanes.get(entry.lane);
    if (lane) lane.push(entry);
    else this.#lanes.set(entry.lane, [entry]);
    this.bytes += entry.frame.length;
  }

  /** What was sent on an earlier connection and goes again, before anything new; `mark` follows it. */
  again(entries: Entry[], mark: Parcel): void {
    for (const entry of entries) this.#push({ ...entry, lane: AGAIN, at: 0 });
    this.#push({ parcel: mark, frame: encode(mark), reliable: false, guarded: false, lane: AGAIN, at: 0, stream: 0 });
  }

  /** Waits until there may be capacity. */
  room(): Promise<void> {
    return new Promise<void>((resolve) => this.#full.push(resolve));
  }

  #wake(): void {
    if (this.bytes < this.most) for (const wake of this.#full.splice(0)) wake();
  }

  /** Sends what the pipe takes. */
  pump(pipe: Pipe): void {
    const ahead = globalThis.document?.hidden ? AHEAD_HIDDEN : AHEAD;
    while (pipe.waiting < ahead) {
      const entry = this.#next();
      if (!entry || !this.permits(entry)) break;
      this.#write(pipe, entry);
    }
    this.#wake();
  }

  /** The most urgent one; where it may not begin a stream, the most urgent of those that have. */
  #next(): Entry | undefined {
    const urgent = (entries: Iterable<Entry>): Entry | undefined => {
      let best: Entry | undefined;
      for (const entry of entries) if (!best || entry.lane > best.lane) best = entry;
      return best;
    };
    const heads = [...this.#lanes.values()].flatMap((lane) => lane.slice(0, 1));
    const best = urgent(heads);
    if (!best || best.at > 0 || best.frame.length <= 2 * PIECE) return best;
    const open = [...this.#open].reduce((sum, entry) => sum + entry.frame.length, best.frame.length);
    return this.#open.size < STREAMS && (open <= this.parcelLimit || !this.#open.size) ? best : urgent(this.#open);
  }

  #write(pipe: Pipe, entry: Entry): void {
    const whole = entry.frame.length - 4;
    if (entry.at === 0 && (entry.lane === STOP || entry.frame.length <= 2 * PIECE)) {
      pipe.send(entry.frame);
      return this.#done(entry);
    }
    if (entry.at === 0) {
      entry.stream = ++this.#streams;
      this.#open.add(entry);
    }
    const end = Math.min(whole, entry.at + PIECE);
    pipe.send(chunk(entry.stream, entry.frame.subarray(4), entry.at, end));
    entry.at = end;
    if (end === whole) this.#done(entry);
  }

  #done(entry: Entry): void {
    const lane = this.#lanes.get(entry.lane)!;
    // Only the first of a lane is ever sent.
    lane.shift();
    if (!lane.length) this.#lanes.delete(entry.lane);
    this.#open.delete(entry);
    this.bytes -= entry.frame.length;
    if (entry.parcel.family !== "time") this.wrote(entry);
  }

  /** The connection is lost: what was half sent begins anew. */
  detach(): void {
    for (const entry of this.#open) entry.at = 0;
    this.#open.clear();
    this.#streams = 0;
  }

  /** Takes out what was to go again, and did not yet. */
  takeAgain(): Entry[] {
    return this.take((entry) => entry.lane === AGAIN).filter((entry) => entry.parcel.family !== "time");
  }

  /** Takes out what is not to be sent any more, in its order. */
  take(which: (entry: Entry) => boolean): Entry[] {
    const taken: Entry[] = [];
    for (const [number, lane] of this.#lanes) {
      const kept = lane.filter((entry) => !which(entry));
      taken.push(...lane.filter(which));
      if (kept.length) this.#lanes.set(number, kept);
      else this.#lanes.delete(number);
    }
    for (const entry of taken) this.bytes -= entry.frame.length;
    this.#wake();
    return taken;
  }
}
