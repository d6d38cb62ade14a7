// All robots, as one channel tells them, where they were, and what has come to pass.
import type { Hub } from "../../hub/hub.svelte.js";
import { Teller } from "../../hub/teller.svelte.js";
import { fleet as t } from "../../texts/fleet.js";
import type { Failure, HubEvent, Message } from "../../worker/protocol.js";
import { type Line, Log } from "./log.svelte.js";
import { type Robot, changesOf, robotOf } from "./robots.js";
import { Trails } from "./trails.js";

/** ms between two updates of what is shown, at the least. */
const EVERY = 250;
/** ms of the longest trail. */
const TRAIL = 120_000;

export interface Incoming extends Line {
  text: string;
  tone: "good" | "warning" | "danger" | "";
}

const TONES: { [what: string]: Incoming["tone"] } = { lost: "danger", linked: "good", expired: "warning", low: "warning", stopped: "warning", unstopped: "good", pressed: "warning" };

export class FleetState {
  /** By number. */
  robots = $state.raw<ReadonlyMap<number, Robot>>(new Map());
  /** Whether the channel is there. */
  joined = $state(false);
  failure = $state.raw<Failure | null>(null);
  readonly #teller: Teller;
  readonly incoming = new Log<Incoming>();
  readonly trails = new Trails(TRAIL);

  constructor(
    readonly hub: Hub,
    readonly path: string,
  ) {
    this.#teller = new Teller(hub);
  }

  /** In the order of their numbers. */
  readonly list = $derived([...this.robots.values()].sort((one, other) => one.unit - other.unit));
  /** When the newest was said. */
  readonly newest = $derived(this.list.reduce((newest, { born }) => Math.max(newest, born), 0));

  /** Since when nobody knows how the robots are, ms since 1970. */
  get unknownSince(): number | undefined {
    return this.#teller.unknownSince;
  }

  /** Watches it until the function that it gives is called. */
  start(): () => void {
    return this.hub.watch(
      // No rate: the hub has one interval for all names of a sender beyond 64, and a gateway has a name for each robot.
      { path: this.path, kind: "channel", newest: true, every: EVERY, state: true },
      {
        joined: () => ([this.joined, this.failure] = [true, null]),
        events: (events) => this.#heard(events),
        failed: (failure) => ([this.joined, this.failure] = [false, failure]),
      },
    );
  }

  #heard(events: readonly HubEvent[]): void {
    const robots = new Map(this.robots);
    const news: Omit<Incoming, "key">[] = [];
    for (const event of events) {
      this.#teller.happens(event);
      const robot = event.type === "message" ? robotOf(event as Message) : undefined;
      if (!robot) continue;
      const { unit, x, y, born } = robot;
      this.#teller.tells(event as Message);
      const before = robots.get(unit);
      // Said again to later members.
      if (before && before.born > born) continue;
      robots.set(unit, robot);
      if (x !== undefined && y !== undefined && robot.state !== "lost") this.trails.add(unit, x, y, born);
      if (!before) continue;
      for (const change of changesOf(before, robot)) {
        const words = change.what === "owner" ? t.logs.owned(change.owner) : change.what === "pressed" ? `${t.logs.changes[change.what]!}: ${t.one.pressed(robot.switches)}` : t.logs.changes[change.what]!;
        news.push({ at: event.arrived, unit, text: words, tone: TONES[change.what] ?? "" });
      }
    }
    this.robots = robots;
    this.incoming.add(news);
  }
}
