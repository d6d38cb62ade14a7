// Another configuration, tried on what was recorded.
import { fields, flag, list, number, text, time } from "../../hub/fields.js";
import { failureOf } from "../../hub/failure.js";
import type { Hub } from "../../hub/hub.svelte.js";
import { inquire } from "../../hub/inquiry.js";
import type { Failure, Plain, PlainFields } from "../../worker/protocol.js";

export interface Fault {
  line: number | undefined;
  column: number | undefined;
  key: string | undefined;
  text: string;
}

export interface Difference {
  at: number | undefined;
  /** The line of the recording. */
  recorded: number | undefined;
  peer: string;
  user: string;
  request: string;
  message: string;
  context: string;
  old: string;
  new: string;
  rule: string | undefined;
  line: number | undefined;
  /** All of it in lower case, to find something in. */
  words: string;
}

export interface Result {
  inputs: number;
  differ: number;
  more: boolean;
  differences: Difference[];
  configured: number;
  unknownUsers: string[];
  end: string | undefined;
  cut: boolean;
  /** How long it took, ms. */
  took: number;
}

/** What is kept of edits until the tab is closed. */
interface Edits {
  config: string;
  sha256: string;
}

export function faultOf(value: Plain): Fault {
  const all = fields(value);
  return { line: number(all, "line"), column: number(all, "column"), key: text(all, "key"), text: text(all, "text") ?? "" };
}

export function differenceOf(value: Plain): Difference {
  const all = fields(value);
  const word = (key: string): string => text(all, key) ?? "";
  const read = {
    at: time(all, "at"),
    recorded: number(all, "recorded-line"),
    peer: word("peer"),
    user: word("user"),
    request: word("request"),
    message: word("message"),
    context: word("context"),
    old: word("old"),
    new: word("new"),
    rule: text(all, "rule"),
    line: number(all, "line"),
  };
  return { ...read, words: Object.values(read).join(" ").toLowerCase() };
}

export function resultOf(reply: PlainFields, took: number): Result {
  const differences = list(reply, "differences").map(differenceOf);
  return {
    inputs: number(reply, "inputs") ?? 0,
    differ: number(reply, "differ") ?? differences.length,
    more: flag(reply, "more"),
    differences,
    configured: number(reply, "configured") ?? 0,
    unknownUsers: list(reply, "unknown-users").map(String),
    end: text(reply, "end"),
    cut: flag(reply, "cut"),
    took,
  };
}

/** The lines that are not those of the other text, from 1: what is equal at both ends is left away. */
export function changedLines(before: string, after: string): { first: number; last: number; count: number } | null {
  if (before === after) return null;
  const [old, now] = [before.split("\n"), after.split("\n")];
  let start = 0;
  while (start < old.length && start < now.length && old[start] === now[start]) start += 1;
  let end = 0;
  while (end < old.length - start && end < now.length - start && old[old.length - 1 - end] === now[now.length - 1 - end]) end += 1;
  const last = Math.max(start + 1, now.length - end);
  return { first: start + 1, last, count: Math.max(now.length - end - start, old.length - end - start) };
}

/** Where a line begins and ends in a text; lines count from 1. */
export function lineRange(config: string, line: number): [start: number, end: number] {
  let start = 0;
  for (let at = 1; at < line; at += 1) {
    const next = config.indexOf("\n", start);
    if (next < 0) break;
    start = next + 1;
  }
  const end = config.indexOf("\n", start);
  return [start, end < 0 ? config.length : end];
}

function storage(): Storage | undefined {
  try {
    return sessionStorage;
  } catch {
    return undefined;
  }
}

export class WhatIf {
  /** The configuration that runs. */
  running = $state<string | undefined>(undefined);
  file = $state("mom.toml");
  sha256 = $state("");
  /** Whether there is anything to try it on. */
  recorded = $state(false);
  config = $state("");
  /** Also other rules for the same decision. */
  rules = $state(false);
  faults = $state.raw<readonly Fault[]>([]);
  failure = $state.raw<Failure | null>(null);
  /** Why the running configuration is not told. */
  refusal = $state.raw<Failure | null>(null);
  result = $state.raw<Result | null>(null);
  /** Of which text the result and the faults are. */
  tried = $state<string | null>(null);
  /** Whether the edits began from a configuration that runs no more. */
  stale = $state(false);
  /** When the trial began, ms since 1970. */
  since = $state<number | undefined>(undefined);

  constructor(readonly hub: Hub) {}

  get #place(): string {
    return `mom what-if ${this.hub.address}`;
  }

  get isEdited(): boolean {
    return this.running !== undefined && this.config !== this.running;
  }

  async load(): Promise<void> {
    this.refusal = null;
    try {
      const reply = await inquire(this.hub, "what-if", "/", {});
      this.running = text(reply, "config") ?? "";
      this.file = text(reply, "file") ?? this.file;
      this.sha256 = text(reply, "sha256") ?? "";
      this.recorded = flag(reply, "recorded");
      this.#recall();
    } catch (error) {
      this.refusal = failureOf(error);
    }
  }

  #recall(): void {
    const running = this.running ?? "";
    this.config = running;
    try {
      const found = storage()?.getItem(this.#place);
      if (!found) return;
      const edits = JSON.parse(found) as Edits;
      this.config = edits.config;
      this.stale = edits.sha256 !== this.sha256;
    } catch {
      // What cannot be read was not kept.
    }
  }

  edit(config: string): void {
    this.config = config;
    this.#keep();
  }

  #keep(): void {
    try {
      if (this.isEdited) storage()?.setItem(this.#place, JSON.stringify({ config: this.config, sha256: this.sha256 } satisfies Edits));
      else storage()?.removeItem(this.#place);
    } catch {
      // A full or forbidden storage keeps nothing.
    }
  }

  /** Begins from the running configuration again. */
  reset(): void {
    [this.stale, this.faults, this.failure, this.result, this.tried] = [false, [], null, null, null];
    this.edit(this.running ?? "");
  }

  async run(): Promise<void> {
    const config = this.config;
    const since = Date.now();
    [this.since, this.failure, this.faults, this.result] = [since, null, [], null];
    try {
      const reply = await inquire(this.hub, "what-if", "/", { config, ...(this.rules ? { rules: true } : {}) });
      this.result = resultOf(reply, Date.now() - since);
    } catch (error) {
      const failure = failureOf(error);
      this.faults = list(failure.content, "faults").map(faultOf);
      this.failure = failure;
      if (failure.code === "not-recorded") this.recorded = false;
    } finally {
      this.tried = config;
      this.since = undefined;
    }
  }
}
