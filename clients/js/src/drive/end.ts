// How commands, and the work under a token, end, in the same words everywhere.
import type { Fields, Lost } from "../index.js";
import { type CommandReport, errorName, errorWords } from "./heard.js";
import { visible } from "./visible.js";

/** So many stops are said to a device that does not end its command. */
export const STOPS = 3;

/** What the hub has refused, as a {@link MomError} has it. */
export interface Refusal {
  /** The word, as `held`. */
  readonly code: string;
  readonly text: string;
  readonly number?: number;
  /** All that the hub said. */
  readonly content?: Fields;
}

/** How a command ended. */
export type How =
  /** It was carried out: so many statements. */
  | { kind: "finished"; of: number }
  /** The device has refused it, or ended it with an error. */
  | { kind: "failed"; report: CommandReport }
  /** The hub has refused it. */
  | { kind: "refused"; error: Refusal }
  /** The hub has dropped it on its way to the device, for this reason. */
  | { kind: "dropped"; reason: string }
  /** The hub has not said whether it has it; why. */
  | { kind: "unanswered"; why: string }
  /** No device answers, or the device asks for no commands, or it has begun this one and says nothing any more. */
  | { kind: "no-answer" | "asks-nothing" | "silent" }
  /** The device has left, or the hub has lost its connection (`missed`). */
  | { kind: "gone"; device: string; missed: boolean }
  /** The link to the hub is down. */
  | { kind: "disconnected" }
  /** So many events were lost here. */
  | { kind: "lagged"; count: number }
  /** The token was lost; whether the device has said that it has ended the command, undefined if that was never sent. */
  | { kind: "lost"; lost: Lost; ended: boolean | undefined };

/** A command's end, and how it is told. */
export interface CommandEnd {
  readonly how: How;
  /** Whether it was carried out. */
  readonly finished: boolean;
  /** The word for it: `finished`, the name of the device's error, the code of the hub's, or what became of it else (`lost`). */
  readonly name: string;
  /** In words. */
  readonly text: string;
  /** What to do, where something can be done. */
  readonly hint: string | undefined;
  /** What the device or the hub has said is wrong: `name`, `code` (its number), `text`, and more by docs/PROTOCOL.md. */
  readonly error: Fields | undefined;
}

/** Why a device could not be driven, or did not end its work as it should. */
export class DriveError extends Error {
  override readonly name = "DriveError";

  /** @internal */
  constructor(
    /** Plain words. */
    readonly text: string,
    /** What to do, where something can be done. */
    readonly hint?: string,
    cause?: unknown,
  ) {
    super(text, cause === undefined ? undefined : { cause });
  }
}

/** What is commanded: the device's channel, and the token that guards it. */
export interface Whose {
  place: string;
  token?: string | undefined;
}

/**
 * How a device took the end of the work: it has ended its command or nothing ran, it has done so after a `stop` only, or it has said
 * nothing.
 */
export type Halt = "confirmed" | "stopped" | "silent";

/** Of a command that the device cannot have heard of. */
const NOTHING = "; nothing of the command ran";
const UNKNOWN = "; what became of the command is not known";

/** Tells how a command ended; `runs`: it may have been sent, and nothing was heard of its end. */
export function commandEnd(how: How, whose: Whose, command: string, runs: boolean): CommandEnd {
  const [text, hint] = words(how, whose, command, runs ? UNKNOWN : NOTHING);
  return { how, finished: how.kind === "finished", name: nameOf(how), text, hint, error: errorOf(how) };
}

function nameOf(how: How): string {
  switch (how.kind) {
    case "failed":
      return ownName(visible(errorName(how.report) ?? ""));
    case "refused":
      return how.error.code;
    case "asks-nothing":
      return "no-answer";
    default:
      return how.kind;
  }
}

/** The longest name of an error that is told, characters. */
const LONGEST = 64;
/** What a device's error may not be called: these are words of the commander's own. */
const OWN = ["", "finished", "error", "dropped", "unanswered", "no-answer", "silent", "gone", "disconnected", "lagged", "lost"];

function ownName(name: string): string {
  return OWN.includes(name) ? "error" : [...name].slice(0, LONGEST).join("");
}

function errorOf(how: How): Fields | undefined {
  if (how.kind === "failed") return how.report.error ?? {};
  if (how.kind !== "refused") return undefined;
  const { code, number, text, content } = how.error;
  return { ...content, name: code, ...(number === undefined ? {} : { code: number }), text };
}

/** The words and the advice. */
function words(how: How, { place, token }: Whose, command: string, became: string): [text: string, hint?: string] {
  const around = `see who is there: mom tree ${place.slice(0, place.lastIndexOf("/")) || "/"}`;
  const lookOrStop = `look at it: mom watch ${place}; stop it: mom stop ${place}`;
  const send = `send ${visible(JSON.stringify(command))} to ${place}`;
  switch (how.kind) {
    case "finished":
      return ["finished"];
    case "failed":
      return failed(how.report, place, lookOrStop);
    case "refused":
      return [`${send}: ${refused(how.error)}`];
    case "dropped":
      return [`${send}: the hub dropped it on its way: ${visible(how.reason)}${NOTHING}`];
    case "unanswered":
      return [`${send}: ${how.why}${became}`, lookOrStop];
    case "no-answer":
      return [`no device answers in ${place}`, around];
    case "asks-nothing":
      return [
        `the device in ${place} asks for nothing`,
        `start it so that it asks for its commands, or let it go with: mom unstop ${place}`,
      ];
    case "silent":
      return [`the device in ${place} has said nothing for 90 s${became}`, around];
    case "gone": {
      const device = visible(how.device);
      const gone = how.missed ? `the hub has lost the connection of ${device}, the device in ${place}` : `${device} has left ${place}`;
      return [gone + became, around];
    }
    case "disconnected": {
      const lost = `the connection to the hub is lost, and the token with it${became}`;
      return became === NOTHING ? [lost] : [lost, `see what it did: mom watch ${place}`];
    }
    case "lagged":
      return [`${how.count} ${how.count === 1 ? "event was" : "events were"} lost here${became}`, lookOrStop];
    case "lost":
      return lost(how.lost, how.ended, token ?? "the token");
  }
}

function failed(report: CommandReport, place: string, lookOrStop: string): [string, string?] {
  const [name, text] = [errorName(report), errorWords(report)];
  if (name === "stopped") return [text, `let it go with: mom unstop ${place}`];
  if (name === "estop") return [text, `reset its emergency stop, then let it go with: mom unstop ${place}`];
  return name === "changing-hands" || name === "link" ? [text, lookOrStop] : [text];
}

function refused({ code, text, content }: Refusal): string {
  const nearest = content?.["nearest"];
  return `${code}: ${text}${typeof nearest === "string" ? ` (did you mean ${nearest}?)` : ""}`;
}

function lost(how: Lost, ended: boolean | undefined, token: string): [string, string?] {
  const text = `lost ${token}: ${lossWords(how)}`;
  if (ended === undefined) return [text + NOTHING];
  if (ended) return [`${text}; the device has ended the command`];
  return [`${text}; the device has not said that it has ended the command`, "go and look; switch it off where it moves"];
}

/** What a reason means, said with and without the peer that caused it. */
const REASONS: Record<string, { by?: (peer: string) => string; alone?: string }> = {
  preempted: { by: (peer) => `${peer} has a higher level and took it` },
  expired: { by: (peer) => `the time was over, and ${peer} was next`, alone: "the lease was over" },
  given: { by: (peer) => `${peer} has it now` },
  broken: { by: (peer) => `${peer} took it away` },
  disconnected: always("the connection to the hub is lost"),
  deleted: always("it was deleted"),
  returned: always("it returned to its giver"),
  revoked: always("you may no longer be here"),
};

function always(text: string): { by: () => string; alone: string } {
  return { by: () => text, alone: text };
}

/** Why a token is lost, in words. */
export function lossWords({ reason, by }: Lost): string {
  const known = Object.hasOwn(REASONS, reason) ? REASONS[reason] : undefined;
  if (by === undefined) return known?.alone ?? visible(reason);
  return known?.by?.(visible(by)) ?? `${visible(reason)} by ${visible(by)}`;
}

/** What is wrong with how a device took the end of the work; undefined where it has obeyed. */
export function verdict(halt: Halt, place: string): { text: string; hint: string } | undefined {
  switch (halt) {
    case "confirmed":
      return undefined;
    case "stopped":
      return {
        text: `the device in ${place} did not end its command when the hub halted it, so it was stopped`,
        hint: `see what is wrong with it, then let it go with: mom unstop ${place}`,
      };
    case "silent":
      return {
        text: `the device in ${place} has not said that it has ended its command, though the hub was asked to halt it, and ${STOPS} times to stop it`,
        hint: "go and look; switch it off where it moves",
      };
  }
}
