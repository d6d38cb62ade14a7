// The lines of a chat as data.
import { visible, visibleLines } from "../../hub/said.js";
import type { Plain } from "../../worker/protocol.js";

export interface ChatLine {
  key: number;
  kind: "said" | "came" | "left";
  who: string;
  text: string;
  mine: boolean;
  /** To whom alone. */
  to?: string | undefined;
  at: number;
  history: boolean;
  cut: boolean;
}

/** So many are kept. */
const MOST = 500;

export function append(lines: readonly ChatLine[], line: Omit<ChatLine, "key">): ChatLine[] {
  const key = (lines.at(-1)?.key ?? 0) + 1;
  return [...lines.slice(-(MOST - 1)), { ...line, key }];
}

/** What a peer said, whatever it is. */
export function textOf(content: Plain | undefined): string {
  if (typeof content === "string") return visibleLines(content);
  if (content === undefined || content === null) return "";
  return visible(JSON.stringify(content, (_key, value: unknown) => (typeof value === "bigint" ? String(value) : value)));
}

export type Draft = { to: string | undefined; text: string } | { unknown: string };

/** What is to be sent to whom: `/name text` is for one who is here, by the longest name that fits. A line that only begins like a path is for all. */
export function draftOf(draft: string, here: readonly string[], chosen: string): Draft {
  const text = draft.trim();
  const named = /^\/(\S+)(\s|$)/.exec(text);
  if (!named) return { to: chosen === "" ? undefined : chosen, text };
  const fits = here.filter((name) => text.startsWith(`/${name}`) && /^(\s|$)/.test(text.slice(name.length + 1))).sort((one, other) => other.length - one.length);
  if (fits[0] !== undefined) return { to: fits[0], text: text.slice(fits[0].length + 1).trim() };
  return { unknown: named[1]! };
}
