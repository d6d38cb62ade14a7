import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./bundle.mjs";

const { REST, FASTEST, directionOf, forwardOf, step, velocity } = await load("panels/jog/machine.ts");
const { STANDARD, beyond, mappingOf, readPad } = await load("panels/jog/pad.ts");

const good = { now: 1000, held: true, owns: true, stopAt: undefined, stopped: false, unknownSince: undefined, linked: true, visible: true, focused: true, age: 100, limit: 1000, unseen: false, pad: { pushed: false, deadMan: false, gone: false }, refused: undefined };

test("drives while something is held, and rests when it is let go", () => {
  const drive = step(REST, good);
  assert.deepEqual(drive, { phase: "drive", since: 1000 });
  assert.equal(step(drive, { ...good, now: 2000 }), drive);
  assert.deepEqual(step(drive, { ...good, held: false }), REST);
});

test("each obstacle locks, says why, and holds until everything is let go", () => {
  for (const [reason, change] of [
    ["stop", { stopAt: 1500 }],
    ["stopped", { stopped: true }],
    ["unknown", { unknownSince: 1500 }],
    ["link", { linked: false }],
    ["token-lost", { owns: false }],
    ["hidden", { visible: false }],
    ["blurred", { focused: false }],
    ["no-picture", { age: undefined }],
    ["old-picture", { age: 1001 }],
    ["pad-gone", { held: false, pad: { pushed: false, deadMan: false, gone: true } }],
    ["dead-man", { pad: { pushed: true, deadMan: false, gone: false } }],
    ["refused", { refused: { at: 1500, text: "busy" } }],
  ]) {
    const drive = step(REST, good);
    const locked = step(drive, { ...good, now: 2000, ...change });
    assert.equal(locked.phase, "locked", reason);
    assert.equal(locked.why.reason, reason);
    // What is in the way has gone, but it is still held.
    const later = step(locked, { ...good, now: 3000 });
    assert.equal(later, locked, reason);
    const rest = step(later, { ...good, now: 3100, held: false });
    assert.deepEqual(rest, { phase: "rest", why: locked.why });
    assert.deepEqual(step(rest, { ...good, now: 3200 }), { phase: "drive", since: 3200 }, reason);
  }
});

test("does not begin where something is in the way", () => {
  assert.deepEqual(step(REST, { ...good, owns: false }), { phase: "locked", why: { reason: "no-token", text: undefined } });
  assert.equal(step(REST, { ...good, age: undefined, unseen: true }).phase, "drive");
  // An order to stop of before, and a refusal of before, are over.
  assert.equal(step(REST, { ...good, stopAt: 900, refused: { at: 900, text: "" } }).phase, "drive");
  assert.equal(step(REST, { ...good, pad: { pushed: true, deadMan: true, gone: false } }).phase, "drive");
  // At rest nothing is complained of.
  assert.equal(step(REST, { ...good, held: false, owns: false }), REST);
});

test("a reason that tells to do what is done is not said any more; what has come to pass is", () => {
  for (const [reason, change] of [
    ["no-token", { owns: false }],
    ["stopped", { stopped: true }],
    ["unknown", { unknownSince: 900 }],
    ["link", { linked: false }],
    ["no-picture", { age: undefined }],
  ]) {
    const locked = step(REST, { ...good, ...change });
    assert.equal(locked.why.reason, reason);
    const rest = step(locked, { ...good, ...change, held: false });
    assert.equal(step(rest, { ...good, ...change, held: false }), rest, `${reason} holds`);
    assert.deepEqual(step(rest, { ...good, held: false }), REST, reason);
  }
  const hidden = step(step(step(REST, good), { ...good, visible: false }), { ...good, held: false });
  assert.equal(step(hidden, { ...good, held: false }), hidden);
  // A stop is told until it is let go.
  const stop = step(step(step(REST, good), { ...good, stopAt: 1500 }), { ...good, held: false });
  const stopped = step(stop, { ...good, held: false, stopped: true });
  assert.equal(stopped.why.reason, "stopped");
  assert.deepEqual(step(stopped, { ...good, held: false }), REST);
});

test("is no faster in two directions than in one, and never faster than the arm", () => {
  assert.deepEqual(velocity([1, 0, 0, 0, 0], 50, 30), [50, 0, 0, 0, 0]);
  const [x, y, z] = velocity([1, 1, 1, 0, 0], 150, 30);
  assert.ok(Math.hypot(x, y, z) <= 150, `${x} ${y} ${z}`);
  assert.deepEqual(velocity([0, 0, 0.5, 2, -0.5], 100, 200), [0, 0, 50, 90, -45]);
  assert.ok(velocity([1, 0, 0, 0, 0], 1000, 30)[0] <= FASTEST);
});

test("forward is away from the viewer", () => {
  const near = ([x, y], [u, v]) => assert.ok(Math.hypot(x - u, y - v) < 1e-9, `${x} ${y}`);
  // Rows: right, down, forward; this one looks along x and down.
  near(forwardOf([0, -600, 0, 0, 0, 0, -600, 0, 0.8, 0, -0.6, 900]), [1, 0]);
  // Straight down, y upward in the image.
  near(forwardOf([600, 0, 320, 0, 0, -600, 240, 0, 0, 0, -1, 900]), [0, 1]);
  assert.equal(forwardOf([1, 2, 3]), undefined);
  assert.equal(forwardOf(new Array(12).fill(0)), undefined);
  // Seen along x, right of the picture is towards lesser y.
  assert.deepEqual(velocity([1, 0, 0, 0, 0], 50, 30, [1, 0]), [0, -50, 0, 0, 0]);
  assert.deepEqual(velocity([0, 1, 0, 0, 0], 50, 30, [1, 0]), [50, 0, 0, 0, 0]);
});

test("keys by letter, and by place where the keyboard has other letters", () => {
  assert.equal(directionOf("w", "KeyW"), "away");
  assert.equal(directionOf("W", "KeyW"), "away");
  assert.equal(directionOf("ArrowLeft", "ArrowLeft"), "left");
  assert.equal(directionOf("ц", "KeyW"), "away");
  // On a French keyboard this is the place of Q.
  assert.equal(directionOf("a", "KeyQ"), "left");
  assert.equal(directionOf("z", "KeyW"), undefined);
  assert.equal(directionOf(" ", "Space"), undefined);
  assert.equal(directionOf("constructor", ""), undefined);
});

test("a gamepad by its mapping, beyond the dead zone", () => {
  const buttons = Array.from({ length: 17 }, () => ({ pressed: false, value: 0 }));
  const pad = { axes: [0.1, -1, 0.575, 0], buttons: buttons.map((button, number) => (number === 5 || number === 13 ? { pressed: true, value: 1 } : button)) };
  const { wish, deadMan } = readPad(pad, STANDARD, 0.15, 0.5);
  assert.deepEqual(wish.map((part) => Math.round(part * 100) / 100), [0, 0.5, 0, -0.25, -0.5]);
  assert.equal(deadMan, true);
  assert.equal(beyond(1, 0.2), 1);
  assert.equal(beyond(NaN, 0.2), 0);
  assert.equal(readPad({ axes: [], buttons: [] }, STANDARD, 0.1, 1).deadMan, false);
  assert.deepEqual(mappingOf(JSON.parse(JSON.stringify(STANDARD))), STANDARD);
  for (const wrong of [null, {}, { sources: [], deadMan: 5 }, { ...STANDARD, deadMan: "5" }, { ...STANDARD, sources: [1, 2, 3, 4, 5] }]) assert.equal(mappingOf(wrong), undefined);
});
