// What goes wrong in the channels that a page watches, which no call of the page fails by.
import { type Event, fieldsOf } from "mom-client";
import { failure, plainFields } from "./plain.js";
import type { Say } from "./port.js";
import type { Failure, PlainFields } from "./protocol.js";

/** What a device says of an error. */
function failureIn(said: PlainFields, code: string): Failure {
  const word = (key: string): string | undefined => (typeof said[key] === "string" ? said[key] : undefined);
  const name = word("name") ?? code;
  return { kind: "refused", code: name, text: word("text") ?? name, content: said };
}

export class Troubles {
  constructor(readonly say: Say) {}

  /** Takes an event of a channel; `me` is this page's peer, whose commands are followed by the panel that sent them. */
  heard(path: string, event: Event, me: string): void {
    if (event.type === "refused") return this.say({ word: "trouble", path, failure: failure(event.error) });
    if (event.type !== "message" || event.history) return;
    if (event.name === "camera-error") return this.say({ word: "trouble", path, failure: failureIn(plainFields(event.content), event.name) });
    if (event.name !== "status") return;
    const { state, peer, error } = fieldsOf(event.content);
    if (state === "error" && typeof peer === "string" && peer !== me) this.say({ word: "trouble", path, peer, failure: failureIn(plainFields(error), "error") });
  }
}
