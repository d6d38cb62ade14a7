// What the first bytes of a packet say: its header (S14), and of one that is not sealed its device map (S17) and the payload behind it.

/** Bytes of a header. */
export const HEADER = 20;
/** Of a last received that is none. */
const NONE = 0xffff;

export interface Header {
  version: number;
  model: number;
  /** 0: none, 1: ChaCha20-Poly1305. */
  encryption: number;
  type: number;
  sequence: number;
  /** ms of the sender's own clock. */
  stamp: number;
  /** In hexadecimal. */
  session: string;
  /** The sequence of the other side's newest data packet; undefined before the first. */
  last: number | undefined;
  /** To the robot: how often it was told to clear its buffers. From it: how many are free. */
  buffers: number;
}

/** A packet as far as it is known. */
export interface Seen {
  header: Header;
  sealed: boolean;
  /** One bit for each element; undefined where it cannot be known: of a sealed packet, or one that is not data packet. */
  bits: readonly boolean[] | undefined;
  /** The header's bytes by field, the map's and the payload's, in hexadecimal; the last two are empty where they are sealed. */
  parts: { header: readonly string[]; map: string; payload: string };
}

/** The bytes that hexadecimal says; undefined if it is none. */
export function bytesOf(hex: string): Uint8Array | undefined {
  if (hex.length % 2 || !/^[0-9a-f]*$/i.test(hex)) return undefined;
  return Uint8Array.from({ length: hex.length / 2 }, (_, index) => parseInt(hex.slice(2 * index, 2 * index + 2), 16));
}

export function hexOf(bytes: Uint8Array): string {
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Where the fields of a header end. */
const ENDS = [1, 3, 4, 5, 7, 11, 17, 19, 20];

export function headerOf(bytes: Uint8Array): Header | undefined {
  if (bytes.length < HEADER) return undefined;
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const last = view.getUint16(17);
  return {
    version: view.getUint8(0),
    model: view.getUint16(1),
    encryption: view.getUint8(3),
    type: view.getUint8(4),
    sequence: view.getUint16(5),
    stamp: view.getUint32(7),
    session: hexOf(bytes.subarray(11, 17)),
    last: last === NONE ? undefined : last,
    buffers: view.getUint8(19),
  };
}

/** Bytes of the device map of so many elements. */
export const mapSize = (elements: number): number => Math.ceil(elements / 8);

/** The bits of a device map, the first in the highest bit of the first byte. */
export function bitsOf(map: Uint8Array, elements: number): boolean[] {
  return Array.from({ length: elements }, (_, place) => ((map[place >> 3] ?? 0) & (0x80 >> (place & 7))) !== 0);
}

/** Whether it carries values: only such a packet begins with a device map. */
export const isData = (type: number): boolean => type === 0x01 || type === 0x81;

/** Reads the first bytes of a packet; `map` is its device map, for one whose own is sealed. */
export function seenOf(hex: string, elements: number, map?: string): Seen | undefined {
  const bytes = bytesOf(hex);
  const header = bytes && headerOf(bytes);
  if (!bytes || !header) return undefined;
  const sealed = header.encryption !== 0;
  const size = mapSize(elements);
  const fields = ENDS.map((end, index) => hexOf(bytes.subarray(index === 0 ? 0 : ENDS[index - 1], end)));
  const told = map ? bytesOf(map) : undefined;
  const behind = sealed ? new Uint8Array() : bytes.subarray(HEADER);
  const own = isData(header.type) && behind.length >= size ? behind.subarray(0, size) : undefined;
  const known = told && told.length >= size ? told : own;
  return {
    header,
    sealed,
    bits: known && elements ? bitsOf(known, elements) : undefined,
    parts: { header: fields, map: own ? hexOf(own) : "", payload: hexOf(own ? behind.subarray(size) : behind) },
  };
}
