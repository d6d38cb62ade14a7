// Driving several robots at once: their tokens, what is sent to them, and what became of it.
import { refusalOf } from "../../hub/device.svelte.js";
import { HubError, failureOf } from "../../hub/failure.js";
import { fields, number, text } from "../../hub/fields.js";
import type { Hub } from "../../hub/hub.svelte.js";
import { fleet as t } from "../../texts/fleet.js";
import { texts } from "../../texts/index.js";
import type { Failure, HubEvent, Message, StandingStop } from "../../worker/protocol.js";
import { type Line, Log } from "./log.svelte.js";
import type { FleetState } from "./state.svelte.js";
import { wordsOf } from "./units.js";

/** Robots that are spoken to at the same time. */
const ABREAST = 16;
/** A robot's channel is heard for so long after the last command's end, ms. */
const LINGER = 15_000;
/** What a robot said of a command before the hub told this page the command's number. */
const EARLY = 200;

export type Became = "sending" | "sent" | "waiting" | "executing" | "finished" | "error" | "refused";

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

const OVER = new Set<Became>(["finished", "error", "refused"]);
export const isOver = (became: Became): boolean => OVER.has(became);

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

const local = (code: string, words: string): HubError => new HubError({ kind: "local", code, text: words, content: {} });

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
  readonly #heard = new Map<number, { ready: Promise<void>; end: () => void; timer: ReturnType<typeof setTimeout> | undefined }>();
  /** Commands under way, by number. */
  readonly #open = new Map<number, Outgoing>();
  readonly #early = new Map<number, Message>();
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
      const words = t.logs.lostToken(path, texts.token.reasons[reason ?? ""] ?? reason ?? "", by);
      this.fleet.incoming.add([...units].map((unit) => ({ at: Date.now(), unit, text: words, tone: "warning" as const })));
    });
    return () => {
      end();
      for (const heard of this.#heard.values()) {
        clearTimeout(heard.timer);
        heard.end();
      }
      this.#heard.clear();
      this.#open.clear();
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
        this.#become(line, "refused", failureOf(error));
        this.#linger(unit);
        throw error;
      }
    });
    this.refuse(refused);
    const statements = new Set(done.map(statementOf));
    this.news = done.length ? t.done.send(t.of(wordsOf(done), done.length), statements.size === 1 ? [...statements][0]! : `${[...statements][0]!.split(" ")[0]!} …`) : null;
    return { keys: lines.map(({ key }) => key), refused };
  }

  async #command(line: Outgoing, expires: number | undefined, going: (unit: number) => void): Promise<void> {
    const { unit, statement } = line;
    const path = this.channel(unit);
    going(unit);
    const token = await this.tokenOf(unit);
    const owned = this.hub.owned.get(token);
    if (!owned) throw local("not-owner", t.needs(token));
    await this.#listen(unit);
    going(unit);
    const sent = await this.hub.call("send", path, "command", statement, { echo: false, fence: owned.fence, ...(expires === undefined ? {} : { expires }) });
    if (sent.delivered === 0) throw local("no-answer", t.nobodyObeys(path));
    this.#open.set(sent.id, line);
    if (line.became === "sending") this.#become(line, "sent");
    const early = this.#early.get(sent.id);
    if (early) this.#status(sent.id, early);
  }

  /** Hears what a robot says of commands. */
  #listen(unit: number): Promise<void> {
    const known = this.#heard.get(unit);
    if (known) {
      clearTimeout(known.timer);
      known.timer = undefined;
      return known.ready;
    }
    let end = (): void => undefined;
    const ready = new Promise<void>((resolve, reject) => {
      end = this.hub.watch(
        { path: this.channel(unit), kind: "channel", names: ["status"] },
        {
          joined: () => resolve(),
          events: (events) => this.#events(unit, events),
          failed: (failure) => {
            this.#forget(unit);
            reject(new HubError(failure));
          },
        },
      );
    });
    this.#heard.set(unit, { ready, end, timer: undefined });
    return ready;
  }

  #forget(unit: number): void {
    this.#heard.get(unit)?.end();
    this.#heard.delete(unit);
  }

  #events(unit: number, events: readonly HubEvent[]): void {
    for (const event of events) {
      if (event.type !== "message") continue;
      const message = event as Message;
      const said = fields(message.content);
      const id = number(said, "id");
      if (id === undefined || text(said, "peer") !== this.hub.me?.peer) continue;
      if (this.#open.has(id)) this.#status(id, message);
      else {
        this.#early.set(id, message);
        if (this.#early.size > EARLY) this.#early.delete(this.#early.keys().next().value!);
      }
    }
    this.#linger(unit);
  }

  /** Its channel is left some time after the last command has ended. */
  #linger(unit: number): void {
    const heard = this.#heard.get(unit);
    if (!heard || [...this.#open.values()].some((line) => line.unit === unit)) return;
    clearTimeout(heard.timer);
    heard.timer = setTimeout(() => this.#forget(unit), LINGER);
  }

  #status(id: number, { content, arrived }: Message): void {
    const line = this.#open.get(id);
    const said = fields(content);
    const state = text(said, "state");
    if (!line || (state !== "waiting" && state !== "executing" && state !== "finished" && state !== "error")) return;
    this.#become(line, state, refusalOf(fields(said["error"])));
    if (!isOver(state)) return;
    this.#open.delete(id);
    this.#early.delete(id);
    const { unit, statement, failure } = line;
    const words = state === "finished" ? t.logs.finished(statement) : t.logs.failed(statement, failure?.text ?? texts.commands.noWords);
    this.fleet.incoming.add([{ at: arrived, unit, text: words, tone: state === "finished" ? "good" : "danger" }]);
  }

  #become(line: Outgoing, became: Became, failure?: Failure): void {
    // A command's end is its last word, whatever comes late.
    if (isOver(line.became)) return;
    [line.became, line.failure] = [became, failure];
    if (isOver(became)) line.took = Date.now() - line.at;
    this.outgoing.change(line.key, { became, failure, took: line.took });
    if (isOver(became)) for (const hear of this.onEnd) hear(line);
  }
}
