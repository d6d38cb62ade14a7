// What waits to be sent.
import { encode } from "./binary.js";
import { local } from "./error.js";
import { abort, chunk } from "./frames.js";
import { type Parcel, dropped } from "./parcel.js";
import type { Pipe } from "./pipe.js";
import { AGAIN, type Marks, STOP, isPerishable, keyOf, laneOf, passes, waitsBehind, withdraws } from "./precedence.js";
import { wallMicros } from "./value.js";

/** So much is given to a pipe ahead of time; the rest waits here, where what is urgent can overtake it. */
const AHEAD = 64 * 1024;
/** The timers of a page that nobody sees come once a second. */
const AHEAD_HIDDEN = 1024 * 1024;
const PIECE = 16 * 1024;
/** Streams of chunks that are open at once; a hub takes eight. */
const STREAMS = 4;

/** One parcel on its way. */
export interface Entry {
  readonly parcel: Parcel;
  readonly frame: Uint8Array;
  /** Whether it is kept until the hub has read it. */
  readonly reliable: boolean;
  readonly fleeting: boolean;
  readonly token: string | undefined;
  readonly awaited: boolean;
  /** Whether it must not be sent after a loss of the connection. */
  readonly perishable: boolean;
  /** What a newer one that takes its place has in common with it. */
  readonly key: string | undefined;
  /** When it is worthless, in ms by the clock of the outbox. */
  readonly until: number;
  /** Counts what is said. */
  readonly number: number;
  lane: number;
  /** How much of it has been sent in chunks. */
  at: number;
  stream: number;
}

/** Something will not be sent, or nobody can say whether it was read, and why. */
export type Loss = (entry: Entry, reason: string) => void;

/** Lanes by urgency; a large parcel goes in chunks, and what is more urgent between them. */
export class Outbox {
  readonly #lanes = new Map<number, Entry[]>();
  /** What waits behind messages, these messages, and what was said after it. */
  #barrier: Entry | undefined;
  readonly #ahead = new Set<Entry>();
  #behind: Entry[] = [];
  /** By their keys, what a newer one may take the place of. */
  readonly #named = new Map<string | undefined, Entry>();
  readonly #open = new Set<Entry>();
  #aborted: number[] = [];
  #streams = 0;
  #numbers = 0;
  /** Between a loss of the connection and its end. */
  #away = false;
  #full: (() => void)[] = [];
  /** Bytes that wait. */
  bytes = 0;
  /** Where it is full. */
  most = 4 * 1024 * 1024;
  parcelLimit = 8 * 1024 * 1024;
  /** Whether more may be sent at this moment. */
  permits: (entry: Entry) => boolean = () => true;
  wrote: (entry: Entry) => void = () => undefined;
  /** The clock of timestamps, in ms. */
  now = (): number => wallMicros() / 1000;

  constructor(readonly lost: Loss) {}

  /**
   * Puts a parcel where it belongs.
   *
   * @throws MomError `too-large`, or `lost` for what must not wait until a lost connection is resumed.
   */
  put(parcel: Parcel, marks: Marks = {}): void {
    const entry = this.#entry(parcel, marks);
    const size = entry.frame.length - 4;
    if (size > this.parcelLimit) throw local("too-large", `the parcel has ${size} bytes; the hub accepts at most ${this.parcelLimit}`);
    if (this.#away && entry.perishable) throw dropped(parcel, "lost");
    if (entry.lane === STOP) for (const unstop of this.take((waiting) => withdraws(parcel, waiting.parcel))) this.lost(unstop, "withdrawn");
    this.#add(entry);
    while (this.bytes > this.most && this.#dropFleeting());
  }

  #entry(parcel: Parcel, { delivery = "reliable", token, awaited = false }: Marks): Entry {
    const [lane, message] = [laneOf(parcel), parcel.family === "message"];
    const { timestamp, expires } = parcel;
    const created = timestamp ? Number(timestamp.micros) / 1000 : this.now();
    return {
      parcel,
      frame: encode(parcel),
      // A stop is kept whatever its channel does with other messages, and never too old.
      reliable: !message || lane === STOP || delivery === "reliable",
      fleeting: message && lane !== STOP && delivery === "fleeting",
      token,
      awaited,
      perishable: isPerishable(parcel, token),
      key: keyOf(parcel, delivery),
      until: !message || lane === STOP || expires === undefined ? Infinity : created + expires,
      number: ++this.#numbers,
      lane,
      at: 0,
      stream: 0,
    };
  }

  /** Queues it up, or puts it in the place of an older one. */
  #add(entry: Entry): void {
    const stop = entry.lane === STOP;
    let old = this.#named.get(entry.key);
    // A caller waits for its own answer.
    if (old && (this.#open.has(old) || (stop && old.awaited))) old = undefined;
    const list = this.#barrier && !stop ? this.#behind : (this.#lanes.get(entry.lane) ?? []);
    const place = old && old.lane === entry.lane ? list.indexOf(old) : -1;
    const stays = (later: Entry): boolean => waitsBehind(later.parcel) !== undefined;
    if (old && place >= 0 && !stays(entry) && !(list === this.#behind && list.slice(place).some(stays))) {
      list[place] = entry;
      this.#gone(old);
      this.#came(entry);
    } else {
      // What was said after something that waits behind messages must not overtake it.
      if (old) this.take((waiting) => waiting === old);
      this.#came(entry);
      this.#queue(entry);
    }
    if (old && !stop) this.lost(old, "replaced");
  }

  #came(entry: Entry): void {
    this.bytes += entry.frame.length;
    if (entry.key !== undefined) this.#named.set(entry.key, entry);
  }

  #gone(entry: Entry): void {
    this.bytes -= entry.frame.length;
    if (this.#named.get(entry.key) === entry) this.#named.delete(entry.key);
    this.#ahead.delete(entry);
    if (this.#open.delete(entry)) this.#aborted.push(entry.stream);
  }

  /** Puts it into its lane, or behind what waits for messages. */
  #queue(entry: Entry): void {
    if (this.#barrier && entry.lane < AGAIN && !this.#passes(entry, this.#barrier)) {
      this.#behind.push(entry);
      return;
    }
    const fits = waitsBehind(entry.parcel);
    if (fits) for (const list of this.#lanes.values()) for (const waiting of list) if (fits(waiting)) this.#ahead.add(waiting);
    if (this.#ahead.size && fits) this.#barrier = entry;
    else this.#line(entry);
  }

  #passes({ parcel }: Entry, barrier: Entry): boolean {
    return passes(parcel, barrier.parcel) && this.#behind.every((waiting) => passes(parcel, waiting.parcel));
  }

  #line(entry: Entry): void {
    const lane = this.#lanes.get(entry.lane);
    if (lane) lane.push(entry);
    else this.#lanes.set(entry.lane, [entry]);
  }

  /** Lets go what waited behind messages that are gone. */
  #settle(): void {
    if (this.#ahead.size) return;
    const [barrier, behind] = [this.#barrier, this.#behind];
    [this.#barrier, this.#behind] = [undefined, []];
    if (barrier) this.#line(barrier);
    for (const entry of behind) this.#queue(entry);
  }

  #dropFleeting(): boolean {
    let oldest: Entry | undefined;
    for (const list of [...this.#lanes.values(), this.#behind]) {
      const first = list.find((entry) => entry.fleeting && !this.#open.has(entry));
      if (first && (!oldest || first.number < oldest.number)) oldest = first;
    }
    for (const entry of this.take((waiting) => waiting === oldest)) this.lost(entry, "queue-full");
    return oldest !== undefined;
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
    for (;;) {
      for (const stream of this.#aborted.splice(0)) pipe.send(abort(stream));
      const entry = pipe.waiting < ahead ? this.#next() : undefined;
      if (!entry) break;
      if (entry.until <= this.now()) {
        this.#shift(entry);
        this.lost(entry, "expired");
      } else if (this.permits(entry)) this.#write(pipe, entry);
      else break;
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
    const best = urgent([...this.#lanes.values()].map((lane) => lane[0]!));
    if (!best || this.#open.has(best) || best.frame.length <= 2 * PIECE) return best;
    const open = [...this.#open].reduce((sum, entry) => sum + entry.frame.length, best.frame.length);
    return this.#open.size < STREAMS && (open <= this.parcelLimit || !this.#open.size) ? best : urgent(this.#open);
  }

  #write(pipe: Pipe, entry: Entry): void {
    const whole = entry.frame.length - 4;
    if (!this.#open.has(entry) && (entry.lane === STOP || entry.frame.length <= 2 * PIECE)) {
      pipe.send(entry.frame);
      return this.#done(entry);
    }
    if (!this.#open.has(entry)) {
      entry.stream = ++this.#streams;
      this.#open.add(entry);
    }
    const end = Math.min(whole, entry.at + PIECE);
    pipe.send(chunk(entry.stream, entry.frame.subarray(4), entry.at, end));
    entry.at = end;
    if (end === whole) this.#done(entry);
  }

  #done(entry: Entry): void {
    this.#open.delete(entry);
    this.#shift(entry);
    if (entry.parcel.family !== "time") this.wrote(entry);
  }

  /** Takes out the first of a lane; only that is ever sent. */
  #shift(entry: Entry): void {
    const lane = this.#lanes.get(entry.lane)!;
    lane.shift();
    if (!lane.length) this.#lanes.delete(entry.lane);
    this.#gone(entry);
    this.#settle();
  }

  /** The connection is lost: what was half sent begins anew, and what must not be sent late is dropped, unless it has `moved`. */
  lose(moved = false): void {
    this.#away = true;
    for (const entry of this.#open) entry.at = 0;
    this.#open.clear();
    [this.#streams, this.#aborted] = [0, []];
    if (!moved) for (const entry of this.take((waiting) => waiting.perishable)) if (entry.parcel.family !== "time") this.lost(entry, "lost");
  }

  /** There is a connection again: what had left and was not read goes again, before all that waits, and `mark` behind it. */
  back(unread: readonly Entry[], mark?: Parcel): void {
    this.#away = false;
    // What goes again has left before what waits, so a newer stop takes the place of an older one here, too.
    for (const entry of [...unread, ...this.take(({ lane }) => lane === STOP || lane === AGAIN)]) {
      entry.at = 0;
      if (entry.perishable || !entry.reliable) this.lost(entry, "unknown");
      else if (entry.lane === STOP) this.#add(entry);
      else this.#again(entry);
    }
    if (mark) this.#again(this.#entry(mark, {}));
  }

  #again(entry: Entry): void {
    entry.lane = AGAIN;
    this.#came(entry);
    this.#line(entry);
  }

  /** Takes out what is not to be sent any more, lane by lane. */
  take(which: (entry: Entry) => boolean): Entry[] {
    const taken: Entry[] = [];
    const left = (list: readonly Entry[]): Entry[] => {
      const kept: Entry[] = [];
      for (const entry of list) (which(entry) ? taken : kept).push(entry);
      return kept;
    };
    for (const [number, lane] of this.#lanes) {
      const kept = left(lane);
      if (kept.length) this.#lanes.set(number, kept);
      else this.#lanes.delete(number);
    }
    if (this.#barrier) [this.#barrier] = left([this.#barrier]);
    if (!this.#barrier) this.#ahead.clear();
    this.#behind = left(this.#behind);
    for (const entry of taken) this.#gone(entry);
    this.#settle();
    this.#wake();
    return taken;
  }
}
