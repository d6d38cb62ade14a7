/** Whether this platform can open what a hub compresses. */
export const CAN_INFLATE = typeof DecompressionStream !== "undefined";

/** Opens a stream of zlib as it comes, in order. */
export class Inflater {
  readonly #writer: WritableStreamDefaultWriter<BufferSource>;

  /** `ended` is called once, with why, when nothing more is opened. */
  constructor(opened: (bytes: Uint8Array) => void, ended: (why: string) => void) {
    const { writable, readable } = new DecompressionStream("deflate");
    this.#writer = writable.getWriter();
    void this.#open(readable.getReader(), opened).then(ended, (error: unknown) => ended(`stream-deflate: ${String(error)}`));
  }

  push(bytes: Uint8Array): void {
    // The reader hears why.
    this.#writer.write(bytes as Uint8Array<ArrayBuffer>).catch(() => undefined);
  }

  /** Nothing more comes; what has come is opened first. */
  close(): void {
    this.#writer.close().catch(() => undefined);
  }

  async #open(reader: ReadableStreamDefaultReader<Uint8Array>, opened: (bytes: Uint8Array) => void): Promise<string> {
    for (;;) {
      const { done, value } = await reader.read();
      if (done) return "the hub ended its stream";
      opened(value);
    }
  }
}
