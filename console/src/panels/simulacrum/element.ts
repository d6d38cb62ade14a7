// An element of a robot as its messages tell it: what is wanted of it beside what it has or says.
import { fields, flag, list, number, text } from "../../hub/fields.js";
import type { Message, Plain } from "../../worker/protocol.js";
import { HEADER, bytesOf, headerOf } from "./packet.js";

export type Kind = "effector" | "sensor" | "monitor" | "command" | "module" | "event" | "memory-command" | "memory-event";

export interface Element {
  name: string;
  kind: Kind | "";
  /** Its place in the device map, if that was told. */
  place: number | undefined;
  /** In the order in which this page heard of it. */
  heard: number;
  wanted: readonly number[] | undefined;
  /** Confirmed by the robot, or said by it. */
  value: readonly number[] | undefined;
  /** One for each number, or one for all. */
  units: readonly string[];
  activated: boolean;
  active: boolean;
  linked: boolean;
  /** How often it has come to pass, of an event. */
  events: number | undefined;
  /** When its value was known to be so, ms since 1970, and the error of that. */
  born: number;
  error: number | undefined;
  /** ms for which its value had been this one by then. */
  since: number | undefined;
}

/** What is told of packets. */
export interface Packet {
  linked: boolean;
  /** T, ms, as it is wanted. */
  period: number | undefined;
  /** Whether the robot has confirmed T and what is active; undefined if that is not told. */
  confirmed: boolean | undefined;
  /** The share of the robot's packets that did not arrive. */
  loss: number | undefined;
  /** µs. */
  trip: number | undefined;
  /** µs by which the robot's clock is ahead, and the error of that. */
  offset: number | undefined;
  error: number | undefined;
  sent: number | undefined;
  received: number | undefined;
  /** Bytes a second, with UDP and IP. */
  downRate: number | undefined;
  upRate: number | undefined;
  /** The first bytes of the newest packets, and the maps of those that are sealed, in hexadecimal. */
  down: string;
  up: string;
  downMap: string | undefined;
  upMap: string | undefined;
  free: number | undefined;
  accepted: number | undefined;
  /** Datagrams that were dropped, by reason, the most first. */
  dropped: readonly (readonly [reason: string, times: number])[];
  /** µs since the robot was heard last, at the time of this message. */
  heard: number | undefined;
  /** When this was told, ms since 1970. */
  born: number;
}

const KINDS = new Set<string>(["effector", "sensor", "monitor", "command", "module", "event", "memory-command", "memory-event"]);
/** The name of the message that tells of packets. */
export const PACKET = "packet";

function numbers(value: Plain | undefined): number[] | undefined {
  if (!Array.isArray(value)) return undefined;
  return value.map((one) => (typeof one === "bigint" ? Number(one) : typeof one === "number" ? one : NaN));
}

/** What a message says of an element; undefined if it says nothing of one. */
export function elementOf(message: Message, heard: number): Element | undefined {
  const said = fields(message.content);
  const kind = text(said, "kind");
  if (message.name === PACKET || kind === undefined) return undefined;
  const since = number(said, "since");
  return {
    name: message.name,
    kind: KINDS.has(kind) ? (kind as Kind) : "",
    place: number(said, "place"),
    heard,
    wanted: numbers(said["wanted"]),
    value: numbers(said["value"]),
    units: list(said, "unit").map(String),
    activated: flag(said, "activated"),
    active: flag(said, "active"),
    linked: flag(said, "linked"),
    events: number(said, "events"),
    born: message.born ?? message.arrived,
    error: message.error,
    since: since === undefined ? undefined : since / 1000,
  };
}

export function packetOf(message: Message): Packet | undefined {
  if (message.name !== PACKET) return undefined;
  const said = fields(message.content);
  const dropped = Object.entries(fields(said["dropped"])).flatMap(([reason, times]) => (typeof times === "number" && times > 0 ? [[reason, times] as const] : []));
  return {
    linked: flag(said, "linked"),
    period: number(said, "period"),
    confirmed: typeof said["confirmed"] === "boolean" ? said["confirmed"] : undefined,
    loss: number(said, "loss"),
    trip: number(said, "round-trip"),
    offset: number(said, "offset"),
    error: number(said, "error"),
    sent: number(said, "sent"),
    received: number(said, "received"),
    downRate: number(said, "down-rate"),
    upRate: number(said, "up-rate"),
    down: text(said, "down") ?? "",
    up: text(said, "up") ?? "",
    downMap: text(said, "down-map"),
    upMap: text(said, "up-map"),
    free: number(said, "free-buffers"),
    accepted: number(said, "accepted"),
    dropped: dropped.sort(([, one], [, other]) => other - one),
    heard: number(said, "heard"),
    born: message.born ?? message.arrived,
  };
}

/** In the order of the device map, where it is told. */
export function inOrder(elements: Iterable<Element>): Element[] {
  return [...elements].sort((one, other) => (one.place ?? Infinity) - (other.place ?? Infinity) || one.heard - other.heard);
}

/** Whether each element's place in the device map is known: then bits have names. */
export function isPlaced(elements: readonly Element[]): boolean {
  return elements.length > 0 && elements.every(({ place }, index) => place === index);
}

/** Whether what is wanted differs from what is confirmed. */
export function isApart({ wanted, value }: Pick<Element, "wanted" | "value">): boolean {
  if (!wanted) return false;
  if (!value || value.length !== wanted.length) return true;
  return wanted.some((one, index) => Math.abs(one - value[index]!) > 1e-6 * Math.max(1, Math.abs(one)));
}

/**
 * When a value was known to be so, ms since 1970. A robot says nothing of what has not changed: as long as it is linked, and the element is active, each of its
 * packets says that the value is still this one.
 */
export function knownAt(element: Pick<Element, "born" | "linked" | "active">, packet: Packet | undefined): number {
  if (!element.linked || !element.active || !packet?.linked || packet.heard === undefined) return element.born;
  return Math.max(element.born, packet.born - packet.heard / 1000);
}

/** What its numbers are in, for its number `index`. */
export function unitOf(units: readonly string[], index: number): string {
  return units.length === 1 ? units[0]! : (units[index] ?? "");
}

/** Whether it is a speed, which is given for a time only. */
export const isSpeed = (units: readonly string[]): boolean => units.some((unit) => unit.endsWith("/s"));

/** A number as people read it: up to three digits behind the point. */
export const figure = (value: number): string => (Number.isFinite(value) ? String(Math.round(value * 1000) / 1000).replace("-", "−") : "–");

/** `−90, 0, 20 deg`; each number with its own unit where they differ. */
export function valueWords(values: readonly number[], units: readonly string[]): string {
  const of = values.map((_, index) => unitOf(units, index));
  if (of.every((unit) => unit === of[0])) return `${values.map(figure).join(", ")}${of[0] ? ` ${of[0]}` : ""}`;
  return values.map((value, index) => `${figure(value)}${of[index] ? ` ${of[index]}` : ""}`).join(", ");
}

/** The model's number in hexadecimal, if a packet has told it. */
export function modelOf(packet: Packet | undefined): number | undefined {
  for (const hex of [packet?.up, packet?.down]) {
    const bytes = hex ? bytesOf(hex.slice(0, 2 * HEADER)) : undefined;
    const header = bytes && headerOf(bytes);
    if (header) return header.model;
  }
  return undefined;
}
