// The order to stop: one request for all devices of a place, over the link or around it.
import { type Client, MomError, type StopReport as Told, connect } from "mom-client";
import { failure } from "./plain.js";
import type { Say } from "./port.js";
import type { Login, Order, StopReport, StopTerms } from "./protocol.js";
import type { Standing } from "./standing.js";

/** A hub that does not answer for so long is looked for elsewhere, in ms. */
const LINK = 400;
const AROUND = 10_000;
/** So many channels are let go by one request, which may have 64 KiB. */
const PORTION = 400;

function within(path: string, top: string): boolean {
  return top === "/" || path === top || path.startsWith(`${top}/`);
}

/** The requests of an order; only a large hub needs several to let go. */
async function* asked(client: Client, order: Order, top: string, { reason, stops = {}, within }: StopTerms): AsyncGenerator<Told> {
  const wait = within === undefined ? {} : { within };
  if (order === "stop") return yield await client.stop(top, { ...wait, ...(reason === undefined ? {} : { reason }) });
  const own = stops[top];
  if (own !== undefined) return yield await client.unstop(top, own, wait);
  const all = Object.entries(stops);
  for (let at = 0; at < all.length; at += PORTION) yield await client.unstop(top, Object.fromEntries(all.slice(at, at + PORTION)), wait);
}

/** One order and what came of it. */
class Ordered {
  readonly report: StopReport;
  readonly #begun = performance.now();

  constructor(
    order: Order,
    top: string,
    readonly terms: StopTerms,
    readonly standing: Standing,
    readonly tell: (report: StopReport) => void,
  ) {
    this.report = { order, top, at: Date.now(), devices: [], refused: [], newer: [], empty: [], denied: [], over: false, taken: false, trying: [] };
  }

  changed(): void {
    this.tell(structuredClone(this.report));
  }

  #device(path: string, device: string): StopReport["devices"][number] {
    const { devices } = this.report;
    let found = devices.find((each) => each.path === path && each.device === device);
    if (!found) devices.push((found = { path, device }));
    return found;
  }

  /** A device has said how it stands. */
  heard(path: string, device: string, stopped: boolean): void {
    if (!within(path, this.report.top) || stopped !== (this.report.order === "stop")) return;
    this.#obeys(path, device);
    this.changed();
  }

  #obeys(path: string, device: string): void {
    const answer = this.#device(path, device);
    answer.word = "obeys";
    answer.after ??= performance.now() - this.#begun;
  }

  taken(): void {
    this.report.taken = true;
    this.changed();
  }

  /** Asks a hub to do it. */
  async ask(client: Client): Promise<void> {
    const { order, top } = this.report;
    // A hub reads in order what is said to it: what answers this has read the stop before.
    const told = this.#tell(client);
    if (order === "stop") void client.lookup(top).then(() => this.taken(), (error: unknown) => failure(error).kind === "refused" && this.taken());
    await told;
  }

  async #tell(client: Client): Promise<void> {
    const { order, top } = this.report;
    try {
      for await (const told of asked(client, order, top, this.terms)) this.#answered(told, client);
      this.taken();
    } catch (error) {
      const said = failure(error);
      // A stop is tried by every way there is, and what is lost on one is none of the other's.
      if (said.kind === "refused" || order === "unstop") this.report.refused.push({ path: top, failure: said });
      if (said.kind !== "refused") throw error;
      this.taken();
    }
  }

  #answered({ channels, denied }: Told, { name, user }: Client): void {
    const { report, standing } = this;
    const { reason } = this.terms;
    const own = { by: name, user, ...(reason === undefined ? {} : { reason }), only: [] };
    report.denied = [...new Set([...report.denied, ...denied])];
    for (const { path, number, guarded, devices, newer, error } of channels) {
      for (const { peer, word } of devices) {
        if (word === "silent" || word === "lost") this.#device(path, peer).word ??= word;
        else this.#obeys(path, peer);
      }
      if (guarded && !devices.length && !report.empty.includes(path)) report.empty.push(path);
      if (error !== undefined) report.refused.push({ path, failure: { kind: "refused", code: error, text: error, content: {} } });
      for (const stop of newer) {
        report.newer.push({ path, number: stop.number, by: stop.by, user: stop.user, reason: stop.reason, since: stop.since?.toDate().getTime(), only: stop.only });
        standing.learn(path, stop);
      }
      if (report.order === "stop") standing.learn(path, { number, stopped: true, ...own });
      else if (!newer.length && error === undefined) standing.learn(path, { number, stopped: false, only: [] });
    }
  }
}

export class Stopping {
  #client: Client | null = null;
  #now: Ordered | null = null;

  constructor(
    readonly say: Say,
    readonly login: () => Login | null,
    readonly isUp: () => boolean,
    readonly standing: Standing,
  ) {}

  /** There is a new peer. */
  reset(client: Client): void {
    this.#client = client;
    this.standing.reset(client);
  }

  /** A device has said how it stands. */
  heard(path: string, device: string, stopped: boolean): void {
    this.#now?.heard(path, device, stopped);
  }

  /** Stops one place, or lets it go, and makes no report; what fails, fails. */
  async one(order: Order, path: string, terms: StopTerms): Promise<void> {
    const client = this.#client;
    if (!client) throw new MomError("local", "not-logged-in", "log in first");
    if (order === "unstop" && terms.stops?.[path] === undefined) {
      // The page has shown none: it does so now, and its user decides.
      const state = await client.stops(path);
      this.standing.learn(path, state);
      if (!state.stopped) return;
      throw new MomError("local", "not-seen", `${state.by ?? "somebody"} has stopped it${state.reason ? `: ${state.reason}` : ""}. Let it go again if it may move.`);
    }
    const ordered = new Ordered(order, path, { ...terms, within: 0 }, this.standing, () => undefined);
    await ordered.ask(client);
    const [refused] = ordered.report.refused;
    const [newer] = ordered.report.newer;
    this.standing.look();
    if (refused) throw new MomError("refused", refused.failure.code, refused.failure.text);
    if (newer) throw new MomError("refused", "newer-stop", `${newer.by ?? "somebody"} has stopped it again since${newer.reason ? `: ${newer.reason}` : ""}`, 232);
  }

  async order(order: Order, top: string, terms: StopTerms): Promise<void> {
    const ordered = new Ordered(order, top, terms, this.standing, (report) => ordered === this.#now && this.say({ word: "stop", report }));
    this.#now = ordered;
    ordered.changed();
    const link = this.#client ? ordered.ask(this.#client) : Promise.reject(new MomError("local", "not-logged-in", "log in first"));
    const settled = link.catch(() => undefined);
    // What lets go is never said by another way: it is for what the user sees now.
    if (order === "stop" && !(await this.#takenSoon(ordered, settled))) await this.#around(ordered, settled);
    await settled;
    ordered.report.over = true;
    ordered.report.trying = [];
    ordered.changed();
    this.standing.look();
  }

  async #takenSoon(ordered: Ordered, settled: Promise<void>): Promise<boolean> {
    for (const end = performance.now() + (this.isUp() ? LINK : 0); !ordered.report.taken && performance.now() < end; ) {
      const over = await Promise.race([settled.then(() => true), new Promise<false>((resolve) => setTimeout(resolve, 20, false))]);
      if (over) break;
    }
    return ordered.report.taken;
  }

  /** By a connection of its own, through whichever door opens, until the link or it has said so. */
  async #around(ordered: Ordered, settled: Promise<void>): Promise<void> {
    const login = this.login();
    if (!login) return;
    ordered.report.trying = login.address.split(/\s+/);
    ordered.changed();
    const giveUp = new AbortController();
    const timer = setTimeout(() => giveUp.abort(), AROUND);
    void settled.then(() => ordered.report.taken && giveUp.abort());
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
      await ordered.ask(client).catch(() => undefined);
      await client.close();
    } catch {
      // The report says that nobody has taken it.
    } finally {
      clearTimeout(timer);
      ordered.report.trying = [];
    }
  }
}
