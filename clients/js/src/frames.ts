// The hub's stream of bytes, taken apart into parcels.
import { CHUNK, PARCEL, PREFACE } from "./binary.js";
import { EMPTY, Reader } from "./bytes.js";
import { MomError, local } from "./error.js";

const STREAMS = 8;
const FIRST = 1;
const LAST = 2;
const ABORTED = 4;
/** The kind of the frame behind which all is compressed. */
const COMPRESSED = 2;

interface Stream {
  readonly whole: Uint8Array;
  at: number;
}

/** Reads frames of any size from pieces of any size, and joins chunks. */
export class Frames {
  #bytes: Uint8Array = EMPTY;
  #begin = 0;
  #end = 0;
  #greeted = false;
  readonly #streams = new Map<number, Stream>();
  /** Takes what has come behind the mark of a stream, where one may come. */
  onStream: ((rest: Uint8Array) => void) | null = null;
  /** The longest parcel; the hub keeps its own limit, too. */
  most = Infinity;

  /** Takes bytes, and gives the parcels that are whole now, without their kind. */
  *push(more: Uint8Array): Generator<Uint8Array> {
    this.#append(more);
    if (!this.#greeted && !this.#greet()) return;
    while (this.#end - this.#begin >= 4) {
      const length = new Reader(this.#bytes.subarray(this.#begin, this.#end)).u32();
      if (length > this.most) throw local("too-large", `the hub announces a frame of ${length} bytes, above its limit of ${this.most}`);
      if (length === 0) throw local("bad-frame", "a frame has no kind");
      if (this.#end - this.#begin < 4 + length) return;
      const frame = this.#bytes.subarray(this.#begin + 4, this.#begin + 4 + length);
      this.#begin += 4 + length;
      const kind = frame[0] ?? 0;
      if (kind === PARCEL) yield frame.subarray(1);
      else if (kind === COMPRESSED && this.onStream) {
        const rest = this.#bytes.subarray(this.#begin, this.#end);
        this.#begin = this.#end;
        return this.onStream(rest);
      } else if (kind === CHUNK) {
        const whole = this.#chunk(new Reader(frame.subarray(1)));
        if (whole) yield whole;
      } else if (kind < 128) throw local("bad-frame", `${kind} is not a kind of frame`);
    }
  }

  #append(more: Uint8Array): void {
    const held = this.#end - this.#begin;
    if (held === 0) {
      // What was given out may be used as long as its taker likes.
      this.#bytes = more;
      [this.#begin, this.#end] = [0, more.length];
      return;
    }
    if (this.#end + more.length > this.#bytes.length || this.#begin > 0) {
      const larger = new Uint8Array(Math.max(2 * held, held + more.length));
      larger.set(this.#bytes.subarray(this.#begin, this.#end));
      this.#bytes = larger;
      [this.#begin, this.#end] = [0, held];
    }
    this.#bytes.set(more, this.#end);
    this.#end += more.length;
  }

  #greet(): boolean {
    const held = Math.min(this.#end - this.#begin, PREFACE.length);
    for (let at = 0; at < Math.min(held, 4); at++) {
      if (this.#bytes[this.#begin + at] !== PREFACE[at]) throw local("bad-frame", "the answer is not from a hub that speaks the binary form");
    }
    if (held < PREFACE.length) return false;
    const major = this.#bytes[this.#begin + 4];
    if (major !== PREFACE[4]) throw local("bad-version", `the hub speaks version ${major}, and this client ${PREFACE[4]}`);
    this.#begin += PREFACE.length;
    this.#greeted = true;
    return true;
  }

  /** The parcel that is whole by this chunk. */
  #chunk(reader: Reader): Uint8Array | null {
    const broken = (why: string): MomError => local("bad-frame", `chunk of stream ${number}: ${why}`);
    const number = reader.varint();
    const flags = reader.u8();
    let stream = this.#streams.get(number);
    if (flags & ABORTED) {
      if (!stream) throw broken("it is not open");
      this.#streams.delete(number);
      return null;
    }
    if (flags > (FIRST | LAST)) throw broken(`flags ${flags}`);
    if (flags & FIRST) {
      const length = reader.varint();
      const open = [...this.#streams.values()].reduce((sum, stream) => sum + stream.whole.length, length);
      if (stream) throw broken("it is open already");
      if (this.#streams.size >= STREAMS) throw broken(`more than ${STREAMS} are open`);
      if (open > this.most) throw local("too-large", `${open} bytes are announced in chunks, above the hub's limit of ${this.most}`);
      stream = { whole: new Uint8Array(length), at: 0 };
      this.#streams.set(number, stream);
    }
    if (!stream) throw broken("it is not open");
    const bytes = reader.take(reader.left);
    if (stream.at + bytes.length > stream.whole.length) throw broken("it is longer than announced");
    stream.whole.set(bytes, stream.at);
    stream.at += bytes.length;
    if (!(flags & LAST)) return null;
    this.#streams.delete(number);
    if (stream.at < stream.whole.length || stream.at === 0) throw broken("it is shorter than announced");
    if (stream.whole[0] !== PARCEL) throw broken("it does not hold a parcel");
    return stream.whole.subarray(1);
  }
}

/** The end of a stream that will not be whole. */
export function abort(stream: number): Uint8Array {
  return cut(stream, ABORTED, EMPTY, 0, 0);
}

/** One chunk, with its length. */
export function chunk(stream: number, bytes: Uint8Array, from: number, to: number): Uint8Array {
  return cut(stream, (from === 0 ? FIRST : 0) | (to === bytes.length ? LAST : 0), bytes, from, to);
}

function cut(stream: number, flags: number, bytes: Uint8Array, from: number, to: number): Uint8Array {
  const head: number[] = [CHUNK];
  const varint = (number: number): void => {
    for (; number > 127; number = Math.floor(number / 128)) head.push((number % 128) + 128);
    head.push(number);
  };
  varint(stream);
  head.push(flags);
  if (flags & FIRST) varint(bytes.length);
  const frame = new Uint8Array(4 + head.length + to - from);
  new DataView(frame.buffer).setUint32(0, frame.length - 4);
  frame.set(head, 4);
  frame.set(bytes.subarray(from, to), 4 + head.length);
  return frame;
}
