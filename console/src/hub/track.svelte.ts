// Where a device has been: its last poses, which all pictures of it share.
import { DeviceState, type Pose } from "./device.svelte.js";
import type { Hub } from "./hub.svelte.js";

const MOST = 2000;

/** Tips that are nearer to each other than this are one place, mm. */
const APART = 0.5;

export class Track {
  readonly device: DeviceState;
  /** The oldest first. */
  poses = $state.raw<readonly Pose[]>([]);
  #users = 0;
  #end: (() => void) | undefined;

  constructor(hub: Hub, path: string) {
    this.device = new DeviceState(hub, path);
  }

  /** Follows it until the function that it gives is called. */
  start(): () => void {
    if (this.#users++ === 0) {
      const ends = [this.device.start()];
      this.#end = () => ends.forEach((end) => end());
      // An effect of its own, which does not end with that of the first who follows it.
      queueMicrotask(() => {
        if (!this.#users) return;
        ends.push(
          $effect.root(() => {
            $effect(() => {
              const pose = this.device.pose;
              if (pose) this.#add(pose);
            });
          }),
        );
      });
    }
    return () => {
      if (--this.#users === 0) this.#end?.();
    };
  }

  readonly #list: Pose[] = [];

  #add(pose: Pose): void {
    const last = this.#list.at(-1);
    if (last && Math.hypot(pose[0] - last[0], pose[1] - last[1], pose[2] - last[2]) < APART) return;
    this.#list.push(pose);
    if (this.#list.length > MOST) this.#list.splice(0, this.#list.length - MOST);
    this.poses = this.#list.slice();
  }
}

const tracks = new WeakMap<Hub, Map<string, Track>>();

export function trackOf(hub: Hub, path: string): Track {
  let all = tracks.get(hub);
  if (!all) tracks.set(hub, (all = new Map()));
  let found = all.get(path);
  if (!found) all.set(path, (found = new Track(hub, path)));
  return found;
}
