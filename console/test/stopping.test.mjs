// The order to stop and to let go, against a client that is none.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
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
const walking = new Set();
afterEach(() => {
  for (const one of walking) one.end();
  walking.clear();
});

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
  walking.add(standing);
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
  assert.deepEqual(asked, [["stop", "/", { within: 3000, reason: "smoke" }]]);
  const { devices: found, empty, denied, over, taken } = report();
  assert.deepEqual(found.map(({ device, word }) => [device, word]), [["arm", "obeys"], ["hand", "silent"], ["eye", "lost"]]);
  assert.ok(found[0].after >= 0 && found[1].after === undefined);
  assert.deepEqual([empty, denied, over, taken], [["/belt"], ["/secret"], true, true]);
  // Until the hub lists them.
  assert.deepEqual(await shown(), []);
});

test("a device that obeys is not said to stand before it rests, by the hub's answer and by its own states, whichever comes first", async () => {
  const devices = [{ peer: "arm", word: "stopped", rest: "measured" }, { peer: "cart", word: "stopped", moving: true }, { peer: "belt", word: "stopped", moving: true, reached: false }, { peer: "old", word: "stopped" }];
  const { stopping, report } = worker({ answers: { stop: { channels: [told("/r", 7, devices)], others: 0, denied: [] } } });
  const ordered = stopping.order("stop", "/", {});
  const state = (device, said, since) => stopping.heard("/r", device, { stopped: true, ...said }, since);
  state("cart", { moving: false, reached: true, rest: "not-measured" });
  state("belt", { moving: true, reached: false }, 1000);
  await ordered;
  const known = () => Object.fromEntries(report().devices.map(({ device, rest, since }) => [device, since === undefined ? rest : [rest, since]]));
  // What it has said itself is not older than the answer.
  assert.deepEqual(known(), { arm: "measured", cart: "not-measured", belt: ["unreached", 1000], old: "unsaid" });
  const [cart] = report().devices.filter(({ device }) => device === "cart");
  state("cart", { moving: false, reached: true, rest: "not-measured" });
  assert.equal(report().devices.find(({ device }) => device === "cart").told, cart.told, "when it came to rest, not when it said so again");
  state("belt", { moving: false, reached: true });
  state("arm", { moving: true, reached: true });
  assert.deepEqual(known(), { arm: "moving", cart: "not-measured", belt: "unknown", old: "unsaid" });
});

test("what follows from a device's state, and from the hub's answer, is the same, and that of all clients", async () => {
  const { restOf, isWell } = await load("worker/rest.ts");
  const cases = JSON.parse(readFileSync(new URL("../../tests/cases/answers.json", import.meta.url), "utf8")).filter(({ answer }) => answer.word === "stopped");
  assert.ok(cases.length >= 8);
  for (const { name, says, answer, obeyed } of cases) assert.deepEqual([isWell(restOf(says)), isWell(restOf(answer))], [obeyed, obeyed], name);
});

test("of channels whose stops the page has not heard of the hub is asked", async () => {
  const { asked, standing, shown } = worker({ answers: { stops: async (path) => { if (path === "/gone") throw new Error("no such path"); return path === "/free" ? { number: 3, stopped: false, only: [] } : stopped(4, "bob", "smoke"); } } });
  const found = await standing.ask(["/r", "/free", "/gone"]);
  assert.deepEqual(found.map(({ path, number, by, reason }) => [path, number, by, reason]), [["/r", 4, "bob", "smoke"]]);
  assert.equal(asked.length, 3);
  assert.deepEqual(await shown(), [["/r", 4, "bob", "smoke"]]);
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
  await assert.rejects(stopping.one("unstop", "/r", { stops: {} }), /bob stopped it: smoke/);
  await stopping.one("unstop", "/r", { stops: { "/r": 4 } });
  assert.deepEqual(asked, [["stops", "/r"], ["unstop", "/r", 4, {}]]);
  assert.deepEqual(await shown(), []);
});

test("a large hub is let go in several requests", async () => {
  const { asked, stopping } = worker();
  const stops = Object.fromEntries(Array.from({ length: 900 }, (_, at) => [`/r/${at}`, 1]));
  await stopping.order("unstop", "/", { stops });
  assert.deepEqual(asked.map(([, , numbers]) => Object.keys(numbers).length), [400, 400, 100]);
});

/** Waits until something holds, for five seconds at most. */
async function until(what) {
  for (const end = performance.now() + 5000; !what(); ) {
    assert.ok(performance.now() < end, `waited for ${what}`);
    await new Promise((resolve) => setImmediate(resolve));
  }
}

/** A client that is silent: nothing is ever answered. */
const silent = () => ({ name: "alice", user: "alice", ...Object.fromEntries(["stop", "unstop", "stops", "lookup", "list"].map((name) => [name, () => new Promise(() => undefined)])), unaddressed: async function* () {} });

/** A page's worker whose link is silent, and what is said over the second connection, which opens if `opens` says so. */
function around({ opens = async () => undefined, up = true } = {}) {
  const asked = [];
  const words = [];
  const client = { ...silent(), stop: async (top, terms) => (asked.push([top, terms]), { channels: [told("/robot/arm", 7, [{ peer: "arm", word: "stopped" }])], others: 0, denied: [] }), lookup: async () => ({}) };
  const standing = new Standing((word) => words.push(word), () => up);
  const login = { address: "ws://hub http://hub", guest: true };
  const lend = async (of, within, unneeded, use) => {
    assert.equal(of, login);
    await opens();
    await use(client);
  };
  const stopping = new Stopping((word) => words.push(word), () => login, () => up, standing, lend, [10, 10]);
  const link = silent();
  stopping.reset(link);
  walking.add(standing);
  return { asked, words, stopping, link, report: () => words.filter(({ word }) => word === "stop").at(-1).report };
}

test("a stop that the link does not take goes over a second connection after 300 ms, and is over with its answer", async () => {
  const { asked, stopping, report } = around();
  const begun = performance.now();
  await stopping.order("stop", "/", { reason: "smoke" });
  assert.ok(performance.now() - begun >= 295, "the link has its time");
  assert.deepEqual(asked, [["/", { within: 3000, reason: "smoke" }]]);
  const { taken, over, trying, devices } = report();
  assert.deepEqual([taken, over, trying, devices.map(({ device, word }) => [device, word])], [true, true, [], [["arm", "obeys"]]]);
});

test("a link that is known to be down is not waited for", async () => {
  let opened = 0;
  const { asked, stopping } = around({ up: false, opens: async () => void (opened = performance.now()) });
  const begun = performance.now();
  await stopping.order("stop", "/", {});
  assert.ok(opened - begun < 250, `${opened - begun} ms`);
  assert.equal(asked.length, 1);
});

test("a connection that hangs is followed by another one", async () => {
  let tries = 0;
  const { asked, stopping, report } = around({ opens: () => (++tries < 3 ? new Promise(() => undefined) : Promise.resolve()) });
  await stopping.order("stop", "/", {});
  assert.deepEqual([tries, asked.length, report().taken], [3, 1, true]);
});

test("what the link takes while the second connection opens is not said again", async () => {
  let take;
  const { asked, stopping, link, report } = around({ opens: () => (take(), new Promise((resolve) => setImmediate(resolve))) });
  const answer = new Promise((resolve) => (take = () => resolve({ channels: [], others: 0, denied: [] })));
  link.stop = () => answer;
  await stopping.order("stop", "/", {});
  assert.deepEqual([asked, report().taken], [[], true]);
});

test("stops of single channels go around the link each, and one that nobody takes is said to be so", async () => {
  const { asked, stopping } = around();
  await Promise.all(["/a", "/b", "/c"].map((path) => stopping.one("stop", path, {})));
  assert.deepEqual(asked.map(([path]) => path), ["/a", "/b", "/c"]);
  const shut = around({ opens: async () => Promise.reject(new Error("no door opened")) });
  shut.link.stop = shut.link.lookup = async () => Promise.reject(new Error("lost"));
  await assert.rejects(shut.stopping.one("stop", "/a", {}), /NOT CONFIRMED: the hub has not accepted the order for \/a/);
  await shut.stopping.order("stop", "/", {});
  assert.deepEqual([shut.report().taken, shut.report().over], [false, true]);
  // The link may still be silent when every way has been tried: it is not confirmed all the while.
  const dumb = around({ opens: async () => Promise.reject(new Error("no door opened")) });
  void dumb.stopping.order("stop", "/", {});
  await until(() => dumb.report().missed && !dumb.report().trying.length);
  assert.deepEqual([dumb.report().taken, dumb.report().over], [false, false]);
});

test("a user logged in by any proof can open the second connection", async () => {
  const { proofOf } = await load("worker/session.ts");
  const { privateKey } = await crypto.subtle.generateKey({ name: "Ed25519" }, false, ["sign", "verify"]);
  const address = "ws://hub";
  assert.deepEqual(proofOf({ address, user: "alice", password: "secret" }), { user: "alice", password: "secret" });
  assert.deepEqual(proofOf({ address, guest: true }), { guest: true });
  assert.deepEqual(proofOf({ address, token: "a.b.c" }), { token: "a.b.c" });
  const { user, key } = proofOf({ address, user: "alice", key: privateKey });
  assert.deepEqual([user, key.key], ["alice", privateKey]);
});
