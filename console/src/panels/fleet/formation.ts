// Where each of several robots is to drive, so that they stand to each other as they do now.

export interface Place {
  unit: number;
  x: number | undefined;
  y: number | undefined;
}

/** What the wire of the robots can say, mm. */
export const LOWEST = -9999;
export const FARTHEST = 99_999;

const fits = (at: number): boolean => at >= LOWEST && at <= FARTHEST;

/** The middle of the robots goes to a point. Those whose place is not known have no goal; `outside` are those whose goal nobody could say. */
export function goalsOf(places: readonly Place[], to: readonly [x: number, y: number]): { goals: Map<number, [x: number, y: number]>; outside: number[] } {
  const known = places.flatMap(({ unit, x, y }) => (x === undefined || y === undefined ? [] : [{ unit, x, y }]));
  const middle = (of: "x" | "y"): number => known.reduce((sum, place) => sum + place[of], 0) / known.length;
  const [x, y] = known.length ? [middle("x"), middle("y")] : [0, 0];
  const goals = new Map(known.map((place): [number, [number, number]] => [place.unit, [Math.round(to[0] + place.x - x), Math.round(to[1] + place.y - y)]]));
  return { goals, outside: [...goals].filter(([, [x, y]]) => !fits(x) || !fits(y)).map(([unit]) => unit) };
}
