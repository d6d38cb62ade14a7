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
  nobody: "nobody",
  you: "you",
  of: (one: number, all: number) => `${one} of ${all}`,
  refusal: {
    title: (what: string) => `Refused: ${what}`,
    failed: (what: string) => `Failed: ${what}`,
    rule: "Rule",
    owner: "Owner",
    yourLevel: "Your level",
    place: "Place in the queue",
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
