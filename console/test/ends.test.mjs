// What a stop ends in the page: what is under way for its place, and nothing else.
import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./bundle.mjs";

const { OrderedStops } = await load("worker/ordered.ts");
const { FleetDriver } = await load("panels/fleet/driver.svelte.ts");
const { AgentTask } = await load("panels/objects/agent.svelte.ts");

/** A page's hub: what it asks of the worker waits until the test answers it. */
function hubOf(stops = []) {
  const ordered = new OrderedStops();
  const listeners = new Set();
  const asked = [];
  return {
    stops,
    me: { peer: "alice" },
    asked,
    owned: new Map(),
    call: (name, ...args) => new Promise((resolve) => asked.push({ name, args, resolve })),
    watch: () => () => undefined,
    note: () => undefined,
    stopsOrdered: (path) => ordered.count(path),
    onStop: (listener) => (listeners.add(listener), () => listeners.delete(listener)),
    stop(top = "/") {
      ordered.add(top);
      for (const listener of listeners) listener(top);
    },
    stopEach: (paths) => paths.map((path) => (asked.push({ name: "stopOne", args: ["stop", path] }), Promise.resolve())),
  };
}

/** What follows from what was answered has been done. */
const settled = () => new Promise((resolve) => setImmediate(resolve));

const UNITS = Array.from({ length: 300 }, (_, at) => at + 1);
const pathOf = (unit) => `/fleet/${unit}/robot`;
const driverOf = (hub) => new FleetDriver(hub, { path: "/fleet/status", robots: new Map() });

test("a stop is one of its place and of all below", () => {
  const stops = new OrderedStops();
  stops.add("/");
  stops.add("/fleet/3");
  stops.add("/fleet/3/robot");
  assert.deepEqual(["/", "/robot/arm", "/fleet", "/fleet/3", "/fleet/3/robot", "/fleet/31/robot"].map((path) => stops.count(path)), [1, 1, 1, 2, 3, 1]);
  assert.ok(Date.now() - stops.newest("/robot/arm") < 1000);
  assert.equal(new OrderedStops().newest("/robot"), undefined);
});

test("robots of a batch that were not let go before STOP was pressed stay stopped, and the others by the stops that were shown", async () => {
  const hub = hubOf(UNITS.map((unit) => ({ path: pathOf(unit), number: 5 })));
  const driver = driverOf(hub);
  const all = driver.free(hub.stops);
  assert.equal(hub.asked.length, 16);
  hub.stop();
  // The page knows of the new stops at once.
  hub.stops = UNITS.map((unit) => ({ path: pathOf(unit), number: 6 }));
  for (const { resolve } of hub.asked) resolve();
  await settled();
  assert.equal(await all, false);
  assert.equal(hub.asked.length, 16, "nothing more was sent");
  assert.ok(hub.asked.every(({ args: [, path, { stops }] }) => stops[path] === 5), "none names the stop that was pressed later");
  assert.deepEqual(driver.refused.map(({ units, failure }) => [units.length, failure.text]), [[284, "STOP was pressed."]]);
});

test("a stop elsewhere lets a batch go on", async () => {
  const hub = hubOf(UNITS.map((unit) => ({ path: pathOf(unit), number: 5 })));
  const driver = driverOf(hub);
  const all = driver.free(hub.stops.slice(0, 2));
  hub.stop("/robot/arm");
  for (const { resolve } of hub.asked) resolve();
  assert.equal(await all, true);
});

test("robots are stopped all at once, not one behind the other", () => {
  const hub = hubOf();
  void driverOf(hub).stop(UNITS);
  assert.equal(hub.asked.length, 300);
});

test("an agent that was asked before STOP is not lent the token after it", async () => {
  const hub = hubOf();
  let heard;
  hub.watch = (_, handlers) => ((heard = handlers.events), () => undefined);
  const task = new AgentTask(hub, "/servo", "align", {});
  task.start();
  void task.begin({}, "/robot/token", { for: 1000 });
  hub.asked[0].resolve({ id: 1, delivered: 1 });
  await settled();
  hub.stop();
  assert.equal(task.phase, "over");
  heard([{ type: "message", name: "progress", history: false, content: { state: "accepted", by: "alice", agent: "servo" } }]);
  await settled();
  assert.deepEqual(hub.asked.map(({ name, args }) => [name, args[1]]), [["send", "align"], ["send", "cancel"]]);
});
