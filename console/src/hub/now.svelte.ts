// The present time, for ages that run.
const EVERY = 200;

class Clock {
  #now = $state(Date.now());
  #users = 0;
  #timer: ReturnType<typeof setInterval> | undefined;

  /** ms since 1970, five times a second as long as a panel reads it. */
  get ms(): number {
    if ($effect.tracking()) {
      $effect(() => {
        this.#users += 1;
        this.#timer ??= setInterval(() => (this.#now = Date.now()), EVERY);
        return () => {
          this.#users -= 1;
          if (this.#users) return;
          clearInterval(this.#timer);
          this.#timer = undefined;
        };
      });
    }
    return this.#now;
  }
}

export const now = new Clock();
