// Who could take a token: the others of its session, without the devices, which obey its owner.
import type { Hub } from "../../hub/hub.svelte.js";
import { selectionOf } from "../../hub/selection.svelte.js";

/** Channels whose devices are looked up, at most. */
const MOST = 32;

export interface Receivers {
  people: string[];
  /** Of level 0: programs and guests. */
  others: string[];
}

/** The names of peers to whom a token can be handed over. */
export async function receivers(hub: Hub, path: string): Promise<Receivers> {
  const parent = path.slice(0, path.lastIndexOf("/")) || "/";
  const selection = selectionOf(hub);
  const [members, children] = await Promise.all([hub.call("members", parent), hub.call("list", parent).catch(() => [])]);
  // Which members of a session are devices their channels say: those beside the token, and those that the page knows of.
  const beside = children.filter(({ kind }) => kind === "channel").map(({ path }) => path);
  const channels = [...new Set([...beside, ...selection.cameras, ...selection.devices.map(({ path }) => path)])].slice(0, MOST);
  const told = await Promise.all(channels.map((channel) => hub.call("members", channel).catch(() => [])));
  const devices = new Set(told.flat().filter(({ device }) => device).map(({ peer }) => peer));
  const able = members.filter(({ peer }) => peer !== hub.me?.peer && !devices.has(peer));
  return { people: able.filter(({ level }) => level > 0).map(({ peer }) => peer), others: able.filter(({ level }) => level <= 0).map(({ peer }) => peer) };
}
