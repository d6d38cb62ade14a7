// What several panels say.
import { left, timeOfDay } from "./format.js";

export const common = {
  /** Names of others stand in these as text, and are never markup. */
  cancel: "Cancel",
  close: "Close",
  send: "Send",
  retry: "Try again",
  copied: "Copied.",
  notCopied: "The browser blocked copying: select the text and copy it yourself.",
  unknown: "not known",
  /** How something is of which nothing was heard since. */
  unknownSince: (ms: number) => `unknown since ${timeOfDay(ms)}`,
  /** What is known of a device's rest. */
  rest: { measured: "at rest, measured", "not-measured": "at rest, not measured", moving: "moving", unknown: "rest unknown", unreached: "not reached", unsaid: "rest not reported" },
  restTitles: {
    measured: "Its measured position has stayed within its tolerance for 0.3 s",
    "not-measured": "Its stopping time has passed; it does not measure",
    moving: "It is moving, or not at rest yet",
    unknown: "It can report that it is at rest, and has not",
    unreached: "Its controller cannot be reached, so its motion is unknown",
    unsaid: "It does not report whether it is at rest",
  },
  atRest: "at rest",
  stoppedBriefly: "stopped",
  restByWord: "at rest, as reported",
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
