import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./bundle.mjs";

const { robotOf, changesOf, counted, movesStopped } = await load("panels/fleet/robots.ts");
const { filtered } = await load("panels/fleet/filter.ts");
const { sorted, columns } = await load("panels/fleet/columns.ts");
const { rangesOf, unitsOf, wordsOf } = await load("panels/fleet/units.ts");
const { goalsOf } = await load("panels/fleet/formation.ts");
const { Trails } = await load("panels/fleet/trails.ts");
const { statementOf, goalOf, wholeOf, PERIOD } = await load("panels/fleet/statement.ts");
const { NOTHING, only, toggled, extended, keyed } = await load("panels/fleet/selected.ts");
const view = await load("panels/fleet/viewport.ts");
const { nearest, within } = await load("panels/fleet/near.ts");

const said = (unit, more = {}, born = 1000) => ({
  name: `robot-${unit}`,
  content: { unit, linked: true, x: unit * 100, y: 0, heading: 0, leds: 0, battery: 80, switches: 0, expired: false, "round-trip": 500, moving: false, stopped: false, fence: 0, ...more },
  born,
  error: 1,
  arrived: born + 5,
});
const robot = (unit, more, born) => robotOf(said(unit, more, born));
const units = (robots) => robots.map(({ unit }) => unit);

test("a robot is what its message says, and in what state it is by what matters most", () => {
  for (const [more, state] of [
    [{}, "standing"],
    [{ moving: true }, "driving"],
    [{ moving: true, expired: true }, "expired"],
    [{ expired: true, stopped: true }, "stopped"],
    [{ stopped: true, linked: false }, "lost"],
  ]) assert.equal(robot(1, more).state, state);
  assert.equal(robotOf({ ...said(1), name: "state" }), undefined);
  assert.equal(robotOf({ ...said(1), content: "nonsense" }).unit, 1);
  const strange = robotOf({ ...said(7), content: { x: "1", battery: 5n, owner: 3, executing: null }, born: undefined });
  assert.deepEqual([strange.x, strange.battery, strange.owner, strange.born], [undefined, 5, undefined, 1005]);
  assert.deepEqual(robot(1, { executing: { peer: "bob", statement: 1, of: 2 }, waiting: 3 }).executing, { peer: "bob", statement: 1, of: 2 });
  assert.deepEqual(counted([robot(1), robot(2, { moving: true, battery: 19 }), robot(3, { linked: false })]), { lost: 1, stopped: 0, expired: 0, driving: 1, standing: 1, low: 1 });
});

test("what is known of a robot's rest, and since when it is not reached by this machine's clock", () => {
  const rest = (more) => robot(1, more).rest;
  assert.deepEqual([rest({}), rest({ moving: true }), rest({ reached: true }), rest({ reached: true, rest: "measured" }), rest({ reached: false, moving: true })], ["unsaid", "moving", "unknown", "measured", "unreached"]);
  assert.deepEqual([robot(1, { stopped: true, moving: true }), robot(1, { moving: true })].map(movesStopped), [true, false]);
  assert.equal(robot(1, { reached: false }).state, "lost");
  // Its gateway's clock is 500 ms ahead.
  const late = robotOf({ ...said(1, { reached: false, "unreached-since": 700_000 }), said: 1500 });
  assert.equal(late.since, 200);
  assert.equal(robot(1, { reached: false, "unreached-since": "long ago" }).since, undefined);
});

test("what changes is told, what only goes on is not", () => {
  const what = (before, after) => changesOf(robot(1, before), robot(1, after)).map(({ what }) => what);
  assert.deepEqual(what({}, { x: 5, moving: true, "round-trip": 9 }), []);
  assert.deepEqual(what({}, { linked: false }), ["lost"]);
  assert.deepEqual(what({ linked: false }, { stopped: true }), ["linked", "stopped"]);
  assert.deepEqual(what({ stopped: true }, {}), ["unstopped"]);
  assert.deepEqual(what({ stopped: true }, { linked: false }), ["lost"]);
  assert.deepEqual(what({ battery: 20 }, { battery: 19, expired: true }), ["expired", "low"]);
  assert.deepEqual(what({ switches: 1 }, { switches: 3 }), ["pressed"]);
  assert.deepEqual(what({ switches: 3 }, { switches: 1 }), []);
  assert.deepEqual(changesOf(robot(1, { owner: "bob" }), robot(1)), [{ what: "owner", owner: undefined }]);
});

test("ranges are read and written", () => {
  assert.deepEqual(rangesOf("5, 1-2,31"), { ranges: [[5, 5], [1, 2], [31, 31]] });
  for (const [text, mistake] of [["", ""], ["0", "0"], ["1-", "1-"], ["2,x", "x"], ["100000", "100000"], ["5-3", "5-3"], ["-1", "-1"]]) assert.deepEqual(rangesOf(text), { mistake });
  const known = [3, 1, 2, 6];
  assert.deepEqual(unitsOf(" all ", known), { units: [1, 2, 3, 6] });
  assert.deepEqual(unitsOf("6,1-2,2", known), { units: [1, 2, 6] });
  assert.deepEqual(unitsOf("1-99999", known), { missing: 4 });
  assert.equal(wordsOf([5, 1, 2, 3, 7, 8, 8]), "1-3, 5, 7, 8");
  assert.equal(wordsOf([]), "");
  assert.deepEqual(unitsOf(wordsOf(known), known), { units: [1, 2, 3, 6] });
});

test("the filter: words that all must fit", () => {
  const all = [
    robot(1, { owner: "alice" }),
    robot(2, { owner: "carol", moving: true }),
    robot(3, { linked: false, battery: 5 }),
    robot(10, { owner: "carol~2", stopped: true, switches: 1 }),
    robot(20, { expired: true, battery: 30, "round-trip": 25_000, executing: { peer: "x" } }),
  ];
  const context = { me: "alice", selected: new Set([2, 3]) };
  for (const [filter, want] of [
    ["", [1, 2, 3, 10, 20]],
    ["moving", [2]],
    ["Driving", [2]],
    ["lost", [3]],
    ["stop", [10]],
    ["expired", [20]],
    ["low", [3]],
    ["mine", [1]],
    ["free", [3, 20]],
    ["!free", [1, 2, 10]],
    ["owner:carol", [2, 10]],
    ["owner:carol moving", [2]],
    ["carol !10", [2]],
    ["2-10", [2, 3, 10]],
    ["1,20", [1, 20]],
    ["1,", [1]],
    ["2-", [2]],
    ["battery<30", [3]],
    ["trip>10", [20]],
    ["x>900 x<1500", [10]],
    ["busy", [20]],
    ["pressed", [10]],
    ["selected", [2, 3]],
    ["nobody-there", []],
  ]) assert.deepEqual(units(filtered(all, filter, context)), want, filter);
});

test("each column sorts, what wants attention first; equal ones by number", () => {
  const all = [robot(3, { battery: 10 }, 3), robot(1, { moving: true, owner: "bob" }, 1), robot(2, { linked: false, "round-trip": undefined, battery: undefined }, 2), robot(4, { owner: "ann", "round-trip": 900 }, 1)];
  for (const [by, want, back] of [
    ["unit", [1, 2, 3, 4], [4, 3, 2, 1]],
    ["state", [2, 1, 3, 4], [3, 4, 1, 2]],
    ["battery", [3, 1, 4, 2], [2, 1, 4, 3]],
    ["trip", [4, 1, 3, 2], [2, 1, 3, 4]],
    ["owner", [4, 1, 2, 3], [2, 3, 1, 4]],
    ["age", [1, 4, 2, 3], [3, 2, 1, 4]],
    ["at", [1, 2, 3, 4], [4, 3, 2, 1]],
  ]) {
    assert.deepEqual(units(sorted(all, by, false)), want, by);
    assert.deepEqual(units(sorted(all, by, true)), back, `${by}, reversed`);
  }
  assert.deepEqual(columns.map(({ id }) => id), ["unit", "state", "battery", "trip", "owner", "age", "at"]);
});

test("several robots keep their places to each other", () => {
  const { goals, outside } = goalsOf([{ unit: 1, x: 0, y: 0 }, { unit: 2, x: 1000, y: 0 }, { unit: 3, x: 500, y: 900 }, { unit: 4, x: undefined, y: 3 }], [5000.4, 5000.4]);
  assert.deepEqual([...goals], [[1, [4500, 4700]], [2, [5500, 4700]], [3, [5000, 5600]]]);
  assert.deepEqual(outside, []);
  assert.deepEqual([...goalsOf([{ unit: 1, x: 7, y: 7 }], [1.6, -2.4]).goals], [[1, [2, -2]]]);
  assert.deepEqual(goalsOf([{ unit: 1, x: 0, y: 0 }, { unit: 2, x: 2, y: 0 }], [-9999, 0]).outside, [1]);
  assert.deepEqual([...goalsOf([], [1, 1]).goals], []);
});

test("a trail keeps where a robot was, and until when", () => {
  const trails = new Trails(1000);
  for (const [x, at] of [[0, 0], [1, 100], [2, 200], [100, 300], [200, 400], [200, 350], [200, 900]]) trails.add(1, x, 0, at);
  assert.deepEqual(trails.of(1, 0), [[0, 0, 200], [100, 0, 300], [200, 0, 900]]);
  assert.deepEqual(trails.of(1, 250), [[100, 0, 300], [200, 0, 900]]);
  assert.deepEqual(trails.of(1, 901), []);
  assert.deepEqual(trails.of(2, 0), []);
  trails.add(1, 300, 0, 1250);
  assert.equal(trails.of(1, 0)[0][2], 300, "what is too old is dropped");
  for (let at = 2000; at < 5000; at += 1) trails.add(3, at * 10, 0, at);
  assert.ok(trails.of(3, 0).length <= 601);
});

test("statements are typed field by field, within what the gateway takes", () => {
  assert.deepEqual(statementOf("motor", { left: "-1000", right: " 1000", ms: "60000" }), { text: "motor -1000 1000 60000" });
  assert.deepEqual(statementOf("goto", { x: "-9999", y: "99999" }), { text: "goto -9999 99999" });
  assert.deepEqual(statementOf("via", { points: "1 2, 3 4\n5 6" }), { text: "via 1 2 3 4 5 6" });
  assert.deepEqual(statementOf("leds", { mask: "255" }), { text: "leds 255" });
  assert.deepEqual(statementOf("wait", { ms: "0" }), { text: "wait 0" });
  for (const [verb, typed, wrong] of [
    ["motor", { left: "1001", right: "1.5", ms: "0" }, ["left", "right", "ms"]],
    ["goto", { x: "", y: "-10000" }, ["x", "y"]],
    ["via", { points: "1 2 3" }, ["points"]],
    ["via", { points: "1 100000" }, ["points"]],
    ["via", {}, ["points"]],
    ["leds", { mask: "256" }, ["mask"]],
    ["wait", { ms: "1e3" }, ["ms"]],
  ]) assert.deepEqual(Object.keys(statementOf(verb, typed).mistakes), wrong, JSON.stringify(typed));
  assert.deepEqual(wholeOf(PERIOD, "100"), { value: 100 });
  assert.ok("mistake" in wholeOf(PERIOD, "99"));
  assert.deepEqual([goalOf("goto 1 2"), goalOf("leds 1; via 1 2 3 4; wait 5"), goalOf("motor 1 2 3"), goalOf("goto 1")], [[1, 2], [3, 4], undefined, undefined]);
});

test("clicks and keys select", () => {
  const order = [4, 2, 9, 7, 1];
  const of = ({ units }) => [...units];
  assert.deepEqual(of(only(2)), [2]);
  assert.deepEqual(of(toggled(only(2), 9)), [2, 9]);
  assert.deepEqual(of(toggled(toggled(only(2), 9), 2)), [9]);
  assert.deepEqual(of(extended(only(2), 7, order)), [2, 9, 7]);
  assert.deepEqual(of(extended(only(7), 4, order)), [4, 2, 9, 7]);
  assert.deepEqual(of(extended(extended(only(9), 1, order), 2, order)), [2, 9]);
  assert.deepEqual(of(extended({ units: new Set([4]), active: 9, anchor: 9 }, 7, order, true)), [4, 9, 7]);
  assert.deepEqual(of(extended(only(55), 7, order)), [7]);
  const key = (before, name, more = {}) => keyed(before, order, name, { shift: false, control: false, ...more }, 2);
  assert.equal(key(NOTHING, "ArrowDown").active, 4);
  assert.equal(key(NOTHING, "ArrowUp").active, 1);
  assert.deepEqual(of(key(only(4), "ArrowDown")), [2]);
  assert.equal(key(only(1), "ArrowDown").active, 1);
  assert.deepEqual(of(key(only(4), "PageDown")), [9]);
  assert.deepEqual(of(key(only(2), "End", { shift: true })), [2, 9, 7, 1]);
  const away = key(only(4), "ArrowDown", { control: true });
  assert.deepEqual([of(away), away.active], [[4], 2]);
  assert.deepEqual(of(key(away, "Enter")), [4, 2]);
  assert.deepEqual(of(key(only(4), "a", { control: true })), order);
  for (const nothing of ["a", " ", "Escape", "Tab"]) assert.equal(key(only(4), nothing), undefined, nothing);
  assert.equal(keyed(NOTHING, [], "ArrowDown", { shift: false, control: false }, 2), undefined);
});

test("the map shows a part of the floor, and finds what is where", () => {
  const at = { x: 1000, y: 1000, scale: 0.1, width: 400, height: 200 };
  assert.deepEqual(view.toScreen(at, [1000, 1000]), [200, 100]);
  assert.deepEqual(view.toScreen(at, [1100, 1100]), [210, 90]);
  assert.deepEqual(view.toFloor(at, view.toScreen(at, [123, 456])).map(Math.round), [123, 456]);
  const nearer = view.zoomed(at, 2, [210, 90]);
  assert.deepEqual(view.toFloor(nearer, [210, 90]).map(Math.round), [1100, 1100]);
  assert.equal(view.zoomed(at, 1e9).scale, 5);
  assert.deepEqual([view.moved(at, 10, 10).x, view.moved(at, 10, 10).y], [900, 1100]);
  const all = view.fitted(at, [[0, 0], [10_000, 5000]]);
  for (const corner of [[0, 0], [10_000, 5000]]) {
    const [x, y] = view.toScreen(all, corner);
    assert.ok(x > 0 && x < 400 && y > 0 && y < 200);
  }
  assert.equal(view.fitted(at, []), at);
  assert.deepEqual([view.stepOf(0.1, 64), view.stepOf(1, 50), view.stepOf(0.01, 64)].map(Math.round), [1000, 50, 10_000]);
  assert.deepEqual([2000, 500, 5].map(view.lengthWords), ["2 m", "50 cm", "5 mm"]);
  const robots = [robot(1, { x: 1000, y: 1000 }), robot(2, { x: 1100, y: 1000 }), robot(3, { x: undefined })];
  assert.equal(nearest(robots, at, [207, 100], 16).unit, 2);
  assert.equal(nearest(robots, at, [260, 100], 16), undefined);
  assert.deepEqual(units(within(robots, at, [205, 90, 20, 20])), [2]);
});
