// MessagePack, as far as docs/PROTOCOL.md has it. A codec of its own: the usual packages bring more than half of the size that this
// client may have, and none of them refuses what the protocol refuses.
import { type Reader, type Writer, utf8 } from "./bytes.js";
import { local } from "./error.js";
import { Double, Time, type Value, isFields } from "./value.js";

const MOST_DEPTH = 32;
const NO_XML = /[^\t\n\r\x20-\ud7ff\ue000-\ufffd\u{10000}-\u{10ffff}]/u;

/** Writes a value; what has no form on the wire is `not-encodable`. */
export function pack(writer: Writer, value: Value, depth = MOST_DEPTH): void {
  if (value === null) writer.u8(0xc0);
  else if (typeof value === "boolean") writer.u8(value ? 0xc3 : 0xc2);
  else if (typeof value === "number") packNumber(writer, value);
  else if (typeof value === "bigint") packInt(writer, value);
  else if (typeof value === "string") packText(writer, value);
  else if (value instanceof Double) packDouble(writer, value.number);
  else if (value instanceof Time) packTime(writer, value.micros);
  else if (value instanceof Date) packTime(writer, Time.of(value).micros);
  else if (value instanceof Uint8Array) head(writer, value.length, [0, 0, 0xc4, 0xc5, 0xc6]).raw(value);
  else if (depth === 0) throw local("too-deep", `lists and maps nest at most ${MOST_DEPTH} deep`);
  else if (Array.isArray(value)) {
    head(writer, value.length, [0x90, 16, 0, 0xdc, 0xdd]);
    for (const item of value as readonly Value[]) pack(writer, item, depth - 1);
  } else if (value instanceof Map || isFields(value)) packMap(writer, value, depth);
  else throw local("not-encodable", `a ${typeof value} cannot be sent`);
}

export function packMap(writer: Writer, map: Map<string, Value> | { readonly [key: string]: Value | undefined }, depth = MOST_DEPTH): void {
  const all = map instanceof Map ? [...map] : Object.entries(map);
  const entries = all.filter((entry): entry is [string, Value] => entry[1] !== undefined);
  head(writer, entries.length, [0x80, 16, 0, 0xde, 0xdf]);
  for (const [key, value] of entries) {
    packText(writer, key);
    pack(writer, value, depth - 1);
  }
}

/** The head of something with a length: the byte of short ones, below which length, and the bytes of 8, 16 and 32 bits. */
function head(writer: Writer, length: number, [short, below, b8, b16, b32]: [number, number, number, number, number]): Writer {
  if (length < below) return writer.u8(short | length);
  if (length < 256 && b8) return writer.u8(b8).u8(length);
  return length < 65536 ? writer.u8(b16).u16(length) : writer.u8(b32).u32(length);
}

function packText(writer: Writer, text: string): void {
  if (NO_XML.test(text)) throw local("not-encodable", "a string has a control character or half a surrogate pair");
  const bytes = utf8(text);
  head(writer, bytes.length, [0xa0, 32, 0xd9, 0xda, 0xdb]).raw(bytes);
}

function packNumber(writer: Writer, number: number): void {
  if (!Number.isSafeInteger(number) || Object.is(number, -0)) packDouble(writer, number);
  else if (number >= 0) {
    if (number < 128) writer.u8(number);
    else if (number < 256) writer.u8(0xcc).u8(number);
    else if (number < 65536) writer.u8(0xcd).u16(number);
    else if (number < 2 ** 32) writer.u8(0xce).u32(number);
    else writer.u8(0xcf).i64(BigInt(number));
  } else if (number >= -32) writer.u8(number & 255);
  else if (number >= -128) writer.u8(0xd0).u8(number & 255);
  else if (number >= -32768) writer.u8(0xd1).u16(number & 65535);
  else if (number >= -(2 ** 31)) writer.u8(0xd2).u32(number >>> 0);
  else writer.u8(0xd3).i64(BigInt(number));
}

function packInt(writer: Writer, number: bigint): void {
  if (BigInt.asIntN(64, number) !== number) throw local("not-encodable", `${number} has more than 64 bits`);
  if (Number.isSafeInteger(Number(number))) packNumber(writer, Number(number));
  else writer.u8(number < 0n ? 0xd3 : 0xcf).i64(number);
}

function packDouble(writer: Writer, number: number): void {
  if (!Number.isFinite(number)) throw local("not-encodable", `${number} cannot be sent`);
  writer.u8(0xcb).f64(number);
}

function packTime(writer: Writer, micros: bigint): void {
  const rest = ((micros % 1000000n) + 1000000n) % 1000000n;
  writer.u8(0xc7).u8(12).u8(0xff).u32(Number(rest) * 1000);
  writer.i64((micros - rest) / 1000000n);
}

/**
 * Reads values. Where they are `exact`, maps come as `Map` and whole doubles as `Double`, for programs that pass them on.
 */
export class Unpacker {
  constructor(
    readonly reader: Reader,
    readonly exact = false,
  ) {}

  value(depth = MOST_DEPTH): Value {
    const { reader } = this;
    const kind = reader.u8();
    if (kind < 0x80) return kind;
    if (kind < 0x90) return this.#map(kind & 15, depth);
    if (kind < 0xa0) return this.#list(kind & 15, depth);
    if (kind < 0xc0) return this.#text(kind & 31);
    if (kind >= 0xe0) return kind - 256;
    switch (kind) {
      case 0xc0: return null;
      case 0xc2: return false;
      case 0xc3: return true;
      case 0xc4: return reader.take(reader.u8()).slice();
      case 0xc5: return reader.take(reader.u16()).slice();
      case 0xc6: return reader.take(reader.u32()).slice();
      case 0xc7: return this.#time(reader.u8());
      case 0xca: return this.#double(reader.view(4).getFloat32(0));
      case 0xcb: return this.#double(reader.view(8).getFloat64(0));
      case 0xcc: return reader.u8();
      case 0xcd: return reader.u16();
      case 0xce: return reader.u32();
      case 0xcf: return this.#int(BigInt.asUintN(64, reader.i64()));
      case 0xd0: return reader.view(1).getInt8(0);
      case 0xd1: return reader.view(2).getInt16(0);
      case 0xd2: return reader.view(4).getInt32(0);
      case 0xd3: return this.#int(reader.i64());
      case 0xd6: return this.#time(4);
      case 0xd7: return this.#time(8);
      case 0xd9: return this.#text(reader.u8());
      case 0xda: return this.#text(reader.u16());
      case 0xdb: return this.#text(reader.u32());
      case 0xdc: return this.#list(reader.u16(), depth);
      case 0xdd: return this.#list(reader.u32(), depth);
      case 0xde: return this.#map(reader.u16(), depth);
      case 0xdf: return this.#map(reader.u32(), depth);
    }
    throw local("bad-content", `no value of the protocol begins with byte ${kind}`);
  }

  #int(number: bigint): Value {
    if (BigInt.asIntN(64, number) !== number) throw local("bad-content", `${number} is not an int of 64 bits`);
    return Number.isSafeInteger(Number(number)) ? Number(number) : number;
  }

  #double(number: number): Value {
    if (!Number.isFinite(number)) throw local("bad-content", "a double is not finite");
    return this.exact ? new Double(number) : number;
  }

  #text(length: number): string {
    const text = this.reader.text(length);
    if (NO_XML.test(text)) throw local("bad-encoding", "a string has a control character");
    return text;
  }

  #time(length: number): Value {
    const kind = this.reader.view(1).getInt8(0);
    if (kind !== -1) throw local("bad-content", `the protocol has no extension type ${kind}`);
    const { reader } = this;
    let [nanos, seconds] = [0, 0n];
    if (length === 4) seconds = BigInt(reader.u32());
    else if (length === 8) {
      const both = BigInt.asUintN(64, reader.i64());
      [nanos, seconds] = [Number(both >> 34n), both & 0x3ffffffffn];
    } else if (length === 12) [nanos, seconds] = [reader.u32(), reader.i64()];
    else throw local("bad-content", `a time cannot have ${length} bytes`);
    return new Time(seconds * 1000000n + BigInt(Math.floor(nanos / 1000)));
  }

  #deeper(count: number, depth: number): void {
    if (depth === 0) throw local("too-deep", `lists and maps nest at most ${MOST_DEPTH} deep`);
    // Each has a byte at least: nobody makes this client reserve memory by a number alone.
    if (count > this.reader.left) throw local("bad-content", `${count} values are announced, but only ${this.reader.left} bytes are left`);
  }

  #list(count: number, depth: number): Value {
    this.#deeper(count, depth);
    return Array.from({ length: count }, () => this.value(depth - 1));
  }

  #map(count: number, depth: number): Value {
    this.#deeper(count, depth);
    const map = new Map<string, Value>();
    for (let left = count; left > 0; left--) {
      const key = this.value(0);
      if (typeof key !== "string" || map.has(key)) throw local("bad-content", `${String(key)} is not a valid key of a map, or is there twice`);
      map.set(key, this.value(depth - 1));
    }
    return this.exact ? map : Object.fromEntries(map);
  }
}
