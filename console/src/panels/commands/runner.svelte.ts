// Sends the commands of a list one after the other, and tells what becomes of them, as `mom run` does.
import { type News, local } from "../../hub/carrier.js";
import type { Card } from "../../hub/card.js";
import { type Carded, carded } from "../../hub/cards.svelte.js";
import { DeviceState } from "../../hub/device.svelte.js";
import type { Hub } from "../../hub/hub.svelte.js";
import { texts } from "../../texts/index.js";
import type { Failure } from "../../worker/protocol.js";
import { type Item, type Items, clearFinished, isOpen, next, progress, restore, save } from "./list.js";
import { isRelative, read } from "./script.js";

/** The key of a command that is in no list. */
const NO_KEY = -1;
/** Between two commands it is looked so often whether the rest may be sent still, ms. */
const LOOK = 50;

const t = texts.commands;

export class CommandList {
  items = $state.raw<Items>([]);
  /** What is sent now: all that wait, or one. */
  running = $state<"all" | "one" | undefined>(undefined);
  /** The rest waits when the present one has ended. */
  pausing = $state(false);
  /** ms between two commands. */
  between = $state(0);
  /** Why the rest waits. */
  halted = $state<string | undefined>(undefined);
  readonly device: DeviceState;
  readonly #carded: Carded;
  #attached = 0;
  #watching: (() => void) | undefined;

  constructor(
    readonly hub: Hub,
    readonly path: string,
  ) {
    this.device = new DeviceState(hub, path);
    this.#carded = carded(hub, path);
    try {
      this.items = restore(localStorage.getItem(this.#place));
    } catch {
      // A browser without storage keeps nothing.
    }
  }

  get #place(): string {
    return `mom-commands ${this.path}`;
  }

  /** What the device says that it can do; undefined if it says nothing, or that is not known yet. */
  get card(): Card | undefined {
    return this.#carded.card;
  }

  /** Whether the hub has said what the device can do, or that it does not say it. */
  get isKnown(): boolean {
    return this.#carded.known;
  }

  #watch(): () => void {
    const ends = [this.device.start(), this.#carded.start()];
    return () => ends.forEach((end) => end());
  }

  /** It is in view until the function that this gives is called. Unseen, nothing more is sent. */
  attach(): () => void {
    this.#attached += 1;
    this.#watching ??= this.#watch();
    return () => {
      this.#attached -= 1;
      queueMicrotask(() => {
        if (this.#attached) return;
        if (this.running) [this.pausing, this.halted] = [true, t.unseen];
        else this.#rest();
      });
    };
  }

  #rest(): void {
    if (this.#attached || this.running) return;
    this.#watching?.();
    this.#watching = undefined;
  }

  change(items: Items): void {
    this.items = items;
    try {
      localStorage.setItem(this.#place, save(items));
    } catch {
      // A browser without storage keeps nothing.
    }
  }

  #progress(key: number, step: Partial<Item>): void {
    this.change(progress(this.items, key, step));
  }

  /** Why nothing can be sent now, in words; undefined if something can. */
  get hindrance(): string | undefined {
    const { hub, device } = this;
    if (hub.link.state !== "connected" && hub.link.state !== "stale") return t.noLink;
    if (device.failure) return device.failure.text;
    if (device.token === undefined) return t.noDevice;
    if (!hub.owned.has(device.token)) return t.noToken(device.token);
    if (device.estop) return t.estop;
    if (device.stopped) return t.stopped;
    return undefined;
  }

  /** After the present one the rest waits. */
  pause(): void {
    this.pausing = true;
  }

  clearFinished(): void {
    this.change(clearFinished(this.items));
  }

  /** Sends all that wait, one after the other, up to the first that fails. */
  async all(): Promise<void> {
    if (this.#refuse(this.items.filter(isOpen))) return;
    await this.#run("all", () => next(this.items));
  }

  /** Sends one. */
  async one(key: number): Promise<void> {
    if (this.#refuse(this.items.filter((item) => item.key === key))) return;
    let sent = false;
    await this.#run("one", () => {
      const item = sent ? undefined : this.items.find((item) => item.key === key);
      sent = true;
      return item;
    });
  }

  /** Nothing moves before all can be read. */
  #refuse(items: Items): boolean {
    const { card } = this;
    if (!card) return false;
    for (const { key, text } of items) {
      const { mistake } = read(text, card);
      if (!mistake) continue;
      this.halted = t.mistaken(this.items.findIndex((item) => item.key === key) + 1, mistake.text);
      return true;
    }
    return false;
  }

  /** Sends one that is in no list, unless one of the list is under way; why it failed, null if it has finished. */
  async once(text: string): Promise<Failure | null> {
    const hindered = this.running ? t.underWay : this.hindrance;
    if (hindered !== undefined) return local("hindered", hindered);
    [this.running, this.pausing, this.halted] = ["one", false, undefined];
    const failure = await this.#carryOut({ key: NO_KEY, text }, this.#over());
    [this.running, this.pausing] = [undefined, false];
    this.#rest();
    return failure;
  }

  /** Tells from now on why nothing more may be sent. */
  #over(): () => string | undefined {
    const { hub, device } = this;
    const fence = hub.owned.get(device.token ?? "")?.fence;
    const ordered = hub.stopsOrdered(this.path);
    return () => {
      if (hub.stopsOrdered(this.path) !== ordered) return t.stopOrdered;
      if (hub.link.state !== "connected" && hub.link.state !== "stale") return t.linkLost;
      if (hub.owned.get(device.token ?? "")?.fence !== fence) return t.tokenLost;
      return undefined;
    };
  }

  async #run(what: "all" | "one", following: () => Item | undefined): Promise<void> {
    if (this.running || this.hindrance !== undefined) return;
    [this.running, this.pausing, this.halted] = [what, false, undefined];
    const over = this.#over();
    let first = true;
    for (let item = following(); item; item = following()) {
      const from = first ? 0 : performance.now() + this.between;
      while (performance.now() < from && over() === undefined) await new Promise((resolve) => setTimeout(resolve, LOOK));
      first = false;
      const hindered = this.pausing ? (this.halted ?? t.paused) : over();
      if (hindered !== undefined) {
        this.halted = hindered;
        break;
      }
      // It may have been removed meanwhile.
      if (!this.items.some(({ key }) => key === item!.key)) continue;
      if (await this.#carryOut(item, over)) {
        this.halted = this.items.some(({ state }) => state === "waiting") ? (over() ?? t.failed) : over();
        break;
      }
    }
    [this.running, this.pausing] = [undefined, false];
    this.#rest();
  }

  /** One command to its end; why it failed, null if it has finished. */
  async #carryOut({ key, text }: Pick<Item, "key" | "text">, over: () => string | undefined): Promise<Failure | null> {
    const begun = performance.now();
    const send = (relative: boolean): Promise<Failure | null> => {
      this.#progress(key, { state: "sending", error: undefined, statement: 0, of: 0, took: undefined });
      return this.device.carryOut({ text, ...(relative ? { basedOn: "newest" } : {}) }, (news) => this.#tell(key, news));
    };
    const relative = this.card !== undefined && isRelative(text, this.card);
    let failure = await send(relative);
    // A device without a card says only by its refusal that a command is relative.
    if (failure?.code === "no-state" && !relative && over() === undefined) failure = await send(true);
    const took = performance.now() - begun;
    this.#progress(key, { state: failure ? "error" : "finished", error: failure ?? undefined, trying: undefined, took });
    if (failure) this.hub.note("error", t.noted(this.path, text, failure.text), failure);
    return failure;
  }

  #tell(key: number, { became, statement = 0, of = 0, why }: News): void {
    if (became === "again") this.#progress(key, { state: "sending", trying: why });
    const state = became === "waiting" ? "taken" : became;
    if (state === "taken" || state === "executing") this.#progress(key, { state, statement, of, trying: undefined });
  }
}

const lists = new WeakMap<Hub, Map<string, CommandList>>();

/** The list of a device, which lives as long as the page. */
export function listOf(hub: Hub, path: string): CommandList {
  const all = lists.get(hub) ?? new Map<string, CommandList>();
  lists.set(hub, all);
  let found = all.get(path);
  if (!found) all.set(path, (found = new CommandList(hub, path)));
  return found;
}
