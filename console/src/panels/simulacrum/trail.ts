// What a figure was in the last minute, for a small line without axes. A figure that is not told again is what it was.

/** ms. */
export const SPAN = 60_000;
/** ms between two points, at the least. */
const STEP = 250;

interface Point {
  at: number;
  /** null: not known from then on. */
  value: number | null;
  /** The least and the greatest within the step, so that a short peak is seen. */
  least: number;
  most: number;
}

export class Trail {
  #points: Point[] = [];

  /** It is this from then on. */
  add(at: number, value: number | null): void {
    const last = this.#points.at(-1);
    if (last && (at < last.at || value === last.value)) return;
    const merged = last && at - last.at < STEP;
    const point = merged ? last : { at, value, least: Infinity, most: -Infinity };
    point.value = value;
    if (value !== null) [point.least, point.most] = [Math.min(point.least, value), Math.max(point.most, value)];
    if (!merged) this.#points.push(point);
    // One is kept of the time before, as it holds until the next.
    const first = this.#points.findIndex(({ at: when }) => when > at - SPAN);
    if (first > 1) this.#points.splice(0, first - 1);
  }

  /** The points of the last minute before `now`: from 0, a minute ago, to 1, now. */
  points(now: number): [x: number, value: number | null][] {
    const begin = now - SPAN;
    const seen: [number, number | null][] = [];
    for (const { at, value, least, most } of this.#points) {
      const x = Math.max(0, Math.min(1, (at - begin) / SPAN));
      if (at <= begin) seen.length = 0;
      else for (const peak of [least, most]) if (Number.isFinite(peak) && peak !== value) seen.push([x, peak]);
      seen.push([x, value]);
    }
    const last = seen.at(-1);
    if (last) seen.push([1, last[1]]);
    return seen;
  }

  /** The least and the greatest that it was in the last minute; undefined if nothing is known. */
  range(now: number): [least: number, most: number] | undefined {
    const values = this.points(now).flatMap(([, value]) => (value === null ? [] : [value]));
    return values.length ? [Math.min(...values), Math.max(...values)] : undefined;
  }
}

/** The steps of a line as the path of an SVG of this size; `range` is what its height spans. */
export function pathOf(points: readonly (readonly [x: number, value: number | null])[], [least, most]: readonly [number, number], width: number, height: number): string {
  const high = (value: number): number => (most > least ? height - ((value - least) / (most - least)) * height : height / 2);
  const short = (value: number): string => String(Math.round(value * 10) / 10);
  let path = "";
  let open = false;
  for (const [x, value] of points) {
    if (open) path += `H${short(x * width)}`;
    if (value === null) open = false;
    else {
      path += open ? `V${short(high(value))}` : `M${short(x * width)} ${short(high(value))}`;
      open = true;
    }
  }
  return path;
}
