// How old the pictures are that the page shows; each camera says so here, and driving panels ask.
import type { Hub } from "./hub.svelte.js";

export interface Shown {
  born: number | undefined;
  error: number | undefined;
  arrived: number;
  /** Whether it tells the pose of a robot, and when the robot told that, ms since 1970. */
  posed: boolean;
  poseTime: number | undefined;
}

class Pictures {
  readonly #shown = new WeakMap<Hub, Map<string, Shown>>();
  #version = $state(0);
  /** How many were shown since the page was loaded. */
  count = 0;

  /** A camera has shown a picture. */
  shows(hub: Hub, path: string, shown: Shown): void {
    const all = this.#shown.get(hub) ?? new Map<string, Shown>();
    this.#shown.set(hub, all);
    all.delete(path);
    all.set(path, shown);
    this.count += 1;
    this.#version += 1;
  }

  /** A camera is not shown any more. */
  hides(hub: Hub, path: string): void {
    this.#shown.get(hub)?.delete(path);
    this.#version += 1;
  }

  /** The cameras that are shown, that with the newest picture first. */
  cameras(hub: Hub): string[] {
    void this.#version;
    return [...(this.#shown.get(hub)?.keys() ?? [])].reverse();
  }

  /** The newest picture of a camera, or of any. */
  newest(hub: Hub, path?: string): Shown | undefined {
    void this.#version;
    const all = this.#shown.get(hub);
    return path === undefined ? [...(all?.values() ?? [])].at(-1) : all?.get(path);
  }
}

export const pictures = new Pictures();
