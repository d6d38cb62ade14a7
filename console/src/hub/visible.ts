// Work that is done again and again, but only while its result can be seen.

/** Calls `work` at once and then so often, in ms, as long as the page is visible and the work before is done. Gives what ends it. */
export function whileVisible(every: number, work: () => Promise<void> | void): () => void {
  let timer: ReturnType<typeof setTimeout> | undefined;
  let [busy, ended] = [false, false];
  const round = async (): Promise<void> => {
    clearTimeout(timer);
    if (busy || ended || document.visibilityState !== "visible") return;
    busy = true;
    const begun = performance.now();
    try {
      await work();
    } finally {
      busy = false;
      if (!ended) timer = setTimeout(() => void round(), Math.max(every - (performance.now() - begun), every / 4));
    }
  };
  const seen = (): void => void round();
  document.addEventListener("visibilitychange", seen);
  void round();
  return () => {
    ended = true;
    clearTimeout(timer);
    document.removeEventListener("visibilitychange", seen);
  };
}
