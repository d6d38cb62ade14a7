// Sends the commands of a list one after the other, and follows what becomes of them, as `mom run` does.
import type { Card } from "../../hub/card.js";
import { type Carded, carded } from "../../hub/cards.svelte.js";
import { DeviceState, type Status } from "../../hub/device.svelte.js";
import { HubError, failureOf } from "../../hub/failure.js";
import { number } from "../../hub/fields.js";
import type { Hub } from "../../hub/hub.svelte.js";
import { texts } from "../../texts/index.js";
import type { Failure } from "../../worker/protocol.js";
import { type Item, type Items, clearFinished, isOpen, next, obstacle, progress, restore, save } from "./list.js";
import { isRelative, read } from "./script.js";

/** How long a device may take for its first word of a command, and how long to end what its last owner has begun, in ms. */
const ANSWER = 10_000;
const STANDING = 60_000;
const MOMENT = 300;

/** The key of a command that is in no list. */
const NO_KEY = -1;

const t = texts.commands;

/** Waits until something is there, undefined after so many ms. */
function until<T>(probe: () => T | undefined, ms = Infinity): Promise<T | undefined> {
  return new Promise((resolve) => {
    let timer: ReturnType<typeof setTimeout> | undefined;
    const finish = (value: T | undefined): void => {
      clearTimeout(timer);
      queueMicrotask(() => end());
      resolve(value);
    };
    const end = $effect.root(() => {
      $effect(() => {
        const value = probe();
        if (value !== undefined) finish(value);
      });
    });
    if (ms !== Infinity) timer = setTimeout(() => finish(undefined), ms);
  });
}

function local(code: string, text: string): Failure {
  return { kind: "local", code, text, content: {} };
}

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
  #lost: string | undefined;

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
    hub.onOwned((token, owned, reason, by) => {
      if (owned !== null || token !== this.device.token) return;
      this.#lost = texts.token.lost(token, texts.token.reasons[reason ?? ""] ?? reason ?? "", by);
    });
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
    [this.running, this.pausing, this.halted, this.#lost] = ["one", false, undefined, undefined];
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
      if (hub.owned.get(device.token ?? "")?.fence !== fence) return this.#lost ?? t.tokenLost;
      return undefined;
    };
  }

  async #run(what: "all" | "one", following: () => Item | undefined): Promise<void> {
    if (this.running || this.hindrance !== undefined) return;
    [this.running, this.pausing, this.halted, this.#lost] = [what, false, undefined, undefined];
    const over = this.#over();
    let first = true;
    for (let item = following(); item; item = following()) {
      if (!first && this.between > 0) await until(over, this.between);
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

  /** One command to its end, tried again where that is sure to help; why it failed, null if it has finished. */
  async #carryOut({ key, text }: Pick<Item, "key" | "text">, over: () => string | undefined): Promise<Failure | null> {
    const begun = performance.now();
    let relative = this.card !== undefined && isRelative(text, this.card);
    for (;;) {
      this.#progress(key, { state: "sending", error: undefined, statement: 0, of: 0, took: undefined });
      const failure = await this.#attempt(key, text, relative, over);
      // A device without a card says only by its refusal that a command is relative.
      if (failure?.code === "no-state" && !relative && over() === undefined) {
        relative = true;
        continue;
      }
      const took = performance.now() - begun;
      if (!failure) {
        this.#progress(key, { state: "finished", trying: undefined, took });
        return null;
      }
      const waits = took < STANDING && over() === undefined ? obstacle(failure) : undefined;
      if (waits === undefined || !(await this.#wait(key, failure, waits, over))) {
        this.#progress(key, { state: "error", error: failure, trying: undefined, took });
        this.hub.note("error", t.noted(this.path, text, failure.text), failure);
        return failure;
      }
    }
  }

  /** Waits until it may be tried again; false if that is not to be. */
  async #wait(key: number, failure: Failure, waits: "stands" | "moment", over: () => string | undefined): Promise<boolean> {
    this.#progress(key, { state: "sending", trying: failure.text });
    if (waits === "moment") return (await until(over, failure.retryAfter ?? MOMENT)) === undefined;
    const fence = this.hub.owned.get(this.device.token ?? "")?.fence ?? 0;
    const stands = await until(() => {
      if (over() !== undefined) return false;
      const { state } = this.device;
      return state["linked"] !== false && state["moving"] !== true && (number(state, "fence") ?? -1) >= fence ? true : undefined;
    }, STANDING);
    return stands === true;
  }

  /** Why it failed; null if it has finished. */
  async #attempt(key: number, text: string, relative: boolean, over: () => string | undefined): Promise<Failure | null> {
    const { device, hub } = this;
    let id: number;
    try {
      if (relative) {
        // It counts from a state in which the device stands: of one that moves still none holds.
        await until(() => (over() !== undefined || (device.stateId !== undefined && !device.moving) ? true : undefined), ANSWER);
        const why = over();
        if (why !== undefined) throw new HubError(local("ended", why));
        if (device.stateId === undefined) throw new HubError(local("no-answer", t.silent));
      }
      id = await device.command(text, { relative });
    } catch (error) {
      return failureOf(error);
    }
    let seen: Status | undefined;
    const news = (): Status | undefined => {
      const status = device.status(id);
      return status && status !== seen ? status : undefined;
    };
    for (;;) {
      const word = await until<Status | string>(() => news() ?? over(), seen ? Infinity : ANSWER);
      if (word === undefined) return local("no-answer", t.silent);
      if (typeof word === "string") {
        // The device's own last word may be on its way still.
        const last = hub.me ? await until(() => [device.status(id)].find((status) => status?.state === "finished" || status?.state === "error"), 1000) : undefined;
        if (last?.state === "finished") return null;
        return last?.error ? { ...last.error, text: `${word} ${texts.commands.deviceSays(last.error.text)}` } : local("ended", `${word} ${t.halts}`);
      }
      seen = word;
      const { state, statement, of, error } = word;
      if (state === "finished") {
        this.#progress(key, { statement, of });
        return null;
      }
      if (state === "error") {
        this.#progress(key, { statement, of });
        return error ?? local("error", t.noWords);
      }
      this.#progress(key, { state: state === "executing" ? "executing" : "taken", statement, of, trying: undefined });
    }
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
