// The cursor in the room: a pose that a person drags in the pictures, measures with, and pastes into commands.
import { type Axis, AXES, clamp, rounded } from "../room/workspace.js";
import type { Point } from "../room/matrix.js";
import type { Pose } from "./device.svelte.js";
import type { Hub } from "./hub.svelte.js";

/** A block that pictures show: its middle, the height of its top, and its turn. */
export interface Block {
  name: string;
  middle: Point;
  top: number;
  yaw: number;
}

export class Cursor {
  /** mm and degrees. */
  pose = $state.raw<Pose>([0, 0, 200, 0, 0]);
  shown = $state(true);
  /** The degrees in which it was led out of the workspace last. */
  outside = $state.raw<readonly Axis[]>([]);
  /** What the newest picture shows. */
  blocks = $state.raw<readonly Block[]>([]);

  /** Puts it there, or as near as the workspace lets it. */
  set(wanted: Readonly<Pose>): void {
    const { pose, outside } = clamp(wanted);
    const next = rounded(pose);
    if (next.some((value, at) => value !== this.pose[at])) this.pose = next;
    if (outside.join() !== this.outside.join()) this.outside = outside;
  }

  /** Changes one degree. */
  setAxis(axis: Axis, value: number): void {
    const next: Pose = [...this.pose];
    next[AXES.indexOf(axis)] = value;
    this.set(next);
  }

  /** Above the top of a block, with the jaws along its faces. */
  above(block: Block): void {
    this.set([block.middle[0], block.middle[1], block.top, block.yaw, 0]);
  }

  sees(blocks: readonly Block[]): void {
    if (JSON.stringify(blocks) !== JSON.stringify(this.blocks)) this.blocks = blocks;
  }
}

const cursors = new WeakMap<Hub, Cursor>();

export function cursorOf(hub: Hub): Cursor {
  let found = cursors.get(hub);
  if (!found) cursors.set(hub, (found = new Cursor()));
  return found;
}
