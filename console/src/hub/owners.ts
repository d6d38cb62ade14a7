// Who owns which tokens, found by a walk through the tree as in `mom top`, within the same bounds.
import { list, text } from "./fields.js";
import type { Hub } from "./hub.svelte.js";

/** Contexts that one walk looks at, at most. */
const LOOKS = 1000;
/** Tokens whose owners are asked for, at most. */
const TOKENS = 256;
/** Owners are asked for so many times before the tree is walked again for new tokens. */
const ROUNDS = 10;

/** The tokens that each peer owns, by the peer's name. */
export type Owners = ReadonlyMap<string, readonly string[]>;

export class OwnerWalk {
  #tokens: string[] = [];
  #rounds = 0;

  constructor(readonly hub: Hub) {}

  /** Asks who owns what now. What this user may not know is left out. */
  async owners(): Promise<Owners> {
    if (!this.#rounds) {
      this.#tokens = await this.#look();
      this.#rounds = ROUNDS;
    }
    this.#rounds -= 1;
    const infos = await Promise.all(this.#tokens.map((path) => this.hub.call("ask", "context", "info", path).catch(() => null)));
    const owned = new Map<string, string[]>();
    infos.forEach((info, index) => {
      if (!info) return;
      const path = this.#tokens[index]!;
      const owner = text(info, "owner");
      for (const peer of new Set([...(owner === undefined ? [] : [owner]), ...list(info, "holders").map(String)])) owned.set(peer, [...(owned.get(peer) ?? []), path]);
    });
    return owned;
  }

  async #look(): Promise<string[]> {
    const tokens: string[] = [];
    const waiting = ["/"];
    for (let looks = 0; waiting.length && looks < LOOKS && tokens.length < TOKENS; looks += 1) {
      const children = await this.hub.call("list", waiting.shift()!).catch(() => []);
      for (const { path, kind } of children) {
        if (kind === "session") waiting.push(path);
        else if (kind === "token" && tokens.length < TOKENS) tokens.push(path);
      }
    }
    return tokens;
  }
}
