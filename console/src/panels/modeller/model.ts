// A robot's model (S4 to S6) as it is typed, and how large its packets are. A field is a text until it is checked.
export const KINDS = ["effector", "sensor", "monitor", "command", "module", "event", "memory-command", "memory-event"] as const;
export type Kind = (typeof KINDS)[number];
export const TYPES = ["u8", "i8", "u16", "i16", "u32", "i32", "f32", "bytes"] as const;
export type Type = (typeof TYPES)[number];
export const MOTIONS = ["absolute", "interpolated", "incremental"] as const;

/** The fields of an element that are texts. Lists have commas between their values, a range has `..` between its ends. */
export const FIELDS = ["name", "kind", "type", "count", "max", "sound", "unit", "scale", "range", "safe", "rate", "motion", "period", "lasts", "of", "members", "doc"] as const;
export type Field = (typeof FIELDS)[number];
export type Row = { readonly [field in Field]: string } & { readonly key: number };

export const MODEL_FIELDS = ["name", "id", "period", "largest", "watchdog", "doc"] as const;
export type ModelField = (typeof MODEL_FIELDS)[number];
export type Draft = { readonly [field in ModelField]: string } & { readonly elements: readonly Row[] };

/** What stands where a model's file says nothing. */
export const DEFAULTS = { period: 20, largest: 1472, watchdog: 500 } as const;
export const MOST_ELEMENTS = 256;
/** Bytes of a header (S14), of what a sealed packet has more, and of UDP and IPv4 around a packet. */
export const HEADER = 20;
export const TAG = 16;
export const AROUND = 28;

export const NUMBER_SIZES: { readonly [type: string]: number } = { u8: 1, i8: 1, u16: 2, i16: 2, u32: 4, i32: 4, f32: 4 };
/** The least and the greatest number of a type. */
export const BOUNDS: { readonly [type: string]: readonly [number, number] } = {
  u8: [0, 255],
  i8: [-128, 127],
  u16: [0, 65_535],
  i16: [-32_768, 32_767],
  u32: [0, 4_294_967_295],
  i32: [-2_147_483_648, 2_147_483_647],
  f32: [-3.4028234663852886e38, 3.4028234663852886e38],
};

/** Whether a text says what sound bytes are, such as `pcm 16000`, and the most bytes of its blocks of 20 ms. */
export function soundOf(text: string): { readonly block: number } | undefined {
  const [, codec, digits] = /^(pcm|opus) (\d{4,5})$/.exec(text.trim()) ?? [];
  const rate = Number(digits);
  if (codec === "pcm") return rate >= 8000 && rate <= 96_000 && rate % 50 === 0 ? { block: rate / 25 } : undefined;
  return codec === "opus" && [8000, 12_000, 16_000, 24_000, 48_000].includes(rate) ? { block: 1275 } : undefined;
}

export const isKind = (word: string): word is Kind => (KINDS as readonly string[]).includes(word);
export const isType = (word: string): word is Type => (TYPES as readonly string[]).includes(word);
export const isNumber = (type: string): boolean => type in NUMBER_SIZES;

/** Whether elements of a kind, with data of a type, have a field. */
export function hasField(kind: string, type: string, field: Field): boolean {
  const numbers = isNumber(type);
  switch (field) {
    case "name":
    case "kind":
    case "doc":
      return true;
    case "safe":
    case "rate":
    case "motion":
      return kind === "effector" && numbers;
    case "period":
      return kind === "sensor" || kind === "monitor";
    case "lasts":
      return kind === "command" || kind === "memory-command";
    case "of":
      return kind === "monitor";
    case "members":
      return kind === "module";
    case "type":
      return kind !== "monitor" && kind !== "module";
    case "max":
      return kind !== "monitor" && kind !== "module" && type === "bytes";
    case "sound":
      return (kind === "effector" || kind === "sensor") && type === "bytes";
    default:
      return kind !== "monitor" && kind !== "module" && numbers;
  }
}

export function blank(key: number, values: Partial<Row> = {}): Row {
  return { name: "", kind: "sensor", type: "", count: "", max: "", sound: "", unit: "", scale: "", range: "", safe: "", rate: "", motion: "", period: "", lasts: "", of: "", members: "", doc: "", ...values, key };
}

export function emptyDraft(): Draft {
  return { name: "robot", id: "1", period: "", largest: "", watchdog: "", doc: "", elements: [blank(1, { name: "left-wheel", kind: "effector", type: "i16", unit: "mm/s", range: "-500..500" })] };
}

export const nextKey = (rows: readonly Row[]): number => rows.reduce((most, { key }) => Math.max(most, key), 0) + 1;

/** The rows with one moved up (-1) or down (1). */
export function moved(rows: readonly Row[], key: number, by: number): readonly Row[] {
  const from = rows.findIndex((row) => row.key === key);
  const to = from + by;
  if (from < 0 || to < 0 || to >= rows.length) return rows;
  const next = [...rows];
  [next[from], next[to]] = [next[to]!, next[from]!];
  return next;
}

/** What an element's data are: so many numbers of so many bytes, or at most so many bytes; nothing if it has none. */
export interface Payload {
  kind: Kind;
  /** Bytes of all its numbers, or 2 and the most bytes. */
  data: number;
  /** Whether its data are bytes. */
  isBytes: boolean;
  /** Whether they are too many for a packet, and travel in fragments (S13, S27). */
  isBlob: boolean;
}

export type Way = "down" | "up";

/** The most bytes of an element's payload in a packet (S5). */
export function payloadSize({ kind, data, isBytes }: Payload, way: Way): number {
  switch (kind) {
    case "effector":
      return way === "down" ? data : 0;
    case "sensor":
    case "monitor":
      return way === "up" ? data : 0;
    case "command":
    case "memory-command":
      return way === "down" ? 1 + data : 1;
    case "event":
      return way === "up" ? 1 + data : 1;
    case "memory-event":
      // The length of bytes and that of a memory event are one.
      return way === "up" ? (isBytes ? 1 + data : 3 + data) : 1;
    case "module":
      return 0;
  }
}

/** Whether an element's bit can be 1 in a packet: an effector and a module have nothing to say. */
export const hasBit = (kind: Kind, way: Way): boolean => way === "down" || (kind !== "effector" && kind !== "module");

export const mapSize = (elements: number): number => Math.ceil(elements / 8);

/** The bytes of a packet with the payloads of these elements in it; those that are not known count nothing. */
export function packetSize(payloads: readonly (Payload | undefined)[], way: Way, isIn: (place: number) => boolean = () => true): number {
  return payloads.reduce((sum, payload, place) => sum + (payload && isIn(place) ? payloadSize(payload, way) : 0), HEADER + mapSize(payloads.length));
}
