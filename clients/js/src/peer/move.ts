// From the tunnel back to a WebSocket.
import { local } from "../error.js";
import type { Said } from "../ledger.js";
import type { Link } from "../login.js";
import type { Peer } from "./peer.js";
import type { Wire } from "../wire.js";

/** A WebSocket is looked for first after so long, and so seldom at most. */
const FIRST_SEARCH = 5000;
const LONGEST_SEARCH = 300_000;
/** Messages are held back for so long at most, and the hub has as long to answer the last word. */
const LONGEST_HOLD = 2000;

/** Looks for a WebSocket while a peer is on the tunnel, and moves its link there. */
export class Mover {
  /** Whether all but stops waits, since the link is about to move. */
  holding = false;

  constructor(readonly peer: Peer) {}

  /** Looks now and then, as long as this connection lasts; gives what ends that. */
  seek(wire: Wire, wait = FIRST_SEARCH): () => void {
    const again = (): ReturnType<typeof setTimeout> => setTimeout(() => void seek(), wait * (1 - Math.random() / 2));
    const seek = async (): Promise<void> => {
      if (await this.#move(wire)) wait = Math.min(2 * wait, LONGEST_SEARCH);
      if (this.peer.wire === wire) timer = again();
    };
    let timer = again();
    return () => clearTimeout(timer);
  }

  /** Whether a move would harm: to the hub it is a loss, at which devices of tokens are halted, and commands to a device are dropped. */
  get #mustStay(): boolean {
    const { guards, places } = this.peer;
    return !guards.isEmpty || places.all().some(({ terms }) => terms?.["device"] === true);
  }

  /** Moves the link, if a WebSocket works; false if it must not be tried now. What fails before the last word changes nothing. */
  async #move(old: Wire): Promise<boolean> {
    const { peer } = this;
    const link = peer.link;
    if (!link || this.#mustStay) return false;
    let left = false;
    let late: ReturnType<typeof setTimeout> | undefined;
    // Nobody knows over which connection the hub goes on.
    const giveUp = (why: string): void => {
      if (!left || peer.wire !== old) return;
      this.holding = false;
      peer.endServing(why);
      peer.wire = null;
    };
    const leave = async (): Promise<Said> => {
      await this.#settle(old, link);
      left = true;
      late = setTimeout(giveUp, LONGEST_HOLD, "the hub did not say whether the link has moved");
      old.leave();
      return peer.ledger.said;
    };
    try {
      const found = await peer.connector.move(link, leave);
      if (peer.wire !== old || peer.link !== link) found?.wire.drop();
      else if (found) peer.moveTo(found);
      else if (left) peer.take(old);
    } catch (error) {
      giveUp(String(error));
    } finally {
      clearTimeout(late);
      this.holding = false;
      peer.pump();
    }
    return true;
  }

  /** Holds back what the move could lose, until the hub has read all that was said before. */
  async #settle(old: Wire, link: Link): Promise<void> {
    const { peer } = this;
    const stays = (): boolean => peer.wire !== old || peer.link !== link || this.#mustStay || peer.isEnding;
    if (!stays()) {
      this.holding = true;
      // It acknowledges all of that before it answers.
      await peer.pending.wait({ family: "time", name: "ping" }, peer.ping(), LONGEST_HOLD);
      if (!stays() && peer.ledger.kept.every((entry) => entry.reliable && !entry.perishable)) return;
    }
    throw local("not-now", "the link cannot move now");
  }
}
