// The audit log as this page has read it: newest first, as much as can be shown.
import { flag, list, number, text } from "../../hub/fields.js";
import { failureOf } from "../../hub/failure.js";
import type { Hub } from "../../hub/hub.svelte.js";
import { inquire } from "../../hub/inquiry.js";
import type { Failure, PlainFields } from "../../worker/protocol.js";
import { type Fact, type Filter, EMPTY, contentOf, factOf } from "./facts.js";

/** The page keeps so many. */
export const MOST = 5000;
const PAGE = 200;
/** The hub reads a bounded part of the log for each request; so many parts without a fact are read on without being asked to. */
const EMPTY_PARTS = 50;

export class AuditLog {
  facts = $state.raw<readonly Fact[]>([]);
  failure = $state.raw<Failure | null>(null);
  /** Why following has failed; it goes on. */
  trouble = $state.raw<Failure | null>(null);
  busy = $state(false);
  /** Whether there is more to read, older than what is shown. */
  more = $state(false);
  /** Whether newer ones were dropped to make room for older ones. */
  topCut = $state(false);
  inMemory = $state(false);
  /** How many came by following since they were last looked at. */
  fresh = $state(0);
  filter: Filter = EMPTY;
  #latest: number | undefined;
  #next: number | undefined;
  #since: PlainFields = {};
  #run = 0;
  #polling = false;

  constructor(readonly hub: Hub) {}

  get #path(): string {
    return this.filter.context.trim() || "/";
  }

  get #now(): number {
    return this.hub.hubTime() ?? Date.now();
  }

  /** Reads the newest facts that fit. */
  async load(filter: Filter): Promise<void> {
    const run = ++this.#run;
    [this.filter, this.failure, this.trouble, this.#latest, this.#next, this.fresh] = [filter, null, null, undefined, undefined, 0];
    // Paging and following keep to the time of this moment.
    this.#since = contentOf(filter, this.#now);
    this.busy = true;
    try {
      const facts = await this.#read(run, undefined, (facts) => (this.facts = facts));
      if (facts) [this.facts, this.topCut] = [facts, false];
    } catch (error) {
      if (run !== this.#run) return;
      [this.failure, this.facts, this.more] = [failureOf(error), [], false];
    } finally {
      if (run === this.#run) this.busy = false;
    }
  }

  /** Reads one page, and further as long as there is nothing in what the hub has read. */
  async #read(run: number, before: number | undefined, first?: (facts: Fact[]) => void): Promise<Fact[] | undefined> {
    const facts: Fact[] = [];
    for (let part = 0; part < EMPTY_PARTS; part += 1) {
      const reply = await inquire(this.hub, "audit", this.#path, { ...this.#since, most: PAGE, ...(before === undefined ? {} : { before }) });
      if (run !== this.#run) return undefined;
      this.#latest ??= number(reply, "latest") ?? 0;
      this.inMemory = text(reply, "source") === "memory";
      facts.push(...list(reply, "facts").map(factOf));
      const next = number(reply, "next");
      this.more = flag(reply, "more") && next !== undefined;
      if (this.more) before = this.#next = next;
      if (!this.more || facts.length >= PAGE / 4) break;
      first?.([...facts]);
    }
    return facts;
  }

  /** Reads on, back in time. */
  async older(): Promise<void> {
    if (this.busy || !this.more) return;
    const run = this.#run;
    this.busy = true;
    try {
      const facts = await this.#read(run, this.#next);
      if (!facts) return;
      const all = [...this.facts, ...facts];
      this.topCut ||= all.length > MOST;
      this.facts = all.slice(-MOST);
    } catch (error) {
      if (run === this.#run) this.trouble = failureOf(error);
    } finally {
      if (run === this.#run) this.busy = false;
    }
  }

  /** Asks once for what is new; gives how many came. */
  async poll(): Promise<number> {
    if (this.busy || this.#polling || this.failure || this.topCut || this.#latest === undefined || !this.hub.isUp) return 0;
    const run = this.#run;
    this.#polling = true;
    try {
      const after = this.#latest;
      const newest = this.facts[0]?.seq ?? -1;
      const facts: Fact[] = [];
      let before: number | undefined;
      for (let part = 0; part < EMPTY_PARTS; part += 1) {
        const reply = await inquire(this.hub, "audit", this.#path, { ...this.#since, most: PAGE, after, ...(before === undefined ? {} : { before }) });
        if (run !== this.#run) return 0;
        this.#latest = Math.max(this.#latest, number(reply, "latest") ?? 0);
        facts.push(...list(reply, "facts").map(factOf).filter(({ seq }) => seq > newest));
        before = flag(reply, "more") ? number(reply, "next") : undefined;
        if (before === undefined || facts.length >= PAGE) break;
      }
      this.trouble = null;
      // More than one page at once: what is between is read by going back.
      if (before !== undefined) {
        if (facts.length) this.facts = facts;
        [this.#next, this.more] = [before, true];
      } else if (facts.length) {
        const all = [...facts, ...this.facts];
        if (all.length > MOST) [this.#next, this.more] = [all[MOST - 1]!.seq, true];
        this.facts = all.slice(0, MOST);
      }
      this.fresh += facts.length;
      return facts.length;
    } catch (error) {
      if (run === this.#run) this.trouble = failureOf(error);
      return 0;
    } finally {
      this.#polling = false;
    }
  }
}
