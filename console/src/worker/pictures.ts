// Images: only the newest is decoded, when the page has shown the one before.
import type { MessageEvent } from "mom-client";
import { plainFields } from "./plain.js";
import type { Say } from "./port.js";
import type { Message } from "./protocol.js";

/** A larger one is not decoded: it would take the page's memory. */
const MOST_BYTES = 8 * 1024 * 1024;
const MOST_PIXELS = 40_000_000;

export class Pictures {
  #waiting: { bytes: Uint8Array; content: MessageEvent["content"]; message: Message } | null = null;
  #skipped = 0;
  #busy = false;
  #ended = false;
  /** What was decoded last. */
  file: { bytes: Uint8Array; type: string } | null = null;

  constructor(
    readonly id: number,
    /** Pixels. */
    readonly width: number,
    readonly say: Say,
  ) {}

  /** False if it has no image. */
  take(event: MessageEvent, message: Message): boolean {
    const fields = event.content as { [key: string]: unknown } | undefined;
    const bytes = fields?.["image"];
    if (!(bytes instanceof Uint8Array)) return false;
    if (bytes.length > MOST_BYTES) {
      this.say({ word: "unshown", watch: this.id, size: bytes.length, sender: message.sender, why: "too-large" });
      return true;
    }
    if (this.#waiting) this.#skipped += 1;
    this.#waiting = { bytes, content: event.content, message };
    if (!this.#busy) void this.#decode();
    return true;
  }

  shown(): void {
    this.#busy = false;
    if (this.#waiting) void this.#decode();
  }

  end(): void {
    this.#ended = true;
    this.#waiting = this.file = null;
  }

  async #decode(): Promise<void> {
    const { bytes, content, message } = this.#waiting!;
    this.#waiting = null;
    this.#busy = true;
    try {
      const { image: _image, ...rest } = content as { [key: string]: unknown };
      const fields = plainFields(rest as never);
      const type = typeof fields["media-type"] === "string" ? fields["media-type"] : "image/jpeg";
      const [width, height] = [Number(fields["width"] ?? 0), Number(fields["height"] ?? 0)];
      if (width * height > MOST_PIXELS) throw new RangeError("too many pixels");
      const smaller = width > this.width ? { resizeWidth: this.width, resizeQuality: "low" as const } : {};
      const bitmap = await createImageBitmap(new Blob([bytes as Uint8Array<ArrayBuffer>], { type }), smaller);
      if (this.#ended) return bitmap.close();
      this.file = { bytes, type };
      const { sender, born, error, arrived, size } = message;
      const skipped = this.#skipped;
      this.#skipped = 0;
      this.say({ word: "picture", watch: this.id, picture: { bitmap, content: fields, sender, size, born, error, arrived, skipped, watch: this.id } }, [bitmap]);
    } catch {
      this.#busy = false;
      this.say({ word: "unshown", watch: this.id, size: bytes.length, sender: message.sender, why: "not-readable" });
    }
  }
}
