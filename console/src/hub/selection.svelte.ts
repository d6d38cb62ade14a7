// What the page is about: the device that is driven, and the camera that is looked through.
import type { ContextInfo } from "mom-client";
import { fields, list, text } from "./fields.js";
import type { PlainFields } from "../worker/protocol.js";
import type { Hub } from "./hub.svelte.js";

export interface Device {
  path: string;
  token: string;
}

/** All that is in the tree, as far as this user may know. */
export async function contexts(hub: Hub): Promise<ContextInfo[]> {
  const found: ContextInfo[] = [];
  const waiting = ["/"];
  for (let path = waiting.pop(); path !== undefined; path = waiting.pop()) {
    const children = await hub.call("list", path).catch(() => []);
    found.push(...children);
    waiting.push(...children.filter(({ kind }) => kind === "session").map(({ path }) => path));
  }
  return found.sort((one, other) => (one.path < other.path ? -1 : 1));
}

export class Selection {
  devices = $state.raw<readonly Device[]>([]);
  cameras = $state.raw<readonly string[]>([]);
  device = $state<string | undefined>(undefined);
  camera = $state<string | undefined>(undefined);

  constructor(readonly hub: Hub) {}

  /** Looks for devices whose commands a token guards, and for cameras. */
  async look(): Promise<void> {
    const all = (await contexts(this.hub)).filter(({ kind }) => kind === "channel");
    const infos = await Promise.all(all.map(async ({ path }) => ({ path, info: await this.hub.call("ask", "context", "info", path).catch((): PlainFields => ({})) })));
    const devices: Device[] = [];
    for (const { path, info } of infos) {
      const guard = fields(info["guard"]);
      const token = text(guard, "token");
      const names = list(guard, "names");
      if (token !== undefined && (names.includes("command") || names.includes("*"))) devices.push({ path, token });
    }
    // Nothing says of a channel that images are sent there, but names do.
    this.cameras = all.map(({ path }) => path).filter((path) => /(^|\/)(camera|cam|video)[^/]*(\/|$)/i.test(path));
    this.devices = devices;
    const first = devices.find(({ path }) => !this.cameras.includes(path)) ?? devices[0];
    if (!devices.some(({ path }) => path === this.device)) this.device = first?.path;
    if (this.camera === undefined || !this.cameras.includes(this.camera)) this.camera = this.cameras.find((path) => /\/x$/.test(path)) ?? this.cameras[0];
  }
}

const selections = new WeakMap<Hub, Selection>();

export function selectionOf(hub: Hub): Selection {
  let found = selections.get(hub);
  if (!found) selections.set(hub, (found = new Selection(hub)));
  return found;
}
