// Projection, its inverses, clipping and the workspace, over cameras and poses at random.
import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./bundle.mjs";

const { along, depth, flow, FAR, line, matrixOf, NEAR, onCurve, onPlane, pathData, project, scaleAt } = await load("room/matrix.ts");
const { AXES, clamp, LIMITS, rounded, tool } = await load("room/workspace.ts");
const { Drag, handlesOf, reachOf } = await load("room/handles.ts");

/** The same numbers in each run. */
function random(seed) {
  let state = seed >>> 0;
  return (low = 0, high = 1) => {
    state = (state + 0x6d2b79f5) >>> 0;
    let mixed = Math.imul(state ^ (state >>> 15), 1 | state);
    mixed = (mixed + Math.imul(mixed ^ (mixed >>> 7), 61 | mixed)) ^ mixed;
    return low + (((mixed ^ (mixed >>> 14)) >>> 0) / 2 ** 32) * (high - low);
  };
}

const minus = (a, b) => a.map((value, at) => value - b[at]);
const cross = ([a, b, c], [d, e, f]) => [b * f - c * e, c * d - a * f, a * e - b * d];
const dot = (a, b) => a.reduce((sum, value, at) => sum + value * b[at], 0);
const unit = (a) => a.map((value) => value / Math.hypot(...a));

/** A camera that looks from one place to another, as those of the lab do. */
function camera(position, target, focal, up = [0, 0, 1], [width, height] = [640, 480]) {
  const forward = unit(minus(target, position));
  const right = unit(cross(forward, up));
  const down = cross(forward, right);
  const rows = [0, 1, 2].map((at) => [focal * right[at] + (width / 2) * forward[at], focal * down[at] + (height / 2) * forward[at], forward[at]]);
  return [0, 1, 2].flatMap((row) => [...rows.map((column) => column[row]), -dot(rows.map((column) => column[row]), position)]);
}

/** A camera anywhere around the table. */
function anyCamera(next) {
  const [around, up, far] = [next(0, 2 * Math.PI), next(0.15, 1.45), next(900, 3000)];
  const position = [far * Math.cos(up) * Math.cos(around), far * Math.cos(up) * Math.sin(around), 200 + far * Math.sin(up)];
  return camera(position, [next(-150, 150), next(-150, 150), next(0, 300)], next(500, 1800));
}

function anyPose(next) {
  return AXES.map((axis) => next(LIMITS[axis].low, LIMITS[axis].high));
}

const LAB = {
  x: camera([1600, 0, 760], [0, 0, 225], 832),
  y: camera([0, -1600, 760], [0, 0, 225], 832),
  top: camera([0, 0, 3000], [0, 0, 0], 1696, [0, 1, 0]),
};

test("a matrix is read as it is sent, and nothing else is taken for one", () => {
  const matrix = LAB.x;
  assert.deepEqual(matrixOf(matrix).map((value) => value.toFixed(6)), matrix.map((value) => value.toFixed(6)));
  const scaled = matrixOf(matrix.map((value) => value * 7));
  assert.ok(Math.abs(scaled[11] - matrix[11]) < 1e-6, "the third row gives mm");
  for (const wrong of [undefined, null, "matrix", [], matrix.slice(1), [...matrix.slice(1), "1"], matrix.map(() => 0), matrix.map(() => Number.NaN)]) assert.equal(matrixOf(wrong), undefined);
});

test("the middle of the table is in the middle of the top camera's image", () => {
  const [u, v] = project(LAB.top, [0, 0, 0]);
  assert.ok(Math.hypot(u - 320, v - 240) < 1e-9);
  const [right] = project(LAB.top, [100, 0, 0]);
  assert.ok(Math.abs(right - 320 - (1696 / 3000) * 100) < 1e-9);
});

test("a pixel's place along an axis is where it was projected from", () => {
  const next = random(1);
  let solved = 0;
  for (let run = 0; run < 5000; run += 1) {
    const matrix = anyCamera(next);
    const point = anyPose(next).slice(0, 3);
    const way = [[1, 0, 0], [0, 1, 0], [0, 0, 1]][run % 3];
    const far = next(-250, 250);
    const pixel = project(matrix, point.map((value, at) => value + way[at] * far));
    if (!pixel || depth(matrix, point) < NEAR) continue;
    const seen = Math.hypot(...flow(matrix, point, way)) / scaleAt(matrix, point);
    const found = along(matrix, point, way, pixel);
    assert.ok(Math.abs(found - far) < 1e-6 / Math.max(seen, 1e-3) + 1e-6, `${found} is not ${far}`);
    solved += 1;
  }
  assert.ok(solved > 4000);
});

test("a pixel beside the axis gives the place that is seen nearest to it", () => {
  const next = random(2);
  for (let run = 0; run < 500; run += 1) {
    const matrix = anyCamera(next);
    const point = anyPose(next).slice(0, 3);
    const way = [[1, 0, 0], [0, 1, 0], [0, 0, 1]][run % 3];
    const at = (far) => project(matrix, point.map((value, index) => value + way[index] * far));
    if (Math.hypot(...flow(matrix, point, way)) / scaleAt(matrix, point) < 0.1) continue;
    const seen = at(next(-150, 150));
    const pixel = [seen[0] + next(-40, 40), seen[1] + next(-40, 40)];
    const found = along(matrix, point, way, pixel);
    if (Math.abs(found) > 1000) continue;
    const gap = (far) => Math.hypot(...minus(at(far), pixel));
    for (const off of [-3, -0.5, 0.5, 3]) assert.ok(gap(found) <= gap(found + off) + 1e-9);
  }
});

test("an axis that points into the camera gives bounded places, never nonsense", () => {
  const next = random(3);
  for (let run = 0; run < 3000; run += 1) {
    const point = [next(-1, 1), next(-1, 1), next(0, 400)].map((value, at) => (at < 2 && run % 2 ? 0 : value));
    const found = along(LAB.top, point, [0, 0, 1], [next(-2000, 2000), next(-2000, 2000)]);
    if (found === undefined) continue;
    assert.ok(Number.isFinite(found) && Math.abs(found) <= FAR);
    assert.ok(depth(LAB.top, [point[0], point[1], point[2] + found]) >= NEAR - 1e-3, "nothing goes through the camera");
  }
  assert.equal(along(LAB.top, [0, 0, 100], [0, 0, 1], [320, 240]), undefined, "end-on");
});

test("a pixel's place on a plane is where it was projected from; the sky shows none", () => {
  const next = random(4);
  for (let run = 0; run < 3000; run += 1) {
    const matrix = anyCamera(next);
    const [x, y, z] = anyPose(next);
    const pixel = project(matrix, [x, y, z]);
    if (!pixel) continue;
    const found = onPlane(matrix, z, pixel);
    assert.ok(found && Math.hypot(found[0] - x, found[1] - y) < 1e-4, `${found} is not ${[x, y]}`);
  }
  assert.equal(onPlane(LAB.x, 0, [320, -1e5]), undefined);
});

test("lines end before the camera, and what is behind it is not drawn", () => {
  const next = random(5);
  for (let run = 0; run < 3000; run += 1) {
    const matrix = anyCamera(next);
    const [from, to] = [0, 1].map(() => [next(-4000, 4000), next(-4000, 4000), next(-2000, 4000)]);
    const seen = line(matrix, from, to);
    const behind = [from, to].map((point) => depth(matrix, point) < NEAR);
    assert.equal(seen === undefined, behind[0] && behind[1]);
    if (!seen) continue;
    assert.ok(seen.flat().every(Number.isFinite));
    [from, to].forEach((point, at) => {
      if (!behind[at]) assert.ok(Math.hypot(...minus(seen[at], project(matrix, point))) < 1e-6);
    });
    // What is seen of it lies on the line that is seen: both ends and a place between that is visible are on one.
    const middle = from.map((value, at) => value + 0.5 * (to[at] - value));
    const pixel = project(matrix, middle);
    if (pixel) {
      const way = minus(seen[1], seen[0]);
      const off = Math.abs(way[0] * (pixel[1] - seen[0][1]) - way[1] * (pixel[0] - seen[0][0])) / Math.max(1, Math.hypot(...way));
      assert.ok(off < 1e-3 * Math.max(1, ...seen.flat().map(Math.abs)), `${off} px beside the line`);
    }
  }
  const passing = pathData(LAB.x, [[0, 0, 0], [3000, 0, 900], [0, 0, 100], [0, 100, 100]], 640);
  assert.doesNotMatch(passing, /NaN|Infinity/);
  assert.equal(pathData(LAB.x, [[2000, 0, 760], [3000, 0, 760]], 640), "");
});

test("the workspace takes what is inside as it is, and the nearest of what is not", () => {
  const next = random(6);
  for (let run = 0; run < 3000; run += 1) {
    const pose = AXES.map((axis) => next(2 * LIMITS[axis].low - 50, 2 * LIMITS[axis].high));
    const { pose: inside, outside } = clamp(pose);
    AXES.forEach((axis, at) => {
      const { low, high } = LIMITS[axis];
      assert.ok(inside[at] >= low && inside[at] <= high);
      const isOutside = axis !== "spin" && (pose[at] < low || pose[at] > high);
      assert.equal(outside.includes(axis), isOutside, axis);
      if (!isOutside && axis !== "spin") assert.equal(inside[at], pose[at]);
    });
    // A whole turn is none.
    assert.ok(Math.abs(Math.cos(((inside[3] - pose[3]) * Math.PI) / 180) - 1) < 1e-9);
    assert.deepEqual(clamp(inside), { pose: inside, outside: [] });
    assert.deepEqual(clamp(rounded(inside)).outside, []);
  }
  for (const wrong of [Number.NaN, Infinity, -Infinity]) {
    const { pose, outside } = clamp([wrong, wrong, wrong, wrong, wrong]);
    assert.ok(pose.every(Number.isFinite));
    assert.equal(outside.length, 5);
  }
});

test("the tool's frame is that of the cameras", () => {
  assert.deepEqual(tool([1, 2, 3, 0, 0], [10, 20, 30]), [11, 22, 33]);
  const [x, y, z] = tool([0, 0, 0, 90, 45], [10, 0, 100]);
  assert.ok(Math.hypot(x - 70.7107, y - 10, z - 70.7107) < 1e-3);
});

test("a place on a curve is found again, also on a ring that is seen from the side", () => {
  const next = random(7);
  for (let run = 0; run < 300; run += 1) {
    const matrix = anyCamera(next);
    const [x, y, z] = anyPose(next);
    const seen = (spin) => project(matrix, [x + 60 * Math.cos((spin * Math.PI) / 180), y + 60 * Math.sin((spin * Math.PI) / 180), z]);
    const from = next(-180, 180);
    const to = from + next(-25, 25);
    const found = onCurve(seen, seen(to), from, from - 120, from + 120);
    assert.ok(Math.hypot(...minus(seen(found), seen(to))) < 0.05);
  }
});

/** Drags a handle in steps, as a hand does, and gives the pose and where the handle is drawn at last. */
function dragged(matrix, before, grip, way) {
  const reach = reachOf(matrix, before, 85);
  const handle = handlesOf(matrix, before, reach).find((each) => each.grip === grip);
  const start = [handle.at[0] + 3, handle.at[1] - 2];
  const drag = new Drag(handle, reach, matrix, before, start);
  let pose = before;
  for (let step = 1; step <= 10; step += 1) {
    const pointer = start.map((value, at) => value + (way[at] * step) / 10);
    pose = rounded(clamp(drag.to(matrix, pose, pointer)).pose);
  }
  const after = handlesOf(matrix, pose, reach).find((each) => each.grip === grip);
  return { pose, handle, at: drag.shifted(after.at, after.anchor), wanted: [handle.at[0] + way[0], handle.at[1] + way[1]] };
}

test("a handle that is dragged changes its degree alone, and stays under the pointer", () => {
  const next = random(8);
  let [followed, endOn] = [0, 0];
  for (let run = 0; run < 400; run += 1) {
    const matrix = run % 4 === 0 ? Object.values(LAB)[run % 3] : anyCamera(next);
    const before = rounded([next(-120, 120), next(-120, 120), next(120, 300), next(-170, 170), next(-20, 20)]);
    const reach = reachOf(matrix, before, 85);
    assert.ok(reach);
    for (const { grip, at, endOn: isEndOn } of handlesOf(matrix, before, reach)) {
      // Along the handle's own line: where its degree would be a little more.
      const amount = next(5, 18) * (next() < 0.5 ? -1 : 1);
      const moved = [...before];
      if (grip === "tip") [moved[0], moved[1]] = [before[0] + amount, before[1] - amount];
      else moved[AXES.indexOf(grip)] += amount;
      const target = handlesOf(matrix, moved, reach).find((each) => each.grip === grip);
      const way = isEndOn ? [amount, -amount] : minus(target.anchor, handlesOf(matrix, before, reach).find((each) => each.grip === grip).anchor);
      const { pose, at: drawn, wanted } = dragged(matrix, before, grip, way);
      const allowed = grip === "tip" ? ["x", "y"] : [grip];
      AXES.forEach((axis, index) => {
        if (!allowed.includes(axis)) assert.equal(pose[index], before[index], `${grip} has changed ${axis}`);
      });
      if (isEndOn) {
        endOn += 1;
        // It goes along the dashed line, which the pointer's way has a part of.
        assert.ok(Math.hypot(...minus(drawn, at)) <= Math.hypot(...way) + 1e-6);
        continue;
      }
      assert.ok(Math.hypot(...minus(drawn, wanted)) < 2, `${grip} is ${Math.hypot(...minus(drawn, wanted)).toFixed(2)} px from the pointer`);
      followed += 1;
    }
  }
  assert.ok(followed > 1500, `${followed} followed`);
  assert.ok(endOn > 10, `${endOn} seen end-on`);
});

test("no two handles lie upon each other in the lab's pictures", () => {
  const wrist = (x, y) => camera([x, y + 105, 365], [x, y + 45, 140], 461, [0, 1, 0]);
  for (const [name, matrix] of Object.entries({ ...LAB, wrist: wrist(40, -60), "wrist beside": wrist(-100, 0) })) {
    for (const pose of [[0, 0, 200, 0, 0], [0, 0, 0, 0, 0], [100, -80, 120, 0, 0]]) {
      const handles = handlesOf(matrix, pose, reachOf(matrix, pose, 85));
      assert.equal(handles.length, 6);
      handles.forEach((one, index) =>
        handles.slice(index + 1).forEach((other) => {
          const gap = Math.hypot(...minus(one.at, other.at));
          assert.ok(gap >= 24, `${one.grip} and ${other.grip} are ${gap.toFixed(0)} px apart in ${name} at ${pose}`);
        }),
      );
    }
  }
});

test("a cursor behind the camera or in it has no handles", () => {
  assert.equal(reachOf(LAB.x, [1700, 0, 760, 0, 0], 85), undefined);
  assert.equal(reachOf(LAB.x, [1590, 0, 757, 0, 0], 85), undefined);
});

test("a pixel is that of the nearest block whose outline it is within, or of the table", async () => {
  const { blockAt, tableAt } = await load("room/pick.ts");
  const matrix = matrixOf(camera([700, 0, 500], [0, 0, 0], 600));
  /** The edges of a cube on the table, corner by corner. */
  const cube = (x, y, size = 50) => ({ points: [0, size].flatMap((z) => [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([dx, dy]) => [x + (dx * size) / 2, y + (dy * size) / 2, z])) });
  const blocks = [cube(0, 0), cube(200, 100), cube(-60, 0)];
  const near = (one, other) => assert.ok(Math.hypot(one[0] - other[0], one[1] - other[1]) < 1e-6, `${one} ${other}`);
  for (const [index, place] of [[0, [0, 0, 50]], [1, [200, 100, 25]], [2, [-60, 0, 50]], [undefined, [200, -100, 0]]]) assert.equal(blockAt(matrix, blocks, project(matrix, place)), index, String(place));
  // Behind the nearer one the other is not seen.
  assert.equal(blockAt(matrix, [cube(-60, 0), cube(0, 0)], project(matrix, [24, 0, 40])), 1);
  assert.equal(blockAt(matrix, [{ points: [] }, { points: [[0, 0, 0]] }], project(matrix, [0, 0, 0])), undefined);
  near(tableAt(matrix, project(matrix, [120, -80, 0])), [120, -80]);
  // Beside the workspace, and above the horizon.
  assert.equal(tableAt(matrix, project(matrix, [-600, 0, 0])), undefined);
  assert.equal(tableAt(matrix, [320, -5000]), undefined);
});
