import { type Fields, int, text } from "./value.js";

/**
 * What kind of failure it is: `refused` by the hub, no `connection` now (with the code `lost` if what was said never left, and `unknown` if
 * nobody can say whether the hub has read it), no answer in time (`timed-out`; it is unknown whether the request
 * was carried out), `closed` for good, or wrong on this side (`local`).
 */
export type ErrorKind = "refused" | "connection" | "timed-out" | "closed" | "local";

/** The words that arise on this side. */
const NUMBERS: Record<string, number> = {
  "timed-out": 102,
  "bad-login": 201,
  "wrong-kind": 215,
  "bad-slot": 220,
  "bad-path": 221,
  "bad-content": 223,
  "bad-encoding": 224,
  "too-deep": 228,
  "not-encodable": 229,
  disconnected: 305,
  "bad-frame": 400,
  "bad-version": 401,
  "too-large": 403,
  insecure: 404,
};

/** Why something failed. */
export class MomError extends Error {
  override readonly name = "MomError";

  /** @internal */
  constructor(
    readonly kind: ErrorKind,
    /** The word of the code, as `held`. */
    readonly code: string,
    /** Plain words. */
    readonly text: string,
    /** The number of the code; a program that does not know the word goes by its range. */
    readonly number: number = NUMBERS[code] ?? 299,
    /** All that the hub said, by the keys of docs/PROTOCOL.md. */
    readonly content: Fields = {},
  ) {
    super(`${code}: ${text}`);
  }

  /** Milliseconds after which the same request may pass. */
  get retryAfter(): number | undefined {
    return int(this.content, "retry-after");
  }

  /** The rule that refused. */
  get rule(): string | undefined {
    return text(this.content, "rule");
  }

  /** The slot at fault. */
  get slot(): string | undefined {
    return text(this.content, "slot");
  }

  /** The nearest thing that exists. */
  get nearest(): string | undefined {
    return text(this.content, "nearest");
  }

  /** The peer that owns the token. */
  get owner(): string | undefined {
    return text(this.content, "owner");
  }

  /** Whether the same request may pass later. */
  get mayRetry(): boolean {
    return this.number < 200;
  }

  /** Whether a client that was closed with it, or not let in, should come back. */
  get mayReconnect(): boolean {
    return this.kind === "connection" || this.kind === "timed-out" || this.number < 200 || Math.floor(this.number / 100) === 3;
  }
}

/** @internal */
export function local(code: string, text: string): MomError {
  return new MomError("local", code, text);
}

/** @internal */
export function disconnected(text: string): MomError {
  return new MomError("connection", "disconnected", text);
}
