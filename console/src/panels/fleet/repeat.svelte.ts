// A statement that is sent again and again.
import { fleet as t } from "../../texts/fleet.js";
import { isWithin } from "../../worker/ordered.js";
import type { FleetDriver, Outgoing } from "./driver.svelte.js";

export type End = keyof typeof t.send.ends;

export class Repeat {
  /** What is under way. */
  now = $state.raw<{ units: readonly number[]; statement: string; every: number; count: number } | null>(null);
  /** What became of the last one. */
  ended = $state.raw<{ count: number; why: End } | null>(null);
  /** The lines of the newest round. */
  keys = $state.raw<readonly number[]>([]);
  readonly #all = new Set<number>();
  #timer: ReturnType<typeof setTimeout> | undefined;
  #round = 0;

  constructor(readonly driver: FleetDriver) {}

  begin(units: readonly number[], statement: string, every: number): void {
    this.end("button");
    this.ended = null;
    this.#all.clear();
    this.now = { units, statement, every, count: 0 };
    void this.#send(++this.#round);
  }

  async #send(round: number): Promise<void> {
    const { now, driver } = this;
    if (!now || round !== this.#round) return;
    if (!driver.hub.isUp) return this.end("link");
    const begun = performance.now();
    this.now = { ...now, count: now.count + 1 };
    // What is late is not order any more.
    const { keys, refused } = await driver.send(now.units, () => now.statement, { expires: Math.max(1000, now.every * 2) });
    this.keys = keys;
    for (const key of keys) this.#all.add(key);
    if (round !== this.#round) return;
    if (refused.length) return this.end("refused");
    this.#timer = setTimeout(() => void this.#send(round), Math.max(0, now.every - (performance.now() - begun)));
  }

  end(why: End): void {
    clearTimeout(this.#timer);
    this.#round += 1;
    if (!this.now) return;
    this.ended = { count: this.now.count, why };
    this.now = null;
  }

  /** Ends it when robots refuse what they were sent, when the link is lost, at STOP, and when nobody sees the page. */
  watch(): () => void {
    const hidden = (): void => void (document.visibilityState !== "visible" && this.end("hidden"));
    const stopped = (top: string): void => void (this.now?.units.some((unit) => isWithin(this.driver.channel(unit), top)) && this.end("stop"));
    const failed = ({ key, unit, failure }: Outgoing): void => {
      if (!failure || !this.now || !this.#all.has(key)) return;
      this.end("refused");
      this.driver.refuse([{ what: t.whats["send"]!, units: [unit], failure }]);
    };
    this.driver.onEnd.add(failed);
    document.addEventListener("visibilitychange", hidden);
    const end = this.driver.hub.onStop(stopped);
    return () => {
      this.driver.onEnd.delete(failed);
      document.removeEventListener("visibilitychange", hidden);
      end();
      this.end("closed");
    };
  }
}
