// The way from the worker to the page.
import type { Word } from "./protocol.js";

export type Say = (word: Word, transfer?: Transferable[]) => void;
