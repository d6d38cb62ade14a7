// What the page measures of itself.
import type { Hub } from "./hub.svelte.js";
import { pictures } from "./pictures.svelte.js";

let longest = 0;
let pictureCount = 0;
let asked = 0;

/** Whether the browser tells which work has kept the page waiting. */
export const tellsTasks = typeof PerformanceObserver !== "undefined" && (PerformanceObserver.supportedEntryTypes ?? []).includes("longtask");

if (tellsTasks) {
  new PerformanceObserver((entries) => {
    for (const { duration } of entries.getEntries()) longest = Math.max(longest, duration);
  }).observe({ type: "longtask" });
}

/** The figures since they were asked for last. Times are ms; a task below 50 ms counts as none. */
export function ownFigures(hub: Hub): { [name: string]: number | undefined } {
  const now = performance.now();
  const seconds = (now - asked) / 1000;
  const shown = pictures.count - pictureCount;
  const figures = {
    "own trip": hub.link.roundTrip,
    "own clock": hub.link.offsetError,
    "own task": tellsTasks ? longest : undefined,
    "own pictures": asked ? shown / seconds : undefined,
  };
  [longest, pictureCount, asked] = [0, pictures.count, now];
  return figures;
}
