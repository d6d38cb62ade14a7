// The robots of a fleet's file (W12, W14): its gateway tells them in a channel, and answers who adds, changes or removes one.
import { HubError, failureOf } from "../../hub/failure.js";
import { fields, flag, list, number, text } from "../../hub/fields.js";
import type { Hub } from "../../hub/hub.svelte.js";
import { fleet as t } from "../../texts/fleet.js";
import type { Failure, HubEvent, Message, Plain, PlainFields } from "../../worker/protocol.js";

/** ms in which an edit is answered: robots that are left are told to stand before. */
const PATIENCE = 15_000;

export interface Entry {
  unit: number;
  address: string;
  name?: string;
  group?: string;
}

/** What became of the last edit: what was done, or why not, with the field at fault. */
export type Outcome = { done: string } | { failure: Failure; field?: string };

function entryOf(value: Plain): Entry | undefined {
  const entry = fields(value);
  const [unit, address, name, group] = [number(entry, "unit"), text(entry, "address"), text(entry, "name"), text(entry, "group")];
  if (unit === undefined || address === undefined) return undefined;
  return { unit, address, ...(name === undefined ? {} : { name }), ...(group === undefined ? {} : { group }) };
}

/** Who waits for an answer. */
interface Waits {
  id: number | undefined;
  /** Answers that came before the id of the question was known. */
  early: Message[];
  answer: (message: Message) => void;
}

export class FleetFile {
  /** By number; undefined before the gateway has told them. */
  entries = $state.raw<readonly Entry[] | undefined>(undefined);
  busy = $state(false);
  outcome = $state.raw<Outcome | null>(null);
  /** What others have changed. */
  told = $state.raw<string | null>(null);
  #waits: Waits | null = null;

  constructor(
    readonly hub: Hub,
    readonly path: string,
  ) {}

  /** Watches it until the function that it gives is called. Where it is not, or may not be seen, nothing is said. */
  start(): () => void {
    return this.hub.watch(
      { path: this.path, kind: "channel", names: ["robots", "edited"], newest: true, answers: true },
      { joined: () => undefined, events: (events) => events.forEach((event) => this.#heard(event)), failed: () => (this.entries = undefined) },
    );
  }

  #heard(event: HubEvent): void {
    if (event.type !== "message") return;
    const message = event as Message;
    const said = fields(message.content);
    if (message.name === "robots") {
      const entries = list(said, "robots").map(entryOf).filter((entry) => entry !== undefined);
      this.entries = entries.sort((one, other) => one.unit - other.unit);
      return;
    }
    if (message.history) return;
    const waits = this.#waits;
    if (waits && waits.id === undefined) waits.early.push(message);
    if (waits && waits.id !== undefined && message.reference === waits.id) return waits.answer(message);
    if (flag(said, "ok")) this.told = t.file.by(text(said, "by") ?? "", text(said, "text") ?? "");
  }

  /** Asks for an edit; whether it was done. */
  async edit(edit: PlainFields): Promise<boolean> {
    if (this.busy) return false;
    [this.busy, this.outcome, this.told] = [true, null, null];
    try {
      const said = fields((await this.#ask(edit)).content);
      if (flag(said, "ok")) {
        this.outcome = { done: text(said, "text") ?? "" };
        return true;
      }
      const field = text(said, "field");
      const failure: Failure = { kind: "refused", code: text(said, "name") ?? "", text: text(said, "text") ?? "", content: {} };
      this.outcome = { failure, ...(field === undefined ? {} : { field }) };
    } catch (error) {
      this.outcome = { failure: failureOf(error) };
    } finally {
      [this.busy, this.#waits] = [false, null];
    }
    return false;
  }

  #ask(edit: PlainFields): Promise<Message> {
    const silent: Failure = { kind: "local", code: "no-answer", text: t.file.silent, content: {} };
    return new Promise((resolve, reject) => {
      const timer = setTimeout(() => reject(new HubError(silent)), PATIENCE);
      const answer = (message: Message): void => (clearTimeout(timer), resolve(message));
      const waits: Waits = { id: undefined, early: [], answer };
      this.#waits = waits;
      this.hub.call("send", this.path, "edit", edit, { echo: false, expires: PATIENCE }).then(
        ({ id, delivered }) => {
          if (delivered === 0) return reject(new HubError(silent));
          waits.id = id;
          for (const message of waits.early) if (message.reference === id) answer(message);
        },
        (error: unknown) => (clearTimeout(timer), reject(error as Error)),
      );
    });
  }
}
