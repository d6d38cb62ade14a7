// What the hub counts, and what follows from two of its answers; the figures of `mom top` and `mom stats`, by the same rules.
import { fields, flag, list, number, text, time } from "./fields.js";
import type { Plain, PlainFields } from "../worker/protocol.js";

/** Ages of messages on arrival, ms. */
export interface Ages {
  count: number;
  p50: number;
  p99: number;
  most: number;
}

/** The statistics of docs/PROTOCOL.md. */
export interface Counts {
  sent: number;
  bytes: number;
  delivered: number;
  dropped: number;
  reasons: [reason: string, count: number][];
  classes: [kind: string, count: number][];
  queued: number;
  age: Ages | undefined;
}

export interface ChannelStats {
  path: string;
  members: number | undefined;
  counts: Counts;
}

/** What the statistics of a channel say of one member. */
export interface MemberStats {
  peer: string;
  user: string;
  counts: Counts;
}

/** Who has logged in; times are ms. */
export interface PeerStats {
  peer: string;
  user: string;
  form: string;
  door: string;
  tls: boolean;
  from: string | undefined;
  /** ms since 1970, by the hub's clock. */
  since: number | undefined;
  silent: number;
  roundTrip: number | undefined;
  queued: number;
  sent: number;
  received: number;
  dropped: number;
}

export interface Memory {
  used: number;
  /** Without one the hub takes what it gets. */
  bound: number | undefined;
  users: { user: string; bytes: number }[];
}

/** One answer of the hub. */
export interface Sample {
  /** When it came, ms of a clock that never jumps. */
  at: number;
  channels: ChannelStats[];
  members: MemberStats[];
  peers: PeerStats[];
  morePeers: number;
  /** Whether channels are missing. */
  more: boolean;
  memory: Memory | undefined;
}

/** What happens, per second. */
export interface Rates {
  messages: number;
  delivered: number;
  dropped: number;
  /** Bytes from peers and to them. */
  received: number;
  sent: number;
}

/** What happens in one channel, per second. */
export interface ChannelRates {
  messages: number;
  bytes: number;
  delivered: number;
  dropped: number;
}

function countsOf(value: PlainFields): Counts {
  const pairs = (key: string): [string, number][] =>
    Object.entries(fields(value[key]))
      .map(([word, count]): [string, number] => [word, Number(count)])
      .filter(([, count]) => count > 0);
  const age = fields(value["age"]);
  const ms = (key: string): number => (number(age, key) ?? 0) / 1000;
  const reasons = pairs("dropped");
  return {
    sent: number(value, "sent") ?? 0,
    bytes: number(value, "bytes") ?? 0,
    delivered: number(value, "delivered") ?? 0,
    dropped: reasons.reduce((sum, [, count]) => sum + count, 0),
    reasons,
    classes: pairs("dropped-classes"),
    queued: number(value, "queued") ?? 0,
    age: number(age, "count") ? { count: number(age, "count")!, p50: ms("p50"), p99: ms("p99"), most: ms("most") } : undefined,
  };
}

function channelOf(plain: Plain): ChannelStats {
  const value = fields(plain);
  return { path: text(value, "path") ?? "", members: number(value, "members"), counts: countsOf(value) };
}

function peerOf(plain: Plain): PeerStats {
  const value = fields(plain);
  const roundTrip = number(value, "round-trip");
  return {
    peer: text(value, "peer") ?? "",
    user: text(value, "user") ?? "",
    form: text(value, "form") ?? "none",
    door: text(value, "door") ?? "",
    tls: flag(value, "tls"),
    from: text(value, "from"),
    since: time(value, "since"),
    silent: (number(value, "heard") ?? 0) / 1000,
    roundTrip: roundTrip === undefined ? undefined : roundTrip / 1000,
    queued: number(value, "queued") ?? 0,
    sent: number(value, "sent") ?? 0,
    received: number(value, "received") ?? 0,
    dropped: number(value, "dropped") ?? 0,
  };
}

/** Reads what `stats` answers, of a channel or of a session. */
export function sampleOf(answer: PlainFields, at: number): Sample {
  const isChannel = text(answer, "kind") === "channel";
  const memory = fields(answer["memory"]);
  const used = number(memory, "used");
  const peers = list(answer, "peers");
  return {
    at,
    channels: isChannel ? [channelOf(answer)] : list(answer, "channels").map(channelOf),
    members: isChannel ? peers.map((plain) => ({ peer: text(fields(plain), "peer") ?? "", user: text(fields(plain), "user") ?? "", counts: countsOf(fields(plain)) })) : [],
    peers: isChannel ? [] : peers.map(peerOf),
    morePeers: number(answer, "more-peers") ?? 0,
    more: flag(answer, "more"),
    memory:
      used === undefined
        ? undefined
        : {
            used,
            bound: number(memory, "bound"),
            users: list(memory, "users").map((user) => ({ user: text(fields(user), "user") ?? "", bytes: number(fields(user), "bytes") ?? 0 })),
          },
  };
}

/** A name may be another connection's a moment later. */
export function peerKey({ peer, since }: Pick<PeerStats, "peer" | "since">): string {
  return `${peer}\n${since}`;
}

function perSecond(before: Sample, now: Sample): (earlier: number, later: number) => number {
  const seconds = Math.max(now.at - before.at, 1) / 1000;
  return (earlier, later) => Math.max(later - earlier, 0) / seconds;
}

/** What happens in each channel. Peers that came or went meanwhile are left out: their counts are not known at both ends. */
export function channelRates(before: Sample, now: Sample): Map<string, ChannelRates> {
  const rate = perSecond(before, now);
  const earlier = new Map(before.channels.map(({ path, counts }) => [path, counts]));
  const rates = new Map<string, ChannelRates>();
  for (const { path, counts } of now.channels) {
    const old = earlier.get(path);
    if (!old) continue;
    rates.set(path, {
      messages: rate(old.sent, counts.sent),
      bytes: rate(old.bytes, counts.bytes),
      delivered: rate(old.delivered, counts.delivered),
      dropped: rate(old.dropped, counts.dropped),
    });
  }
  return rates;
}

/** All of it together. */
export function ratesBetween(before: Sample, now: Sample): Rates {
  const rate = perSecond(before, now);
  const rates: Rates = { messages: 0, delivered: 0, dropped: 0, received: 0, sent: 0 };
  for (const { messages, delivered, dropped } of channelRates(before, now).values()) {
    rates.messages += messages;
    rates.delivered += delivered;
    rates.dropped += dropped;
  }
  const earlier = new Map(before.peers.map((peer) => [peerKey(peer), peer]));
  for (const peer of now.peers) {
    const old = earlier.get(peerKey(peer));
    if (!old) continue;
    rates.received += rate(old.received, peer.received);
    rates.sent += rate(old.sent, peer.sent);
  }
  return rates;
}

/** The value below which so many percent are; the nearest that there is. */
export function percentile(sorted: readonly number[], percent: number): number | undefined {
  if (!sorted.length) return undefined;
  return sorted[Math.min(sorted.length - 1, Math.max(0, Math.ceil((percent / 100) * sorted.length) - 1))];
}

export interface Spread {
  count: number;
  p50: number;
  p99: number;
  most: number;
}

/** How values that are known spread. */
export function spread(values: readonly (number | undefined)[]): Spread | undefined {
  const sorted = values.filter((value): value is number => value !== undefined && Number.isFinite(value)).sort((one, other) => one - other);
  if (!sorted.length) return undefined;
  return { count: sorted.length, p50: percentile(sorted, 50)!, p99: percentile(sorted, 99)!, most: sorted.at(-1)! };
}
