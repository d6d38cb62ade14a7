// Users and verbs of one context: who may do what.
import { fields, flag, list, text } from "../../hub/fields.js";
import { failureOf } from "../../hub/failure.js";
import type { Hub } from "../../hub/hub.svelte.js";
import { inquire } from "../../hub/inquiry.js";
import type { Failure, PlainFields } from "../../worker/protocol.js";
import { type Answer, type Question, answerOf } from "./answer.js";

/** Of one request. */
const MOST_USERS = 32;

export interface Column {
  user: string;
  peer: string | undefined;
  /** Level and groups stand here. */
  all: PlainFields;
  answers: ReadonlyMap<string, Answer>;
}

/** One line of the table: a verb, or a message that is sent. */
export interface Row {
  id: string;
  verb: string;
  message: string | undefined;
}

const rowId = (verb: string, message?: string): string => (message === undefined ? verb : `${verb} ${message}`);

function columnOf(value: PlainFields): { column: Column; rows: Row[] } {
  const answers = new Map<string, Answer>();
  const rows: Row[] = [];
  const take = (verb: string, message: string | undefined, answer: Answer): void => {
    const id = rowId(verb, message);
    answers.set(id, answer);
    rows.push({ id, verb, message });
  };
  for (const [verb, answer] of Object.entries(fields(value["verbs"]))) take(verb, undefined, answerOf(answer));
  for (const [message, answer] of Object.entries(fields(value["messages"]))) take("send", message, answerOf(answer));
  return { column: { user: text(value, "user") ?? "", peer: text(value, "peer"), all: value, answers }, rows };
}

/** Names of users as a person writes them. */
export function usersOf(words: string): string[] {
  return [...new Set(words.split(/[\s,;]+/).filter(Boolean))].slice(0, MOST_USERS);
}

export class Matrix {
  columns = $state.raw<readonly Column[]>([]);
  rows = $state.raw<readonly Row[]>([]);
  /** What the hub says of the context. */
  about = $state.raw<PlainFields>({});
  /** The context that is shown. */
  path = $state("");
  failure = $state.raw<Failure | null>(null);
  busy = $state(false);
  more = $state(false);
  #latest = 0;

  constructor(readonly hub: Hub) {}

  /** Asks about these users; without any about oneself, which needs no right. */
  async load(path: string, users: readonly string[]): Promise<void> {
    const mine = ++this.#latest;
    this.busy = true;
    this.failure = null;
    try {
      let reply: PlainFields;
      try {
        reply = await inquire(this.hub, "explain", path, users.length ? { users: [...users] } : {});
      } catch (error) {
        if (mine !== this.#latest) return;
        this.failure = failureOf(error);
        // What concerns oneself everybody may ask.
        if (!users.length || this.failure.code !== "denied") {
          this.columns = this.rows = [];
          return;
        }
        reply = await inquire(this.hub, "explain", path, {});
      }
      if (mine !== this.#latest) return;
      const read = list(reply, "users").map((user) => columnOf(fields(user)));
      const rows = new Map<string, Row>();
      for (const row of read.flatMap(({ rows }) => rows)) if (!rows.has(row.id)) rows.set(row.id, row);
      this.columns = read.map(({ column }) => column);
      this.rows = [...rows.values()];
      this.about = reply;
      this.path = path;
      this.more = flag(reply, "more");
    } catch (error) {
      if (mine !== this.#latest) return;
      this.failure = failureOf(error);
      this.columns = this.rows = [];
    } finally {
      if (mine === this.#latest) this.busy = false;
    }
  }
}

/** One question of one user, with its answer. */
export class Asking {
  question = $state.raw<Question | null>(null);
  answer = $state.raw<Answer | null>(null);
  failure = $state.raw<Failure | null>(null);
  busy = $state(false);
  #latest = 0;

  constructor(readonly hub: Hub) {}

  /** Shows an answer that is known. */
  show(question: Question, answer: Answer): void {
    this.#latest += 1;
    [this.question, this.answer, this.failure, this.busy] = [question, answer, null, false];
  }

  clear(): void {
    this.#latest += 1;
    [this.question, this.answer, this.failure, this.busy] = [null, null, null, false];
  }

  async ask(question: Question): Promise<void> {
    const mine = ++this.#latest;
    [this.question, this.answer, this.failure, this.busy] = [question, null, null, true];
    const { user, verb, path, message, kind } = question;
    const own = !user || user === this.hub.me?.user;
    const content = { verb, ...(own ? {} : { user }), ...(message && verb === "send" ? { message } : {}), ...(kind && verb === "create" ? { kind } : {}) };
    try {
      const reply = await inquire(this.hub, "explain", path, content);
      if (mine === this.#latest) this.answer = answerOf(reply);
    } catch (error) {
      if (mine === this.#latest) this.failure = failureOf(error);
    } finally {
      if (mine === this.#latest) this.busy = false;
    }
  }
}

/** The users who are connected, as far as this one may know. */
export async function connectedUsers(hub: Hub, path: string): Promise<string[]> {
  const places = [...new Set(["/", path, path.slice(0, path.lastIndexOf("/")) || "/"])];
  const members = await Promise.all(places.map((place) => hub.call("members", place).catch(() => [])));
  const users = new Set(members.flat().map(({ user }) => user));
  return [...users].sort();
}
