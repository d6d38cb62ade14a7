// The order to stop and to let go, against a client that is none.
import assert from "node:assert/strict";
import { afterEach, before, test } from "node:test";
import { setTimeout as sleep } from "node:timers/promises";
import { load } from "./bundle.mjs";

let Stopping;
let Standing;
before(async () => {
  ({ Stopping } = await load("worker/stopping.ts"));
  ({ Standing } = await load("worker/standing.ts"));
});

/** Whose walks end with the test: the next one would keep its file from ending. */
let walking;
afterEach(() => walking?.end());

const told = (path, number, devices, more = {}) => ({ path, number, guarded: true, kept: true, devices, newer: [], ...more });
const stopped = (number, by, reason, only = []) => ({ number, stopped: true, by, reason, only });

/** A page's worker at a hub with these contexts, and what is asked of the hub and said to the page. */
function worker({ lists = { "/": [] }, answers = {} } = {}) {
  const asked = [];
  const words = [];
  const answer = (name) => async (...args) => {
    asked.push([name, ...args]);
    if (!(name in answers)) return { channels: [], others: 0, denied: [] };
    return typeof answers[name] === "function" ? answers[name](...args) : answers[name];
  };
  const client = { name: "alice", user: "alice", stop: answer("stop"), unstop: answer("unstop"), stops: answer("stops"), lookup: async () => ({}), list: async (path) => lists[path] ?? [], unaddressed: async function* () {} };
  const say = (word) => words.push(word);
  const standing = new Standing(say, () => true);
  const stopping = new Stopping(say, () => null, () => true, standing);
  stopping.reset(client);
  walking = standing;
  const shown = async () => {
    await sleep(60);
    return words.filter(({ word }) => word === "stops").at(-1)?.stops.map(({ path, number, by, reason }) => [path, number, by, reason]);
  };
  return { asked, words, stopping, standing, shown, lists, report: () => words.filter(({ word }) => word === "stop").at(-1).report };
}

test("STOP is one request, and its report says what stands, what is silent, what is lost and what is not there", async () => {
  const devices = [{ peer: "arm", word: "stopped" }, { peer: "hand", word: "silent" }, { peer: "eye", word: "lost" }];
  const { asked, stopping, report, shown } = worker({ answers: { stop: { channels: [told("/robot/arm", 7, devices), told("/belt", 9, [])], others: 3, denied: ["/secret"] } } });
  await stopping.order("stop", "/", { reason: "smoke" });
  assert.deepEqual(asked, [["stop", "/", { reason: "smoke" }]]);
  const { devices: found, empty, denied, over, taken } = report();
  assert.deepEqual(found.map(({ device, word }) => [device, word]), [["arm", "obeys"], ["hand", "silent"], ["eye", "lost"]]);
  assert.ok(found[0].after >= 0 && found[1].after === undefined);
  assert.deepEqual([empty, denied, over, taken], [["/belt"], ["/secret"], true, true]);
  // Until the hub lists them.
  assert.deepEqual(await shown(), []);
});

test("what holds is known from lists, and who said it, and from what is heard", async () => {
  const lists = { "/": [{ path: "/robot", kind: "session" }], "/robot": [{ path: "/robot/arm", kind: "channel", stop: stopped(5, "bob", "smoke") }, { path: "/robot/eye", kind: "channel" }] };
  const { standing, shown } = worker({ lists });
  assert.deepEqual(await shown(), [["/robot/arm", 5, "bob", "smoke"]]);
  const message = (name, stop, content, more = {}) => ({ type: "message", name, stop, content, sender: "carol", history: false, parcel: {}, ...more });
  standing.heard("/robot/arm", message("stop", 6, "fire"));
  standing.heard("/robot/arm", message("stop", 4, "of before"));
  standing.heard("/robot/eye", message("stop", 3, { by: "dave", reason: "dark" }, { sender: "hub" }));
  assert.deepEqual(await shown(), [["/robot/arm", 6, "carol", "fire"], ["/robot/eye", 3, "dave", "dark"]]);
  standing.heard("/robot/arm", message("unstop", 5));
  standing.heard("/robot/eye", message("unstop", 3));
  assert.deepEqual(await shown(), [["/robot/arm", 6, "carol", "fire"]]);
  standing.heard("/robot/arm", { type: "stops", path: "/robot/arm", state: { number: 6, stopped: false, only: [] } });
  assert.deepEqual(await shown(), []);
});

test("only what the page has shown is let go, and a newer stop is told with who and why", async () => {
  const newer = [{ ...stopped(8, "bob", "a hand is in it"), only: [] }];
  const lists = { "/": [{ path: "/arm", kind: "channel", stop: stopped(8, "bob", "a hand is in it") }] };
  const { asked, stopping, report, shown } = worker({ lists, answers: { unstop: { channels: [told("/arm", 7, [], { newer })], others: 0, denied: [] } } });
  await stopping.order("unstop", "/", { stops: { "/arm": 7 } });
  assert.deepEqual(asked, [["unstop", "/", { "/arm": 7 }, {}]]);
  assert.deepEqual(report().newer.map(({ path, number, by, reason }) => [path, number, by, reason]), [["/arm", 8, "bob", "a hand is in it"]]);
  assert.deepEqual(await shown(), [["/arm", 8, "bob", "a hand is in it"]]);
  // One channel by its own number.
  await stopping.order("unstop", "/arm", { stops: { "/arm": 8 } });
  assert.deepEqual(asked.at(-1), ["unstop", "/arm", 8, {}]);
  await stopping.order("unstop", "/other", { stops: {} });
  assert.equal(asked.length, 2, "nothing is known there");
});

test("one robot of a fleet: what was not shown is shown first", async () => {
  const { asked, stopping, shown } = worker({ answers: { stops: stopped(4, "bob", "smoke"), unstop: { channels: [told("/r", 4, [{ peer: "r", word: "unstopped" }])], others: 0, denied: [] } } });
  await assert.rejects(stopping.one("unstop", "/r", { stops: {} }), /bob has stopped it: smoke/);
  await stopping.one("unstop", "/r", { stops: { "/r": 4 } });
  assert.deepEqual(asked, [["stops", "/r"], ["unstop", "/r", 4, { within: 0 }]]);
  assert.deepEqual(await shown(), []);
});

test("a large hub is let go in several requests", async () => {
  const { asked, stopping } = worker();
  const stops = Object.fromEntries(Array.from({ length: 900 }, (_, at) => [`/r/${at}`, 1]));
  await stopping.order("unstop", "/", { stops });
  assert.deepEqual(asked.map(([, , numbers]) => Object.keys(numbers).length), [400, 400, 100]);
});
