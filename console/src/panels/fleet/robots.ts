// A robot as the channel of all robots tells it, and what may be said of it in a word.
import { fields, flag, number, text } from "../../hub/fields.js";
import type { Message } from "../../worker/protocol.js";
import { type Rest, restOf, unreachedSince } from "../../worker/rest.js";

/** What a robot does; the first that holds, in this order. */
export const STATES = ["lost", "stopped", "expired", "driving", "standing"] as const;
export type State = (typeof STATES)[number];

/** A battery below so many percent wants to be loaded. */
export const LOW = 20;

export interface Robot {
  unit: number;
  state: State;
  stopped: boolean;
  /** What the channel of all says of its rest; its own channel may say more. */
  rest: Rest;
  /** Since when it is not reached, ms since 1970 by this machine's clock. */
  since: number | undefined;
  /** mm and degrees, counterclockwise from x. */
  x: number | undefined;
  y: number | undefined;
  heading: number | undefined;
  leds: number | undefined;
  /** Percent. */
  battery: number | undefined;
  /** A bit for each that is pressed. */
  switches: number;
  /** µs. */
  trip: number | undefined;
  owner: string | undefined;
  /** The peer whose command is executed, and how far it is. */
  executing: { peer: string; statement: number; of: number } | undefined;
  waiting: number;
  /** When this was so, ms since 1970 by this machine's clock, and the error of that. */
  born: number;
  error: number | undefined;
}

/** What a message says of a robot; undefined if it is about none. */
export function robotOf({ name, content, said: at, born, error, arrived }: Message): Robot | undefined {
  const named = /^robot-(\d{1,5})$/.exec(name);
  if (!named) return undefined;
  const said = fields(content);
  const doing = fields(said["executing"]);
  const rest = restOf(said);
  const state = said["linked"] === false || rest === "unreached" ? "lost" : flag(said, "stopped") ? "stopped" : flag(said, "expired") ? "expired" : flag(said, "moving") ? "driving" : "standing";
  return {
    unit: Number(named[1]),
    state,
    stopped: flag(said, "stopped"),
    rest,
    since: unreachedSince(said, at === undefined || born === undefined ? 0 : at - born),
    x: number(said, "x"),
    y: number(said, "y"),
    heading: number(said, "heading"),
    leds: number(said, "leds"),
    battery: number(said, "battery"),
    switches: number(said, "switches") ?? 0,
    trip: number(said, "round-trip"),
    owner: text(said, "owner"),
    executing: said["executing"] === undefined ? undefined : { peer: text(doing, "peer") ?? "", statement: number(doing, "statement") ?? 0, of: number(doing, "of") ?? 0 },
    waiting: number(said, "waiting") ?? 0,
    born: born ?? arrived,
    error,
  };
}

/** Whether it is stopped, and moves all the same by what is known. */
export const movesStopped = ({ state, rest }: Pick<Robot, "state" | "rest">): boolean => state === "stopped" && rest === "moving";

export const isLow = ({ battery }: Pick<Robot, "battery">): boolean => battery !== undefined && battery < LOW;

export type Counts = { [name in State | "low"]: number };

export function counted(robots: Iterable<Robot>): Counts {
  const counts: Counts = { lost: 0, stopped: 0, expired: 0, driving: 0, standing: 0, low: 0 };
  for (const robot of robots) {
    counts[robot.state] += 1;
    if (isLow(robot)) counts.low += 1;
  }
  return counts;
}

/** What has become different in a way that people want to be told. */
export type Change = { what: "lost" | "linked" | "expired" | "low" | "stopped" | "unstopped" | "pressed" } | { what: "owner"; owner: string | undefined };

export function changesOf(before: Robot, after: Robot): Change[] {
  const changes: Change[] = [];
  const becomes = (state: State): boolean => after.state === state && before.state !== state;
  if (becomes("lost")) changes.push({ what: "lost" });
  if (before.state === "lost" && after.state !== "lost") changes.push({ what: "linked" });
  if (becomes("stopped")) changes.push({ what: "stopped" });
  if (before.state === "stopped" && after.state !== "stopped" && after.state !== "lost") changes.push({ what: "unstopped" });
  if (becomes("expired")) changes.push({ what: "expired" });
  if (isLow(after) && !isLow(before)) changes.push({ what: "low" });
  if (after.switches & ~before.switches) changes.push({ what: "pressed" });
  if (after.owner !== before.owner) changes.push({ what: "owner", owner: after.owner });
  return changes;
}
