// A second connection for what the link does not take: another door, another place in the network's queues.
import { type Client, connect } from "mom-client";
import type { Login } from "./protocol.js";
import { proofOf } from "./session.js";

/** Who needs one within so many ms of its beginning shares it; later it may hang as the link does. */
const SHARED = 500;
/** ms between the doors that are tried: a browser lets one WebSocket at a time begin at one hub, and the link's own attempt may hang there. */
const STAGGER = 50;

interface Opening {
  login: Login;
  begun: number;
  client: Promise<Client>;
  giveUp: AbortController;
  users: number;
}

export class Second {
  #newest: Opening | null = null;

  /**
   * Lends a connection, which all who need one at the same time share, until `use` has ended; it is given up after so many ms if no door opens, or when
   * it is needed no more.
   */
  async lend(login: Login, within: number, unneeded: Promise<void>, use: (client: Client) => Promise<void>): Promise<void> {
    const known = this.#newest;
    const opening = known?.login === login && performance.now() - known.begun < SHARED ? known : this.#open(login, within);
    opening.users += 1;
    try {
      const client = await Promise.race([opening.client, unneeded.then(() => null)]);
      if (client) await use(client);
    } finally {
      opening.users -= 1;
      if (!opening.users) this.#end(opening);
    }
  }

  #open(login: Login, within: number): Opening {
    const giveUp = new AbortController();
    const client = connect(login.address, { ...proofOf(login), reconnect: false, connectWithin: within, connectTimeout: within, stagger: STAGGER, signal: giveUp.signal });
    return (this.#newest = { login, begun: performance.now(), client, giveUp, users: 0 });
  }

  #end(opening: Opening): void {
    if (this.#newest === opening) this.#newest = null;
    opening.giveUp.abort();
  }
}
