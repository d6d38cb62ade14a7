// Which part of the floor the map shows: a point in its middle, and pixels for each mm. x goes right, y goes up.

export interface Viewport {
  x: number;
  y: number;
  /** px for each mm. */
  scale: number;
  /** px. */
  width: number;
  height: number;
}

/** From 2 km to 20 cm on 1000 px. */
const SMALLEST = 0.0005;
const LARGEST = 5;
const bounded = (scale: number): number => Math.min(LARGEST, Math.max(SMALLEST, scale));

export const toScreen = ({ x, y, scale, width, height }: Viewport, at: readonly [number, number]): [number, number] => [width / 2 + (at[0] - x) * scale, height / 2 - (at[1] - y) * scale];
export const toFloor = ({ x, y, scale, width, height }: Viewport, at: readonly [number, number]): [number, number] => [x + (at[0] - width / 2) / scale, y - (at[1] - height / 2) / scale];

/** Shows all of these places, and at least so much of the floor, mm. */
export function fitted(view: Viewport, places: Iterable<readonly [number, number]>, least = 2000, edge = 44): Viewport {
  let [left, right, bottom, top] = [Infinity, -Infinity, Infinity, -Infinity];
  for (const [x, y] of places) [left, right, bottom, top] = [Math.min(left, x), Math.max(right, x), Math.min(bottom, y), Math.max(top, y)];
  if (left > right) return view;
  const room = (size: number): number => Math.max(40, size - 2 * edge);
  const scale = bounded(Math.min(room(view.width) / Math.max(least, right - left), room(view.height) / Math.max(least, top - bottom)));
  return { ...view, x: (left + right) / 2, y: (bottom + top) / 2, scale };
}

/** Nearer or farther; what is at this pixel stays there. */
export function zoomed(view: Viewport, by: number, at: readonly [number, number] = [view.width / 2, view.height / 2]): Viewport {
  const scale = bounded(view.scale * by);
  const [x, y] = toFloor(view, at);
  return { ...view, scale, x: x - (at[0] - view.width / 2) / scale, y: y + (at[1] - view.height / 2) / scale };
}

/** Moves what is shown by so many pixels. */
export const moved = (view: Viewport, dx: number, dy: number): Viewport => ({ ...view, x: view.x - dx / view.scale, y: view.y + dy / view.scale });

/** Mm between two lines of the grid, so that they are at least so many pixels apart. */
export function stepOf(scale: number, apart: number): number {
  const least = apart / scale;
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => step >= least * 0.999)!;
}

/** `2 m`, `50 cm`. */
export const lengthWords = (mm: number): string => (mm >= 1000 ? `${mm / 1000} m` : mm >= 10 ? `${mm / 10} cm` : `${mm} mm`);
