// Attempts to reach the hub, over whichever door opens.
import { type Door, doorsOf, isPrivate, shown } from "./address.js";
import { MomError, disconnected, local } from "./error.js";
import type { Said } from "./ledger.js";
import { type Link, type NextId, type Resumed, type Welcome, credentials, logIn, resume, sign } from "./login.js";
import type { ConnectOptions, Proof } from "./options.js";
import type { Parcel } from "./parcel.js";
import type { WebSocketClass } from "./pipe.js";
import { reportFailure } from "./report.js";
import type { Fields } from "./value.js";
import { type Wire, connectWire } from "./wire.js";

const FIRST_WAIT = 100;
const LONGEST_WAIT = 30_000;
/** From so long before the end of the grace time on, at most, each wait is half of what is left of it. */
const LAST_ATTEMPT = 500;
/** … but no less than this. */
const SHORTEST_WAIT = 50;

/** The door that worked last, by address: it is tried first. */
const worked = new Map<string, string>();

/** Whether others must not hear the proof. */
function isSecret({ password, token }: ConnectOptions): boolean {
  return password !== undefined || token !== undefined;
}

/** What an attempt gave. */
export interface Connected {
  wire: Wire;
  resumed: Resumed | null;
  welcome: Welcome | null;
}

export class Connector {
  /** Numbers of contexts hold over the connections of a link. */
  readonly numbers = new Map<number, string>();
  readonly #ended = new AbortController();
  /** A WebSocket has opened and come to nothing, so a tunnel that has worked has its turn. */
  #tunnelFirst = false;
  /** Who reports the first failure, as long as no attempt has come to its end. */
  #reporter: ConnectOptions["report"];

  constructor(
    readonly address: string,
    private options: ConnectOptions,
    readonly nextId: NextId,
  ) {
    this.#reporter = options.report;
    options.signal?.addEventListener("abort", () => this.end(), { once: true });
    if (options.signal?.aborted) this.end();
  }

  /** What a login by another proof says; kept for later ones when it has succeeded. */
  changed(proof: Proof): { login(): Promise<Fields>; answer(reply: Parcel): Promise<Fields>; keep(): void } {
    const { password: _password, key: _key, token: _token, guest: _guest, ...others } = this.options;
    const options: ConnectOptions = { ...others, ...proof };
    return {
      login: () => {
        doorsOf(worked.get(this.address) ?? this.address, isSecret(options), false);
        return credentials(options);
      },
      answer: async (reply) => ({ signature: await sign(options, reply) }),
      keep: () => void (this.options = options),
    };
  }

  /** No more attempts. */
  end(): void {
    this.#ended.abort();
  }

  attempts(within: number): Attempts {
    return new Attempts(within, this.#ended.signal);
  }

  /** All doors, the one that worked last first; but the WebSocket beside a tunnel goes before it, or one failure would be for good. */
  #doors(): Door[] {
    const doors = doorsOf(this.address, isSecret(this.options), globalThis.location?.protocol === "https:");
    const known = worked.get(this.address) ?? "";
    const best = this.#tunnelFirst ? known : known.replace(/^http/, "ws");
    const rank = (door: Door): number => (shown(door) === best ? 2 : Number(shown(door) === known));
    return doors.sort((a, b) => rank(b) - rank(a));
  }

  /** The WebSockets to which a link may move: as private as the tunnel that it is on. */
  #better(): Door[] {
    return this.#doors().filter((door) => door.kind === "websocket" && isPrivate(door));
  }

  /** Whether a better door than this one is to be looked for. */
  isSecondBest({ kind }: Door): boolean {
    return kind === "tunnel" && this.options.seekWebSocket !== 0 && this.#make !== undefined && this.#better().length > 0;
  }

  get #make(): WebSocketClass | undefined {
    return this.options.webSocket ?? (globalThis.WebSocket as WebSocketClass | undefined);
  }

  /** One attempt, within its time: a link is resumed; if it cannot be, it is lost and a login follows. */
  connect(link: Link | null, read: Said, notResumed: () => void): Promise<Connected> {
    return this.#attempt(this.#doors(), async (wire) => {
      const secret = isSecret(this.options);
      if (secret && !isPrivate(wire.pipe.door)) throw local("insecure", "others could read this door");
      const resumed = link && (await this.#resume(wire, link, read));
      if (link && !resumed) {
        notResumed();
        wire.numbers.clear();
      }
      const welcome = resumed ? null : await logIn(wire, this.options, this.nextId);
      return this.#through({ wire, resumed, welcome });
    });
  }

  /** Goes on with a link over a WebSocket, if one opens and carries an answer; `read` is asked for last. Null if the hub does not. */
  move(link: Link, read: () => Promise<Said>): Promise<Connected | null> {
    return this.#attempt(this.#better(), async (wire) => {
      wire.post({ family: "time", name: "ping", id: this.nextId() });
      while ((await wire.next()).name !== "pong");
      const resumed = await this.#resume(wire, link, read);
      if (resumed) return this.#through({ wire, resumed, welcome: null });
      wire.drop();
      return null;
    });
  }

  async #attempt<T>(doors: Door[], enter: (wire: Wire) => Promise<T>): Promise<T> {
    const attempt = new AbortController();
    const stop = attempt.signal;
    const late = disconnected("the hub did not answer the login in time");
    const timer = setTimeout(() => attempt.abort(late), this.options.connectTimeout ?? 10_000);
    const end = (): void => attempt.abort();
    this.#ended.signal.addEventListener("abort", end);
    if (this.#ended.signal.aborted) end();
    let wire: Wire | null = null;
    stop.addEventListener("abort", () => wire?.drop());
    try {
      wire = await connectWire(doors, this.#make, { compress: this.options.compress === true }, stop, this.options.stagger);
      return await enter(wire);
    } catch (error) {
      wire?.drop();
      if (this.#reporter && !this.#ended.signal.aborted) reportFailure(this.address, error, this.#reporter);
      this.#reporter = undefined;
      this.#tunnelFirst = wire?.pipe.door.kind === "websocket" && (error as MomError).kind === "connection";
      throw wire && stop.reason === late ? late : error;
    } finally {
      clearTimeout(timer);
      this.#ended.signal.removeEventListener("abort", end);
    }
  }

  #resume(wire: Wire, link: Link, read: Said | (() => Promise<Said>)): Promise<Resumed | null> {
    for (const [number, path] of this.numbers) wire.numbers.set(number, path);
    return resume(wire, link, read, this.nextId);
  }

  /** This door leads to the hub. */
  #through(connected: Connected): Connected {
    const { wire } = connected;
    wire.numbers = this.#keep(wire.numbers);
    worked.set(this.address, shown(wire.pipe.door));
    [this.#tunnelFirst, this.#reporter] = [false, undefined];
    return connected;
  }

  #keep(numbers: Map<number, string>): Map<number, string> {
    for (const [number, path] of numbers) this.numbers.set(number, path);
    return this.numbers;
  }
}

/** The waits between attempts: at random up to a bound that doubles, so that a fleet does not come back all at once. */
export class Attempts {
  readonly #begin = performance.now();
  #bound = FIRST_WAIT;

  constructor(
    readonly within: number,
    readonly ended: AbortSignal,
  ) {}

  /** Takes a failed attempt; throws if none may follow. */
  failed(error: MomError): void {
    if (this.ended.aborted) throw disconnected("this client is closed");
    if (error.kind === "local" || !error.mayReconnect) throw error;
    const passed = performance.now() - this.#begin;
    if (passed >= this.within) throw disconnected(`given up after ${Math.round(passed)} ms: ${error.text}`);
  }

  /**
   * How long to wait, but no less than the hub asked for. While a link can be resumed, which is for `left` ms of its grace time, several
   * attempts fall into that, and more of them just before its end.
   */
  next(error: MomError | undefined, grace = 0, left = 0): number {
    const last = left - Math.min(LAST_ATTEMPT, grace / 8);
    if (last <= 0 && left > SHORTEST_WAIT) return Math.max(left / 2, SHORTEST_WAIT, error?.retryAfter ?? 0);
    const bound = last > 0 ? Math.min(this.#bound, grace / 4) : this.#bound;
    this.#bound = Math.min(2 * this.#bound, LONGEST_WAIT);
    return Math.max(Math.min(Math.random() * bound, last > 0 ? last : Infinity), error?.retryAfter ?? 0);
  }

  /** Waits; a network that comes back ends it. */
  async wait(error: MomError | undefined, grace?: number, left?: number): Promise<void> {
    const wait = this.next(error, grace, left);
    await new Promise<void>((resolve) => {
      const wake = (): void => {
        clearTimeout(timer);
        globalThis.removeEventListener?.("online", wake);
        this.ended.removeEventListener("abort", wake);
        resolve();
      };
      const timer = setTimeout(wake, wait);
      this.ended.addEventListener("abort", wake);
      if (!error?.retryAfter) globalThis.addEventListener?.("online", wake);
    });
    if (this.ended.aborted) throw disconnected("this client is closed");
  }
}
