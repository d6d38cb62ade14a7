// A device as the page knows it: its newest state and how old that is, and what became of its commands.
import type { Failure, HubEvent, Message, PlainFields } from "../worker/protocol.js";
import { type Rest, restOf, unreachedSince } from "../worker/rest.js";
import { carded } from "./cards.svelte.js";
import { HubError } from "./failure.js";
import { fields, flag, list, number, text } from "./fields.js";
import type { Hub } from "./hub.svelte.js";
import { Teller } from "./teller.svelte.js";

/** mm and degrees. */
export type Pose = [x: number, y: number, z: number, spin: number, tilt: number];

/** The state of a command, by the words of M42. */
export interface Status {
  peer: string;
  id: number | undefined;
  state: string;
  statement: number;
  of: number;
  error: Failure | undefined;
  arrived: number;
}

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
  /** The id of that state, which a relative command is based on. */
  stateId = $state<number | undefined>(undefined);
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
  /** The newest status of each command. */
  statuses = $state.raw<ReadonlyMap<string, Status>>(new Map());
  failure = $state.raw<Failure | null>(null);

  /** When it made its newest states, by its own clock: a camera names the state that its picture shows. */
  readonly #told = new Set<number>();
  readonly #teller: Teller;

  constructor(
    readonly hub: Hub,
    readonly path: string,
  ) {
    this.#teller = new Teller(hub);
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

  /** Watches it until the function that it gives is called. */
  start(): () => void {
    return this.hub.watch(
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
      this.stateId = message.id ?? this.stateId;
      [this.born, this.error, this.arrived] = [message.born, message.error, message.arrived];
    } else {
      const status: Status = {
        peer: text(content, "peer") ?? "",
        id: number(content, "id"),
        state: text(content, "state") ?? "",
        statement: number(content, "statement") ?? 0,
        of: number(content, "of") ?? 0,
        error: refusalOf(fields(content["error"])),
        arrived: message.arrived,
      };
      const all = new Map(this.statuses);
      all.delete(`${status.peer}\n${status.id}`);
      all.set(`${status.peer}\n${status.id}`, status);
      // Enough for a long list of commands.
      if (all.size > 500) all.delete(all.keys().next().value!);
      this.statuses = all;
    }
  }

  #unreachedBy({ born, said, arrived }: Message, content: PlainFields): { since: number; late: boolean } | undefined {
    if (restOf(content) !== "unreached") return undefined;
    const told = unreachedSince(content, born === undefined || said === undefined ? 0 : said - born);
    if (told !== undefined) return { since: told, late: false };
    return this.unreached ?? { since: born ?? arrived, late: this.arrived === undefined };
  }

  /** The status of a command of this page. */
  status(id: number | undefined): Status | undefined {
    return id === undefined ? undefined : this.statuses.get(`${this.hub.me?.peer}\n${id}`);
  }

  /** Sends a command under the token that this page owns; gives the command's id. */
  async command(script: string, options: { expires?: number; relative?: boolean } = {}): Promise<number> {
    const owned = this.token === undefined ? undefined : this.hub.owned.get(this.token);
    if (this.token !== undefined && !owned) {
      throw new HubError({ kind: "local", code: "not-owner", text: `${this.path} needs ${this.token}`, content: {} });
    }
    const { expires, relative } = options;
    const sent = await this.hub.call("send", this.path, "command", script, {
      echo: false,
      ...(owned ? { fence: owned.fence } : {}),
      ...(expires === undefined ? {} : { expires }),
      ...(relative && this.stateId !== undefined ? { basedOn: this.stateId } : {}),
    });
    if (sent.delivered === 0) throw new HubError({ kind: "local", code: "no-answer", text: `no device in ${this.path} can obey`, content: {} });
    return sent.id;
  }
}
