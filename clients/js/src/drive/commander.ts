// Driving a device: one command after the other, each to its end.
import { type Channel, type Client, type Event, type Events, type Fields, type Lost, MomError, type Parcel, fieldsOf } from "../index.js";
import { type Command, Course, type Progress, type Step } from "./course.js";
import { type CommandEnd, DriveError, type Halt, type How, type Whose, commandEnd, verdict } from "./end.js";
import { stateOf } from "./heard.js";

/** No timer waits longer, ms. */
const LONGEST = 2 ** 31 - 1;

/** How a command is followed. */
export interface CarryOutOptions {
  /** Called whenever it has come further, or will be sent again. */
  told?: (progress: Progress) => void;
}

/** What is told of the command that is under way. */
interface UnderWay {
  command: Command;
  told: CarryOutOptions["told"];
  end: Promise<CommandEnd>;
  resolve: (end: CommandEnd) => void;
}

/**
 * A device that is driven under a token. It does not hold the token: its holder says that this is lost ({@link Commander.lost}), or ends
 * the work ({@link Commander.end}). {@link drive} does both.
 */
export class Commander {
  readonly #course: Course;
  readonly #events: Events;
  readonly #whose: Whose;
  readonly #begin = performance.now();
  #timer: ReturnType<typeof setTimeout> | undefined;
  /** For when it is set. */
  #due: number | undefined;
  /** What is followed; receipts and answers of others before it are not its own. */
  #underWay: UnderWay | undefined;
  #last: UnderWay | undefined;
  #lost: Lost | undefined;
  #ending: Promise<void> | undefined;
  /** At the end of the work: gives the token back, and takes how the device took it. */
  #release: () => void = () => undefined;
  #halted: (halt: Halt) => void = () => undefined;
  #state: Fields | undefined;

  /**
   * Drives the device of this channel as the owner with this fence. `events` are those of the channel, if they were subscribed before: so
   * the newest state is known.
   */
  constructor(
    readonly client: Client,
    readonly channel: Channel,
    readonly fence: number,
    events: Events = channel.events(),
  ) {
    this.#whose = { place: channel.path, token: channel.guard?.token };
    this.#course = new Course(client.name, this.#whose, fence);
    this.#events = events;
    void this.#listen();
  }

  /** The content of the newest state of the device; undefined before the first. */
  get state(): Fields | undefined {
    return this.#state;
  }

  /**
   * Has a command carried out, and gives how it ended: it fails by its {@link CommandEnd}, not by an exception. What is in its way and
   * passes (the device still does what its last owner began, its mechanism is out of reach, or our clock is being measured) is waited for.
   *
   * @throws DriveError while another command is under way.
   */
  async carryOut(command: string | Command, { told }: CarryOutOptions = {}): Promise<CommandEnd> {
    if (this.#underWay) throw new DriveError(`a command to ${this.channel.path} is under way`, "wait for its end first");
    const wanted = typeof command === "string" ? { text: command } : command;
    const lost = this.#lost ?? (this.#ending ? { reason: "released" } : undefined);
    if (lost?.reason === "disconnected") return this.#tell({ kind: "disconnected" }, wanted);
    if (lost) return this.#tell({ kind: "lost", lost, ended: undefined }, wanted);
    let resolve!: (end: CommandEnd) => void;
    const end = new Promise<CommandEnd>((done) => (resolve = done));
    this.#last = this.#underWay = { command: wanted, told, end, resolve };
    this.#do(() => this.#course.begin(wanted));
    return end;
  }

  /**
   * The token is lost, and no command is sent any more. Gives how the one that is under way ends, in two seconds at most; undefined if none
   * is.
   */
  async lost(lost: Lost): Promise<CommandEnd | undefined> {
    if (!this.#ending) this.#lost ??= lost;
    const underWay = this.#ending ? undefined : this.#underWay;
    this.#do(() => this.#course.lost(lost));
    return underWay?.end;
  }

  /**
   * Ends the work, also of the command that is under way: `release` gives the token back, at which the hub halts the device, and the device
   * is heard to have ended what runs; it is told to stop if it does not. After a loss of the token only that is waited for which
   * {@link Commander.lost} gives.
   *
   * @throws DriveError where the token was not taken back, or the device did not end its command, and was stopped or is silent.
   */
  end(release: () => Promise<unknown>): Promise<void> {
    return (this.#ending ??= this.#end(release));
  }

  async #end(release: () => Promise<unknown>): Promise<void> {
    if (this.#lost) {
      // What the device does now is its next owner's.
      await this.#underWay?.end;
      this.#close();
      return;
    }
    const { runs } = this.#course;
    let failure: DriveError | undefined = new DriveError("the hub does not say that it has the token back");
    const answered = (error?: DriveError): void => {
      failure = error;
      this.#do(() => this.#course.released());
    };
    const halt = await new Promise<Halt>((resolve) => {
      this.#halted = resolve;
      this.#release = () => void (async () => release())().then(() => answered(), (error: unknown) => answered(this.#unreleased(error)));
      this.#do(() => this.#course.cancel());
    });
    const wrong = verdict(halt, this.channel.path);
    this.#close();
    const { command } = this.#underWay ?? {};
    const ended = runs ? halt !== "silent" : undefined;
    if (command) this.#ended(this.#tell({ kind: "lost", lost: { reason: "released" }, ended }, command));
    if (failure && wrong) throw new DriveError(`${failure.text}; ${wrong.text}`, failure.hint ?? wrong.hint, failure.cause);
    if (failure) throw failure;
    if (wrong) throw new DriveError(wrong.text, wrong.hint);
  }

  #unreleased(error: unknown): DriveError {
    const why = error instanceof Error ? error.message : String(error);
    return new DriveError(`release ${this.#whose.token ?? "the token"}: ${why}`, undefined, error);
  }

  #tell(how: How, { text }: Command): CommandEnd {
    return commandEnd(how, this.#whose, text, false);
  }

  /** Hears no more. */
  #close(): void {
    clearTimeout(this.#timer);
    void this.#events.return();
  }

  async #listen(): Promise<void> {
    for await (const event of this.#events) this.#do(() => this.#hear(event));
    this.#do(() => this.#course.linkDown());
  }

  #hear(event: Event): void {
    if (event.type === "message" && event.name === "state" && stateOf(event)) this.#state = fieldsOf(event.content);
    this.#course.hear(event);
  }

  #now(): number {
    return Math.floor(performance.now() - this.#begin);
  }

  /** Tells the course of something, and does what is to be done then. */
  #do(tell: () => void): void {
    this.#course.at(this.#now());
    tell();
    for (let step = this.#course.poll(); step; step = this.#course.poll()) this.#take(step);
    this.#wakeAt(this.#course.nextWake);
  }

  #wakeAt(due: number | undefined): void {
    if (due === this.#due) return;
    clearTimeout(this.#timer);
    this.#due = due;
    if (due === undefined) return;
    const wake = (): void => {
      this.#due = undefined;
      this.#do(() => this.#course.wake(this.#now()));
    };
    // Where this program stood still, what has come meanwhile is heard first.
    const heard = (): void => void (this.#timer = setTimeout(wake, 0));
    this.#timer = setTimeout(heard, Math.min(Math.max(0, due - this.#now()), LONGEST));
  }

  #take(step: Step): void {
    switch (step.step) {
      case "send":
        return void this.#send(step);
      case "tell": {
        const { told } = this.#underWay ?? {};
        // What it throws must not keep this commander from its work.
        if (told) queueMicrotask(() => told(step.progress));
        return;
      }
      case "ask":
        return void this.#ask();
      case "end":
        return this.#ended(step.end);
      case "release":
        return this.#release();
      case "stop": {
        const content = { reason: "it did not end a command when its token was given back" };
        // Where it cannot be said, the next one is due all the same.
        return void this.channel.sendAcknowledged("stop", content, { echo: false }).catch(() => undefined);
      }
      case "halted":
        return this.#halted(step.halt);
    }
  }

  #ended(end: CommandEnd): void {
    const underWay = this.#underWay;
    this.#underWay = undefined;
    underWay?.resolve(end);
  }

  async #send({ command, on, to }: Step & { step: "send" }): Promise<void> {
    const { text, attachments, expires } = command;
    const content = attachments && Object.keys(attachments).length ? { script: text, attachments } : text;
    // By its fence it is not taken under another ownership, should the token be lost and come back meanwhile. The receipt says its id.
    const slots = { content, fence: this.fence, echo: false, receipt: true };
    const parcel: Parcel = { family: "message", name: "command", context: this.channel.path, ...slots };
    if (to !== undefined) parcel.reference = to;
    if (expires !== undefined) parcel.expires = expires;
    if (on !== undefined) parcel.extra = { "based-on": on };
    const sender = this.#last;
    const answer = await this.client.request(parcel).catch((error: unknown) => error);
    if (sender !== this.#last) return;
    this.#do(() => this.#receipt(answer));
  }

  #receipt(answer: unknown): void {
    const course = this.#course;
    if (!(answer instanceof Error)) {
      const { reference, content } = answer as Parcel;
      course.sent(fieldsOf(content)["delivered"] === 0 ? undefined : reference);
    } else if (!(answer instanceof MomError)) course.unanswered(answer.message);
    // What is lost never left: the link may be resumed, and the token is not lost then.
    else if (answer.kind === "refused" || answer.kind === "local" || answer.code === "lost") course.refused(answer);
    else if (answer.kind === "timed-out" || answer.code === "unknown") course.unanswered(answer.text);
    else course.linkDown();
  }

  async #ask(): Promise<void> {
    const { token } = this.#whose;
    const sender = this.#last;
    if (token !== undefined) await this.client.info(token).catch(() => undefined);
    if (sender === this.#last) this.#do(() => this.#course.asked());
  }
}
