// The course of the commands to one device, from sending to the end, without IO and clock. Dialogues say what it does:
// tests/cases/commander.txt.
import type { Event, Fields, Lost } from "../index.js";
import { type CommandEnd, type Halt, type How, type Refusal, STOPS, type Whose, commandEnd } from "./end.js";
import { type CommandReport, type StateNews, errorName, errorText, isLast, reportOf, hasBegun, standsFor, stateOf, wasTooLate } from "./heard.js";

/** ms in which a device answers a command, and the hub a question. */
const ANSWER = 10_000;
/** ms in which the hub gives a receipt; who sends waits for one for 10 s. */
const RECEIPT = 15_000;
/** ms after which a device that says nothing is not there any more; a statement may wait for a minute. */
const SILENT = 90_000;
/** ms for which a device may do what its last owner began, or its mechanism may be out of reach. */
const STANDING = 60_000;
/** ms for which the hub may measure our clock, and between two commands to a device that may take the next one. */
const MEASURED = 10_000;
const SOON = 100;
/** ms within which a device that asks for its commands does so, unless it has something to do. */
const ASKS = 65_000;
/** ms in which the hub takes a token back. */
const RELEASED = 1_000;
/** ms in which a device ends a command after the hub's `halt`. */
const HALTED = 2_000;
/** ms between two stops of a device that does not end its command. */
const REPEATED = 300;
/** Reports that may come before the receipt. */
const EARLY = 64;

/** A command to a device. */
export interface Command {
  /** Its statements: `move 50 50 200 0 0; grip close`. */
  text: string;
  /** Bytes that they name, such as a sound. */
  attachments?: { readonly [name: string]: Uint8Array };
  /** Of one that says only how far: the state that it counts from, by its id, or the `newest` one in which the device rests. */
  basedOn?: number | "newest";
  /** ms after which it is worth nothing. */
  expires?: number;
  /** It is never sent again, whatever is in its way. */
  once?: boolean;
  /** It is sent when the device asks for it (`next`), and again where that did not begin it in time. */
  whenAsked?: boolean;
}

/** How far a command has come. */
export type Progress =
  /** The device says that it waits or is carried out, at which statement (0 before the first) of how many. */
  | { kind: "device"; state: string; statement: number; of: number }
  /**
   * It will be sent again, since what is in its way passes: the error's name (`changing-hands`, `link`, `too-old`; also `expired`,
   * `try-later` and `late` of what a device asks for), and its words.
   */
  | { kind: "again"; why: string; text: string };

/** What is to be done next. */
export type Step =
  /** The command is to be sent, based on that state, as the answer to that `next`. Then {@link Course.sent}, `refused` or `unanswered`. */
  | { step: "send"; command: Command; on: number | undefined; to: number | undefined }
  /** It has come further. */
  | { step: "tell"; progress: Progress }
  /** The hub is to be asked about the token, which says first whether that is lost. Then {@link Course.asked}. */
  | { step: "ask" }
  /** It has ended. */
  | { step: "end"; end: CommandEnd }
  /** The token is to be given back. Then {@link Course.released}. */
  | { step: "release" }
  /** The device is to be told to stop. */
  | { step: "stop" }
  /** The work has ended. */
  | { step: "halted"; halt: Halt };

/** What is waited for, and until when. */
type Wait =
  /** No command is under way. */
  | { for: "nothing"; until?: undefined }
  /** The state that a relative command is based on. */
  | { for: "state"; since: number; until: number }
  /** The hub's receipt; that the device asks for the command, answers it; or that the hub has the token back. */
  | { for: "receipt" | "next" | "answer" | "release"; until: number }
  /** That the device goes on with the command that it has taken, by its id. */
  | { for: "running"; until: number; id: number | undefined }
  /** That what is in the way passes; when the command is sent again without a word of the device. */
  | { for: "obstacle"; until: number; report: CommandReport; again: number | undefined }
  /** The hub's word, whether the token is lost; how the command ends else. */
  | { for: "asked"; until: number; end: How }
  /** That the device says that it has ended what was begun under the token. */
  | { for: "loss"; until: number; lost: Lost }
  /** The same at the end of the work; how often the device was told to stop. */
  | { for: "ended"; until: number; stops: number };

const NOTHING: Wait = { for: "nothing" };

/**
 * The commands to one device under one fence, one after the other, without IO and clock: a program tells what it hears
 * ({@link Course.hear} and what is beside it), calls {@link Course.wake} when that is due ({@link Course.nextWake}), and after each carries
 * out the steps that {@link Course.poll} gives. {@link Commander} does so. Times are ms of a clock that only rises, from 0.
 */
export class Course {
  #command: Command = { text: "" };
  #wait: Wait = NOTHING;
  /** What is in the way, by its name, and when it was first met. */
  #met: { name: string; since: number } | undefined;
  /** The ids by which the command was sent. */
  readonly #ids = new Set<number>();
  /** Those of commands that were given up for another, and whose end was not heard. */
  #left: number[] = [];
  #early: CommandReport[] = [];
  #runs = false;
  /** Whether the device has said anything of the command, and that it has begun it; and who said so first. */
  #reported = false;
  #begun = false;
  #worker: string | undefined;
  /** When it was sent last. */
  #sentAt = 0;
  /** The device's peer, once it has said something. */
  #device: string | undefined;
  #state: StateNews | undefined;
  #now = 0;
  #steps: Step[] = [];

  constructor(
    /** The name of this peer at the hub, by which the device names it. */
    readonly me: string,
    readonly whose: Whose,
    readonly fence: number,
  ) {}

  /** Whether a command is under way. */
  get isUnderWay(): boolean {
    return !["nothing", "release", "ended"].includes(this.#wait.for);
  }

  /** Whether a command was sent, and no end of it was heard. */
  get runs(): boolean {
    return this.#runs;
  }

  /** When it is to be woken. */
  get nextWake(): number | undefined {
    const wait = this.#wait;
    return wait.for === "obstacle" ? Math.min(wait.until, wait.again ?? Infinity) : wait.until;
  }

  /** What is to be done next. */
  poll(): Step | undefined {
    return this.#steps.shift();
  }

  /** It is so late. What is due meanwhile happens at {@link Course.wake} only, so that what came before can be told first. */
  at(now: number): void {
    this.#now = Math.max(this.#now, now);
  }

  /** It is so late, and what is due happens. */
  wake(now: number): void {
    this.at(now);
    const due = this.nextWake;
    if (due === undefined || now < due) return;
    const wait = this.#wait;
    switch (wait.for) {
      case "state":
        // It says itself that it moves.
        return this.#state ? this.#send() : this.#end({ kind: "no-answer" });
      case "next":
        return this.#end({ kind: "asks-nothing" });
      case "answer":
        return this.#end({ kind: "no-answer" });
      case "receipt":
        return this.#end({ kind: "unanswered", why: "no receipt within 15 s" });
      case "running":
        return this.#end({ kind: "silent" });
      case "obstacle":
        return now < wait.until ? this.#beginAgain() : this.#ask({ kind: "failed", report: wait.report });
      case "asked":
        return this.#end(wait.end);
      case "loss":
        return this.#end({ kind: "lost", lost: wait.lost, ended: false });
      case "release":
        return this.released();
      case "ended":
        return this.#insist(wait.stops);
    }
  }

  /** Stops a device that does not end its command, or gives that up. */
  #insist(stops: number): void {
    if (stops >= STOPS) return this.#halted("silent");
    this.#steps.push({ step: "stop" });
    this.#wait = { for: "ended", until: this.#now + REPEATED, stops: stops + 1 };
  }

  /** A command is to be carried out. One before that has not ended goes on, and nothing more is told of it. */
  begin(command: Command): void {
    [this.#command, this.#met, this.#steps] = [command, undefined, []];
    if (this.#runs) this.#left = [...this.#left, ...this.#ids].slice(-EARLY);
    [this.#runs, this.#reported, this.#begun, this.#worker] = [false, false, false, undefined];
    this.#beginAgain();
  }

  #beginAgain(): void {
    this.#ids.clear();
    const [{ whenAsked, basedOn }, since] = [this.#command, this.#now];
    if (whenAsked) this.#wait = { for: "next", until: since + ASKS };
    else if (basedOn !== "newest" || this.#state?.moving === false) this.#send();
    else this.#wait = { for: "state", since, until: since + (this.#state ? STANDING : ANSWER) };
  }

  #send(to?: number): void {
    const { basedOn } = this.#command;
    // From here on it may run, whether or not its receipt comes.
    [this.#runs, this.#reported] = [true, false];
    this.#sentAt = this.#now;
    this.#early = [];
    this.#wait = { for: "receipt", until: this.#now + RECEIPT };
    this.#steps.push({ step: "send", command: this.#command, on: basedOn === "newest" ? this.#state?.id : basedOn, to });
  }

  /** The receipt of the command: its id; undefined if there is nobody to take it. */
  sent(id: number | undefined): void {
    if (id === undefined) return this.#unsent({ kind: "no-answer" });
    this.#ids.add(id);
    if (this.#wait.for === "receipt") {
      this.#wait = this.#command.whenAsked ? { for: "next", until: this.#now + ASKS } : { for: "answer", until: this.#now + ANSWER };
    }
    for (const report of this.#early.splice(0)) this.#take(report);
  }

  /** The hub has refused the command. */
  refused(error: Refusal): void {
    const passes = error.code === "expired" || error.code === "try-later";
    if (!this.#command.whenAsked || !passes || this.#wait.for !== "receipt") return this.#unsent({ kind: "refused", error });
    this.#runs = this.#ids.size > 0;
    this.#nextAgain(error.code, error.text);
  }

  /** The hub has not said whether it has the command, and why. */
  unanswered(why: string): void {
    if (this.#wait.for === "receipt") this.#end({ kind: "unanswered", why });
  }

  /** The command did not go out. */
  #unsent(end: How): void {
    this.#runs = this.#ids.size > 0;
    const wait = this.#wait.for;
    if (wait === "receipt") return end.kind === "refused" ? this.#ask(end) : this.#end(end);
    if ((wait === "ended" || wait === "loss") && !this.#runs) this.#hasEnded(undefined);
  }

  #again(why: string, text: string): void {
    this.#steps.push({ step: "tell", progress: { kind: "again", why, text } });
  }

  /** It is given to the device when that asks again. */
  #nextAgain(why: string, text: string): void {
    this.#wait = { for: "next", until: this.#now + ASKS };
    this.#again(why, text);
  }

  /** Takes an event of the device's channel. */
  hear(event: Event): void {
    switch (event.type) {
      case "message": {
        const { name, sender, history } = event;
        const state = name === "state" ? stateOf(event) : undefined;
        const report = name === "status" && !history ? reportOf(event) : undefined;
        if (state) this.stateTold(state, sender, history);
        if (report) this.reported(report, sender);
        if (name === "next" && !history && event.parcel.id !== undefined) this.asks(event.parcel.id);
        return;
      }
      case "left":
      case "lost":
        return this.gone(event.member.peer, event.type === "lost");
      case "link-down":
        return this.linkDown();
      case "lagged":
        return this.lagged(event.count);
      case "dropped": {
        const { sender, receiver } = (event.parcel?.family === "event" ? event.parcel.content : {}) as Fields;
        if (sender === this.me) this.dropped(event.reason, typeof receiver === "string" ? receiver : undefined);
      }
    }
  }

  /** The device asks for a command, by this id. */
  asks(id: number): void {
    if (this.#wait.for !== "next") return;
    if (this.#ids.size) this.#again("late", "it was not begun in time");
    this.#send(id);
  }

  /** The device's state; an old one is from before this program came. */
  stateTold(news: StateNews, by?: string, isOld = false): void {
    if (!isOld) this.#hearsDevice(by);
    this.#state = news;
    // What is stopped and rests has ended what it did.
    if (!isOld && news.stopped && !news.moving && this.#wait.for === "ended" && this.#wait.stops > 0) return this.#hasEnded(true);
    const wait = this.#wait;
    if (wait.for === "state") {
      wait.until = wait.since + STANDING;
      if (!news.moving) this.#send();
    } else if (wait.for === "obstacle" && !isOld) {
      const name = errorName(wait.report);
      // No state tells that a clock has been measured.
      if (name !== "changing-hands" && name !== "link") return;
      const passed = name === "link" ? news.linked : standsFor(news, this.fence);
      if (!passed) wait.again = undefined;
      else if (this.#now < this.#sentAt + SOON) wait.again = this.#sentAt + SOON;
      else this.#beginAgain();
    }
  }

  #hearsDevice(by: string | undefined): void {
    this.#device = by ?? this.#device;
    if (this.#wait.for === "running") this.#wait.until = this.#now + SILENT;
  }

  /** What the device says of a command; old ones are left out. */
  reported(report: CommandReport, by?: string): void {
    if (report.peer !== this.me || (report.fence !== undefined && report.fence !== this.fence)) return;
    // Where several devices are, it is the one's that has answered.
    if (this.#worker !== undefined && by !== undefined && by !== this.#worker) return;
    this.#hearsDevice(by);
    if (report.id !== undefined && this.#ids.has(report.id)) this.#worker = by;
    this.#take(report);
  }

  /** The hub has dropped a message of this peer on its way to a device (`receiver`), for this reason. */
  dropped(reason: string, receiver?: string): void {
    const isOther = receiver !== undefined && this.#device !== undefined && receiver !== this.#device;
    if (this.#reported || !this.#runs || isOther) return;
    const wait = this.#wait;
    if (wait.for === "answer") {
      this.#runs = false;
      this.#ask({ kind: "dropped", reason });
    } else if (wait.for === "loss") {
      this.#runs = false;
      this.#end({ kind: "lost", lost: wait.lost, ended: undefined });
    } else if (wait.for === "release") this.#runs = false;
    else if (wait.for === "ended" && !this.#left.length) this.#hasEnded(true);
  }

  #take(report: CommandReport): void {
    const isThis = report.id !== undefined && this.#ids.has(report.id);
    this.#reported ||= isThis;
    this.#begun ||= isThis && hasBegun(report);
    const wasLeft = report.id !== undefined && this.#left.includes(report.id);
    if (wasLeft && isLast(report)) this.#left = this.#left.filter((id) => id !== report.id);
    switch (this.#wait.for) {
      case "release":
      case "ended":
      case "loss":
        if (isLast(report)) this.#hearsAnEnd(report, isThis, wasLeft);
        return;
      case "receipt":
        if (isThis) return this.#comes(report);
        this.#early.push(report);
        if (this.#early.length > EARLY) this.#early.shift();
        return;
      case "answer":
      case "running":
      case "next":
        if (isThis) this.#comes(report);
        return;
      case "obstacle":
        // It has begun all the same.
        if (isThis && !isLast(report) && this.#begun) this.#comes(report);
        return;
      case "nothing":
        // It was given up.
        if (isThis && isLast(report)) this.#runs = false;
    }
  }

  /** A command has ended at the end of the work. */
  #hearsAnEnd(report: CommandReport, isThis: boolean, wasLeft: boolean): void {
    // Which one runs may not be known yet: then the end of any of ours is its end.
    const ends = isThis || (!this.#ids.size && !wasLeft);
    if (report.id !== undefined) this.#ids.delete(report.id);
    // Of those that a device was given which asks for them, at most one is begun.
    if (ends && !(this.#ids.size && wasTooLate(report))) this.#runs = false;
    if (!this.#mayRun) this.#hasEnded(true);
  }

  /** The command has come further. */
  #comes(report: CommandReport): void {
    const { state, statement, of } = report;
    // Commands are carried out one after the other.
    if (state !== "error" && statement > 0) this.#left = [];
    if (state === "error") return this.#fails(report);
    if (state === "finished") {
      this.#runs = false;
      return this.#end({ kind: "finished", of });
    }
    this.#wait = { for: "running", until: this.#now + SILENT, id: report.id };
    this.#steps.push({ step: "tell", progress: { kind: "device", state, statement, of } });
  }

  /** The device does not carry it out; unless what is in the way passes. */
  #fails(report: CommandReport): void {
    const [name, { whenAsked }] = [errorName(report) ?? "", this.#command];
    if (whenAsked && wasTooLate(report) && !this.#begun) {
      // Of those that it was given, at most one is ever begun, and none that came before one that it has answered.
      const [given, taken] = [[...this.#ids], this.#wait.for === "running" && this.#wait.id === report.id];
      for (const id of given.slice(0, given.indexOf(report.id!) + 1)) this.#ids.delete(id);
      if (this.#wait.for !== "next" && !taken) return;
      this.#runs = this.#ids.size > 0;
      return this.#nextAgain(name, errorText(report));
    }
    this.#runs = false;
    const patience = name === "too-old" ? MEASURED : name === "changing-hands" || name === "link" ? STANDING : 0;
    // What may have begun is never said twice.
    const isLastTry = whenAsked || this.#command.once || this.#begun;
    if (!patience || report.error?.["retry"] !== true || isLastTry) return this.#ask({ kind: "failed", report });
    if (this.#met?.name !== name) this.#met = { name, since: this.#now };
    const stands = !this.#state || (standsFor(this.#state, this.fence) && this.#state.linked);
    // No state tells that a clock has been measured, nor again that a device stands.
    const again = name === "too-old" || stands ? this.#now + SOON : undefined;
    this.#again(name, errorText(report));
    this.#wait = { for: "obstacle", until: this.#met.since + patience, report, again };
  }

  /** A device that was halted because the token is lost may say so before the hub does. */
  #ask(end: How): void {
    this.#steps.push({ step: "ask" });
    this.#wait = { for: "asked", until: this.#now + ANSWER, end };
  }

  /** The hub has answered, after all that it had to say before. */
  asked(): void {
    if (this.#wait.for === "asked") this.#end(this.#wait.end);
  }

  /** The token is lost, and the hub halts the device. */
  lost(lost: Lost): void {
    // Nobody would be heard.
    if (lost.reason === "disconnected") return this.linkDown();
    const wait = this.#wait;
    if (!this.isUnderWay || wait.for === "loss") return;
    if (wait.for === "asked" && wait.end.kind === "failed" && !this.#left.length) this.#end({ kind: "lost", lost, ended: true });
    else if (!this.#mayRun) this.#end({ kind: "lost", lost, ended: undefined });
    else {
      const ended = this.#endedEarly;
      this.#wait = { for: "loss", until: this.#now + HALTED, lost };
      if (ended) this.#hasEnded(true);
    }
  }

  /** A peer has left, or the hub misses it. */
  gone(peer: string, missed: boolean): void {
    if ((this.#worker ?? this.#device) === peer) this.#breaks({ kind: "gone", device: peer, missed });
  }

  /** The link to the hub is down. */
  linkDown(): void {
    this.#breaks({ kind: "disconnected" });
  }

  /** So many events were lost. */
  lagged(count: number): void {
    this.#breaks({ kind: "lagged", count });
  }

  #breaks(end: How): void {
    // What the device says may come all the same, or nobody knows soon enough.
    if (this.isUnderWay && this.#wait.for !== "loss") this.#end(end);
  }

  /** Ends the work: the token is given back, and the device heard to have ended what runs. */
  cancel(): void {
    this.#runs &&= !this.#endedEarly;
    this.#steps = [{ step: "release" }];
    this.#wait = { for: "release", until: this.#now + (this.#mayRun ? RELEASED : ANSWER) };
  }

  /** The hub has the token back, or has refused it. */
  released(): void {
    if (this.#wait.for !== "release") return;
    if (this.#mayRun) this.#wait = { for: "ended", until: this.#now + HALTED, stops: 0 };
    else this.#halted("confirmed");
  }

  /** Whether something may run that was commanded here. */
  get #mayRun(): boolean {
    return this.#runs || this.#left.length > 0;
  }

  /** Whether the device has said before the receipt that a command has ended. */
  get #endedEarly(): boolean {
    return !this.#ids.size && this.#early.some(isLast);
  }

  /** What runs has ended: the device has said so, or was never told to begin. */
  #hasEnded(said: true | undefined): void {
    [this.#runs, this.#left] = [false, []];
    const wait = this.#wait;
    if (wait.for === "ended") this.#halted(wait.stops ? "stopped" : "confirmed");
    else if (wait.for === "loss") this.#end({ kind: "lost", lost: wait.lost, ended: said });
  }

  #halted(halt: Halt): void {
    this.#wait = NOTHING;
    this.#steps.push({ step: "halted", halt });
  }

  #end(how: How): void {
    this.#wait = NOTHING;
    this.#steps.push({ step: "end", end: commandEnd(how, this.whose, this.#command.text, this.#runs) });
    // The device is another owner's by then, whom a stop would meet.
    if (how.kind === "lost") [this.#runs, this.#left] = [false, []];
  }
}
