// The order to stop: one request for all devices of a place, over the link, and over a second connection where the link does not take it.
import { type Client, MomError, type StopReport as Told } from "mom-client";
import { isWithin } from "./ordered.js";
import { failure } from "./plain.js";
import type { Say } from "./port.js";
import type { Login, Order, StopAnswer, StopReport, StopTerms } from "./protocol.js";
import { type Said, isAtRest, restOf } from "./rest.js";
import { Second } from "./second.js";
import type { Standing } from "./standing.js";

/** Where the hub has not answered over the link for so long, the stop goes over a second connection as well; ms. */
const LINK = 300;
const AROUND = 10_000;
/** The hub waits so long until what is stopped rests, ms. */
const REST = 3000;
/** A second connection that has not taken it after so many ms may hang as the link does: there is another one, and so on. */
const AGAIN = [700, 1400, 2800];
/** So many channels are let go by one request, which may have 64 KiB. */
const PORTION = 400;

/** The requests of an order; only a large hub needs several to let go. */
async function* asked(client: Client, order: Order, top: string, { reason, stops = {}, within }: StopTerms): AsyncGenerator<Told> {
  if (order === "stop") return yield await client.stop(top, { within: within ?? REST, ...(reason === undefined ? {} : { reason }) });
  const wait = within === undefined ? {} : { within };
  const own = stops[top];
  if (own !== undefined) return yield await client.unstop(top, own, wait);
  const all = Object.entries(stops);
  for (let at = 0; at < all.length; at += PORTION) yield await client.unstop(top, Object.fromEntries(all.slice(at, at + PORTION)), wait);
}

/** One order and what came of it. */
class Ordered {
  readonly report: StopReport;
  readonly #begun = performance.now();
  #noteTaken: () => void = () => undefined;
  /** Fulfilled when a hub has taken it, over whichever connection. */
  readonly taken = new Promise<void>((resolve) => (this.#noteTaken = resolve));

  constructor(
    order: Order,
    top: string,
    readonly terms: StopTerms,
    readonly standing: Standing,
    readonly tell: (report: StopReport) => void,
  ) {
    this.report = { order, top, at: Date.now(), devices: [], refused: [], newer: [], empty: [], denied: [], over: false, taken: false, missed: false, trying: [] };
  }

  changed(): void {
    this.tell(structuredClone(this.report));
  }

  #device(path: string, device: string): StopAnswer {
    const { devices } = this.report;
    let found = devices.find((each) => each.path === path && each.device === device);
    if (!found) devices.push((found = { path, device }));
    return found;
  }

  /** A device has said how it stands, and since when it is not reached, if it is not. */
  heard(path: string, device: string, said: Said, since?: number): void {
    if (!isWithin(path, this.report.top) || said["stopped"] !== (this.report.order === "stop")) return;
    this.#rests(this.#obeys(path, device), said, since);
    this.changed();
  }

  #obeys(path: string, device: string): StopAnswer {
    const answer = this.#device(path, device);
    answer.word = "obeys";
    answer.after ??= performance.now() - this.#begun;
    return answer;
  }

  #rests(answer: StopAnswer, said: Said, since?: number): void {
    if (this.report.order !== "stop") return;
    const rest = restOf(said);
    // When it came to rest is asked for, not when that was said again.
    if (!isAtRest(rest) || rest !== answer.rest) answer.told = performance.now() - this.#begun;
    [answer.rest, answer.since] = [rest, since];
  }

  #taken(): void {
    this.report.taken = true;
    this.#noteTaken();
    this.changed();
  }

  /** Asks a hub to do it. */
  async ask(client: Client): Promise<void> {
    const { order, top } = this.report;
    // A hub reads in order what is said to it: what answers this has read the stop before.
    const told = this.#tell(client);
    if (order === "stop") void client.lookup(top).then(() => this.#taken(), (error: unknown) => failure(error).kind === "refused" && this.#taken());
    await told;
  }

  async #tell(client: Client): Promise<void> {
    const { order, top } = this.report;
    try {
      for await (const told of asked(client, order, top, this.terms)) this.#answered(told, client);
      this.#taken();
    } catch (error) {
      const said = failure(error);
      // A stop is tried by every way there is, and what is lost on one is none of the other's.
      if (said.kind === "refused" || order === "unstop") this.report.refused.push({ path: top, failure: said });
      if (said.kind !== "refused") throw error;
      this.#taken();
    }
  }

  #answered({ channels, denied }: Told, { name, user }: Client): void {
    const { report, standing } = this;
    const { reason } = this.terms;
    const own = { by: name, user, ...(reason === undefined ? {} : { reason }), only: [] };
    report.denied = [...new Set([...report.denied, ...denied])];
    for (const { path, number, guarded, devices, newer, error } of channels) {
      for (const said of devices) {
        const { peer, word } = said;
        if (word === "silent" || word === "lost") this.#device(path, peer).word ??= word;
        else {
          const answer = this.#obeys(path, peer);
          // An answer over another connection may be older than what the device itself has said.
          if (!isAtRest(answer.rest)) this.#rests(answer, { ...said }, answer.since);
        }
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

/** Waits for the first of these; true if something came within so many ms. */
async function soon(ms: number, ...what: Promise<unknown>[]): Promise<boolean> {
  let timer: ReturnType<typeof setTimeout> | undefined;
  const late = new Promise<false>((resolve) => (timer = setTimeout(resolve, ms, false)));
  try {
    return await Promise.race([late, ...what.map((each) => each.then(() => true))]);
  } finally {
    clearTimeout(timer);
  }
}

export class Stopping {
  #client: Client | null = null;
  #now: Ordered | null = null;
  readonly #second = new Second();

  constructor(
    readonly say: Say,
    readonly login: () => Login | null,
    readonly isUp: () => boolean,
    readonly standing: Standing,
    /** What lends another connection. */
    readonly lend: Second["lend"] = (...args) => this.#second.lend(...args),
    readonly again: readonly number[] = AGAIN,
  ) {}

  /** There is a new peer. */
  reset(client: Client): void {
    this.#client = client;
    this.standing.reset(client);
  }

  /** There is no peer any more. */
  end(): void {
    this.#client = null;
    this.standing.end();
  }

  /** A device has said how it stands. */
  heard(path: string, device: string, said: Said, since?: number): void {
    this.#now?.heard(path, device, said, since);
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
      throw new MomError("local", "not-seen", `${state.by ?? "a peer"} stopped it${state.reason ? `: ${state.reason}` : ""}. Let it go again if it may move.`);
    }
    // What an unstop did not lift the hub knows when it is kept: an answer that waits for nothing names no newer stop.
    const ordered = new Ordered(order, path, order === "stop" ? { ...terms, within: 0 } : terms, this.standing, () => undefined);
    await this.#carryOut(ordered);
    const [refused] = ordered.report.refused;
    const [newer] = ordered.report.newer;
    this.standing.look();
    if (refused) throw new MomError("refused", refused.failure.code, refused.failure.text);
    if (!ordered.report.taken) throw new MomError("connection", "not-confirmed", `NOT CONFIRMED: the hub has not accepted the order for ${path}, over any connection`);
    if (newer) throw new MomError("refused", "newer-stop", `${newer.by ?? "a peer"} stopped it again${newer.reason ? `: ${newer.reason}` : ""}`, 232);
  }

  async order(order: Order, top: string, terms: StopTerms): Promise<void> {
    const ordered = new Ordered(order, top, terms, this.standing, (report) => ordered === this.#now && this.say({ word: "stop", report }));
    this.#now = ordered;
    ordered.changed();
    await this.#carryOut(ordered);
    ordered.report.over = true;
    ordered.report.trying = [];
    ordered.changed();
    this.standing.look();
  }

  /** Until it has been answered whole over one connection, or every way has failed. */
  async #carryOut(ordered: Ordered): Promise<void> {
    const link = this.#client ? ordered.ask(this.#client) : Promise.reject(new MomError("local", "not-logged-in", "log in first"));
    const settled = link.catch(() => undefined);
    // What lets go is never said by another way: it is for what the user sees now.
    if (ordered.report.order === "unstop" || (await soon(this.isUp() ? LINK : 0, ordered.taken))) return settled;
    const around = this.#around(ordered);
    const failed = Promise.all([settled, around.catch(() => undefined)]);
    await Promise.any([link, around]).catch(() => failed);
  }

  async #try(ordered: Ordered, login: Login): Promise<void> {
    const end = performance.now() + AROUND;
    const tries: Promise<void>[] = [];
    for (const wait of [...this.again, 0]) {
      // The link may have taken it meanwhile.
      const one = this.lend(login, end - performance.now(), ordered.taken, async (client) => (ordered.report.taken ? undefined : ordered.ask(client)));
      one.catch(() => undefined);
      tries.push(one);
      if (await soon(wait, ordered.taken)) break;
    }
    await Promise.any(tries);
  }

  /** By a second connection, through whichever door opens. Others that share it go on, whatever becomes of this one. */
  async #around(ordered: Ordered): Promise<void> {
    ordered.report.missed = true;
    const login = this.login();
    if (!login) throw new MomError("local", "not-logged-in", "log in first");
    ordered.report.trying = login.address.split(/\s+/);
    ordered.changed();
    try {
      await this.#try(ordered, login);
    } finally {
      ordered.report.trying = [];
      ordered.changed();
    }
  }
}
