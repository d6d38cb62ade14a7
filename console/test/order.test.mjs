// What notices say of an order to stop or to let go that is over.
import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./bundle.mjs";

const { troublesOf } = await load("hub/order.ts");
const report = (more) => ({ order: "stop", top: "/", at: 0, devices: [], refused: [], newer: [], empty: [], denied: [], over: true, taken: true, missed: false, trying: [], ...more });
const device = (path, more) => ({ path, device: path.slice(1), ...more });

test("what needs nobody's attention is not a notice", () => {
  const well = ["measured", "not-measured", "unsaid"].map((rest, at) => device(`/${at}`, { word: "obeys", after: 5, rest }));
  assert.deepEqual(troublesOf(report({ devices: well })), []);
  assert.deepEqual(troublesOf(report({ order: "unstop", devices: [device("/a", { after: 5, rest: "moving" })] })), []);
});

test("an order has one notice for all places of which the same is said", () => {
  const failure = { kind: "refused", code: "denied", text: "you may not", content: {} };
  const devices = [device("/a", { word: "silent" }), device("/b", { word: "silent" }), device("/c", { word: "lost" }), device("/d", { word: "obeys", after: 5, rest: "moving" }), device("/e", { word: "obeys", after: 5, rest: "measured" })];
  const newer = [{ path: "/f", number: 2, by: "bob", reason: "smoke\u202e", only: [] }];
  const found = troublesOf(report({ devices, newer, refused: [{ path: "/g", failure }], empty: ["/h"], denied: ["/i", "/j"] }));
  assert.deepEqual(found.map(({ tone, text }) => `${tone} ${text}`), [
    "error Stop: /g: you may not",
    "error Stop: /a a and 1 more: has not confirmed",
    "error Stop: /c c: its connection is lost: it gets the stop when it comes back",
    "error Stop: /d d: obeys, and is moving",
    "error Stop: /f: stays stopped: bob stopped it again: smoke\\u{202e}",
    "warning Stop: /h: there is no device here",
    "warning Stop: /i and 1 more: you may not stop it",
  ]);
  assert.equal(found[0].failure, failure);
});

test("an order that nobody has taken, or that reaches none, is told", () => {
  assert.deepEqual(troublesOf(report({ taken: false, top: "/robot" })), [{ tone: "error", text: "Stop: /robot: NOT CONFIRMED: the hub has not answered" }]);
  assert.deepEqual(troublesOf(report({})), [{ tone: "warning", text: "Stop: /: no device here obeys stop" }]);
});
