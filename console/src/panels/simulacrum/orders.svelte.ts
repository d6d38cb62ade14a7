// Statements to a mirrored robot, and what became of each.
import { DeviceState } from "../../hub/device.svelte.js";
import { failureOf } from "../../hub/failure.js";
import type { Hub } from "../../hub/hub.svelte.js";
import { texts } from "../../texts/index.js";
import type { Failure } from "../../worker/protocol.js";

/** Statements that are kept, the newest. */
const MOST = 50;

export type Became = "sending" | "sent" | "waiting" | "executing" | "finished" | "error" | "refused";

export interface Order {
  key: number;
  at: number;
  statement: string;
  became: Became;
  /** Why it failed. */
  failure: Failure | undefined;
  /** ms to its end. */
  took: number | undefined;
}

interface Sent {
  key: number;
  at: number;
  statement: string;
  id: number | undefined;
  refused: Failure | undefined;
}

const isState = (word: string | undefined): word is "waiting" | "executing" | "finished" | "error" => word === "waiting" || word === "executing" || word === "finished" || word === "error";

export class Orders {
  readonly device: DeviceState;
  #sent = $state.raw<readonly Sent[]>([]);
  #last = 0;

  constructor(
    readonly hub: Hub,
    readonly path: string,
  ) {
    this.device = new DeviceState(hub, path);
  }

  /** The newest first. */
  readonly list: readonly Order[] = $derived(this.#sent.map((sent) => this.#orderOf(sent)));

  #orderOf({ key, at, statement, id, refused }: Sent): Order {
    if (refused) return { key, at, statement, became: "refused", failure: refused, took: undefined };
    const status = this.device.status(id);
    const became = isState(status?.state) ? status.state : id === undefined ? "sending" : "sent";
    const took = status && (became === "finished" || became === "error") ? Math.max(0, status.arrived - at) : undefined;
    return { key, at, statement, became, failure: status?.error, took };
  }

  /** Watches the robot until the function that it gives is called. */
  start(): () => void {
    return this.device.start();
  }

  /** Why nothing can be sent now, in words; undefined if something can. */
  get hindrance(): string | undefined {
    const { hub, device } = this;
    const t = texts.commands;
    if (!hub.isUp) return t.noLink;
    if (device.failure) return device.failure.text;
    if (device.token === undefined) return t.noDevice;
    if (!hub.owned.has(device.token)) return t.noToken(device.token);
    if (device.stopped) return t.stopped;
    return undefined;
  }

  /** Sends a statement under the token that this page owns; its key. */
  async send(statement: string): Promise<number> {
    const key = ++this.#last;
    this.#sent = [{ key, at: Date.now(), statement, id: undefined, refused: undefined }, ...this.#sent].slice(0, MOST);
    const change = (by: Partial<Sent>): void => void (this.#sent = this.#sent.map((sent) => (sent.key === key ? { ...sent, ...by } : sent)));
    try {
      change({ id: await this.device.command(statement) });
    } catch (error) {
      const failure = failureOf(error);
      change({ refused: failure });
      this.hub.note("error", texts.commands.noted(this.path, statement, failure.text), failure);
    }
    return key;
  }

  dismiss(key: number): void {
    this.#sent = this.#sent.filter((sent) => sent.key !== key);
  }
}
