// What a page knows of tokens: one state of each, and what is asked, for all panels.
import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./bundle.mjs";
import { ARM, CART, MOUNT } from "./cards.mjs";

const { tokenOf, tokensOf } = await load("hub/token.svelte.ts");
const { kindOf } = await load("hub/kind.ts");
const { cardOf } = await load("hub/card.ts");

/** A hub of which a test says what it tells. */
function fakeHub(answers = {}) {
  const hub = {
    me: { peer: "alice", user: "alice", level: 1 },
    isUp: true,
    owned: new Map(),
    watches: [],
    notes: [],
    calls: [],
    watch(watch, handlers) {
      const one = { watch, handlers, ended: false };
      hub.watches.push(one);
      return () => (one.ended = true);
    },
    onAsked: (listener) => (hub.ask = (type, what, path = "/robot/token") => listener({ type, path, what, arrived: Date.now() })),
    onOwned: (listener) => (hub.own = listener),
    note: (tone, text) => hub.notes.push([tone, text]),
    call(name, ...args) {
      hub.calls.push([name, ...args]);
      return answers[name]?.(...args) ?? Promise.resolve({});
    },
  };
  return hub;
}

test("all that show a token share one state, which is asked for once and ends with the last of them", () => {
  const hub = fakeHub();
  const token = tokenOf(hub, "/robot/token");
  assert.equal(tokenOf(hub, "/robot/token"), token);
  const ends = [token.start(), token.start(), token.start()];
  assert.equal(hub.watches.length, 1);
  ends[0]();
  ends[1]();
  assert.equal(hub.watches[0].ended, false);
  ends[2]();
  assert.equal(hub.watches[0].ended, true);
});

test("who asks is known though nobody watches the token, with the reason, and is told once", async () => {
  const hub = fakeHub();
  const tokens = tokensOf(hub);
  hub.ask("requested", { peer: "bob", user: "bob", level: 1, within: 30_000, text: "the \u202ered one" });
  assert.deepEqual(tokens.asked.map(({ path, peer, text }) => [path, peer, text]), [["/robot/token", "bob", "the \u202ered one"]]);
  assert.deepEqual(hub.notes, [["warning", "bob asks you for /robot/token: the \\u{202e}red one"]]);
  // What this page asks itself it hears of as well.
  hub.ask("requested", { peer: "alice", user: "alice", level: 1, within: 30_000 });
  assert.equal(tokens.asked.length, 1);
  assert.equal(hub.watches.length, 0);
  await tokenOf(hub, "/robot/token").answer("bob", false);
  assert.deepEqual(hub.calls, [["declineRequest", "/robot/token", "bob"]]);
  assert.equal(tokens.asked.length, 0);
  hub.ask("offer", { by: "bob", to: "alice", within: 10_000, commands: 3 });
  hub.ask("offer", { by: "bob", to: "carol", within: 10_000 }, "/other/token");
  assert.deepEqual(tokens.offers.map(({ path, by, commands }) => [path, by, commands]), [["/robot/token", "bob", 3]]);
  hub.ask("lapsed", { what: "offer", by: "bob", to: "alice", reason: "timed-out" });
  assert.equal(tokens.offers.length, 0);
});

test("tokens that are lost for one reason are told together, and what was given back is none of them", async () => {
  const hub = fakeHub();
  tokensOf(hub);
  hub.own("/robot/token", null, "released", "alice");
  for (const unit of [1, 2, 3]) hub.own(`/fleet/${unit}/token`, null, "preempted", "carol");
  assert.match(tokenOf(hub, "/fleet/2/token").lost, /You lost \/fleet\/2\/token: carol has a higher level and took it/);
  while (!hub.notes.length) await new Promise((resolve) => setTimeout(resolve, 5));
  assert.deepEqual(hub.notes, [["warning", "You lost 3 tokens (/fleet/1/token and others): carol has a higher level and took it."]]);
});

test("who does not wait has no place in the queue", async (t) => {
  let grant;
  const hub = fakeHub({ grab: () => new Promise((resolve) => (grant = resolve)) });
  const token = tokenOf(hub, "/robot/token");
  t.after(token.start());
  const { handlers } = hub.watches[0];
  const queued = () => handlers.events([{ type: "queued", path: token.path, what: { place: 1 }, arrived: Date.now() }]);
  const waits = token.wait();
  queued();
  assert.equal(token.place, 1);
  grant({});
  await waits;
  // Events come in portions: this one is older than the answer.
  queued();
  assert.equal(token.place, undefined);
});

test("a grab is offered first only where it takes the token", (t) => {
  const hub = fakeHub();
  const token = tokenOf(hub, "/robot/token");
  t.after(token.start());
  const says = (info) => hub.watches[0].handlers.joined(info);
  const now = Date.now();
  assert.equal(token.grabbable(now), false, "nothing is known yet");
  for (const [info, takes] of [
    [{}, true],
    [{ owner: "bob", "owner-level": 1, "lease-left": 60_000 }, false],
    [{ owner: "bob", "owner-level": 0, "lease-left": 60_000 }, true],
    [{ owner: "bob", "owner-level": 1, "lease-left": -60_000 }, true],
    [{ owner: "bob", "owner-level": 1, "lease-left": null }, false],
    [{ holders: ["bob", "carol"] }, false],
  ]) {
    says(info);
    assert.equal(token.grabbable(now), takes, JSON.stringify(info));
  }
});

test("a device's kind is what it tells of itself, or what stands beside it", () => {
  const channels = ["/robot/arm", "/fleet/status", "/fleet/7/robot", "/cubo/robot", "/cubo/simulacrum", "/camera/pan"];
  for (const [path, state, kind, card] of [
    ["/robot/arm", { pose: { x: 1, y: 2, z: 3 } }, "arm"],
    ["/robot/arm", {}, undefined],
    ["/camera/pan", { pan: 0, tilt: 0 }, undefined],
    ["/fleet/7/robot", {}, "wheeled"],
    ["/rover/a/robot", { x: 1, y: 2, heading: 90 }, "wheeled"],
    ["/cubo/robot", {}, "mirrored"],
    ["/cubo/robot", { x: 1, y: 2, heading: 90 }, "mirrored"],
    ["/gate", { open: true }, undefined],
    ["/robot/arm", {}, "arm", ARM],
    ["/yard/crane", { pose: { x: 1, y: 2, z: 3 } }, "other", CART],
    ["/yard/crane", { x: 1, heading: 90 }, "other", CART],
    ["/camera/pan", { pan: 0, tilt: 0 }, "other", MOUNT],
    ["/cubo/robot", {}, "mirrored", CART],
    ["/fleet/7/robot", {}, "wheeled", CART],
  ]) assert.equal(kindOf(path, state, channels, card && cardOf(card)), kind, `${path} ${JSON.stringify(state)}`);
});
