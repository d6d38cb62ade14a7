import type { Client, ContextSpec } from "./client.js";
import { asyncDispose } from "../disposal.js";
import type { ContextInfo, Events, Member } from "../events.js";
import type { Fields } from "../value.js";

/** A context that this peer has joined. */
export abstract class Joined {
  /** @internal */
  constructor(
    readonly client: Client,
    readonly path: string,
  ) {}

  /** What happens there from now on; the first subscriber gets what came since the join, too. */
  events(): Events {
    return this.client.peer.events(this.path);
  }

  /** Its details, by the keys of docs/PROTOCOL.md. */
  info(): Promise<Fields> {
    return this.client.info(this.path);
  }

  /** Its members. */
  members(): Promise<Member[]> {
    return this.client.members(this.path);
  }

  /** Leaves it and all below it. */
  leave(): Promise<void> {
    return this.client.peer.leave(this.path);
  }

  /** The same, for `await using`; does nothing if this peer is not there any more. */
  async [asyncDispose](): Promise<void> {
    if (this.client.peer.places.get(this.path)) await this.leave();
  }
}

/** A session: a directory of contexts. */
export class Session extends Joined {
  /** The contexts in it. */
  list(): Promise<ContextInfo[]> {
    return this.client.list(this.path);
  }

  /** Creates a context in it. */
  create(name: string, spec: ContextSpec): Promise<ContextInfo> {
    return this.client.create(`${this.path === "/" ? "" : this.path}/${name}`, spec);
  }
}
