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
  /** All channels that were found. */
  channels = $state.raw<readonly string[]>([]);
  device = $state<string | undefined>(undefined);
  /** What a page is about instead, as long as it is looked at: a device, or null for none. */
  #about = $state.raw<string | null | undefined>(undefined);
  /** By device, the camera that the user has chosen to see it by. */
  #chosen = $state.raw<ReadonlyMap<string, string>>(new Map());
  /** Cameras that have named a state of a device as what their picture shows. */
  #proven = $state.raw<ReadonlyMap<string, ReadonlySet<string>>>(new Map());

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
    this.channels = all.map(({ path }) => path);
    this.devices = devices;
    const first = devices.find(({ path }) => !this.cameras.includes(path)) ?? devices[0];
    if (!devices.some(({ path }) => path === this.device)) this.device = first?.path;
  }

  /** The device that the line is about which is always seen. */
  get shown(): string | undefined {
    return this.#about === undefined ? this.device : (this.#about ?? undefined);
  }

  /** A page is about this device, or about none, until the function that it gives is called. */
  about(device: string | null): () => void {
    this.#about = device;
    return () => (this.#about = undefined);
  }

  /** The camera by which the device is seen: the one that was chosen for it, one beside it, or the first. */
  get camera(): string | undefined {
    const { device, cameras } = this;
    return this.#chosen.get(device ?? "") ?? cameras.find((path) => device !== undefined && this.#isBeside(path, device)) ?? cameras.find((path) => /\/x$/.test(path)) ?? cameras[0];
  }

  /** The user sees a device by this camera. */
  choose(camera: string, device = this.device): void {
    this.#chosen = new Map(this.#chosen).set(device ?? "", camera);
  }

  /** Whether a camera stands in the session of this device, and of no other. */
  #isBeside(camera: string, device: string): boolean {
    const place = device.slice(0, device.lastIndexOf("/") + 1);
    return place.length > 1 && camera.startsWith(place) && !this.devices.some(({ path }) => path !== device && path.startsWith(place) && !this.cameras.includes(path));
  }

  /** A picture of this camera names a state that the device has told. */
  proves(camera: string, device: string): void {
    const known = this.#proven.get(device);
    if (!known?.has(camera)) this.#proven = new Map(this.#proven).set(device, new Set(known).add(camera));
  }

  /**
   * Whether a camera is known to see a device: the user says so, it has named a state of the device, it stands beside it, or it tells a robot's pose and there is
   * one robot only. Nothing else says it, and by any other camera's picture nobody should drive.
   */
  sees(camera: string, device: string, posed: boolean): boolean {
    const robots = this.devices.filter(({ path }) => !this.cameras.includes(path));
    return this.#chosen.get(device) === camera || (this.#proven.get(device)?.has(camera) ?? false) || this.#isBeside(camera, device) || (posed && robots.length === 1 && robots[0]!.path === device);
  }
}

const selections = new WeakMap<Hub, Selection>();

export function selectionOf(hub: Hub): Selection {
  let found = selections.get(hub);
  if (!found) selections.set(hub, (found = new Selection(hub)));
  return found;
}
