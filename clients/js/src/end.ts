// The end of a peer whose page is gone.
import { doorsOf } from "./address.js";
import { MomError } from "./error.js";
import { resumeToEnd } from "./login.js";
import type { ConnectOptions } from "./options.js";
import type { WebSocketClass } from "./pipe.js";
import { connectWire } from "./wire.js";

/** What ends a peer from elsewhere. */
export interface LinkCredential {
  id: string;
  secret: Uint8Array;
}

const WITHIN = 3000;

/**
 * Ends a peer that has lost its connection and will not come back, such as that of a page that was loaded anew: its name and its tokens are
 * free at once, not after the grace time. Does nothing if the hub knows of no such link.
 *
 * @throws MomError `connection` for a hub that cannot be reached.
 */
export async function endPeer(address: string, credential: LinkCredential, options: Pick<ConnectOptions, "webSocket"> = {}): Promise<void> {
  const make = options.webSocket ?? (globalThis.WebSocket as WebSocketClass | undefined);
  const late = new AbortController();
  const timer = setTimeout(() => late.abort(new MomError("timed-out", "timed-out", `the hub did not answer within ${WITHIN} ms`)), WITHIN);
  const doors = doorsOf(address, true, globalThis.location?.protocol === "https:");
  try {
    const wire = await connectWire(doors, make, {}, late.signal);
    late.signal.addEventListener("abort", () => wire.drop());
    try {
      let id = 0;
      const nextId = (): number => ++id;
      // A hub that has not kept what it had not read ends it for that.
      const resumed = await resumeToEnd(wire, credential, nextId);
      if (resumed) {
        wire.post({ family: "time", name: "resent" });
        const logout = nextId();
        wire.post({ family: "login", name: "logout", id: logout });
        for (let parcel = await wire.next(); parcel.reference !== logout; ) parcel = await wire.next();
      }
    } catch (error) {
      if (!(error instanceof MomError) || (error.kind !== "refused" && error.code !== "disconnected")) throw error;
    } finally {
      wire.drop();
    }
  } finally {
    clearTimeout(timer);
  }
}
