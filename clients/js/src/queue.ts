/** So many bytes wait at most, and always one thing. */
const MOST_BYTES = 64 * 1024 * 1024;

/** Things in their order, for one who takes them; beyond the most the oldest are dropped and counted, but for those that are kept. */
export class Queue<T> implements AsyncIterableIterator<T> {
  #waiting: T[] = [];
  #takers: ((result: IteratorResult<T>) => void)[] = [];
  #lost = 0;
  #bytes = 0;
  #closed = false;

  constructor(
    public most: number,
    /** What tells of those that were dropped. */
    readonly lagged: (count: number) => T,
    /** Called when nobody takes more. */
    readonly ends: (queue: Queue<T>) => void,
    /** Which are not given out. */
    readonly skips: (item: T) => boolean = () => false,
    /** What is kept even beyond the most, as the newest of those that give the same word. */
    readonly keeps: (item: T) => string | undefined = () => undefined,
    readonly weighs: (item: T) => number = () => 0,
  ) {}

  get length(): number {
    return this.#waiting.length;
  }

  /** @internal */
  push(item: T): void {
    if (this.#closed) return;
    const taker = this.#takers.shift();
    if (taker && !this.skips(item)) return taker({ done: false, value: item });
    if (taker) {
      this.#takers.unshift(taker);
      return;
    }
    this.#waiting.push(item);
    this.#bytes += this.weighs(item);
    while ((this.#waiting.length > this.most || (this.#bytes > MOST_BYTES && this.#waiting.length > 1)) && this.#drop()) this.#lost += 1;
  }

  /** Drops the oldest that need not be kept, or else the oldest of which there is a newer one. */
  #drop(): boolean {
    let place = this.#waiting.findIndex((item) => this.keeps(item) === undefined);
    if (place < 0) {
      const words = this.#waiting.map(this.keeps);
      place = words.findIndex((word, at) => words.indexOf(word, at + 1) > 0);
    }
    if (place < 0) return false;
    this.#take(place);
    return true;
  }

  #take(place: number): T {
    const item = this.#waiting.splice(place, 1)[0]!;
    this.#bytes -= this.weighs(item);
    return item;
  }

  /** @internal What waits can still be taken. */
  close(): void {
    this.#closed = true;
    for (const taker of this.#takers.splice(0)) taker({ done: true, value: undefined });
  }

  /** The next one, if one waits. */
  tryNext(): T | undefined {
    if (this.#lost > 0) {
      const lost = this.#lost;
      this.#lost = 0;
      return this.lagged(lost);
    }
    for (;;) {
      if (!this.#waiting.length) return undefined;
      const item = this.#take(0);
      if (!this.skips(item)) return item;
    }
  }

  next(): Promise<IteratorResult<T>> {
    const item = this.tryNext();
    if (item !== undefined) return Promise.resolve({ done: false, value: item });
    if (this.#closed) return Promise.resolve({ done: true, value: undefined });
    return new Promise((resolve) => this.#takers.push(resolve));
  }

  /** Nobody takes more. */
  return(): Promise<IteratorResult<T>> {
    this.close();
    this.#waiting = [];
    this.ends(this);
    return Promise.resolve({ done: true, value: undefined });
  }

  [Symbol.asyncIterator](): this {
    return this;
  }
}
