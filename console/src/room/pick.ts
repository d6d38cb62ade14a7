// What is seen at a pixel of a picture: a block, or a place on the table.
import { type Matrix, type Pixel, type Point, depth, onPlane, project } from "./matrix.js";
import { LIMITS } from "./workspace.js";

/** So far beside the workspace a click on the table is meant for its edge, mm. */
const BESIDE = 40;

const turn = ([ax, ay]: Pixel, [bx, by]: Pixel, [cx, cy]: Pixel): number => (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);

/** The corners of the outline around some pixels. */
function hull(pixels: readonly Pixel[]): Pixel[] {
  const sorted = [...pixels].sort(([ax, ay], [bx, by]) => ax - bx || ay - by);
  const half = (points: readonly Pixel[]): Pixel[] => {
    const found: Pixel[] = [];
    for (const point of points) {
      while (found.length > 1 && turn(found.at(-2)!, found.at(-1)!, point) <= 0) found.pop();
      found.push(point);
    }
    return found.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
}

/** The index of the block that is seen at a pixel, by the points of its edges; of several the nearest one. */
export function blockAt(matrix: Matrix, blocks: readonly { points: readonly Point[] }[], pixel: Pixel): number | undefined {
  let nearest: { index: number; far: number } | undefined;
  blocks.forEach(({ points }, index) => {
    const seen = points.map((point) => project(matrix, point));
    if (seen.length < 3 || seen.some((at) => at === undefined)) return;
    const corners = hull(seen as Pixel[]);
    if (corners.length < 3 || !corners.every((corner, at) => turn(corner, corners[(at + 1) % corners.length]!, pixel) >= 0)) return;
    const far = Math.min(...points.map((point) => depth(matrix, point)));
    if (!nearest || far < nearest.far) nearest = { index, far };
  });
  return nearest?.index;
}

/** The place of the table that is seen at a pixel; undefined where there is none within the workspace. */
export function tableAt(matrix: Matrix, pixel: Pixel): Pixel | undefined {
  const found = onPlane(matrix, 0, pixel);
  if (!found) return undefined;
  const inside = (["x", "y"] as const).every((axis, at) => found[at]! >= LIMITS[axis].low - BESIDE && found[at]! <= LIMITS[axis].high + BESIDE);
  return inside ? [found[0], found[1]] : undefined;
}
