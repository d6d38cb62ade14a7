// The binary form of one parcel.
import { Reader, Writer, utf8 } from "./bytes.js";
import { MomError, local } from "./error.js";
import { Unpacker, pack, packMap } from "./msgpack.js";
import type { Parcel } from "./parcel.js";
import { Time } from "./value.js";
import { DELIVERIES, FAMILIES, NUMBERS, WORDS } from "./words.js";

export const PREFACE: Uint8Array = Uint8Array.of(0x8f, 0x4d, 0x4f, 0x4d, 1, 1);

/** What a frame is. */
export const PARCEL = 0;
export const CHUNK = 1;

/** One frame, with its length. */
export function encode(parcel: Parcel): Uint8Array {
  const slots = new Writer();
  let bits = 0;
  const slot = <T>(bit: number, value: T | undefined, write: (value: T) => void): void => {
    if (value === undefined) return;
    bits += 2 ** bit;
    write(value);
  };
  const varint = (number: number): unknown => slots.varint(number);
  const time = (value: Time): unknown => slots.i64(value.micros);
  slot(0, parcel.number, varint);
  slot(1, parcel.name, (name) => writeName(slots, name));
  slot(2, parcel.sender, (name) => writeName(slots, name));
  slot(3, parcel.timestamp, time);
  slot(4, parcel.id, varint);
  if (parcel.content !== undefined) bits += 2 ** 5;
  slot(6, parcel.fence, varint);
  slot(7, parcel.received, time);
  slot(8, parcel.age, (age) => slots.zigzag(age));
  slot(9, parcel.ageError, varint);
  slot(10, parcel.family === "message" ? undefined : parcel.family, (family) => slots.u8(FAMILIES.indexOf(family)));
  slot(11, parcel.reference, varint);
  slot(12, parcel.priority, (priority) => slots.zigzag(priority));
  slot(13, parcel.address, (names) => {
    slots.varint(names.length);
    for (const name of names) writeName(slots, name);
  });
  slot(14, parcel.expires, varint);
  slot(15, parcel.delivery, (delivery) => slots.u8(DELIVERIES.indexOf(delivery)));
  slot(16, parcel.echo, (echo) => slots.u8(Number(echo)));
  slot(17, parcel.receipt, (receipt) => slots.u8(Number(receipt)));
  slot(18, parcel.context, (path) => {
    const bytes = utf8(path);
    slots.varint(bytes.length).raw(bytes);
  });
  slot(19, parcel.extra, (extra) => {
    const map = new Writer();
    packMap(map, extra);
    slots.varint(map.length).raw(map.take());
  });
  const frame = new Writer();
  frame.u32(0).u8(PARCEL).varint(bits).raw(slots.take());
  if (parcel.content !== undefined) pack(frame, parcel.content);
  frame.patch(0, frame.length - 4);
  return frame.take();
}

function writeName(writer: Writer, name: string): void {
  const number = NUMBERS.get(name);
  if (number !== undefined) {
    writer.varint(2 * number + 1);
    return;
  }
  const bytes = utf8(name);
  writer.varint(2 * bytes.length).raw(bytes);
}

/** A word of a later version names nothing that this client knows. */
function readName(reader: Reader): string {
  const key = reader.varint();
  return key % 2 ? (WORDS[(key - 1) / 2] ?? "") : reader.text(key / 2);
}

/**
 * A parcel from the bytes behind its kind. The name of one that this version does not know is empty. Content that cannot be read is the
 * parcel's `fault`.
 */
export function decode(bytes: Uint8Array, exact = false): Parcel {
  const reader = new Reader(bytes);
  const bits = reader.bits();
  const low = Number(bits & 0xfffffn);
  const has = (bit: number): boolean => ((low >> bit) & 1) === 1;
  const parcel: Parcel = { family: "message", name: "" };
  if (has(0)) parcel.number = reader.varint();
  if (!has(1)) throw local("bad-slot", "the parcel has no name");
  parcel.name = readName(reader);
  if (has(2)) parcel.sender = readName(reader);
  if (has(3)) parcel.timestamp = new Time(reader.i64());
  if (has(4)) parcel.id = reader.varint();
  if (has(6)) parcel.fence = reader.varint();
  if (has(7)) parcel.received = new Time(reader.i64());
  if (has(8)) parcel.age = reader.zigzag();
  if (has(9)) parcel.ageError = reader.varint();
  if (has(10)) parcel.family = one(FAMILIES, reader.u8(), "family");
  if (has(11)) parcel.reference = reader.varint();
  if (has(12)) parcel.priority = reader.zigzag();
  if (has(13)) {
    parcel.address = Array.from({ length: Math.min(reader.varint(), reader.left) }, () => readName(reader));
  }
  if (has(14)) parcel.expires = reader.varint();
  if (has(15)) parcel.delivery = one(DELIVERIES, reader.u8(), "delivery");
  if (has(16)) parcel.echo = reader.u8() === 1;
  if (has(17)) parcel.receipt = reader.u8() === 1;
  if (has(18)) parcel.context = reader.text(reader.varint());
  if (has(19)) parcel.extra = readExtra(reader, exact);
  for (let later = bits >> 20n; later > 0n; later >>= 1n) if (later & 1n) reader.take(reader.varint());
  if (has(5)) readContent(parcel, reader, exact);
  return parcel;
}

function one<T>(words: readonly T[], number: number, slot: string): T {
  const word = words[number];
  if (word === undefined) throw local("bad-slot", `${number} is not a ${slot}`);
  return word;
}

function readExtra(reader: Reader, exact: boolean): NonNullable<Parcel["extra"]> {
  const inside = new Reader(reader.take(reader.varint()));
  return new Unpacker(inside, exact).value() as NonNullable<Parcel["extra"]>;
}

function readContent(parcel: Parcel, reader: Reader, exact: boolean): void {
  try {
    parcel.content = new Unpacker(reader, exact).value();
    if (reader.left > 0) throw local("bad-content", `${reader.left} bytes follow the content`);
  } catch (error) {
    if (!(error instanceof MomError)) throw error;
    delete parcel.content;
    parcel.fault = error;
  }
}
