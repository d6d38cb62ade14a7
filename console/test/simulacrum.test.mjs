import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./bundle.mjs";

const { seenOf, headerOf, bytesOf, hexOf, bitsOf, mapSize } = await load("panels/simulacrum/packet.ts");
const { elementOf, packetOf, inOrder, isPlaced, isApart, knownAt, isSpeed, valueWords } = await load("panels/simulacrum/element.ts");
const { numbersOf, timeOf, setOf, doOf, switchOf, askOf, periodOf } = await load("panels/simulacrum/statement.ts");
const { Trail, pathOf, SPAN } = await load("panels/simulacrum/trail.ts");

const HEADER = "01c0b0000101f400001388a1b2c3d4e5f601f302";
const places = (bits) => bits.flatMap((bit, place) => (bit ? [place] : []));

test("a header is read field by field (S14)", () => {
  assert.deepEqual(headerOf(bytesOf(HEADER)), { version: 1, model: 0xc0b0, encryption: 0, type: 1, sequence: 500, stamp: 5000, session: "a1b2c3d4e5f6", last: 499, buffers: 2 });
  assert.equal(headerOf(bytesOf(HEADER.replace("01f302", "ffff02"))).last, undefined);
  assert.equal(headerOf(bytesOf("ff".repeat(11) + HEADER.slice(22))).stamp, 0xffffffff);
  assert.equal(headerOf(bytesOf(HEADER.slice(2))), undefined);
  for (const wrong of ["0", "0g", "01 2"]) assert.equal(bytesOf(wrong), undefined);
  assert.equal(hexOf(bytesOf("00FFa0")), "00ffa0");
  assert.deepEqual(seenOf(HEADER, 16).parts.header, ["01", "c0b0", "00", "01", "01f4", "00001388", "a1b2c3d4e5f6", "01f3", "02"]);
});

test("the golden device maps have the bits of figure 8 (S18)", () => {
  for (const [map, expected] of [["e0", [0, 1, 2]], ["e4", [0, 1, 2, 5]], ["e2", [0, 1, 2, 6]]]) assert.deepEqual(places(seenOf(HEADER + map, 8).bits), expected);
  assert.deepEqual(places(bitsOf(bytesOf("8001"), 16)), [0, 15]);
  assert.deepEqual(places(bitsOf(bytesOf("ff"), 3)), [0, 1, 2]);
  assert.deepEqual([mapSize(8), mapSize(9), mapSize(256)], [1, 2, 32]);
  const { parts, sealed } = seenOf(`${HEADER}c00000640064`, 16);
  assert.deepEqual([parts.map, parts.payload, sealed], ["c000", "00640064", false]);
});

test("what is behind the header of a sealed packet is not shown, and its bits are those that are told beside it", () => {
  const sealed = `${HEADER.slice(0, 6)}01${HEADER.slice(8)}`;
  const without = seenOf(`${sealed}0123456789`, 16);
  assert.deepEqual([without.sealed, without.bits, without.parts.map, without.parts.payload], [true, undefined, "", ""]);
  assert.deepEqual(places(seenOf(`${sealed}0123456789`, 16, "8001").bits), [0, 15]);
  assert.equal(seenOf(`${sealed}0123456789`, 16, "80").bits, undefined);
  // A control packet begins with no map, and one that was cut has none.
  assert.equal(seenOf(`${HEADER.slice(0, 8)}02${HEADER.slice(10)}c000`, 16).bits, undefined);
  assert.equal(seenOf(`${HEADER}c0`, 16).bits, undefined);
  assert.equal(seenOf("", 16), undefined);
});

const said = (name, content, born = 1000) => ({ type: "message", name, content, born, error: 2, arrived: born + 5 });

test("an element is what its message says, whatever that is", () => {
  const wheel = elementOf(said("left-wheel", { kind: "effector", place: 0, wanted: [100], value: [99.5], unit: ["mm/s"], activated: true, active: false, linked: true, since: 2500000 }), 3);
  assert.deepEqual([wheel.kind, wheel.place, wheel.heard, wheel.wanted, wheel.value, wheel.activated, wheel.active, wheel.since], ["effector", 0, 3, [100], [99.5], true, false, 2500]);
  assert.equal(elementOf(said("packet", { kind: "sensor" }), 0), undefined);
  assert.equal(elementOf(said("left-wheel", "nonsense"), 0), undefined);
  const strange = elementOf({ ...said("x", { kind: "warp-drive", wanted: "1", value: [1n, "2"], unit: 3 }), born: undefined }, 0);
  assert.deepEqual([strange.kind, strange.wanted, strange.value[0], Number.isNaN(strange.value[1]), strange.units, strange.born], ["", undefined, 1, true, [], 1005]);
  const packet = packetOf(said("packet", { linked: true, period: 20, loss: 0.01, dropped: { old: 2, sealed: 7, short: 0, odd: "x" }, down: "01", "down-map": "80" }));
  assert.deepEqual([packet.linked, packet.period, packet.confirmed, packet.dropped, packet.downMap, packet.upMap, packet.up], [true, 20, undefined, [["sealed", 7], ["old", 2]], "80", undefined, ""]);
  assert.equal(packetOf(said("left-wheel", {})), undefined);
});

test("elements stand in the order of the device map, where it is told", () => {
  const of = (name, place, heard) => ({ name, place, heard });
  const told = inOrder([of("c", 2, 0), of("a", 0, 1), of("b", 1, 2)]);
  assert.deepEqual([told.map(({ name }) => name).join(""), isPlaced(told)], ["abc", true]);
  const untold = inOrder([of("c", undefined, 1), of("a", undefined, 0)]);
  assert.deepEqual([untold.map(({ name }) => name).join(""), isPlaced(untold)], ["ac", false]);
  assert.equal(isPlaced(inOrder([of("a", 0, 0), of("c", 2, 1)])), false);
  assert.equal(isPlaced([]), false);
});

test("wanted and confirmed are apart until each number is the same", () => {
  for (const [wanted, value, apart] of [[undefined, [1], false], [[1], undefined, true], [[1], [1], false], [[1, 2], [1], true], [[0.3], [0.1 + 0.2], false], [[100], [99.9], true], [[0], [0], false]]) assert.equal(isApart({ wanted, value }), apart, JSON.stringify([wanted, value]));
});

test("a value is as old as the robot's newest word that it is still this one", () => {
  const element = { born: 1000, linked: true, active: true };
  const packet = { linked: true, born: 9000, heard: 15_000 };
  assert.equal(knownAt(element, packet), 8985);
  assert.equal(knownAt({ ...element, born: 8990 }, packet), 8990);
  // Of one that is silent, lost or not told of nothing is known anew.
  for (const [change, of] of [[{ active: false }, packet], [{ linked: false }, packet], [{}, { ...packet, linked: false }], [{}, { ...packet, heard: undefined }], [{}, undefined]]) assert.equal(knownAt({ ...element, ...change }, of), 1000);
});

test("values are said with their units", () => {
  assert.equal(valueWords([100], ["mm/s"]), "100 mm/s");
  assert.equal(valueWords([-90, 0, 20.12345], ["deg"]), "−90, 0, 20.123 deg");
  assert.equal(valueWords([812, 0, 11.9], ["mm", "", "V"]), "812 mm, 0, 11.9 V");
  assert.equal(valueWords([1, NaN], []), "1, –");
  assert.deepEqual([isSpeed(["mm/s"]), isSpeed(["deg", "deg/s"]), isSpeed(["mm", "m/s^2"]), isSpeed([])], [true, true, false, false]);
});

test("statements are built of what is typed, and mistakes are said", () => {
  assert.deepEqual(numbersOf(" 1, -2.5;3 ", 3), { value: [1, -2.5, 3] });
  assert.deepEqual(numbersOf("", undefined), { value: [] });
  assert.match(numbersOf("1 for", undefined).mistake, /“for” is not a number/);
  assert.match(numbersOf("inf", undefined).mistake, /not a number/);
  assert.match(numbersOf("1e999", undefined).mistake, /not a number/);
  assert.match(numbersOf("1 2", 3).mistake, /3 numbers are needed, not 2/);
  assert.match(numbersOf("x".repeat(50), 1).mistake, /^“x{20}…”/);
  assert.deepEqual([timeOf("", false), timeOf(" 1000 ", true)], [{ value: undefined }, { value: 1000 }]);
  for (const [typed, needed] of [["", true], ["0", false], ["60001", false], ["1.5", false], ["-1", true]]) assert.ok("mistake" in timeOf(typed, needed), typed);
  assert.equal(setOf("left-wheel", [100], 1000), "set left-wheel 100 for 1000");
  assert.equal(setOf("joints", [-90, 0, 20.5]), "set joints -90 0 20.5");
  assert.equal(doOf("gesture", [3]), "do gesture 3");
  assert.equal(doOf("wave", []), "do wave");
  assert.deepEqual([switchOf("motion", true), switchOf("motion", false), askOf("camera")], ["activate motion", "deactivate motion", "ask camera"]);
  assert.deepEqual([periodOf(40), periodOf(4), periodOf(999), periodOf(20.4)], ["period 40", "period 5", "period 200", "period 20"]);
});

test("a line of the last minute holds what is not told again, and forgets what is older", () => {
  const trail = new Trail();
  assert.deepEqual([trail.points(0), trail.range(0)], [[], undefined]);
  trail.add(1000, 5);
  trail.add(2000, 5);
  trail.add(31_000, 10);
  trail.add(31_100, 12);
  assert.deepEqual(trail.points(61_000), [[0, 5], [0.5, 10], [0.5, 12], [1, 12]]);
  assert.deepEqual(trail.range(61_000), [5, 12]);
  // A peak that is shorter than a step is drawn.
  for (const [at, value] of [[45_000, 12], [45_100, 40], [45_200, 12], [45_220, null], [45_300, 12]]) trail.add(at, value);
  assert.deepEqual(trail.range(61_000), [5, 40]);
  trail.add(61_000, null);
  // Of what is older than a minute only what still holds counts.
  assert.deepEqual(trail.points(31_000 + SPAN + 30_000), [[0, null], [1, null]]);
  trail.add(1000, 99);
  assert.equal(trail.points(61_000).some(([, value]) => value === 99), false);
  for (let at = 70_000; at < 400_000; at += 250) trail.add(at, at);
  assert.ok(trail.points(400_000).length < 250);
  assert.equal(pathOf([[0, 0], [0.5, 10], [1, 10]], [0, 10], 100, 20), "M0 20H50V0H100V0");
  assert.equal(pathOf([[0, 5], [0.5, null], [0.75, 5], [1, 5]], [5, 5], 100, 20), "M0 10H50M75 10H100V10");
  assert.equal(pathOf([], [0, 1], 100, 20), "");
});
