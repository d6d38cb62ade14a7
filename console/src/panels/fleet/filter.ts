// Which robots the table shows: words with blanks between them, all of which must fit.
import { isLow, type Robot } from "./robots.js";
import { rangesOf } from "./units.js";

export interface Context {
  /** The name of this page's peer. */
  me: string | undefined;
  selected: ReadonlySet<number>;
}

type Test = (robot: Robot, context: Context) => boolean;

const WORDS: { [word: string]: Test } = {
  moving: ({ state }) => state === "driving",
  low: isLow,
  mine: ({ owner }, { me }) => owner !== undefined && owner === me,
  free: ({ owner }) => owner === undefined,
  owned: ({ owner }) => owner !== undefined,
  busy: ({ executing, waiting }) => executing !== undefined || waiting > 0,
  pressed: ({ switches }) => switches !== 0,
  selected: ({ unit }, { selected }) => selected.has(unit),
};

/** What can be compared, in the units of the table. */
const FIGURES: { [name: string]: (robot: Robot) => number | undefined } = {
  battery: ({ battery }) => battery,
  trip: ({ trip }) => (trip === undefined ? undefined : trip / 1000),
  x: ({ x }) => x,
  y: ({ y }) => y,
};

function testOf(word: string): Test {
  if (word.startsWith("!") && word.length > 1) {
    const test = testOf(word.slice(1));
    return (robot, context) => !test(robot, context);
  }
  const named = WORDS[word];
  if (named) return named;
  if (/^[\d,–-]+$/.test(word)) {
    // A comma at the end is still being typed.
    const read = rangesOf(word.replace(/[,–-]+$/, ""));
    if ("ranges" in read) return ({ unit }) => read.ranges.some(([first, last]) => unit >= first && unit <= last);
  }
  const owner = /^owner:(.*)$/.exec(word);
  if (owner) return (robot) => (robot.owner ?? "").toLowerCase().startsWith(owner[1]!);
  const compared = /^([a-z]+)([<>])(-?\d+(?:\.\d+)?)$/.exec(word);
  const figure = FIGURES[compared?.[1] ?? ""];
  if (compared && figure) {
    const than = Number(compared[3]);
    return (robot) => {
      const is = figure(robot);
      return is !== undefined && (compared[2] === "<" ? is < than : is > than);
    };
  }
  return ({ state, owner }) => state.startsWith(word) || (owner ?? "").toLowerCase().includes(word);
}

export function filtered(robots: readonly Robot[], filter: string, context: Context): readonly Robot[] {
  const tests = filter.trim().toLowerCase().split(/\s+/).filter(Boolean).map(testOf);
  return tests.length ? robots.filter((robot) => tests.every((test) => test(robot, context))) : robots;
}
