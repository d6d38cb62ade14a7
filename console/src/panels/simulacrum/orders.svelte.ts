// Statements to a mirrored robot, and what became of each.
import { type Became, isOver } from "../../hub/carrier.js";
import { DeviceState } from "../../hub/device.svelte.js";
import type { Hub } from "../../hub/hub.svelte.js";
import { texts } from "../../texts/index.js";
import type { Failure } from "../../worker/protocol.js";

/** Statements that are kept, the newest. */
const MOST = 50;

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

export class Orders {
  readonly device: DeviceState;
  /** The newest first. */
  list = $state.raw<readonly Order[]>([]);
  #last = 0;

  constructor(
    readonly hub: Hub,
    readonly path: string,
  ) {
    this.device = new DeviceState(hub, path);
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
    if (device.estop) return t.estop;
    if (device.stopped) return t.stopped;
    return undefined;
  }

  /** Sends a statement under the token that this page owns; its key. */
  send(statement: string): number {
    const [key, at] = [++this.#last, Date.now()];
    this.list = [{ key, at, statement, became: "sending" as const, failure: undefined, took: undefined }, ...this.list].slice(0, MOST);
    void this.device.carryOut({ text: statement }, ({ became, failure }) => {
      const took = isOver(became) && became !== "refused" ? Date.now() - at : undefined;
      this.list = this.list.map((order) => (order.key === key ? { ...order, became, failure, took } : order));
      if (failure) this.hub.note("error", texts.commands.noted(this.path, statement, failure.text), failure);
    });
    return key;
  }

  dismiss(key: number): void {
    this.list = this.list.filter((order) => order.key !== key);
  }
}
