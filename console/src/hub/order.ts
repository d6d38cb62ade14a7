// What a person has to know of an order to stop or to let go that is over, in one notice for all places of which the same is said.
import { texts } from "../texts/index.js";
import type { Failure, StopReport } from "../worker/protocol.js";
import { isWell } from "../worker/rest.js";
import { visible } from "./said.js";

export interface Trouble {
  tone: "error" | "warning";
  text: string;
  failure?: Failure;
}

export function troublesOf({ order, top, devices, refused, newer, empty, denied, taken }: StopReport): Trouble[] {
  const t = texts.stop;
  const found = new Map<string, { tone: Trouble["tone"]; places: string[]; failure?: Failure }>();
  const add = (tone: Trouble["tone"], place: string, words: string, failure?: Failure): void => {
    const known = found.get(words);
    if (known) known.places.push(place);
    else found.set(words, { tone, places: [place], ...(failure ? { failure } : {}) });
  };
  if (!taken && !refused.length) add("error", top, t.unconfirmed);
  for (const { path, failure } of refused) add("error", path, failure.text, failure);
  for (const { path, device, after, word, rest } of devices) {
    if (after === undefined) add("error", `${path} ${device}`, word === "lost" ? t.lostDevice : t.silent);
    else if (order === "stop" && rest !== undefined && !isWell(rest)) add("error", `${path} ${device}`, t.obeysBut(texts.common.rest[rest]));
  }
  for (const { path, by, reason } of newer) add("error", path, t.newer(by ?? t.somebody, reason && visible(reason)));
  for (const path of empty) add("warning", path, t.empty);
  for (const path of denied) add("warning", path, t.deniedOne);
  if (taken && !devices.length && !refused.length && !denied.length && !empty.length) add("warning", top, t.none);
  return [...found].map(([words, { tone, places, failure }]) => ({ tone, text: `${t.report(order)}: ${t.places(places[0]!, places.length)}: ${words}`, ...(failure ? { failure } : {}) }));
}
