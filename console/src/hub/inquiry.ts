// Questions that the hub answers for a peer one after the other only: audit, explain and what-if.
import type { PlainFields } from "../worker/protocol.js";
import { HubError, failureOf } from "./failure.js";
import type { Hub } from "./hub.svelte.js";

/** Another page of the same peer may be asking, too. */
const TRIES = 5;

const before = new WeakMap<Hub, Promise<unknown>>();

/** Asks when the question before it has been answered, and again if the hub says later. */
export function inquire(hub: Hub, name: "audit" | "explain" | "what-if", path: string, content: PlainFields): Promise<PlainFields> {
  const turn = (before.get(hub) ?? Promise.resolve()).then(() => ask(hub, name, path, content));
  before.set(
    hub,
    turn.catch(() => undefined),
  );
  return turn;
}

async function ask(hub: Hub, name: string, path: string, content: PlainFields): Promise<PlainFields> {
  for (let tried = 1; ; tried += 1) {
    try {
      return await hub.call("ask", "context", name, path, content);
    } catch (error) {
      const { code, retryAfter } = failureOf(error);
      if (!(error instanceof HubError) || code !== "try-later" || tried >= TRIES) throw error;
      await new Promise((resolve) => setTimeout(resolve, retryAfter ?? 1000));
    }
  }
}
