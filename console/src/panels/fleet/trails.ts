// Where robots were.

/** x, y in mm, and until when it was there, ms. */
export type Spot = [x: number, y: number, until: number];

/** Spots of one robot, at most. */
const MOST = 600;
/** Spots closer than this are one, mm. */
const APART = 5;

export class Trails {
  readonly #spots = new Map<number, Spot[]>();

  constructor(
    /** ms that are kept. */
    readonly keep: number,
  ) {}

  add(unit: number, x: number, y: number, at: number): void {
    let spots = this.#spots.get(unit);
    if (!spots) this.#spots.set(unit, (spots = []));
    const last = spots.at(-1);
    if (last && at <= last[2]) return;
    if (last && Math.hypot(x - last[0], y - last[1]) < APART) last[2] = at;
    else spots.push([x, y, at]);
    let old = Math.max(0, spots.length - MOST);
    while (old < spots.length - 1 && spots[old]![2] < at - this.keep) old += 1;
    if (old) spots.splice(0, old);
  }

  /** Where it was from a time on, the oldest first. */
  of(unit: number, from: number): readonly Spot[] {
    const spots = this.#spots.get(unit) ?? [];
    const first = spots.findIndex(([, , until]) => until >= from);
    return first < 0 ? [] : spots.slice(first);
  }

  clear(): void {
    this.#spots.clear();
  }
}
