import { local } from "./error.js";

const ENCODER = new TextEncoder();
const DECODER = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true });

export const EMPTY = new Uint8Array(0);

export function utf8(text: string): Uint8Array {
  return ENCODER.encode(text);
}

/** Bytes one after the other. */
export class Writer {
  #bytes = new Uint8Array(128);
  #view = new DataView(this.#bytes.buffer);
  #at = 0;

  /** Makes room, and gives where it begins. */
  #room(count: number): number {
    const at = this.#at;
    this.#at += count;
    if (this.#at > this.#bytes.length) {
      const larger = new Uint8Array(Math.max(this.#at, 2 * this.#bytes.length));
      larger.set(this.#bytes.subarray(0, at));
      this.#bytes = larger;
      this.#view = new DataView(larger.buffer);
    }
    return at;
  }

  get length(): number {
    return this.#at;
  }

  u8(number: number): this {
    const at = this.#room(1);
    this.#bytes[at] = number;
    return this;
  }

  u16(number: number): this {
    const at = this.#room(2);
    this.#view.setUint16(at, number);
    return this;
  }

  u32(number: number): this {
    const at = this.#room(4);
    this.#view.setUint32(at, number);
    return this;
  }

  i64(number: bigint): this {
    const at = this.#room(8);
    this.#view.setBigInt64(at, number);
    return this;
  }

  f64(number: number): this {
    const at = this.#room(8);
    this.#view.setFloat64(at, number);
    return this;
  }

  raw(bytes: Uint8Array): this {
    const at = this.#room(bytes.length);
    this.#bytes.set(bytes, at);
    return this;
  }

  /** A LEB128 of at most 53 bits. */
  varint(number: number): this {
    let rest = number;
    for (; rest > 127; rest = Math.floor(rest / 128)) this.u8((rest % 128) + 128);
    return this.u8(rest);
  }

  zigzag(number: number): this {
    return this.varint(number < 0 ? -2 * number - 1 : 2 * number);
  }

  /** Writes a length that was not known before. */
  patch(at: number, number: number): void {
    this.#view.setUint32(at, number);
  }

  take(): Uint8Array {
    return this.#bytes.subarray(0, this.#at);
  }
}

/** Reads bytes one after the other; a lack of them is `bad-content`. */
export class Reader {
  #view: DataView;
  at = 0;

  constructor(readonly bytes: Uint8Array) {
    this.#view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  }

  get left(): number {
    return this.bytes.length - this.at;
  }

  #skip(count: number): number {
    const at = this.at;
    if (count > this.left) throw local("bad-content", `${count} bytes are announced at ${at}, but only ${this.left} are left`);
    this.at += count;
    return at;
  }

  u8(): number {
    return this.#view.getUint8(this.#skip(1));
  }

  u16(): number {
    return this.#view.getUint16(this.#skip(2));
  }

  u32(): number {
    return this.#view.getUint32(this.#skip(4));
  }

  i64(): bigint {
    return this.#view.getBigInt64(this.#skip(8));
  }

  view(count: number): DataView {
    return new DataView(this.bytes.buffer, this.bytes.byteOffset + this.#skip(count), count);
  }

  take(count: number): Uint8Array {
    const at = this.#skip(count);
    return this.bytes.subarray(at, at + count);
  }

  text(count: number): string {
    try {
      return DECODER.decode(this.take(count));
    } catch (error) {
      throw error instanceof TypeError ? local("bad-encoding", "a string is not UTF-8") : error;
    }
  }

  /** A LEB128 of 64 bits, padded or not. */
  bits(): bigint {
    let number = 0n;
    for (let shift = 0n; shift < 70n; shift += 7n) {
      const byte = this.u8();
      number |= BigInt(byte & 127) << shift;
      if (byte < 128) return BigInt.asUintN(64, number);
    }
    throw local("bad-slot", "a number has more than 10 bytes");
  }

  /** The same, as far as a `number` is exact. */
  varint(): number {
    const first = this.bytes[this.at];
    if (first !== undefined && first < 128) {
      this.at += 1;
      return first;
    }
    return Number(this.bits());
  }

  zigzag(): number {
    const number = this.bits();
    return Number((number >> 1n) ^ -(number & 1n));
  }
}
