// Which robots are where on the map.
import type { Robot } from "./robots.js";
import { type Viewport, toScreen } from "./viewport.js";

const isPlaced = ({ x, y }: Robot): boolean => x !== undefined && y !== undefined;

/** Those whose place is seen, or so many pixels beyond the edge. */
export function clip(robots: readonly Robot[], view: Viewport, edge = 0): Robot[] {
  return within(robots, view, [-edge, -edge, view.width + 2 * edge, view.height + 2 * edge]);
}

/** Those in an area: px, left, top, width, height. */
export function within(robots: readonly Robot[], view: Viewport, [left, top, width, height]: readonly [number, number, number, number]): Robot[] {
  return robots.filter((robot) => {
    if (!isPlaced(robot)) return false;
    const [x, y] = toScreen(view, [robot.x!, robot.y!]);
    return x >= left && x <= left + width && y >= top && y <= top + height;
  });
}

/** The one nearest to a pixel, if it is that near. */
export function nearest(robots: readonly Robot[], view: Viewport, at: readonly [number, number], most: number): Robot | undefined {
  let [found, least]: [Robot | undefined, number] = [undefined, most];
  for (const robot of robots) {
    if (!isPlaced(robot)) continue;
    const [x, y] = toScreen(view, [robot.x!, robot.y!]);
    const distance = Math.hypot(x - at[0], y - at[1]);
    if (distance <= least) [found, least] = [robot, distance];
  }
  return found;
}
