// Which known word was probably meant by an unknown one.

/** Of a longer word only so many letters count. */
const LONGEST = 64;

/** The most similar of some known words, however little it is like the wrong one; an empty one of none. */
export function mostSimilar(word: string, known: readonly string[]): string {
  const letters = [...word].slice(0, LONGEST);
  let [nearest, least] = ["", Infinity];
  for (const candidate of known) {
    const distance = distanceOf(letters, [...candidate].slice(0, LONGEST));
    if (distance < least) [nearest, least] = [candidate, distance];
  }
  return nearest;
}

/** How many letters have to be changed, added, left out, or swapped with the next one. */
function distanceOf(one: readonly string[], other: readonly string[]): number {
  let before: number[] = [];
  let row = Array.from({ length: other.length + 1 }, (_, at) => at);
  for (let i = 1; i <= one.length; i++) {
    const next = [i];
    for (let j = 1; j <= other.length; j++) {
      const differs = one[i - 1] === other[j - 1] ? 0 : 1;
      let least = Math.min(row[j]! + 1, next[j - 1]! + 1, row[j - 1]! + differs);
      const swapped = i > 1 && j > 1 && one[i - 1] === other[j - 2] && one[i - 2] === other[j - 1];
      if (swapped) least = Math.min(least, before[j - 2]! + 1);
      next.push(least);
    }
    [before, row] = [row, next];
  }
  return row[other.length]!;
}
