// What this user may do in one context, as the hub explains it: so that a control says beforehand why it cannot be used.
import type { PlainFields } from "../worker/protocol.js";
import { fields, list, text } from "./fields.js";
import type { Hub } from "./hub.svelte.js";

/** Rules and tokens change; it is asked so often, in ms. */
const AGAIN = 30_000;

export class Rights {
  #verbs = $state.raw<PlainFields>({});

  constructor(
    readonly hub: Hub,
    readonly path: string,
  ) {}

  /** Asks now and then until the function that it gives is called. */
  start(): () => void {
    const look = async (): Promise<void> => {
      if (!this.hub.me || !this.hub.isUp) return;
      const told = await this.hub.call("ask", "context", "explain", this.path).catch(() => null);
      // A hub that does not explain leaves it to the try.
      this.#verbs = told ? fields(fields(list(told, "users")[0])["verbs"]) : {};
    };
    void look();
    const timer = setInterval(() => void look(), AGAIN);
    return () => clearInterval(timer);
  }

  /**
   * Why a manager refuses this verb, in words with the rule; undefined if it does not, or if that is not known. What else stands in the way at
   * this moment (a token's owner, a membership that is missing) is told when it is tried.
   */
  denied(verb: string): string | undefined {
    const answer = fields(this.#verbs[verb]);
    if (text(answer, "answer") !== "deny" || text(answer, "code") !== "denied") return undefined;
    const rule = text(answer, "rule");
    return [text(answer, "text"), rule === undefined ? undefined : `(${rule})`].filter(Boolean).join(" ");
  }
}
