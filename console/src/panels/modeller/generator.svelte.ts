// Code of a model, made by the middle of a mirrored robot: it is asked in the robot's mirror channel, and answers the asker alone.
import { HubError, failureOf } from "../../hub/failure.js";
import { fields, text } from "../../hub/fields.js";
import type { Hub } from "../../hub/hub.svelte.js";
import { Mirrors, robotOf } from "../../hub/mirrors.svelte.js";
import { modeller } from "../../texts/modeller.js";
import type { HubEvent, Message, PlainFields } from "../../worker/protocol.js";

/** What a model can be written as. */
export type Language = "rust" | "c" | "docs" | "toml";

/** A file that was made. */
export interface Generated {
  name: string;
  text: string;
}

/** ms in which a middle answers. */
export const PATIENCE = 5000;
const [ASK, ANSWER] = ["generate", "generated"];
const t = modeller.generator;

const local = (code: string, words: string): HubError => new HubError({ kind: "local", code, text: words, content: {} });

export class Generator {
  readonly mirrors: Mirrors;
  /** What is asked for and not yet answered. */
  asking = $state<Language>();
  #chosen = $state<string>();

  constructor(readonly hub: Hub) {
    this.mirrors = new Mirrors(hub);
  }

  /** The mirror of the robot that is asked. */
  get path(): string | undefined {
    const { paths } = this.mirrors;
    return paths.find((path) => path === this.#chosen) ?? paths[0];
  }

  choose(path: string): void {
    this.#chosen = path;
  }

  /** Why nothing can be asked now, in words; undefined if something can. */
  get hindrance(): string | undefined {
    if (!this.hub.isUp) return t.noLink;
    if (this.path !== undefined) return undefined;
    return this.mirrors.looked ? t.noRobot : t.looking;
  }

  /** Has a model, as TOML, written in a language; without one it is the robot's own. */
  async ask(language: Language, model?: string): Promise<Generated> {
    const { path, hindrance } = this;
    if (path === undefined || hindrance !== undefined) throw local("no-answer", hindrance ?? t.noRobot);
    this.asking = language;
    try {
      return generatedOf(await this.#answer(path, { language, ...(model === undefined ? {} : { model }) }), robotOf(path));
    } catch (error) {
      // The robot may be gone, and another one there.
      if (failureOf(error).code === "no-answer") void this.mirrors.look();
      throw error;
    } finally {
      this.asking = undefined;
    }
  }

  #answer(path: string, ask: PlainFields): Promise<Message> {
    const { hub } = this;
    const silent = local("no-answer", t.silent(robotOf(path), PATIENCE));
    return new Promise((resolve, reject) => {
      let id: number | undefined;
      let asked = false;
      /** Answers that came before the id of the question was known. */
      const early: Message[] = [];
      const end = hub.watch(
        { path, kind: "channel", names: [ANSWER], newest: true, answers: true },
        { joined: () => void say(), events: (events) => events.forEach(heard), failed: (failure) => fail(new HubError(failure)) },
      );
      let timer = setTimeout(() => fail(silent), PATIENCE);

      function over(): void {
        clearTimeout(timer);
        end();
      }
      function fail(error: unknown): void {
        over();
        reject(error as Error);
      }
      async function say(): Promise<void> {
        // It is joined again after a new login.
        if (asked) return;
        asked = true;
        clearTimeout(timer);
        timer = setTimeout(() => fail(silent), PATIENCE);
        try {
          // A middle that joins too late to answer is not asked.
          const sent = await hub.call("send", path, ASK, ask, { echo: false, expires: PATIENCE });
          id = sent.id;
          if (sent.delivered === 0) fail(local("no-answer", t.absent(robotOf(path))));
          early.forEach(heard);
        } catch (error) {
          fail(error);
        }
      }
      function heard(event: HubEvent): void {
        if (event.type !== "message") return;
        const message = event as Message;
        if (id === undefined) return void early.push(message);
        if (message.reference !== id) return;
        over();
        resolve(message);
      }
    });
  }
}

/** The file that an answer has; an error if there is none. */
function generatedOf({ content, cut }: Message, robot: string): Generated {
  const said = fields(content);
  const error = text(said, "error");
  if (error !== undefined) throw local("refused", t.refused(error));
  const [name, written] = [text(said, "name"), text(said, "text")];
  if (name === undefined || written === undefined || cut) throw local("bad-content", t.unclear(robot));
  return { name, text: written };
}

/** How many lines a text has. */
export const linesOf = (written: string): number => written.split("\n").length - (written.endsWith("\n") || written === "" ? 1 : 0);
