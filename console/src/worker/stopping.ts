// The order to stop: to all devices of a place, over the link or around it.
import { type Client, type ContextInfo, MomError, connect, fieldsOf } from "mom-client";
import { failure } from "./plain.js";
import type { Say } from "./port.js";
import type { Login, Order, StopReport } from "./protocol.js";

/** A device that says nothing for so long is silent, in ms; a hub that does not answer for so long is looked for elsewhere. */
const PATIENCE = 1500;
const LINK = 400;
const AROUND = 10_000;
/** Channels are looked for anew so often, in ms. */
const WALK = 20_000;
/** What is wanted of a channel that nobody watches. */
const LITTLE = "1/s";

/** Channels below a path, as far as this peer may list them. */
async function channels(client: Client, top: string): Promise<string[]> {
  const found: string[] = [];
  const waiting: Pick<ContextInfo, "path" | "kind">[] = [top === "/" ? { path: "/", kind: "session" } : await client.lookup(top)];
  for (let context = waiting.pop(); context; context = waiting.pop()) {
    if (context.kind === "channel") found.push(context.path);
    if (context.kind === "session") waiting.push(...(await client.list(context.path).catch(() => [])));
  }
  return found;
}

function within(path: string, top: string): boolean {
  return top === "/" || path === top || path.startsWith(`${top}/`);
}

/** One order and what came of it. */
class Ordered {
  readonly report: StopReport;
  readonly #asked = new Set<string>();
  readonly #begun = performance.now();

  constructor(
    order: Order,
    top: string,
    readonly tell: (report: StopReport) => void,
  ) {
    this.report = { order, top, at: Date.now(), devices: [], refused: [], over: false, taken: false, trying: [] };
  }

  changed(): void {
    this.tell(structuredClone(this.report));
  }

  device(path: string, device: string): StopReport["devices"][number] {
    const { devices } = this.report;
    let found = devices.find((each) => each.path === path && each.device === device);
    if (!found) devices.push((found = { path, device }));
    return found;
  }

  /** A device has said how it stands. */
  heard(path: string, device: string, stopped: boolean): void {
    if (!within(path, this.report.top) || stopped !== (this.report.order === "stop")) return;
    const answer = this.device(path, device);
    if (answer.after !== undefined) return;
    answer.after = performance.now() - this.#begun;
    this.changed();
  }

  /** Says it in a channel, unless it was said there; `listen` is called when this peer is in. */
  async say(client: Client, path: string, listen: (path: string) => void): Promise<void> {
    if (this.#asked.has(path)) return;
    this.#asked.add(path);
    const { order } = this.report;
    try {
      const channel = await client.channel(path);
      const sent = channel.sendAcknowledged(order, undefined, { echo: false });
      listen(path);
      const members = await client.members(path).catch(() => []);
      for (const { peer, device } of members) if (device) this.device(path, peer);
      await sent;
      this.report.taken = true;
      this.changed();
    } catch (error) {
      // It may be said again by another way.
      this.#asked.delete(path);
      const said = failure(error);
      if (said.kind !== "refused") throw error;
      // What this user may not stop is no device of theirs, unless it is all that they named.
      if (said.code !== "denied" || path === this.report.top) this.report.refused.push({ path, failure: said });
    }
  }
}

export class Stopping {
  #client: Client | null = null;
  #known: string[] = [];
  #walker: ReturnType<typeof setInterval> | undefined;
  #now: Ordered | null = null;

  constructor(
    readonly say: Say,
    readonly login: () => Login | null,
    readonly isUp: () => boolean,
    /** Stays in a channel, of which this is enough, and hears what devices say there. */
    readonly attend: (path: string, rate: string | undefined) => Promise<void>,
  ) {}

  /** There is a new peer: it joins the channels that have devices, so that a stop need not. */
  reset(client: Client): void {
    [this.#client, this.#known] = [client, []];
    clearInterval(this.#walker);
    this.#walker = setInterval(() => void this.#walk(client), WALK);
    void this.#walk(client);
  }

  async #walk(client: Client): Promise<void> {
    if (client !== this.#client || !this.isUp()) return;
    const known: string[] = [];
    for (const path of await channels(client, "/").catch(() => [])) {
      const members = await client.members(path).catch(() => []);
      if (members.some(({ device }) => device)) known.push(path);
    }
    this.#known = known;
    for (const path of known) await this.attend(path, LITTLE).catch(() => undefined);
  }

  /** A device has said how it stands. */
  heard(path: string, device: string, stopped: boolean): void {
    this.#now?.heard(path, device, stopped);
  }

  async order(order: Order, top: string): Promise<void> {
    const ordered = new Ordered(order, top, (report) => ordered === this.#now && this.say({ word: "stop", report }));
    this.#now = ordered;
    ordered.changed();
    const link = this.#client && this.#overLink(this.#client, ordered);
    const late = new Promise<"late">((resolve) => setTimeout(resolve, LINK, "late"));
    const first = link && this.isUp() ? await Promise.race([link.then(() => "done" as const, () => "failed" as const), late]) : "failed";
    if (first !== "done" && !ordered.report.taken) await this.#around(ordered, link);
    await link?.catch(() => undefined);
    await new Promise((resolve) => setTimeout(resolve, ordered.report.devices.every(({ after }) => after !== undefined) ? 0 : PATIENCE));
    ordered.report.over = true;
    ordered.report.trying = [];
    ordered.changed();
    if (this.#client) void this.#walk(this.#client);
  }

  /** Over the link: where devices are known to be first, then wherever else there may be some. */
  async #overLink(client: Client, ordered: Ordered): Promise<void> {
    const { top } = ordered.report;
    // What devices say to it is not to wait for its turn.
    const listen = (path: string): void => void (client === this.#client ? this.attend(path, undefined).catch(() => undefined) : this.#listen(client, path));
    await Promise.all(this.#known.filter((path) => within(path, top)).map((path) => ordered.say(client, path, listen)));
    await Promise.all((await channels(client, top)).map((path) => ordered.say(client, path, listen)));
  }

  /** Hears how devices stand over another connection. */
  async #listen(client: Client, path: string): Promise<void> {
    for await (const event of client.peer.events(path)) {
      if (event.type !== "message" || event.name !== "state") continue;
      const stopped = fieldsOf(event.content)["stopped"];
      if (typeof stopped === "boolean") this.heard(path, event.sender, stopped);
    }
  }

  /** By a connection of its own, through whichever door opens, until the link or it has said so. */
  async #around(ordered: Ordered, link: Promise<void> | null): Promise<void> {
    const login = this.login();
    if (!login) throw new MomError("local", "not-logged-in", "log in first");
    ordered.report.trying = login.address.split(/\s+/);
    ordered.changed();
    const giveUp = new AbortController();
    const timer = setTimeout(() => giveUp.abort(), AROUND);
    void link?.then(() => ordered.report.taken && giveUp.abort(), () => undefined);
    const { address, user, password, guest } = login;
    try {
      if (login.key) return;
      const client = await connect(address, {
        ...(user === undefined ? {} : { user }),
        ...(password === undefined ? {} : { password }),
        ...(guest ? { guest } : {}),
        reconnect: false,
        connectWithin: AROUND,
        signal: giveUp.signal,
        onState: () => undefined,
      });
      await this.#overLink(client, ordered).catch(() => undefined);
      // Devices answer to whoever is there.
      await new Promise((resolve) => setTimeout(resolve, PATIENCE));
      await client.close();
    } catch {
      // The report says that nobody has taken it.
    } finally {
      clearTimeout(timer);
    }
  }
}
