// The columns of the table, and their order.
import { fleet as t } from "../../texts/fleet.js";
import { STATES, type Robot } from "./robots.js";

export interface Column {
  id: "unit" | "state" | "battery" | "trip" | "owner" | "age" | "at";
  heading: string;
  number: boolean;
  /** What wants attention comes first. */
  compare(one: Robot, other: Robot): number;
}

const words = (one: string, other: string): number => (one < other ? -1 : one > other ? 1 : 0);
/** What is not known comes last. */
const least = (one: number | undefined, other: number | undefined): number => (one ?? Infinity) - (other ?? Infinity) || 0;
const most = (one: number | undefined, other: number | undefined): number => (other ?? -Infinity) - (one ?? -Infinity) || 0;

const compares: { [id in Column["id"]]: Column["compare"] } = {
  unit: () => 0,
  state: (a, b) => STATES.indexOf(a.state) - STATES.indexOf(b.state),
  battery: (a, b) => least(a.battery, b.battery),
  trip: (a, b) => most(a.trip, b.trip),
  owner: (a, b) => Number(a.owner === undefined) - Number(b.owner === undefined) || words(a.owner ?? "", b.owner ?? ""),
  age: (a, b) => a.born - b.born,
  at: (a, b) => least(a.x, b.x) || least(a.y, b.y),
};

const NUMBERS = new Set(["unit", "battery", "trip", "age"]);

export const columns: readonly Column[] = (Object.keys(compares) as Column["id"][]).map((id) => ({ id, heading: t.columns[id], number: NUMBERS.has(id), compare: compares[id] }));

/** In the order of a column; where that is equal, in that of the numbers. */
export function sorted(robots: readonly Robot[], by: Column["id"], reversed: boolean): Robot[] {
  const compare = compares[by];
  const sign = reversed ? -1 : 1;
  return [...robots].sort((one, other) => sign * compare(one, other) || (by === "unit" ? sign : 1) * (one.unit - other.unit));
}
