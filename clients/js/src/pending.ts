import { MomError } from "./error.js";
import { type Parcel, errorOf, nameOf } from "./parcel.js";

interface Waiting {
  parcel: Parcel;
  resolve: (reply: Parcel) => void;
  reject: (error: MomError) => void;
  timer: ReturnType<typeof setTimeout> | undefined;
  /** What to do with an answer that nobody waits for any more. */
  late: ((reply: Parcel) => void) | undefined;
  over: boolean;
}

/** Requests without an answer yet. */
export class Pending {
  readonly #open = new Map<number, Waiting>();

  /** Waits for the answer to a request. */
  wait(parcel: Parcel, id: number, timeout: number, late?: (reply: Parcel) => void): Promise<Parcel> {
    return new Promise((resolve, reject) => {
      const waiting: Waiting = { parcel, resolve, reject, timer: undefined, late, over: false };
      const overdue = (): void => {
        this.#fail(id, new MomError("timed-out", "timed-out", `no answer to ${nameOf(parcel)} within ${timeout} ms; it is unknown whether it was carried out`));
      };
      if (timeout < Infinity) waiting.timer = setTimeout(overdue, timeout);
      this.#open.set(id, waiting);
    });
  }

  has(id: number): boolean {
    return this.#open.has(id);
  }

  /** Gives an answer to who waits for it; false if nobody does. */
  answer(reply: Parcel): boolean {
    const waiting = this.#open.get(reply.reference ?? -1);
    if (!waiting) return false;
    this.#open.delete(reply.reference ?? -1);
    clearTimeout(waiting.timer);
    if (waiting.over) {
      if (reply.family === "reply") waiting.late?.(reply);
    } else if (reply.family === "error") waiting.reject(errorOf(reply));
    else waiting.resolve(reply);
    return true;
  }

  #fail(id: number, error: MomError): void {
    const waiting = this.#open.get(id);
    if (!waiting || waiting.over) return;
    waiting.over = true;
    clearTimeout(waiting.timer);
    if (!waiting.late) this.#open.delete(id);
    waiting.reject(error);
  }

  /** This one will not be answered. */
  fail(id: number, error: MomError): void {
    this.#fail(id, error);
    this.#open.delete(id);
  }

  failAll(why: (parcel: Parcel) => MomError): void {
    for (const [id, { parcel }] of [...this.#open]) this.fail(id, why(parcel));
  }
}
