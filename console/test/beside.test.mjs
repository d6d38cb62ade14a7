// What messages say beside their images: read as far as it makes sense, whatever it is.
import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./bundle.mjs";

const { besideOf, blockOf, topOf } = await load("panels/camera/overlay.ts");

/** The line that a camera draws over all edges of a block. */
function edges([x, y, z], [a, b, c], yaw) {
  const [cos, sin] = [Math.cos((yaw * Math.PI) / 180), Math.sin((yaw * Math.PI) / 180)];
  const corner = (at) => {
    const [i, j] = [[-1, -1], [1, -1], [1, 1], [-1, 1]][at % 4];
    const [u, v] = [(i * a) / 2, (j * b) / 2];
    return [x + cos * u - sin * v, y + sin * u + cos * v, z + ((at < 4 ? -1 : 1) * c) / 2].map((value) => Math.round(value * 10) / 10);
  };
  return [0, 1, 2, 3, 0, 4, 5, 1, 5, 6, 2, 6, 7, 3, 7, 4].map(corner);
}

test("a block is known by its edges", () => {
  for (let yaw = -80; yaw <= 80; yaw += 5) {
    const block = blockOf({ name: "red", points: edges([100, -50, 20], [40, 40, 40], yaw) });
    const [x, y, z] = block.middle;
    assert.ok(Math.hypot(x - 100, y + 50, z - 20) < 0.1);
    assert.equal(block.top, 40);
    assert.ok(Math.abs(((block.yaw - yaw + 3645) % 90) - 45) < 0.3, `${block.yaw} is not ${yaw}`);
    assert.ok(Math.abs(block.yaw) <= 45.01);
  }
});

test("a block's name stands above it", () => {
  const [x, y, z] = topOf(edges([100, -50, 20], [40, 40, 40], 30));
  assert.ok(Math.hypot(x - 100, y + 50, z - 40) < 0.1);
  assert.equal(topOf([]), undefined);
});

test("what is said is read", () => {
  const taken = new Date(1_700_000_000_000);
  const beside = besideOf({ width: 640, height: 480, view: "x", taken, matrix: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 100], pose: { x: 1, y: 2, z: 3, spin: 4, tilt: 5 }, aim: { pan: 1, tilt: 2 }, overlays: [{ name: "pose", points: [[0, 0, 0], [1, 1, 1]] }, { name: "block red", points: [[0, 0, 0], [1, 1, 1]] }, { name: "blocked", points: [] }] }, 320, 240);
  assert.deepEqual([beside.width, beside.height, beside.view, beside.taken], [640, 480, "x", taken.getTime()]);
  assert.deepEqual(beside.pose, [1, 2, 3, 4, 5]);
  assert.deepEqual(beside.aim, { pan: 1, tilt: 2 });
  assert.deepEqual(beside.blocks.map(({ name }) => name), ["red"]);
  assert.equal(beside.posed.length, 2);
  assert.equal(beside.matrix.length, 12);
});

test("nonsense is left out", () => {
  for (const content of [{}, { width: -1, height: Number.NaN }, { matrix: "x", overlays: 7, pose: [], aim: null, taken: "now" }, { overlays: [null, 7, { name: 7, points: {} }, { name: "pose", points: [[1], [1, 2, "3"], [Number.NaN, 0, 0]] }] }]) {
    const beside = besideOf(content, 320, 240);
    assert.deepEqual([beside.width, beside.height], [320, 240]);
    assert.equal(beside.matrix, undefined);
    assert.equal(beside.taken, undefined);
    assert.deepEqual(beside.posed ?? [], []);
    assert.deepEqual(beside.blocks, []);
  }
  assert.equal(besideOf({ overlays: Array.from({ length: 1000 }, () => ({ name: "block a", points: [] })) }, 1, 1).blocks.length, 200);
});
