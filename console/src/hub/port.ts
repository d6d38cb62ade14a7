// Where the hub's client runs: in a worker, so that decoding never keeps the page waiting.
import url from "../worker/main.ts?worker&url";
import type { Question, Word } from "../worker/protocol.js";

export interface Port {
  ask(question: Question): void;
  onWord: (word: Word) => void;
  /** Called with what the worker did not catch. */
  onFault: (text: string) => void;
  end(): void;
}

/** A page of another origin may not start our file, but one of its own that imports it. */
function start(): Worker {
  if (new URL(url, location.href).origin === location.origin) return new Worker(url, { type: "module" });
  const own = URL.createObjectURL(new Blob([`import ${JSON.stringify(url)};`], { type: "text/javascript" }));
  return new Worker(own, { type: "module" });
}

/** Starts the client. Where the page's policy forbids workers it runs in the page itself. */
export function open(): Port {
  const early: Question[] = [];
  let post = (question: Question): void => void early.push(question);
  let end = (): void => undefined;
  const port: Port = { ask: (question) => post(question), onWord: () => undefined, onFault: () => undefined, end: () => end() };
  const inPage = async (): Promise<void> => {
    const { serve } = await import("../worker/worker.js");
    const { port1, port2 } = new MessageChannel();
    serve(port2 as unknown as Parameters<typeof serve>[0]);
    port1.onmessage = ({ data }: MessageEvent<Word>) => port.onWord(data);
    post = (question) => port1.postMessage(question);
    end = () => port1.close();
    for (const question of early.splice(0)) post(question);
  };
  try {
    const worker = start();
    let heard = false;
    worker.onmessage = ({ data }: MessageEvent<Word>) => {
      heard = true;
      early.length = 0;
      port.onWord(data);
    };
    worker.onerror = ({ message, filename, lineno }) => {
      if (heard) return port.onFault(`${message} (${filename}:${lineno})`);
      worker.terminate();
      void inPage();
    };
    post = (question) => {
      // Asked again if the worker does not start.
      if (!heard) early.push(question);
      worker.postMessage(question);
    };
    end = () => worker.terminate();
  } catch {
    void inPage();
  }
  return port;
}
