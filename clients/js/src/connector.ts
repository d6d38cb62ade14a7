// Attempts to reach the hub, over whichever door opens.
import { doorsOf, isPrivate, shown } from "./address.js";
import { MomError, disconnected, local } from "./error.js";
import { type Link, type NextId, type Resumed, type Welcome, credentials, logIn, resume, sign } from "./login.js";
import type { ConnectOptions, Proof } from "./options.js";
import type { Parcel } from "./parcel.js";
import type { WebSocketClass } from "./pipe.js";
import type { Fields } from "./value.js";
import { type Wire, connectWire } from "./wire.js";

const FIRST_WAIT = 100;
const LONGEST_WAIT = 30_000;

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

  constructor(
    readonly address: string,
    private options: ConnectOptions,
    readonly nextId: NextId,
  ) {
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

  /** One attempt, within its time: a link is resumed; if it cannot be, it is lost and a login follows. */
  async connect(link: Link | null, read: number, notResumed: () => void): Promise<Connected> {
    const secret = isSecret(this.options);
    const doors = doorsOf(this.address, secret, globalThis.location?.protocol === "https:");
    const first = worked.get(this.address);
    doors.sort((a, b) => Number(shown(b) === first) - Number(shown(a) === first));
    const attempt = new AbortController();
    const stop = attempt.signal;
    const late = disconnected("the hub did not answer the login in time");
    const timer = setTimeout(() => attempt.abort(late), this.options.connectTimeout ?? 10_000);
    const end = (): void => attempt.abort();
    this.#ended.signal.addEventListener("abort", end);
    if (this.#ended.signal.aborted) end();
    const make = this.options.webSocket ?? (globalThis.WebSocket as WebSocketClass | undefined);
    let wire: Wire | null = null;
    stop.addEventListener("abort", () => wire?.drop());
    try {
      wire = await connectWire(doors, make, {}, stop, this.options.stagger);
      return await this.#enter(wire, secret, link, read, notResumed);
    } catch (error) {
      wire?.drop();
      throw wire && stop.reason === late ? late : error;
    } finally {
      clearTimeout(timer);
      this.#ended.signal.removeEventListener("abort", end);
    }
  }

  async #enter(wire: Wire, secret: boolean, link: Link | null, read: number, notResumed: () => void): Promise<Connected> {
    if (secret && !isPrivate(wire.pipe.door)) throw local("insecure", "others could read this door");
    if (link) for (const [number, path] of this.numbers) wire.numbers.set(number, path);
    const resumed = link ? await resume(wire, link, read, this.nextId) : null;
    if (link && !resumed) {
      notResumed();
      wire.numbers.clear();
    }
    const welcome = resumed ? null : await logIn(wire, this.options, this.nextId);
    wire.numbers = this.#keep(wire.numbers);
    worked.set(this.address, shown(wire.pipe.door));
    return { wire, resumed, welcome };
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

  /** Waits, but no less than the hub asked for; a network that comes back ends it. */
  async wait(error: MomError | undefined): Promise<void> {
    const wait = Math.max(Math.random() * this.#bound, error?.retryAfter ?? 0);
    this.#bound = Math.min(2 * this.#bound, LONGEST_WAIT);
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
