// A context as the page knows it: what it is, and who is in it.
import type { ContextKind } from "mom-client";
import type { Failure, PlainFields } from "../../worker/protocol.js";
import { failureOf } from "../../hub/failure.js";
import { fields, flag, list, number, text } from "../../hub/fields.js";
import type { Hub } from "../../hub/hub.svelte.js";
import { whileVisible } from "../../hub/visible.js";

export interface MemberRow {
  peer: string;
  user: string;
  level: number;
  device: boolean;
  rate: string | undefined;
  newest: boolean;
}

/** Pages of 128 members that are asked for. */
const PAGES = 16;
/** ms. */
const EVERY = 2000;

/** Who is in a context, with what the client leaves out. */
export async function membersOf(hub: Hub, path: string): Promise<MemberRow[]> {
  const all: MemberRow[] = [];
  let after: PlainFields[string] | undefined;
  for (let page = 0; page < PAGES; page += 1) {
    const answer = await hub.call("ask", "context", "members", path, after === undefined ? {} : { after });
    for (const member of list(answer, "members")) {
      const of = fields(member);
      const rate = of["rate"];
      all.push({ peer: text(of, "peer") ?? "", user: text(of, "user") ?? "", level: number(of, "level") ?? 0, device: flag(of, "device"), rate: rate === undefined || rate === null ? undefined : typeof rate === "string" ? rate : `${String(rate)}/s`, newest: flag(of, "newest") });
    }
    if (!flag(answer, "more")) break;
    after = answer["next"];
  }
  return all;
}

export class Known {
  info = $state.raw<PlainFields | null>(null);
  members = $state.raw<readonly MemberRow[]>([]);
  failure = $state.raw<Failure | null>(null);
  /** Why its members are not known. */
  hidden = $state.raw<Failure | null>(null);
  /** Whether it was there and is not any more. */
  gone = $state(false);

  constructor(
    readonly hub: Hub,
    readonly path: string,
  ) {}

  get kind(): ContextKind | undefined {
    return this.info ? ((text(this.info, "kind") ?? undefined) as ContextKind | undefined) : undefined;
  }

  /** Looks again and again until the function that it gives is called. */
  start(): () => void {
    return whileVisible(EVERY, () => this.look());
  }

  async look(): Promise<void> {
    const { hub, path } = this;
    if (!hub.isUp) return;
    try {
      this.info = await hub.call("ask", "context", "info", path);
      [this.failure, this.gone] = [null, false];
    } catch (error) {
      this.failure = failureOf(error);
      this.gone = this.failure.code === "unknown-path" && this.info !== null;
      if (this.failure.code === "unknown-path") this.members = [];
      return;
    }
    try {
      this.members = await membersOf(hub, path);
      this.hidden = null;
    } catch (error) {
      this.hidden = failureOf(error);
    }
  }
}
