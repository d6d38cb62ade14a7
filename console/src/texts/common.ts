// What several panels say.
import { left, timeOfDay } from "./format.js";

export const common = {
  /** Names of others stand in these as text, and are never markup. */
  cancel: "Cancel",
  close: "Close",
  send: "Send",
  retry: "Try again",
  copied: "Copied.",
  notCopied: "The browser did not let it be copied: mark the text and copy it by hand.",
  unknown: "not known",
  /** How something is of which nothing was heard since. */
  unknownSince: (ms: number) => `unknown since ${timeOfDay(ms)}`,
  /** What is known of a device's rest. */
  rest: { measured: "at rest, measured", "not-measured": "at rest, not measured", moving: "moving", unknown: "not known to rest", unreached: "not reached", unsaid: "rest not told" },
  restTitles: {
    measured: "Its position has not changed by more than its tolerance for 0.3 s of measurements",
    "not-measured": "The time in which it stops has passed; it does not measure",
    moving: "It moves, or does not rest yet",
    unknown: "It could say that it rests, and has not",
    unreached: "What moves it cannot be reached, so nobody knows whether it moves",
    unsaid: "It says nothing of whether it rests",
  },
  atRest: "at rest",
  stoppedBriefly: "stopped",
  restByWord: "at rest, by its word",
  stopped: (rest: string) => `stopped, ${rest}`,
  unreachedSince: (ms: number, late: boolean) => `not reached since ${timeOfDay(ms)}${late ? " or before" : ""}`,
  nobody: "nobody",
  you: "you",
  of: (one: number, all: number) => `${one} of ${all}`,
  refusal: {
    title: (what: string) => `Refused: ${what}`,
    failed: (what: string) => `Failed: ${what}`,
    rule: "Rule",
    owner: "Owner",
    yourLevel: "Your level",
    place: "Place, if you wait",
    when: "Possible again",
    in: (ms: number) => `in ${left(ms)}`,
    nearest: "Did you mean",
    code: "Code",
    dismiss: "Dismiss",
  },
  link: {
    out: "not logged in",
    trying: "connecting",
    connected: "connected",
    stale: "no answer",
    resuming: "link lost, resuming",
    closed: "closed",
  },
};
