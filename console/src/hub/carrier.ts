// Commands of this page to one device: each has a course of mom-client from sending to its end, which a hub and a clock are given here.
import type { MessageEvent } from "mom-client";
import { type Command, type CommandEnd, Course, type Step } from "mom-client/drive";
import { commands as t } from "../texts/driving.js";
import { isWithin } from "../worker/ordered.js";
import type { Failure, Happening, HubEvent, Message, Owned, PlainFields, Watch } from "../worker/protocol.js";
import { firstId } from "../worker/protocol.js";
import { failureOf } from "./failure.js";
import { fields, number, text } from "./fields.js";
import type { Hub } from "./hub.svelte.js";
import { visible } from "./said.js";

/** How far a command has come. `again`: it is sent again once what is in its way has passed; `refused`: it never was with a device. */
export type Became = "sending" | "again" | "sent" | "waiting" | "executing" | "finished" | "error" | "refused";

/** What has become of a command. */
export interface News {
  became: Became;
  statement?: number;
  of?: number;
  /** What is in its way. */
  why?: string;
  failure?: Failure | undefined;
}

type Told = (news: News) => void;

/** A course is asked so often whether something is due, ms. */
const TICK = 50;
/** A device's channel is heard for so long after the last command's end, ms. */
const LINGER = 15_000;

export const isOver = (became: Became): boolean => became === "finished" || became === "error" || became === "refused";

export const local = (code: string, text: string): Failure => ({ kind: "local", code, text, content: {} });

/** Why a command has not finished. */
function failureBy({ how, name: code, text: words, hint, error }: CommandEnd): Failure {
  // The page says itself what was refused, by which rule, and who has the token.
  if (how.kind === "refused") return { ...(how.error as Failure), text: visible(how.error.text) };
  const content = (error ?? {}) as PlainFields;
  const [rule, owner] = ["rule", "owner"].map((key) => text(content, key));
  const kind = how.kind === "failed" ? "refused" : "local";
  return { kind, code, text: words, hint, rule, owner, retryAfter: number(content, "retry-after"), content };
}

const notOwner = (path: string, token = "a token"): Failure => local("not-owner", `${path} needs ${token}`);

let lastId = firstId() + 1;

/** One command, under one ownership. */
class Carried {
  readonly #course: Course;
  readonly #begun = performance.now();
  readonly #listening: (() => void)[];
  /** By which it was sent last. */
  #id: number | undefined;
  /** Where the page stood still, what has come meanwhile is heard first. */
  readonly #timer = setInterval(() => setTimeout(() => this.#do(() => this.#course.wake(this.#now)), 0), TICK);
  /** Whether it is still, or again, to be sent, and why it may not be any more. */
  #waits = true;
  #barred: Failure | undefined;
  #wasSent = false;
  #isOver = false;

  constructor(
    readonly carrier: Carrier,
    readonly owned: Owned,
    readonly told: Told,
    readonly ended: (failure: Failure | null) => void,
  ) {
    const { hub, path } = carrier;
    const { path: token, fence } = owned;
    const course = (this.#course = new Course(hub.me?.peer ?? "", { place: path, token }, fence));
    this.#listening = [
      hub.onOwned((of, now, reason = "taken anew", by) => {
        if (of === token && now?.fence !== fence) this.#do(() => course.lost({ reason, ...(by === undefined ? {} : { by }) }));
      }),
      hub.onStop((top) => isWithin(path, top) && this.#bar("stopped", t.stopOrdered)),
      hub.onLink(({ state }) => {
        // While it may be resumed the token is not lost; but the device is halted, so what has not begun is not meant any more.
        if (state !== "connected" && state !== "stale") this.#bar("disconnected", t.linkLost);
        if (state === "out" || state === "closed") this.#do(() => course.linkDown());
      }),
    ];
  }

  begin(command: Command): void {
    this.#do(() => this.#course.begin(command));
  }

  hear(event: HubEvent): void {
    const { type, what } = event as Happening;
    const { name, content } = event as Message;
    // Others of this page may be under way at the device, and their ends are not this one's.
    if (type === "message" && name === "status" && number(fields(content), "id") !== this.#id) return;
    this.#do(() => {
      // Of a parcel a course wants to know the id.
      if (type === "message") this.#course.hear({ ...event, parcel: { id: (event as Message).id } } as unknown as MessageEvent);
      else if (type === "left" || type === "lost") this.#course.gone(text(fields(what["member"]), "peer") ?? "", type === "lost");
      else if (type === "lagged") this.#course.lagged(number(what, "count") ?? 1);
    });
  }

  /** Nothing is sent from now on. What may run goes on to the device's word. */
  #bar(code: string, words: string): void {
    this.#barred ??= local(code, words);
    this.#do(() => undefined);
  }

  get #now(): number {
    return Math.floor(performance.now() - this.#begun);
  }

  /** Tells the course of something, and does what is to be done then. */
  #do(tell: () => void): void {
    if (this.#isOver) return;
    this.#course.at(this.#now);
    tell();
    for (let step = this.#course.poll(); step && !this.#isOver; step = this.#course.poll()) this.#take(step);
    if (this.#waits && this.#barred) this.end(this.#barred);
  }

  #take(step: Step): void {
    if (step.step === "tell") {
      const { progress } = step;
      this.#waits = progress.kind === "again";
      if (progress.kind === "again") return this.told({ became: "again", why: progress.text });
      const { state, statement, of } = progress;
      return this.told({ became: state === "executing" ? state : "waiting", statement, of });
    }
    this.#waits = false;
    if (step.step === "send") void this.#send(step);
    else if (step.step === "ask") void this.#ask();
    else if (step.step === "end") this.end(step.end.finished ? null : failureBy(step.end));
  }

  async #send({ command: { text, expires }, on }: Step & { step: "send" }): Promise<void> {
    const { carrier: { hub, path }, owned: { path: token, fence } } = this;
    const id = (this.#id = lastId += 2);
    const options = { id, echo: false, fence, ...(expires === undefined ? {} : { expires }), ...(on === undefined ? {} : { basedOn: on }) };
    const mine = hub.owned.get(token)?.fence === fence;
    const answer = await (mine ? hub.call("send", path, "command", text, options).catch(failureOf) : notOwner(path, token));
    this.#do(() => {
      const course = this.#course;
      if ("delivered" in answer) {
        this.#wasSent ||= answer.delivered > 0;
        if (answer.delivered > 0) this.told({ became: "sent" });
        course.sent(answer.delivered > 0 ? id : undefined);
        // What is lost never left.
      } else if (answer.kind === "refused" || answer.kind === "local" || answer.code === "lost") course.refused(answer);
      else if (answer.kind === "timed-out" || answer.code === "unknown") course.unanswered(answer.text);
      else course.linkDown();
    });
  }

  /** The hub says then that the token is lost, if it is. */
  async #ask(): Promise<void> {
    await this.carrier.hub.call("ask", "token", "info", this.owned.path).catch(() => undefined);
    this.#do(() => this.#course.asked());
  }

  end(failure: Failure | null): void {
    if (this.#isOver) return;
    this.drop();
    this.told({ became: !failure ? "finished" : this.#wasSent ? "error" : "refused", failure: failure ?? undefined });
    this.ended(failure);
  }

  /** Nothing is sent or told any more. */
  drop(): void {
    this.#isOver = true;
    clearInterval(this.#timer);
    for (const end of this.#listening) end();
    this.carrier.left(this);
  }
}

/** Hears a device's channel for as long as there are commands of this page, and some time beyond. */
export class Carrier {
  readonly #underWay = new Set<Carried>();
  #heard: { joined: Promise<void>; end: () => void } | undefined;
  #linger: ReturnType<typeof setTimeout> | undefined;
  /** The device's newest word of itself, as long as it is there. */
  #state: Message | undefined;

  constructor(
    readonly hub: Hub,
    readonly path: string,
  ) {}

  #listen(): Promise<void> {
    clearTimeout(this.#linger);
    if (this.#heard) return this.#heard.joined;
    let end = (): void => undefined;
    const joined = new Promise<void>((resolve) => {
      const failed = (failure: Failure): void => {
        for (const one of this.#underWay) one.end(failure);
        this.drop();
      };
      const watch: Watch = { path: this.path, kind: "channel", names: ["state", "status"], state: true };
      end = this.hub.watch(watch, { joined: () => resolve(), events: (all, skipped) => this.#take(all, skipped), failed });
    });
    this.#heard = { joined, end };
    return joined;
  }

  #take(events: readonly HubEvent[], skipped: number): void {
    const lagged = { type: "lagged", path: this.path, what: { count: skipped }, arrived: 0 };
    for (const event of skipped ? [lagged, ...events] : events) {
      const { type, what } = event as Happening;
      if (type === "message" && (event as Message).name === "state") this.#state = event as Message;
      if ((type === "left" || type === "lost") && text(fields(what["member"]), "peer") === this.#state?.sender) this.#state = undefined;
      for (const one of this.#underWay) one.hear(event);
    }
  }

  /** Has a command carried out under the token that this page owns now; tells what becomes of it, and gives why it failed. */
  carryOut(command: Command, token: string | undefined, told: Told = () => undefined): Promise<Failure | null> {
    return new Promise((resolve) => {
      const owned = this.hub.owned.get(token ?? "");
      if (!owned) {
        const failure = notOwner(this.path, token);
        told({ became: "refused", failure });
        return resolve(failure);
      }
      const one = new Carried(this, owned, told, resolve);
      this.#underWay.add(one);
      if (this.#state) one.hear(this.#state);
      void this.#listen().then(() => one.begin(command));
    });
  }

  /** It has ended. */
  left(one: Carried): void {
    this.#underWay.delete(one);
    if (!this.#underWay.size) this.#linger = setTimeout(() => this.drop(), LINGER);
  }

  /** Hears the channel no more: nothing is sent, and nothing told. */
  drop(): void {
    for (const one of this.#underWay) one.drop();
    clearTimeout(this.#linger);
    this.#heard?.end();
    this.#heard = this.#state = undefined;
  }
}
