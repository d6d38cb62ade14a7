// The table of peers: the columns of `mom top` and some more, their order, and the filter.
import type { Heard } from "../../hub/heard.js";
import type { PeerStats } from "../../hub/rates.js";
import { door, figures, measured, silence, size } from "../../texts/figures.js";
import { age, count, duration } from "../../texts/format.js";
import { texts } from "../../texts/index.js";

/** A peer; of those that the hub does not list only name, user and level are known. */
export interface PeerRow {
  name: string;
  user: string;
  level: number | undefined;
  stats: PeerStats | undefined;
  tokens: readonly string[];
  heard: Heard | undefined;
}

export interface Column {
  id: string;
  heading: string;
  number: boolean;
  /** The words of a cell. */
  cell(row: PeerRow, hubTime: number | undefined): string;
  /** The peer with the most of a number comes first, words are in their own order. */
  compare(one: PeerRow, other: PeerRow): number;
  /** What the heading means, where the word alone does not say it. */
  why?: string;
}

const words = (one: string, other: string): number => (one < other ? -1 : one > other ? 1 : 0);
/** The most first; what is not known last. */
const most = (one: number | undefined, other: number | undefined): number => (other ?? -1) - (one ?? -1);
const doorOf = ({ stats }: PeerRow): string => (stats ? door(stats) : "");

const [peer, user, doors, from, silent, trip, queue, drops, tokens] = figures.columns;

export const columns: readonly Column[] = [
  { id: "peer", heading: peer, number: false, cell: ({ name }) => name, compare: (a, b) => words(a.name, b.name) },
  { id: "user", heading: user, number: false, cell: ({ user }) => user, compare: (a, b) => words(a.user, b.user) },
  { id: "door", heading: doors, number: false, cell: doorOf, compare: (a, b) => words(doorOf(a), doorOf(b)) },
  { id: "from", heading: from, number: false, cell: ({ stats }) => stats?.from ?? "", compare: (a, b) => words(a.stats?.from ?? "", b.stats?.from ?? "") },
  { id: "silent", heading: silent, number: true, cell: ({ stats }) => (stats ? silence(stats.silent) : ""), compare: (a, b) => most(a.stats?.silent, b.stats?.silent) },
  { id: "trip", heading: trip, number: true, cell: ({ stats }) => (!stats ? "" : stats.roundTrip === undefined ? figures.none : measured(stats.roundTrip)), compare: (a, b) => most(a.stats?.roundTrip, b.stats?.roundTrip) },
  { id: "queue", heading: queue, number: true, cell: ({ stats }) => (stats ? size(stats.queued) : ""), compare: (a, b) => most(a.stats?.queued, b.stats?.queued) },
  { id: "drops", heading: drops, number: true, cell: ({ stats }) => (stats ? count(stats.dropped) : ""), compare: (a, b) => most(a.stats?.dropped, b.stats?.dropped) },
  { id: "tokens", heading: tokens, number: false, cell: ({ tokens }) => tokens.join(" "), compare: (a, b) => b.tokens.length - a.tokens.length },
  { id: "level", heading: texts.peers.more.level, number: true, cell: ({ level }) => (level === undefined ? "" : String(level)), compare: (a, b) => most(a.level, b.level) },
  {
    id: "since",
    heading: texts.peers.more.since,
    number: true,
    cell: ({ stats }, hubTime) => (stats?.since === undefined || hubTime === undefined ? "" : duration(Math.max(0, Math.floor((hubTime - stats.since) / 1000) * 1000))),
    // The peer that is here longest has the smallest time.
    compare: (a, b) => (a.stats?.since ?? Infinity) - (b.stats?.since ?? Infinity) || 0,
  },
  { id: "age", heading: texts.peers.more.age, number: true, cell: ({ heard }) => (heard ? age(heard.age, heard.error) : ""), compare: (a, b) => most(a.heard?.age, b.heard?.age), why: texts.peers.ageWhy },
  { id: "clock", heading: texts.peers.more.clock, number: true, cell: ({ heard }) => (heard ? `± ${measured(heard.error)}` : ""), compare: (a, b) => most(a.heard?.error, b.heard?.error), why: texts.peers.clockWhy },
];

/** The rows in the order of a column; where that is equal, in that of arrival. */
export function sorted(rows: readonly PeerRow[], by: Column | undefined, reversed: boolean): PeerRow[] {
  const all = by ? [...rows].sort((one, other) => by.compare(one, other)) : [...rows];
  return reversed ? all.reverse() : all;
}

export function filtered(rows: readonly PeerRow[], filter: string): readonly PeerRow[] {
  const wanted = filter.trim().toLowerCase();
  if (!wanted) return rows;
  return rows.filter((row) => [row.name, row.user, doorOf(row), row.stats?.from ?? "", ...row.tokens].some((text) => text.toLowerCase().includes(wanted)));
}
