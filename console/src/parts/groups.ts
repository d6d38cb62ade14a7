// Stops as a person reads them: who stopped what, since when and why.
import { stop as t } from "../texts/control.js";
import { visible } from "../hub/said.js";
import type { StandingStop } from "../worker/protocol.js";

/** Stops that one has said for one reason. */
export interface Group {
  words: string;
  /** The first place, and how many more. */
  places: string;
  paths: readonly string[];
  /** When the oldest was said, ms since 1970. */
  since: number | undefined;
  /** When the newest was. */
  latest: number | undefined;
}

export function groupsOf(stops: readonly StandingStop[]): Group[] {
  const groups = new Map<string, StandingStop[]>();
  for (const stop of stops) {
    const words = t.standing(stop.by ?? t.somebody, stop.user, stop.reason && visible(stop.reason));
    groups.set(words, [...(groups.get(words) ?? []), stop]);
  }
  return [...groups].map(([words, all]) => {
    const paths = all.map(({ path }) => path);
    const times = all.flatMap(({ since }) => since ?? []);
    return { words, places: t.places(paths[0]!, paths.length), paths, since: times.length ? Math.min(...times) : undefined, latest: times.length ? Math.max(...times) : undefined };
  });
}
