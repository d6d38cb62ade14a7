// The life of an agent: it hears tasks, has one at a time carried out, and ends.
import { sayable, sayableOf } from "../device/sayable.js";
import { DriveError, lossWords } from "../drive/index.js";
import { type Channel, type Client, type Event, type Events, type Fields, type Lost, type MessageEvent, MomError, type Token, type TokenGuard, type Value } from "../index.js";
import { Task } from "./task.js";

/** ms for which an accepted task waits for the token. */
export const OFFERED = 15_000;
/** ms that the hub may need to say that a scope is used up. */
const HUB = 500;
/** ms in which it says whether the token is lost. */
const ANSWER = 10_000;
/** ms in which work that is to end has to; then it is told that it does not. */
const LAST = 5000;
/** ms that finding out whether a task can be done may take: who asks waits no longer for an answer. */
const MET = 9000;
/** ms for which the peer of a task may be away, as its connection is lost, before the task ends. */
const AWAY = 5000;
/** The most letters of what is said of a task. */
const TEXT = 2000;
const CODES = { "try-later": 100, denied: 200, "bad-content": 223 } as const;

/** Why an agent does not take a task: throw it in `read` or `meet`. */
export class Refused extends Error {
  constructor(
    readonly code: keyof typeof CODES,
    readonly text: string,
  ) {
    super(text);
  }
}

/** What an agent can be hired for. */
export interface Agent<W = Value | undefined> {
  /** The message by which a task is asked for. */
  readonly verb: string;
  /** The token that has to be lent for it, unless `meet` says another one. */
  readonly token?: string;
  /** Reads a task, which is `task.what` from then on. Throws {@link Refused} with `bad-content`. */
  read?(content: Value | undefined): W;
  /** A task in words that follow "alice has had it"; its verb unless said. */
  words?(what: W): string;
  /**
   * Joins what the task needs, and finds out whether it can be done, before anything is lent; gives the token that has to be lent. Throws
   * {@link Refused} with `try-later`.
   */
  meet?(task: Task<W>): Promise<string> | string;
  /**
   * Works under the token, and says what it has done, in words or as fields with `text`. `task.signal` is aborted where it has to end, and
   * what it drives is ended; the token is given back whatever happens. A `DriveError` ends the task as `failed` in its own words, what else
   * it throws as an internal error, which is logged.
   */
  work(task: Task<W>): Promise<string | Fields | void>;
}

/** How a task has ended. */
interface End {
  state: "done" | "failed" | "cancelled" | "lost";
  text: string;
  more?: Fields;
}

/** Why a task is to end. */
class Ending extends Error {
  constructor(readonly end: End) {
    super(end.text);
  }
}

/**
 * Serves in its channel, until the signal is aborted: a task under way ends then, and the token returns.
 *
 * ```ts
 * await serve(client, "/waving", {
 *   verb: "wave",
 *   token: "/robot/token",
 *   async work(task) {
 *     const arm = await task.drive("/robot/arm");
 *     for (const height of [350, 250, 300]) {
 *       const end = await arm.carryOut(`move 0 0 ${height} 0 0`);
 *       if (!end.finished) throw new DriveError(end.text);
 *       await task.tell(`I am at ${height} mm`);
 *     }
 *     return "I have waved";
 *   },
 * }, { signal });
 * ```
 *
 * @throws MomError if its channel cannot be joined, or the connection is closed for good.
 */
export async function serve<W = Value | undefined>(client: Client, path: string, agent: Agent<W>, { signal }: { signal?: AbortSignal } = {}): Promise<void> {
  signal?.throwIfAborted();
  const channel = await client.channel(path);
  const events = channel.events();
  const life = new Life<W>(client, channel, agent);
  const end = (): void => void events.return();
  signal?.addEventListener("abort", end);
  try {
    if (!signal?.aborted) for await (const event of events) life.hear(event);
  } finally {
    signal?.removeEventListener("abort", end);
    await life.end();
  }
  if (!signal?.aborted) throw new MomError("closed", "disconnected", `${path} is gone, or the connection is closed`);
}

class Life<W> {
  #task: Task<W> | undefined;
  #working: Promise<void> | undefined;
  #away: ReturnType<typeof setTimeout> | undefined;

  constructor(
    readonly client: Client,
    readonly channel: Channel,
    readonly agent: Agent<W>,
  ) {}

  /** Hears what a peer asks for. */
  hear(event: Event): void {
    if ((event.type === "left" || event.type === "lost" || event.type === "resumed") && event.member.peer === this.#task?.peer) this.#notePeer(this.#task, event.type);
    if (event.type !== "message" || event.history) return;
    try {
      if (event.name === this.agent.verb) this.#take(event);
      else if (event.name === "cancel") this.#cancelFor(event.sender);
    } catch (error) {
      void this.#refuse(event, error as Refused);
    }
  }

  #notePeer(task: Task<W>, what: "left" | "lost" | "resumed"): void {
    clearTimeout(this.#away);
    const end = (why: string): void => task.end(new Ending({ state: "cancelled", text: `${task.peer} ${why}` }));
    if (what === "left") end("has left");
    else if (what === "lost") this.#away = setTimeout(() => end("has lost its connection"), AWAY);
  }

  #take(event: MessageEvent): void {
    const { agent } = this;
    if (this.#task) {
      const { peer, what, since } = this.#task;
      throw new Refused("try-later", `busy: ${peer} has had it ${agent.words?.(what) ?? agent.verb} for ${Math.floor((performance.now() - since) / 1000)} s`);
    }
    const task = new Task<W>(event.sender, this.#read(event), this.client, this.channel, event.parcel.id);
    this.#task = task;
    this.#working = this.#carryOut(task, event);
  }

  #read({ content }: MessageEvent): W {
    try {
      return this.agent.read ? this.agent.read(content) : (content as W);
    } catch (error) {
      if (error instanceof Refused) throw error;
      // Whatever a peer says, it does not end the agent.
      console.error(`what is asked for cannot be read`, error);
      throw new Refused("bad-content", `the content of \`${this.agent.verb}\` cannot be read: ${String(error)}`);
    }
  }

  #cancelFor(peer: string): void {
    if (!this.#task) throw new Refused("try-later", "there is no task to cancel");
    const owner = this.#task.peer;
    if (owner !== peer) throw new Refused("denied", `the task is ${owner}'s; only ${owner} cancels it`);
    this.#cancel(`${peer} cancelled it`);
  }

  #cancel(text: string): void {
    this.#task?.end(new Ending({ state: "cancelled", text }));
  }

  /** Ends a task under way, as the program ends. */
  async end(): Promise<void> {
    this.#cancel("the agent's program ends");
    if (this.#working) await within(LAST + 1000, this.#working);
  }

  /** Carries a task out, or refuses it, and says how it ended once the next one can be taken. */
  async #carryOut(task: Task<W>, event: MessageEvent): Promise<void> {
    let end: End | Refused;
    try {
      end = await this.#ended(task);
    } catch (error) {
      if (!(error instanceof Refused)) console.error(`the task of ${task.peer} failed`, error);
      end = error instanceof Refused ? error : { state: "failed", text: "the agent failed with an internal error" };
    }
    this.#task = undefined;
    if (end instanceof Refused) return this.#refuse(event, end);
    await task.say("progress", { ...sayableOf(end.more ?? {}), by: task.peer, state: end.state, text: sayable(end.text).slice(0, TEXT) });
  }

  async #ended(task: Task<W>): Promise<End> {
    const met = this.#token(task);
    const late = within(MET, met).then((isMet) => {
      if (!isMet) throw new Refused("try-later", `it could not be found out within ${MET / 1000} s whether that can be done`);
      return met;
    });
    const token = await unlessEnded(task, late).catch((error: unknown) => {
      throw error instanceof Ending ? new Refused("try-later", error.end.text) : error;
    });
    // Before anything is asked for, so that no offer is missed.
    const offers = token.events();
    try {
      await task.say("progress", { by: task.peer, state: "accepted", text: "offer me the token", agent: this.client.name }, [task.peer]);
      task.guard = await this.#offered(task, token, offers);
    } catch (error) {
      if (error instanceof Ending) return error.end;
      throw error;
    } finally {
      void offers.return();
    }
    return await this.#work(task, token, task.guard);
  }

  async #token(task: Task<W>): Promise<Token> {
    try {
      return await this.client.token((await this.agent.meet?.(task)) ?? this.agent.token ?? "");
    } catch (error) {
      throw error instanceof MomError ? new Refused("try-later", error.message) : error;
    }
  }

  /** The token, once the peer of the task offers it. */
  async #offered(task: Task<W>, token: Token, offers: Events): Promise<TokenGuard> {
    const failed = (text: string): Ending => new Ending({ state: "failed", text });
    const late = setTimeout(() => void offers.return(), OFFERED);
    const end = (): void => void offers.return();
    task.signal.addEventListener("abort", end);
    try {
      for await (const event of offers) {
        if (event.type !== "offer" || event.to !== this.client.name) continue;
        if (event.by !== task.peer) await token.decline().catch((error: unknown) => console.warn("an offer was not declined", error));
        else return await token.accept();
      }
    } catch (error) {
      throw failed(`accept ${token.path}: ${String(error)}`);
    } finally {
      clearTimeout(late);
      task.signal.removeEventListener("abort", end);
    }
    task.signal.throwIfAborted();
    throw failed(`${task.peer} did not offer the token within ${OFFERED / 1000} s`);
  }

  /** How the work ends: by itself, with the task, with the token, or with what was lent. */
  async #work(task: Task<W>, token: Token, guard: TokenGuard): Promise<End> {
    const watch = new AbortController();
    const lost = guard.lost.then((lost) => {
      // But for what this agent has given back itself.
      const isOurs = lost.by === this.client.name || (lost.by === undefined && lost.reason === "released");
      if (!isOurs) task.end(new Ending({ state: "lost", text: scopeWords(guard, lost) }));
    });
    void beyond(token, guard, watch.signal).then((text) => task.end(new Ending({ state: "failed", text })));
    await task.tell("");
    // What has ended already does not begin.
    if (task.signal.aborted) {
      watch.abort();
      await giveBack(task, guard);
      return (task.signal.reason as Ending).end;
    }
    const worked = (async () => this.agent.work(task))().then(
      (said): End => {
        const { text = "", ...more } = typeof said === "object" ? said : { text: said ?? "" };
        return { state: "done", text: String(text), more };
      },
      async (error: unknown): Promise<End> => {
        // A device that refuses because the token is lost may say so before the hub does.
        await within(ANSWER, Promise.race([lost, token.info().catch(() => undefined)]));
        if (error instanceof DriveError || error instanceof MomError) return { state: "failed", text: error.message };
        if (!task.signal.aborted) console.error(`the work for ${task.peer} failed`, error);
        return { state: "failed", text: "the agent failed with an internal error" };
      },
    );
    const end = await unlessEnded(task, worked).catch((error: unknown) => (error as Ending).end);
    watch.abort();
    const wrong = await giveBack(task, guard);
    task.end(new Ending(end));
    if (!(await within(LAST, worked))) {
      console.error(`the work for ${task.peer} does not end; the token was given back without it`);
      await worked;
    }
    if (wrong === undefined) return task.signal.reason instanceof Ending ? task.signal.reason.end : end;
    return { ...end, state: end.state === "done" ? "failed" : end.state, text: end.text ? `${end.text}; ${wrong}` : wrong };
  }

  #refuse({ name, sender, parcel: { id } }: MessageEvent, { code, text }: Refused): Promise<void> {
    const answer = new Task(sender, undefined, this.client, this.channel, id);
    return answer.say(`${name}-refused`, { code: CODES[code], name: code, text: sayable(text).slice(0, TEXT), by: sender }, [sender]);
  }
}

/** What this gives, unless the task is to end before: then it throws that. */
function unlessEnded<T, W>({ signal }: Task<W>, doing: Promise<T>): Promise<T> {
  return new Promise((resolve, reject) => {
    const abort = (): void => reject(signal.reason as Error);
    doing.then(resolve, reject).finally(() => signal.removeEventListener("abort", abort));
    if (signal.aborted) abort();
    else signal.addEventListener("abort", abort, { once: true });
  });
}

/** Whether it is over within so many ms. */
async function within(ms: number, doing: Promise<unknown>): Promise<boolean> {
  let timer: ReturnType<typeof setTimeout> | undefined;
  const late = new Promise<boolean>((resolve) => (timer = setTimeout(() => resolve(false), ms)));
  const isOver = await Promise.race([late, doing.then(() => true, () => true)]);
  clearTimeout(timer);
  return isOver;
}

/** Ends what is driven, and gives the token back; what is wrong with how the device took that, in words. */
async function giveBack<W>(task: Task<W>, guard: TokenGuard): Promise<string | undefined> {
  const ends = [...task.driven.map((driving) => driving.end()), ...(task.driven.length ? [] : [guard.release()])];
  const wrong = (await Promise.allSettled(ends)).filter((end) => end.status === "rejected").map(({ reason }) => (reason as Error).message);
  return wrong.length ? wrong.join("; ") : undefined;
}

/** Waits until what was lent is at its end though the hub has not said so: by our own clock, or as its lender has left it. */
async function beyond(token: Token, { delegation: loan, path }: TokenGuard, signal: AbortSignal): Promise<string> {
  const never = new Promise<string>(() => undefined);
  if (!loan) return never;
  const events = token.events();
  let isOver = false;
  const timer = loan.time === undefined ? undefined : setTimeout(() => void ((isOver = true), events.return()), loan.time + HUB);
  signal.addEventListener("abort", () => void (clearTimeout(timer), events.return()));
  // Of a loan without a giver the hub names none. A question that fails tells nothing; a lost link ends the work otherwise.
  const isLent = async (): Promise<boolean> => {
    const info = await token.info().catch(() => undefined);
    return !info || info["delegated"] !== undefined;
  };
  const left = `${loan.from}, who lent ${path}, has left`;
  if (!(await isLent())) return left;
  for await (const event of events) {
    if (event.type === "left" && event.member.peer === loan.from) return left;
    // Where many are, the hub tells how many.
    if ((event.type === "count" || event.type === "lagged") && !(await isLent())) return left;
  }
  return isOver ? `${usedUp(loan)}; the hub has not said so` : never;
}

/** Why the token is gone, in words; that a scope is used up, where the hub took it back by itself. */
function scopeWords({ delegation, path }: TokenGuard, lost: Lost): string {
  const isUsedUp = delegation && lost.reason === "returned" && lost.by === undefined;
  return `lost ${path}: ${isUsedUp ? `returned, as ${usedUp(delegation)}` : lossWords(lost)}`;
}

function usedUp({ time, commands }: { time?: number; commands?: number }): string {
  const limits = [...(time === undefined ? [] : [`${time / 1000} s`]), ...(commands === undefined ? [] : [`${commands} commands`])];
  return `the scope is used up: ${limits.join(" or ")}`;
}
