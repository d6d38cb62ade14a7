// What is known of a device's rest: by its `state`, or by the hub's answer to a stop. docs/PROTOCOL.md, Devices; tests/cases/answers.json has what follows from what.

/**
 * It has measured that it rests; its stopping time has passed, and it does not measure; it moves; it could say that it rests, and does not; it is not reached, so nobody knows; it says
 * nothing of it.
 */
export type Rest = "measured" | "not-measured" | "moving" | "unknown" | "unreached" | "unsaid";

/** What a `state` or an answer says; of others, so anything may stand there. */
export type Said = { readonly [key: string]: unknown };

export function restOf({ moving, reached, rest }: Said): Rest {
  // What is not a boolean does not say that it is reached, nor that it stands.
  if (reached !== undefined && reached !== true) return "unreached";
  if (moving !== undefined && moving !== false) return "moving";
  if (rest === "measured" || rest === "not-measured") return rest;
  return reached === true ? "unknown" : "unsaid";
}

export const isAtRest = (rest: Rest | undefined): boolean => rest === "measured" || rest === "not-measured";

/** Whether one that was told to stop needs nobody's attention: it rests, or obeys and says nothing of its rest. */
export const isWell = (rest: Rest | undefined): boolean => isAtRest(rest) || rest === "unsaid";

/** Since when a device is not reached, where its state says so: ms since 1970 by this machine's clock, of which its sender's is so many ms ahead. */
export function unreachedSince(said: Said, ahead: number): number | undefined {
  const micros = said["unreached-since"];
  return typeof micros === "number" || typeof micros === "bigint" ? Number(micros) / 1000 - ahead : undefined;
}
