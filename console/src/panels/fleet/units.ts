// Which robots are meant: `all`, or numbers and ranges such as `1,3-5`.

/** The highest number of a robot. */
export const HIGHEST = 99_999;

export type Range = readonly [first: number, last: number];

/** The ranges that a text names, or the part of it that is none. */
export function rangesOf(text: string): { ranges: readonly Range[] } | { mistake: string } {
  const ranges: Range[] = [];
  for (const part of text.split(",").map((part) => part.trim())) {
    const found = /^(\d{1,5})(?:\s*[-–]\s*(\d{1,5}))?$/.exec(part);
    const [first, last] = [Number(found?.[1]), Number(found?.[2] ?? found?.[1])];
    if (!found || first < 1 || first > last) return { mistake: part };
    ranges.push([first, last]);
  }
  return { ranges };
}

/** The robots that a text names, of those that are known; or what is wrong with it. */
export function unitsOf(text: string, known: Iterable<number>): { units: number[] } | { mistake: string } | { missing: number } {
  const all = [...known].sort((one, other) => one - other);
  if (text.trim() === "all") return { units: all };
  const read = rangesOf(text);
  if ("mistake" in read) return read;
  const there = new Set(all);
  const named = new Set<number>();
  for (const [first, last] of read.ranges) {
    for (let unit = first; unit <= last; unit += 1) {
      if (!there.has(unit)) return { missing: unit };
      named.add(unit);
    }
  }
  return { units: [...named].sort((one, other) => one - other) };
}

/** `1-3, 5` of 5, 1, 2, 3. */
export function wordsOf(units: Iterable<number>): string {
  const runs: [number, number][] = [];
  for (const unit of [...units].sort((one, other) => one - other)) {
    const run = runs.at(-1);
    if (run && unit === run[1] + 1) run[1] = unit;
    else if (!run || unit !== run[1]) runs.push([unit, unit]);
  }
  return runs.map(([first, last]) => (first === last ? `${first}` : `${first}${last === first + 1 ? ", " : "-"}${last}`)).join(", ");
}
