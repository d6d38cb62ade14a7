// Asking an agent for work with the robot: it is asked, then lent the token, tells how far it is, and gives the token back.
import { refusalOf } from "../../hub/device.svelte.js";
import { failureOf } from "../../hub/failure.js";
import { fields, text } from "../../hub/fields.js";
import type { Hub } from "../../hub/hub.svelte.js";
import { texts } from "../../texts/index.js";
import { isWithin } from "../../worker/ordered.js";
import type { Failure, HubEvent, Message, PlainFields } from "../../worker/protocol.js";

/** ms in which an agent says whether it takes a task, or how far it is. */
const PATIENCE = 15_000;

/** While it is `ending`, the token is on its way back, and the device is waited for. */
const WORKING = ["accepted", "working", "ending"];

export class AgentTask {
  phase = $state<"idle" | "asking" | "lending" | "working" | "over">("idle");
  agent = $state("");
  /** Its newest word. */
  report = $state.raw<PlainFields>({});
  failure = $state.raw<Failure | null>(null);
  #id: number | undefined;
  /** A word that came before this page knew the id of its question. */
  #early: Message[] = [];
  #terms: { for: number; commands?: number } | null = null;
  #token = "";
  #timer: ReturnType<typeof setTimeout> | undefined;

  constructor(
    readonly hub: Hub,
    readonly channel: string,
    /** The message by which it is asked; what it says to that if it will not is called the same, with `-refused`. */
    readonly verb: string,
    /** Its last states, in words. */
    readonly states: Record<string, string>,
  ) {}

  get busy(): boolean {
    return this.phase === "asking" || this.phase === "lending" || this.phase === "working";
  }

  /** Its last state, if the task is over and it has told one. */
  get outcome(): string | undefined {
    const state = text(this.report, "state") ?? "";
    return this.phase === "over" && state in this.states ? state : undefined;
  }

  /** Hears the agent until the function that it gives is called. */
  start(): () => void {
    const end = this.hub.watch(
      { path: this.channel, kind: "channel", names: ["progress", `${this.verb}-refused`, "cancel-refused"] },
      { events: (events) => events.forEach((event) => this.#heard(event)) },
    );
    // It is neither lent the token after a stop, nor does it go on when the device is let go.
    const free = this.hub.onStop((top) => this.busy && (isWithin(this.channel, top) || isWithin(this.#token, top)) && this.#stopped());
    return () => {
      clearTimeout(this.#timer);
      free();
      end();
    };
  }

  async begin(task: PlainFields, token: string, terms: { for: number; commands?: number }): Promise<void> {
    if (this.busy) return;
    [this.phase, this.report, this.failure, this.agent, this.#early, this.#id] = ["asking", {}, null, "", [], undefined];
    [this.#terms, this.#token] = [terms, token];
    this.#await();
    try {
      const { id, delivered } = await this.hub.call("send", this.channel, this.verb, { ...task }, { echo: false });
      this.#id = id;
      if (delivered === 0) this.#fail(this.#silence());
      for (const message of this.#early.splice(0)) this.#heard(message);
    } catch (error) {
      this.#fail(failureOf(error));
    }
  }

  /** The agent gives the token back, wherever it is with its task. */
  async cancel(): Promise<void> {
    await this.hub.call("send", this.channel, "cancel", {}, { echo: false }).catch((error: unknown) => (this.failure = failureOf(error)));
  }

  #stopped(): void {
    this.#fail({ kind: "local", code: "stopped", text: texts.commands.stopOrdered, content: {} });
    void this.cancel();
  }

  #silence(): Failure {
    return { kind: "local", code: "no-answer", text: texts.objects.silent, content: {} };
  }

  #await(): void {
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.#fail(this.#silence()), PATIENCE);
  }

  #fail(failure: Failure): void {
    clearTimeout(this.#timer);
    [this.phase, this.failure] = ["over", failure];
    this.hub.note("error", failure.text, failure);
  }

  #heard(event: HubEvent): void {
    if (event.type !== "message" || !this.busy) return;
    const message = event as Message;
    const said = fields(message.content);
    if (message.name === "progress") {
      if (text(said, "by") === this.hub.me?.peer && !message.history) this.#progress(said);
      return;
    }
    if (this.#id === undefined) return void this.#early.push(message);
    if (message.name === `${this.verb}-refused` && message.reference === this.#id) this.#fail(refusalOf(said) ?? { ...this.#silence(), kind: "refused", code: "refused", content: said });
    if (message.name === "cancel-refused") this.failure = refusalOf(said) ?? null;
  }

  #progress(said: PlainFields): void {
    const state = text(said, "state") ?? "";
    this.report = said;
    if (state === "accepted" && this.phase === "asking") return void this.#lend(text(said, "agent") ?? "");
    if (WORKING.includes(state)) {
      this.phase = "working";
      return this.#await();
    }
    clearTimeout(this.#timer);
    this.phase = "over";
    this.hub.note(state === "done" ? "info" : "warning", `${this.states[state] ?? state}: ${text(said, "text") ?? ""}`);
  }

  async #lend(agent: string): Promise<void> {
    [this.phase, this.agent] = ["lending", agent];
    this.#await();
    try {
      await this.hub.call("give", this.#token, agent, this.#terms ?? {});
    } catch (error) {
      if (this.phase === "lending") this.#fail(failureOf(error));
      await this.cancel();
    }
  }
}
