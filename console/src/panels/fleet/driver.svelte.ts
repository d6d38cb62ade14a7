// Driving several robots at once: their tokens, what is sent to them, and what became of it.
import { type Became, Carrier, type News, isOver, local as failureHere } from "../../hub/carrier.js";
import { HubError, failureOf } from "../../hub/failure.js";
import { fields, text } from "../../hub/fields.js";
import type { Hub } from "../../hub/hub.svelte.js";
import { fleet as t } from "../../texts/fleet.js";
import { texts } from "../../texts/index.js";
import type { Failure, StandingStop } from "../../worker/protocol.js";
import { type Line, Log } from "./log.svelte.js";
import type { FleetState } from "./state.svelte.js";
import { wordsOf } from "./units.js";

/** Robots that are spoken to at the same time. */
const ABREAST = 16;

export interface Outgoing extends Line {
  statement: string;
  became: Became;
  /** Why it failed. */
  failure: Failure | undefined;
  took: number | undefined;
}

/** The same refusal for some robots. */
export interface Refused {
  what: string;
  units: number[];
  failure: Failure;
}

/** Does it for all, so many at a time; what fails is gathered, alike with alike. */
async function each(what: string, units: readonly number[], work: (unit: number) => Promise<void>, abreast = ABREAST): Promise<{ done: number[]; refused: Refused[] }> {
  const waiting = [...units];
  const done: number[] = [];
  const refused = new Map<string, Refused>();
  const worker = async (): Promise<void> => {
    for (let unit = waiting.shift(); unit !== undefined; unit = waiting.shift()) {
      try {
        await work(unit);
        done.push(unit);
      } catch (error) {
        const failure = failureOf(error);
        const key = [failure.code, failure.rule, failure.owner, failure.code === "local" ? failure.text : ""].join("\n");
        const alike = refused.get(key);
        if (alike) alike.units.push(unit);
        else refused.set(key, { what, units: [unit], failure });
      }
    }
  };
  await Promise.all(Array.from({ length: Math.min(abreast, units.length) }, worker));
  return { done, refused: [...refused.values()] };
}

const local = (code: string, words: string): HubError => new HubError(failureHere(code, words));

export class FleetDriver {
  readonly outgoing = new Log<Outgoing>();
  refused = $state.raw<readonly Refused[]>([]);
  news = $state<string | null>(null);
  /** Something is under way for which others wait. */
  busy = $state(false);
  /** The token that guards each robot, where that is known. */
  tokens = $state.raw<ReadonlyMap<number, string>>(new Map());
  /** Hear of each command's end. */
  readonly onEnd = new Set<(line: Outgoing) => void>();
  readonly #base: string;
  readonly #asked = new Map<number, Promise<string>>();
  readonly #guards = new Map<string, Set<number>>();
  readonly #carriers = new Map<number, Carrier>();
  /** The stops that this page knows of, by channel. */
  readonly #standing: ReadonlyMap<string, StandingStop>;

  constructor(
    readonly hub: Hub,
    readonly fleet: FleetState,
  ) {
    this.#standing = $derived(new Map(hub.stops.map((stop) => [stop.path, stop])));
    this.#base = fleet.path.slice(0, fleet.path.lastIndexOf("/"));
  }

  channel(unit: number): string {
    return `${this.#base}/${unit}/robot`;
  }

  /** Whether this page drives it: it knows of its own tokens before the robot tells. */
  owns(unit: number): boolean {
    const token = this.tokens.get(unit);
    const owner = this.fleet.robots.get(unit)?.owner;
    return token === undefined ? owner !== undefined && owner === this.hub.me?.peer : this.hub.owned.has(token);
  }

  /** Where a robot's camera would be. */
  camera(unit: number): string {
    return `${this.#base}/${unit}/camera`;
  }

  place(unit: number): string {
    return `${this.#base}/${unit}`;
  }

  /** Hears of this page's tokens until the function that it gives is called, which ends all else as well. */
  start(): () => void {
    const end = this.hub.onOwned((path, owned, reason, by) => {
      const units = this.#guards.get(path);
      if (owned !== null || !units || reason === "released") return;
      const words = texts.token.lost(path, reason, by);
      this.fleet.incoming.add([...units].map((unit) => ({ at: Date.now(), unit, text: words, tone: "warning" as const })));
    });
    return () => {
      end();
      for (const carrier of this.#carriers.values()) carrier.drop();
    };
  }

  tokenOf(unit: number): Promise<string> {
    let found = this.#asked.get(unit);
    if (!found) {
      found = this.hub.call("ask", "context", "info", this.channel(unit)).then((info) => {
        const token = text(fields(info["guard"]), "token");
        if (token === undefined) throw local("no-token", t.guard(unit));
        const guarded = this.#guards.get(token) ?? new Set();
        this.#guards.set(token, guarded.add(unit));
        this.tokens = new Map(this.tokens).set(unit, token);
        return token;
      });
      this.#asked.set(unit, found);
      // Asked again the next time.
      found.catch(() => this.#asked.delete(unit));
    }
    return found;
  }

  async #all(what: "grab" | "release" | "stop" | "unstop", units: readonly number[], work: (unit: number) => Promise<void>, abreast?: number): Promise<boolean> {
    [this.busy, this.refused, this.news] = [true, [], null];
    const { done, refused } = await each(t.whats[what]!, units, work, abreast);
    this.busy = false;
    this.refuse(refused);
    if (done.length) this.news = t.done[what](t.of(wordsOf(done), done.length));
    return !refused.length;
  }

  refuse(refused: readonly Refused[]): void {
    this.refused = refused;
    for (const { what, units, failure } of refused) this.hub.note("error", `${t.what(what, wordsOf(units), units.length)}: ${failure.text}`, failure);
  }

  dismiss(one: Refused): void {
    this.refused = this.refused.filter((each) => each !== one);
  }

  /** Several robots may have one token. */
  async grab(units: readonly number[]): Promise<boolean> {
    const asked = new Map<string, Promise<unknown>>();
    return this.#all("grab", units, async (unit) => {
      const token = await this.tokenOf(unit);
      if (this.hub.owned.has(token)) return;
      const grabbing = asked.get(token) ?? this.hub.call("grab", token);
      asked.set(token, grabbing);
      await grabbing;
    });
  }

  async release(units: readonly number[]): Promise<boolean> {
    const asked = new Map<string, Promise<unknown>>();
    return this.#all("release", units, async (unit) => {
      const token = await this.tokenOf(unit);
      if (!asked.has(token) && !this.hub.owned.has(token)) return;
      const giving = asked.get(token) ?? this.hub.call("release", token);
      asked.set(token, giving);
      await giving;
    });
  }

  /** Stops robots, all at once; needs no token. */
  stop(units: readonly number[]): Promise<boolean> {
    const asked = this.hub.stopEach(units.map((unit) => this.channel(unit)), t.stopReason);
    const of = new Map(units.map((unit, place) => [unit, asked[place]!]));
    return this.#all("stop", units, (unit) => of.get(unit)!, units.length);
  }

  /** Whether a robot is stopped, by its own word or as far as this page knows of stops. */
  isStopped(unit: number): boolean {
    return this.fleet.robots.get(unit)?.stopped === true || this.#standing.has(this.channel(unit));
  }

  /** The stops that hold for these robots. Of one that says that it is stopped, and of whose stop the page has not heard, the hub is asked. */
  async stopsOf(units: readonly number[]): Promise<StandingStop[]> {
    const unheard = units.filter((unit) => this.isStopped(unit)).map((unit) => this.channel(unit)).filter((path) => !this.#standing.has(path));
    const found = unheard.length ? await this.hub.call("stopsOf", unheard) : [];
    const all = new Map([...found.map((stop) => [stop.path, stop] as const), ...this.#standing]);
    return units.flatMap((unit) => all.get(this.channel(unit)) ?? []);
  }

  /** Lets robots go: up to these stops, which were shown, and no more of them once a stop is ordered. */
  free(stops: readonly StandingStop[]): Promise<boolean> {
    const shown = new Map(stops.map(({ path, number }) => [path, number]));
    const units = stops.map(({ path }) => Number(path.slice(this.#base.length + 1).split("/", 1)[0]));
    const going = this.#underway(units);
    return this.#all("unstop", units, async (unit) => {
      const path = this.channel(unit);
      going(unit);
      await this.hub.call("stopOne", "unstop", path, { stops: { [path]: shown.get(path)! } });
    });
  }

  /** What throws for a robot once a stop of it is ordered after this. */
  #underway(units: readonly number[]): (unit: number) => void {
    const before = new Map(units.map((unit) => [unit, this.hub.stopsOrdered(this.channel(unit))]));
    return (unit) => {
      if (this.hub.stopsOrdered(this.channel(unit)) !== before.get(unit)) throw local("stopped", texts.commands.stopOrdered);
    };
  }

  /** Sends each of them its statement; gives the lines of the log, and what was refused at once. */
  async send(units: readonly number[], statementOf: (unit: number) => string, options: { expires?: number } = {}): Promise<{ keys: number[]; refused: Refused[] }> {
    const lines = this.outgoing.add(units.map((unit) => ({ at: Date.now(), unit, statement: statementOf(unit), became: "sending" as const, failure: undefined, took: undefined })));
    const of = new Map(lines.map((line) => [line.unit, line]));
    const going = this.#underway(units);
    const { done, refused } = await each(t.whats["send"]!, units, async (unit) => {
      const line = of.get(unit)!;
      try {
        await this.#command(line, options.expires, going);
      } catch (error) {
        this.#become(line, { became: "refused", failure: failureOf(error) });
        throw error;
      }
    });
    this.refuse(refused);
    const statements = new Set(done.map(statementOf));
    this.news = done.length ? t.done.send(t.of(wordsOf(done), done.length), statements.size === 1 ? [...statements][0]! : `${[...statements][0]!.split(" ")[0]!} …`) : null;
    return { keys: lines.map(({ key }) => key), refused };
  }

  /** Sends it, and tells what becomes of it; fails if no robot has it. */
  async #command(line: Outgoing, expires: number | undefined, going: (unit: number) => void): Promise<void> {
    const { unit, statement } = line;
    going(unit);
    const token = await this.tokenOf(unit);
    if (!this.hub.owned.has(token)) throw local("not-owner", t.needs(token));
    going(unit);
    const carrier = this.#carriers.get(unit) ?? new Carrier(this.hub, this.channel(unit));
    this.#carriers.set(unit, carrier);
    await new Promise<void>((resolve, reject) => {
      const command = { text: statement, ...(expires === undefined ? {} : { expires }) };
      const over = carrier.carryOut(command, token, (news) => {
        this.#become(line, news);
        if (news.became === "sent") resolve();
      });
      void over.then((failure) => (line.became === "refused" ? reject(new HubError(failure!)) : resolve()));
    });
  }

  #become(line: Outgoing, { became, failure }: News): void {
    // A command's end is its last word, whatever comes late.
    if (isOver(line.became)) return;
    [line.became, line.failure] = [became, failure];
    if (isOver(became)) line.took = Date.now() - line.at;
    this.outgoing.change(line.key, { became, failure, took: line.took });
    if (!isOver(became)) return;
    for (const hear of this.onEnd) hear(line);
    if (became === "refused") return;
    const { unit, statement } = line;
    const words = failure ? t.logs.failed(statement, failure.text) : t.logs.finished(statement);
    this.fleet.incoming.add([{ at: Date.now(), unit, text: words, tone: failure ? "danger" : "good" }]);
  }
}
