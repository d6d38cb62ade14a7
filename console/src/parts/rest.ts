// How a device stands, in words: whether it is stopped, and what is known of its rest.
import { common as t } from "../texts/common.js";
import { type Rest, isAtRest, isWell } from "../worker/rest.js";

export interface Stood {
  rest: Rest;
  stopped: boolean;
  moving: boolean;
  unreached: { since: number; late: boolean } | undefined;
}

export function restWords({ rest, stopped, moving, unreached }: Stood): string {
  // Rest is measured after a stop or a halt; of what has ended by itself there is only its word that it does not move.
  const byWord = !stopped && !moving && (rest === "unknown" || rest === "unsaid");
  const words = unreached ? t.unreachedSince(unreached.since, unreached.late) : byWord ? t.restByWord : t.rest[rest];
  return stopped ? t.stopped(words) : words;
}

/** The same in few words, beside the line that says what is stopped: how a stopped device stands where it is not at rest. */
export function briefWords({ rest, stopped, moving }: Stood): string {
  if (stopped && isWell(rest)) return t.stoppedBriefly;
  return isAtRest(rest) || (!stopped && !moving && rest !== "unreached") ? t.atRest : t.rest[rest];
}

/** Whether a person has to look: it is stopped or not reached. */
export const needsLook = ({ rest, stopped }: Pick<Stood, "rest" | "stopped">): boolean => stopped || rest === "unreached";
