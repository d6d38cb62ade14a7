import type { Client } from "./client.js";
import type { Parcel } from "../parcel.js";
import { type Fields, fieldsOf, text } from "../value.js";

/** A question of the hub to a peer that manages a context. */
export class Consult {
  /** All that the hub says about the request, by the keys of docs/PROTOCOL.md. */
  readonly content: Fields;

  /** @internal */
  constructor(
    private readonly client: Client,
    readonly parcel: Parcel,
  ) {
    this.content = fieldsOf(parcel.content);
  }

  /** The context. */
  get path(): string {
    return this.parcel.context ?? "/";
  }

  /** What is asked for. */
  get verb(): string {
    return text(this.content, "verb") ?? "";
  }

  /** Who asks. */
  get by(): string {
    return text(this.content, "peer") ?? "";
  }

  /** Allows it; what `stands` holds for later questions of the same kind. */
  allow(options: { stands?: boolean } = {}): Promise<void> {
    return this.#answer({ allow: true, ...options });
  }

  /** Refuses it. */
  deny(options: { text?: string; stands?: boolean } = {}): Promise<void> {
    return this.#answer({ allow: false, ...options });
  }

  async #answer(verdict: Fields): Promise<void> {
    await this.client.request({ family: "manager", name: "verdict", content: { consult: this.parcel.id, ...verdict } });
  }
}
