// A connection in requests of HTTP: some bring bytes up, others bring them down.
import { type Door, shown } from "./address.js";
import { EMPTY } from "./bytes.js";
import { disconnected } from "./error.js";
import type { Heard, Pipe } from "./pipe.js";
import { join } from "./sha256.js";

/** Brought up by one request before login: the hub takes one parcel. */
const MOST_BEFORE_LOGIN = 16 * 1024;
const MOST_UP = 128 * 1024;
/** Unacknowledged the hub sends so much. */
const WINDOW = 64 * 1024;
/** The hub lets an answer last so long, and this client waits a little longer. */
const LONGEST = 20_000;
const PATIENCE = 10_000;
/** Bytes that were sent and are not here after so long are held back by a proxy that waits for the answer's end. */
const HELD_BACK = 1000;
const HELD = new Error("a proxy holds the stream back");
/** Requests that fail are made again after these times; then the tunnel is broken. */
const AGAIN = [50, 250, 1000, 3000];

const sleep = (ms: number): Promise<void> => new Promise((resolve) => setTimeout(resolve, ms));
const number = (answer: Response, header: string): number | undefined => {
  const text = answer.headers.get(header);
  return text === null ? undefined : Number(text);
};

class Tunnel implements Pipe {
  #parts: Uint8Array[] = [];
  #up = 0;
  #down = 0;
  #told = 0;
  #expected = 0;
  #most = MOST_BEFORE_LOGIN;
  #streams: boolean;
  #tell = false;
  #ends = false;
  #over = false;
  #wake: () => void = () => undefined;
  #closing: ReturnType<typeof setTimeout> | undefined;
  #posting: Promise<unknown> | null = null;
  #reading = new AbortController();
  #writing = new AbortController();
  waiting = 0;

  constructor(
    readonly door: Door,
    private id: string,
    readonly heard: Heard,
  ) {
    this.#streams = !door.polled;
    void this.#bringUp();
    void this.#bringDown();
  }

  send(bytes: Uint8Array): void {
    if (this.#ends) return;
    this.#parts.push(bytes);
    this.waiting += bytes.length;
    this.#wake();
  }

  close(): void {
    this.#ends = true;
    this.#wake();
    // What it says last still comes down, unless it says nothing more.
    this.#closing ??= setTimeout(() => this.end("the tunnel is closed"), 1000);
  }

  end(why: string): void {
    if (this.#over) return;
    this.#over = true;
    clearTimeout(this.#closing);
    this.#reading.abort();
    this.#writing.abort();
    this.#wake();
    this.heard.end(why);
  }

  /** Asks until there is an answer of the hub; null where it is not waited for any more. */
  async #ask(method: "GET" | "POST", target: () => string, body: Uint8Array | undefined, most: number): Promise<Response | null> {
    for (let failures = 0; !this.#over; failures++) {
      const stop = new AbortController();
      if (method === "GET") this.#reading = stop;
      else this.#writing = stop;
      const timer = most < Infinity ? setTimeout(() => stop.abort(), most) : undefined;
      try {
        const answer = await fetch(`${shown(this.door)}${target()}`, {
          method,
          ...(body?.length ? { body: body as Uint8Array<ArrayBuffer> } : {}),
          cache: "no-store",
          credentials: "omit",
          signal: stop.signal,
        });
        if (answer.status !== 502 && answer.status !== 504) return answer;
      } catch {
        if (stop.signal.reason === HELD) return null;
      } finally {
        clearTimeout(timer);
      }
      const pause = AGAIN[failures];
      if (pause === undefined) this.end("the tunnel broke off: no answer came");
      else await sleep(pause);
    }
    return null;
  }

  /** Brings up what is written, until all of it is there. */
  async #bringUp(): Promise<void> {
    while (!this.#over) {
      if (!this.waiting && !this.#tell && !this.#ends) await new Promise<void>((resolve) => (this.#wake = resolve));
      if (this.#over) return;
      this.#tell = false;
      const [at, bytes] = [this.#up, this.#first(this.#most)];
      const last = this.#ends && this.waiting === bytes.length;
      const target = (): string => {
        this.#told = this.#down;
        return `/tunnel/${this.id}?at=${at}&ack=${this.#down}${last ? "&end=1" : ""}`;
      };
      const posted = this.#post(target, bytes);
      this.#posting = posted;
      const answer = await posted;
      this.#posting = null;
      if (!answer) return;
      this.#expect(number(answer, "mom-sent"));
      const taken = number(answer, "mom-taken");
      if (answer.status === 503) await sleep(AGAIN[0]!);
      else if ((answer.ok || answer.status === 409) && taken !== undefined && taken >= at && taken <= at + this.waiting) this.#forget(taken - at);
      else return this.end(`the hub answers ${answer.status} through the tunnel`);
      if (last && answer.ok && !this.waiting) return;
    }
  }

  /** Brings bytes up; the answer to those that log in has another id. */
  async #post(target: () => string, bytes: Uint8Array): Promise<Response | null> {
    const answer = await this.#ask("POST", target, bytes, LONGEST + PATIENCE);
    const renewed = answer?.headers.get("mom-tunnel");
    if (renewed) [this.id, this.#most] = [renewed, MOST_UP];
    await answer?.arrayBuffer().catch(() => undefined);
    return answer;
  }

  /** What waits, up to so much. */
  #first(most: number): Uint8Array {
    const taken: Uint8Array[] = [];
    let left = most;
    for (const part of this.#parts) {
      if (left === 0) break;
      taken.push(part.subarray(0, left));
      left -= Math.min(left, part.length);
    }
    return taken.length === 1 ? taken[0]! : taken.length ? join(...taken) : EMPTY;
  }

  #forget(count: number): void {
    this.#up += count;
    this.waiting -= count;
    for (let left = count; left > 0; ) {
      const part = this.#parts.shift()!;
      if (part.length > left) this.#parts.unshift(part.subarray(left));
      left -= Math.min(left, part.length);
    }
    if (count > 0) this.heard.drained();
  }

  /** Polls from now on, if what the hub has sent does not come. */
  #expect(sent: number | undefined): void {
    if (sent === undefined || sent <= this.#expected) return;
    this.#expected = sent;
    if (!this.#streams || sent <= this.#down) return;
    setTimeout(() => {
      if (!this.#streams || this.#down >= sent) return;
      this.#streams = false;
      this.#reading.abort(HELD);
    }, HELD_BACK);
  }

  /** Brings down what the hub says, as a stream or, where a proxy holds that back, by asking again and again. */
  async #bringDown(): Promise<void> {
    for (let failures = 0; !this.#over; ) {
      const id = this.id;
      const target = (): string => {
        this.#told = Math.max(this.#told, this.#down);
        return `/tunnel/${this.id}?at=${this.#down}${this.#streams ? "" : `&wait=${LONGEST}`}`;
      };
      const answer = await this.#ask("GET", target, undefined, this.#streams ? Infinity : LONGEST + PATIENCE);
      if (!answer) continue;
      if (answer.status === 404 && (await this.#isRenewed(id))) continue;
      if (answer.headers.has("mom-end") || answer.status === 404) return this.end("the hub closed the tunnel");
      if (answer.ok && (await this.#read(answer))) failures = 0;
      else if (!answer.ok) {
        const pause = AGAIN[failures++];
        if (pause === undefined) return this.end(`the hub answers ${answer.status} through the tunnel`);
        await sleep(pause);
      }
    }
  }

  /** Its id may just be renewed, by the answer to what is under way. */
  async #isRenewed(id: string): Promise<boolean> {
    if (this.id === id) await this.#posting;
    return this.id !== id;
  }

  async #read(answer: Response): Promise<boolean> {
    const reader = answer.body?.getReader();
    if (!reader) return true;
    try {
      for (;;) {
        const { done, value } = await reader.read();
        if (done || this.#over) return true;
        this.#down += value.length;
        this.heard.bytes(value);
        if (this.#down - this.#told >= WINDOW / 4) {
          this.#tell = true;
          this.#wake();
        }
      }
    } catch {
      // It goes on behind what has come.
      await sleep(AGAIN[0]!);
      return false;
    }
  }
}

/** Opens a tunnel. */
export async function openTunnel(door: Door, heard: Heard, aborted: AbortSignal): Promise<Pipe> {
  let answer: Response;
  try {
    answer = await fetch(`${shown(door)}/tunnel`, { method: "POST", cache: "no-store", credentials: "omit", signal: aborted });
  } catch (error) {
    throw disconnected(String(error instanceof Error && error.cause instanceof Error ? error.cause.message : error));
  }
  const id = answer.headers.get("mom-tunnel");
  const said = await answer.text();
  if (answer.status !== 201 || !id || !/^[0-9a-fA-F]{32}$/.test(id)) throw disconnected(`no tunnel: ${answer.status} ${said.slice(0, 200)}`);
  const tunnel = new Tunnel(door, id, heard);
  aborted.addEventListener("abort", () => tunnel.end("another door was faster"), { once: true });
  return tunnel;
}
