// A log of the page: the newest lines, bounded.

/** Lines that are kept. */
export const MOST = 500;

export interface Line {
  key: number;
  at: number;
  unit: number;
}

export class Log<Entry extends Line> {
  /** The oldest first. */
  lines = $state.raw<readonly Entry[]>([]);
  #last = 0;

  add(entries: readonly Omit<Entry, "key">[]): Entry[] {
    const added = entries.map((entry) => ({ ...entry, key: ++this.#last }) as Entry);
    if (added.length) this.lines = [...this.lines, ...added].slice(-MOST);
    return added;
  }

  change(key: number, change: Partial<Entry>): void {
    this.lines = this.lines.map((line) => (line.key === key ? { ...line, ...change } : line));
  }
}
