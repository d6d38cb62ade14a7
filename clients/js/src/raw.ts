import { doorsOf } from "./address.js";
import { encode } from "./binary.js";
import type { Parcel } from "./parcel.js";
import type { WebSocketClass } from "./pipe.js";
import { type WireOptions, connectWire } from "./wire.js";

/** What a bare connection is made with. */
export interface RawOptions extends WireOptions {
  webSocket?: WebSocketClass;
  /** Called with each parcel but pings, in the order of arrival. */
  onParcel: (parcel: Parcel) => void;
  onEnd: (why: string) => void;
}

/** A bare connection: what is said, its user says. */
export interface RawConnection {
  sendParcel(parcel: Parcel): void;
  /** Ends it after what was sent. */
  close(): void;
}

/**
 * Connects without logging in, resuming or coming back, for tools that say everything themselves. Pings of the hub are answered. Nothing
 * keeps a secret from doors that others can read.
 */
export async function connectRaw(address: string, options: RawOptions): Promise<RawConnection> {
  const make = options.webSocket ?? (globalThis.WebSocket as WebSocketClass | undefined);
  const late = new AbortController();
  const timer = setTimeout(() => late.abort(), 10_000);
  const wire = await connectWire(doorsOf(address, false, false), make, options, late.signal).finally(() => clearTimeout(timer));
  wire.take({
    parcel: (parcel) => parcel && (parcel.family !== "time" || parcel.name !== "ping") && options.onParcel(parcel),
    drained: () => undefined,
    ended: options.onEnd,
  });
  return { sendParcel: (parcel) => wire.pipe.send(encode(parcel)), close: () => wire.pipe.close() };
}
