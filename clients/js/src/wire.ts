import type { Door } from "./address.js";
import { PREFACE, decode, encode } from "./binary.js";
import { MomError, disconnected } from "./error.js";
import { Frames } from "./frames.js";
import { CAN_INFLATE, Inflater } from "./inflater.js";
import type { Parcel } from "./parcel.js";
import type { Heard, Pipe, WebSocketClass } from "./pipe.js";
import { Time } from "./value.js";
import { openTunnel } from "./tunnel.js";
import { openWebSocket } from "./websocket.js";

/** Who uses a connection. */
export interface Listener {
  /** A parcel was read whole; null for one that says nothing to this client. */
  parcel(parcel: Parcel | null, size: number): void;
  drained(): void;
  ended(why: string): void;
}

/** How a connection reads and answers. */
export interface WireOptions {
  /** Maps as `Map`, whole doubles as `Double`. */
  exact?: boolean;
  /** Whether pongs tell the time, so that the hub measures this clock. */
  stamps?: boolean;
  /** Whether the hub may compress what it says, as a login asks for by `compress: ["stream-deflate"]`. */
  compress?: boolean;
}

/** One connection to a hub: parcels both ways. Until it is taken, what comes waits. */
export class Wire implements Heard {
  pipe!: Pipe;
  /** Called before a pong. */
  beforePong: () => void = () => undefined;
  /** The paths of contexts that the hub names by number. */
  numbers = new Map<number, string>();
  readonly frames = new Frames();
  #waiting: [Parcel | null, number][] = [];
  #wake: () => void = () => undefined;
  #listener: Listener | null = null;
  #ended: string | null = null;
  #inflater: Inflater | null = null;
  /** Why it ends, once what has come is opened. */
  #ends: string | null = null;

  constructor(readonly options: WireOptions = {}) {
    if (options.compress && CAN_INFLATE) this.frames.onStream = (rest) => this.#inflate(rest);
  }

  bytes(bytes: Uint8Array): void {
    if (this.#inflater) return this.#inflater.push(bytes);
    this.#take(bytes);
  }

  #take(bytes: Uint8Array): void {
    if (this.#ended !== null) return;
    try {
      for (const frame of this.frames.push(bytes)) this.#frame(frame);
    } catch (error) {
      if (!(error instanceof MomError)) throw error;
      this.pipe.close();
      this.#end(error.message);
    }
  }

  #inflate(rest: Uint8Array): void {
    this.frames.onStream = null;
    this.#inflater = new Inflater(
      (bytes) => this.#take(bytes),
      (why) => {
        if (this.#ends === null) this.pipe.close();
        this.#end(this.#ends ?? why);
      },
    );
    this.#inflater.push(rest);
  }

  drained(): void {
    this.#listener?.drained();
  }

  end(why: string): void {
    if (!this.#inflater) return this.#end(why);
    this.#ends ??= why;
    this.#inflater.close();
  }

  #end(why: string): void {
    if (this.#ended !== null) return;
    this.#ended = why;
    this.#wake();
    this.#listener?.ended(why);
  }

  /** Sends a parcel at once. */
  post(parcel: Parcel): void {
    this.pipe.send(encode(parcel));
  }

  /** The next parcel, before anybody takes the connection. */
  async next(): Promise<Parcel> {
    for (;;) {
      const [parcel] = this.#waiting.shift() ?? [];
      if (parcel) return parcel;
      if (parcel === null) continue;
      if (this.#ended !== null) throw disconnected(this.#ended);
      await new Promise<void>((resolve) => (this.#wake = resolve));
    }
  }

  /** Gives a listener what comes from now on, and what waits. */
  take(listener: Listener): void {
    this.#listener = listener;
    for (const [parcel, size] of this.#waiting.splice(0)) listener.parcel(parcel, size);
    if (this.#ended !== null) listener.ended(this.#ended);
  }

  /** What comes from now on waits, until it is taken again. */
  leave(): void {
    this.#listener = null;
  }

  /** Nobody hears anything of it any more. */
  drop(): void {
    this.#listener = null;
    this.#ended ??= "it was given up";
    this.#wake();
    this.#inflater?.close();
    this.pipe?.close();
  }

  #frame(frame: Uint8Array): void {
    const parcel = this.#read(frame);
    if (parcel?.family === "time" && parcel.name === "ping") this.#pong(parcel);
    if (this.#listener) this.#listener.parcel(parcel, frame.length + 5);
    else {
      this.#waiting.push([parcel, frame.length + 5]);
      this.#wake();
    }
  }

  #read(frame: Uint8Array): Parcel | null {
    try {
      const parcel = decode(frame, this.options.exact);
      if (parcel?.number !== undefined) {
        if (parcel.context === undefined) {
          const path = this.numbers.get(parcel.number);
          if (path !== undefined) parcel.context = path;
        } else this.numbers.set(parcel.number, parcel.context);
      }
      return parcel;
    } catch (error) {
      if (error instanceof MomError) return null;
      throw error;
    }
  }

  #pong(ping: Parcel): void {
    this.beforePong();
    const pong: Parcel = { family: "time", name: "pong" };
    if (ping.id !== undefined) pong.reference = ping.id;
    if (this.options.stamps !== false) {
      const received = Time.now();
      pong.content = { received, sent: received };
    }
    this.post(pong);
  }
}

/** Connects through the first of the doors that opens; each is tried so many ms after the one before, or when that has failed. */
export async function connectWire(doors: readonly Door[], make: WebSocketClass | undefined, options: WireOptions, signal: AbortSignal, stagger = 250): Promise<Wire> {
  const failures: string[] = [];
  const tries = doors.map(() => new AbortController());
  return new Promise<Wire>((resolve, reject) => {
    let left = doors.length;
    let started = 0;
    let settled = false;
    const settle = (): void => {
      settled = true;
      clearTimeout(timer);
    };
    let timer: ReturnType<typeof setTimeout>;
    const giveUp = (): void => {
      settle();
      for (const each of tries) each.abort();
      reject(disconnected(`no door opened in time${failures.length ? ` (${failures.join("; ")})` : ""}`));
    };
    signal.addEventListener("abort", () => settled || giveUp(), { once: true });
    const start = (): void => {
      clearTimeout(timer);
      const place = started++;
      const door = doors[place];
      if (!door || settled) return;
      timer = setTimeout(start, stagger);
      const wire = new Wire(options);
      open(door, make, wire, tries[place]!.signal).then(
        (pipe) => {
          wire.pipe = pipe;
          if (settled) return wire.drop();
          settle();
          tries.forEach((each, other) => other === place || each.abort());
          pipe.send(PREFACE);
          resolve(wire);
        },
        (error: unknown) => {
          const why = error instanceof MomError ? error.text : String(error);
          failures.push(`${door.kind} ${door.tls ? "with TLS " : ""}at ${door.host}:${door.port}: ${why}`);
          left -= 1;
          if (settled) return;
          if (left === 0) {
            settle();
            reject(disconnected(failures.join("; ")));
          } else start();
        },
      );
    };
    start();
  });
}

async function open(door: Door, make: WebSocketClass | undefined, heard: Heard, aborted: AbortSignal): Promise<Pipe> {
  if (door.kind === "tunnel") return openTunnel(door, heard, aborted);
  if (!make) throw disconnected("this platform has no WebSocket: pass one as `webSocket`, for example that of the package ws");
  return openWebSocket(door, make, heard, aborted);
}
