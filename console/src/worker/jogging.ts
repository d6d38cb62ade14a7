// Live driving: a velocity is told again and again, and holds for a short time only.
import { type Client, MomError } from "mom-client";
import { failure } from "./plain.js";
import type { Say } from "./port.js";
import type { Jog } from "./protocol.js";

/** ms between two commands, for how long each holds, and how long the page may be silent. */
const EVERY = 50;
const HOLDS = 200;
const PATIENCE = 250;

export class Jogging {
  #jog: Jog | null = null;
  #said = 0;
  #timer: ReturnType<typeof setInterval> | undefined;

  constructor(
    readonly client: () => Client,
    readonly say: Say,
  ) {}

  /** What is moved now. */
  get path(): string | undefined {
    return this.#jog?.path;
  }

  /** The page's word. */
  set(jog: Jog | null): void {
    const before = this.#jog;
    this.#jog = jog;
    this.#said = performance.now();
    if (!jog) return this.#rest(before);
    // A change goes at once, and again in time.
    if (!before || before.velocity.join() !== jog.velocity.join()) this.#send(jog);
    this.#timer ??= setInterval(() => this.#again(), EVERY);
  }

  #again(): void {
    const jog = this.#jog;
    if (!jog) return;
    if (performance.now() - this.#said > PATIENCE) {
      this.set(null);
      const error = new MomError("local", "timed-out", "the page did not confirm in time that the hand should keep moving");
      return this.say({ word: "jog-ended", path: jog.path, failure: failure(error) });
    }
    this.#send(jog);
  }

  #rest(before: Jog | null): void {
    clearInterval(this.#timer);
    this.#timer = undefined;
    if (before) this.#send({ ...before, velocity: [0, 0, 0, 0, 0] });
  }

  #send({ path, velocity, fence }: Jog): void {
    // One at rest must get there; one that moves is worthless when the next is due.
    const rests = velocity.every((part) => part === 0);
    // The arm says that it stands when the command is over: one to rest is over as soon as it does.
    const text = `jog ${velocity.map((part) => part.toFixed(1)).join(" ")} ${rests ? 1 : HOLDS}`;
    const parcel = { family: "message" as const, name: "command", context: path, content: text, fence, echo: false, ...(rests ? {} : { expires: HOLDS }) };
    void this.client()
      .sendParcel(parcel)
      .catch((error: unknown) => {
        this.#jog = null;
        clearInterval(this.#timer);
        this.#timer = undefined;
        this.say({ word: "jog-ended", path, failure: failure(error) });
      });
  }
}
