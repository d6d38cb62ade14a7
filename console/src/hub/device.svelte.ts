// A device as the page knows it: its newest state and how old that is. Commands of this page are carried out at it.
import type { Command } from "mom-client/drive";
import type { Failure, HubEvent, Message, PlainFields } from "../worker/protocol.js";
import { type Rest, restOf, unreachedSince } from "../worker/rest.js";
import { carded } from "./cards.svelte.js";
import { Carrier, type News } from "./carrier.js";
import { fields, flag, list, number, text } from "./fields.js";
import type { Hub } from "./hub.svelte.js";
import { Teller } from "./teller.svelte.js";

/** mm and degrees. */
export type Pose = [x: number, y: number, z: number, spin: number, tilt: number];

/** So many times of states are kept. */
const TOLD = 200;

export function poseOf(value: PlainFields): Pose | undefined {
  const axes = ["x", "y", "z", "spin", "tilt"].map((axis) => number(value, axis));
  return axes[0] === undefined || axes[1] === undefined || axes[2] === undefined ? undefined : (axes.map((axis) => axis ?? 0) as Pose);
}

/** A device's refusal, as it stands in its messages. */
export function refusalOf(value: PlainFields): Failure | undefined {
  const name = text(value, "name");
  if (name === undefined) return undefined;
  return { kind: "refused", code: name, text: text(value, "text") ?? name, rule: text(value, "rule"), owner: text(value, "owner"), retryAfter: number(value, "retry-after"), content: value };
}

export class DeviceState {
  /** The content of its newest `state`. */
  state = $state.raw<PlainFields>({});
  pose = $state.raw<Pose | undefined>(undefined);
  /** When that state was made, ms since 1970 by this machine's clock, and the error of that. */
  born = $state<number | undefined>(undefined);
  error = $state<number | undefined>(undefined);
  /** When it arrived. */
  arrived = $state<number | undefined>(undefined);
  /** Since when it is not reached, ms since 1970; `late` if it was so before this page heard of it. */
  unreached = $state.raw<{ since: number; late: boolean } | undefined>(undefined);
  /** The token that guards it. */
  token = $state<string | undefined>(undefined);
  guarded = $state.raw<readonly string[]>([]);
  /** The newest error of a command of this page, and when it was told. */
  refused = $state.raw<{ error: Failure | undefined; arrived: number } | undefined>(undefined);
  failure = $state.raw<Failure | null>(null);

  /** When it made its newest states, by its own clock: a camera names the state that its picture shows. */
  readonly #told = new Set<number>();
  readonly #teller: Teller;
  readonly #carrier: Carrier;

  constructor(
    readonly hub: Hub,
    readonly path: string,
  ) {
    this.#teller = new Teller(hub);
    this.#carrier = new Carrier(hub, path);
  }

  /** What it says of its rest. */
  get rest(): Rest {
    return restOf(this.state);
  }

  /** Since when nobody knows how it is, ms since 1970: it is gone, or the link is down and it has not told since. */
  get unknownSince(): number | undefined {
    return this.#teller.unknownSince;
  }

  get moving(): boolean {
    return flag(this.state, "moving");
  }

  get stopped(): boolean {
    return flag(this.state, "stopped");
  }

  /** Its own emergency stop is pressed: nobody resets that from afar. */
  get estop(): boolean {
    return flag(this.state, "estop");
  }

  /** Watches it until the function that it gives is called. */
  start(): () => void {
    const end = this.hub.watch(
      { path: this.path, kind: "channel", names: ["state", "status"], state: true },
      {
        joined: (info) => {
          const guard = fields(info["guard"]);
          this.token = text(guard, "token");
          this.guarded = list(guard, "names").map(String);
          this.failure = null;
        },
        events: (events) => events.forEach((event) => this.#heard(event)),
        failed: (failure) => (this.failure = failure),
      },
    );
    return () => {
      end();
      this.#carrier.drop();
    };
  }

  /** Whether it has told a state at this time of its clock. */
  hasTold(time: number): boolean {
    return this.#told.has(time);
  }

  #heard(event: HubEvent): void {
    this.#teller.happens(event);
    if (event.type !== "message") return;
    const message = event as Message;
    const content = fields(message.content);
    if (message.name === "state") {
      this.unreached = this.#unreachedBy(message, content);
      // It has joined, or tells somebody who has.
      if (!message.history && "stops-within" in content) carded(this.hub, this.path).ask();
      this.state = content;
      if (message.said !== undefined) this.#told.add(message.said);
      if (this.#told.size > TOLD) this.#told.delete(this.#told.keys().next().value!);
      this.#teller.tells(message);
      this.pose = poseOf(fields(content["pose"])) ?? this.pose;
      [this.born, this.error, this.arrived] = [message.born, message.error, message.arrived];
    } else if (text(content, "state") === "error" && text(content, "peer") === this.hub.me?.peer) {
      this.refused = { error: refusalOf(fields(content["error"])), arrived: message.arrived };
    }
  }

  #unreachedBy({ born, said, arrived }: Message, content: PlainFields): { since: number; late: boolean } | undefined {
    if (restOf(content) !== "unreached") return undefined;
    const told = unreachedSince(content, born === undefined || said === undefined ? 0 : said - born);
    if (told !== undefined) return { since: told, late: false };
    return this.unreached ?? { since: born ?? arrived, late: this.arrived === undefined };
  }

  /** Has a command carried out under the token that this page owns; tells what becomes of it, and gives why it failed. */
  carryOut(command: Command, told?: (news: News) => void): Promise<Failure | null> {
    return this.#carrier.carryOut(command, this.token, told);
  }
}
