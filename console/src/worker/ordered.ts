// The stops that this page has ordered: what is under way for a place ends when their number rises.

/** Whether a path is this place or below it. */
export function isWithin(path: string, top: string): boolean {
  return top === "/" || path === top || path.startsWith(`${top}/`);
}

export class OrderedStops {
  readonly #stops = new Map<string, { count: number; at: number }>();

  /** A stop of this place was ordered now. */
  add(top: string): void {
    this.#stops.set(top, { count: (this.#stops.get(top)?.count ?? 0) + 1, at: Date.now() });
  }

  *#of(path: string): Generator<{ count: number; at: number }> {
    for (let at = path; ; at = at.slice(0, at.lastIndexOf("/"))) {
      const found = this.#stops.get(at || "/");
      if (found) yield found;
      if (at === "" || at === "/") return;
    }
  }

  /** How many stops of this path, or of a place above it, were ordered. */
  count(path: string): number {
    let count = 0;
    for (const stop of this.#of(path)) count += stop.count;
    return count;
  }

  /** When the newest of them was ordered, ms since 1970; undefined if there was none. */
  newest(path: string): number | undefined {
    let newest: number | undefined;
    for (const { at } of this.#of(path)) newest = Math.max(at, newest ?? at);
    return newest;
  }
}
