import type { Door } from "./address.js";

/** What comes out of a pipe. */
export interface Heard {
  bytes(bytes: Uint8Array): void;
  /** Something that waited has left. */
  drained(): void;
  /** It is over, and nothing more comes. */
  end(why: string): void;
}

/** Bytes to a hub and back, over one door. */
export interface Pipe {
  readonly door: Door;
  /** Bytes that have not left yet. */
  readonly waiting: number;
  send(bytes: Uint8Array): void;
  /** Ends it after what was sent. */
  close(): void;
}

/** The part of `WebSocket` that is used; `ws` for Node has it, too. */
export interface WebSocketLike {
  binaryType: string;
  readonly readyState: number;
  readonly bufferedAmount: number;
  onopen: ((event: any) => void) | null;
  onmessage: ((event: any) => void) | null;
  onerror: ((event: any) => void) | null;
  onclose: ((event: any) => void) | null;
  send(bytes: Uint8Array<ArrayBuffer>): void;
  close(): void;
}

/** Makes WebSockets: the class of the browser, or `WebSocket` of the package `ws`. */
export type WebSocketClass = new (url: string, protocols?: string) => WebSocketLike;
