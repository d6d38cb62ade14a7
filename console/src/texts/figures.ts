// The words and units that `mom top` and `mom stats` have as well: a test holds them to be equal.
import { duration } from "./format.js";

/** The columns of `mom top`, in its order. */
export const columns = ["peer", "user", "door", "from", "silent", "round trip", "queue", "drops", "tokens"] as const;

/** The columns of `mom stats` after the name, in its order. */
export const statistics = ["sent", "bytes", "delivered", "queued", "age p50", "age p99", "dropped"] as const;

/** A duration that was measured: `0.04 ms`, `12 ms`, `3.5 s`. */
export function measured(ms: number): string {
  const micros = Math.max(0, Math.floor(ms * 1000));
  if (micros < 10_000) return `${Math.floor(micros / 1000)}.${String(Math.floor((micros % 1000) / 10)).padStart(2, "0")} ms`;
  if (micros < 1_000_000) return `${Math.floor(micros / 1000)} ms`;
  return `${Math.floor(micros / 1_000_000)}.${Math.floor((micros % 1_000_000) / 100_000)} s`;
}

/** How long nothing was heard: beyond a minute in whole seconds. */
export function silence(ms: number): string {
  return ms < 60_000 ? measured(ms) : duration(Math.floor(ms / 1000) * 1000);
}

/** `812 B`, `12.3 KiB`, `1.5 MiB`. */
export function size(count: number): string {
  const tenths = (unit: number): string => `${Math.floor(count / unit)}.${Math.floor(((count % unit) * 10) / unit)}`;
  if (count < 1024) return `${Math.floor(count)} B`;
  return count < 1024 * 1024 ? `${tenths(1024)} KiB` : `${tenths(1024 * 1024)} MiB`;
}

/** `1 member`, `3 members`. */
export function plural(number: number, one: string): string {
  return `${number.toLocaleString("en")} ${one}${number === 1 ? "" : "s"}`;
}

/** `tcp binary`, `websocket tls json`. */
export function door(peer: { door: string; tls: boolean; form: string }): string {
  return `${peer.door}${peer.tls ? " tls" : ""}${peer.form === "none" ? "" : ` ${peer.form}`}`;
}

export const figures = {
  columns,
  statistics,
  none: "-",
  connections: (count: number) => plural(count, "connection"),
  memory: (used: number, bound: number | undefined) => (bound === undefined ? `hub keeps ${size(used)}` : `hub keeps ${size(used)} of at most ${size(bound)}`),
  traffic: (received: number, sent: number) => `in ${size(received)}/s, out ${size(sent)}/s`,
  messages: (messages: number, dropped: number) => `${messages.toFixed(0)} messages/s, ${dropped.toFixed(0)} dropped/s`,
  more: (count: number) => `and ${count} more peers, which the hub does not list`,
  perSecond: (bytes: number) => `${size(bytes)}/s`,
};
