// What fails, as an error of the language.
import type { Failure } from "../worker/protocol.js";

export class HubError extends Error {
  constructor(readonly failure: Failure) {
    super(failure.text);
  }
}

/** Why something failed, whatever was thrown. */
export function failureOf(error: unknown): Failure {
  if (error instanceof HubError) return error.failure;
  return { kind: "local", code: "internal", text: error instanceof Error ? error.message : String(error), content: {} };
}
