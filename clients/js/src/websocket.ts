import { type Door, shown } from "./address.js";
import { disconnected } from "./error.js";
import type { Heard, Pipe, WebSocketClass, WebSocketLike } from "./pipe.js";

/** A WebSocket does not tell when it can take more. */
const LOOK_AGAIN = 5;

class WebSocketPipe implements Pipe {
  #looking = false;

  constructor(
    readonly door: Door,
    readonly socket: WebSocketLike,
    readonly heard: Heard,
  ) {}

  get waiting(): number {
    return this.socket.bufferedAmount;
  }

  send(bytes: Uint8Array): void {
    if (this.socket.readyState !== 1) return;
    this.socket.send(bytes as Uint8Array<ArrayBuffer>);
    this.#look();
  }

  close(): void {
    this.socket.close();
  }

  #look(): void {
    if (this.#looking || this.waiting === 0) return;
    this.#looking = true;
    setTimeout(() => {
      this.#looking = false;
      if (this.socket.readyState !== 1) return;
      this.heard.drained();
      this.#look();
    }, LOOK_AGAIN);
  }
}

/** Opens a WebSocket; an `aborted` one is closed. */
export function openWebSocket(door: Door, make: WebSocketClass, heard: Heard, aborted: AbortSignal): Promise<Pipe> {
  return new Promise((resolve, reject) => {
    const socket = new make(`${shown(door)}/mom`, "mom.bin.v1");
    socket.binaryType = "arraybuffer";
    let over = false;
    const end = (why: string): void => {
      if (over) return;
      over = true;
      reject(disconnected(why));
      heard.end(why);
    };
    aborted.addEventListener("abort", () => (end("another door was faster"), socket.close()), { once: true });
    const pipe = new WebSocketPipe(door, socket, heard);
    socket.onopen = () => resolve(pipe);
    socket.onmessage = ({ data }: { data: unknown }) => {
      if (over) return;
      if (data instanceof ArrayBuffer) heard.bytes(new Uint8Array(data));
      else end("text where bytes are spoken");
    };
    // A browser tells nothing, to keep pages from looking around in networks.
    let error = "";
    socket.onerror = ({ message }: { message?: string }) => (error = message ?? "");
    socket.onclose = ({ code, reason }: { code: number; reason: unknown }) => end(`the WebSocket is closed: ${code} ${error || String(reason)}`.trimEnd());
  });
}
