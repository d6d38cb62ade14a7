// Figures over time, as plots take them: one list of times and one of each figure.

/** Ten minutes, once a second. */
const MOST = 600;
/** ms after which a line is broken: nothing was known in between. */
const GAP = 3500;

export class History {
  /** s since 1970. */
  readonly times: number[] = [];
  readonly #columns = new Map<string, (number | null)[]>();
  #last = -Infinity;

  constructor(
    readonly most = MOST,
    readonly gap = GAP,
  ) {}

  /** Adds what is known at a time, ms since 1970. A clock that was set back begins anew. */
  push(at: number, values: { readonly [name: string]: number | undefined }): void {
    if (at < this.#last) this.clear();
    if (at - this.#last > this.gap && this.times.length) this.#row(this.#last + 1, {});
    this.#row(at, values);
    this.#last = at;
  }

  #row(at: number, values: { readonly [name: string]: number | undefined }): void {
    this.times.push(at / 1000);
    for (const name of Object.keys(values)) if (!this.#columns.has(name)) this.#columns.set(name, new Array<null>(this.times.length - 1).fill(null));
    const over = this.times.length > this.most;
    if (over) this.times.shift();
    for (const [name, column] of this.#columns) {
      column.push(values[name] ?? null);
      if (over) column.shift();
      // Names come and go with the channels of a hub.
      if (!(name in values) && column.every((value) => value === null)) this.#columns.delete(name);
    }
  }

  column(name: string): (number | null)[] {
    return this.#columns.get(name) ?? new Array<null>(this.times.length).fill(null);
  }

  clear(): void {
    this.times.length = 0;
    this.#columns.clear();
    this.#last = -Infinity;
  }
}
