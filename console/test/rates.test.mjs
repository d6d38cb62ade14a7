import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./bundle.mjs";

const { sampleOf, ratesBetween, channelRates, percentile, spread } = await load("hub/rates.ts");
const { History } = await load("hub/history.ts");

const answer = (sent, peers, extra = {}) => ({
  path: "/", kind: "session",
  channels: [{ path: "/chat", number: 2, members: 3, sent, bytes: sent * 10, delivered: sent * 2, dropped: { rate: sent / 2, expired: 0 }, age: { count: 4, p50: 120, p99: 4000, most: 5000 } }],
  peers, ...extra,
});
const peer = (name, more) => ({ peer: name, user: name, form: "binary", door: "tcp", tls: false, since: new Date(5), heard: 2_400_000, queued: 1, sent: 0, received: 0, dropped: 0, ...more });

test("an answer is read with its units", () => {
  const sample = sampleOf(answer(10, [peer("alice", { "round-trip": 420, from: "127.0.0.1" })], { memory: { used: 5, bound: 9, users: [{ user: "alice", bytes: 5 }] }, "more-peers": 4 }), 0);
  const [channel] = sample.channels;
  assert.deepEqual([channel.path, channel.members, channel.counts.dropped, channel.counts.reasons], ["/chat", 3, 5, [["rate", 5]]]);
  assert.deepEqual(channel.counts.age, { count: 4, p50: 0.12, p99: 4, most: 5 });
  assert.deepEqual([sample.peers[0].silent, sample.peers[0].roundTrip, sample.peers[0].since, sample.morePeers], [2400, 0.42, 5, 4]);
  assert.deepEqual(sample.memory, { used: 5, bound: 9, users: [{ user: "alice", bytes: 5 }] });
});

test("a channel's answer has its members", () => {
  const sample = sampleOf({ path: "/chat", kind: "channel", sent: 3, peers: [{ peer: "bob", user: "bob", delivered: 2 }] }, 0);
  assert.deepEqual([sample.channels.length, sample.peers.length, sample.members[0].counts.delivered], [1, 0, 2]);
});

test("nonsense is not an error", () => {
  const sample = sampleOf({ channels: [3, null, { dropped: [1] }], peers: "x", memory: 7 }, 0);
  assert.deepEqual([sample.channels.length, sample.peers.length, sample.memory], [3, 0, undefined]);
});

test("rates are of those that were here before, as in mom top", () => {
  const before = sampleOf(answer(0, [peer("alice", { received: 1000 })]), 0);
  const now = sampleOf(answer(20, [peer("alice", { received: 3000, sent: 500 }), peer("bob", { received: 2 ** 30 })]), 2000);
  assert.deepEqual(ratesBetween(before, now), { messages: 10, delivered: 20, dropped: 5, received: 1000, sent: 250 });
  assert.deepEqual(channelRates(before, now).get("/chat"), { messages: 10, bytes: 100, delivered: 20, dropped: 5 });
});

test("a peer of the same name that has logged in anew is another one, and counts that began anew are no rates", () => {
  const before = sampleOf(answer(100, [peer("alice", { received: 5000 })]), 0);
  const now = sampleOf(answer(10, [peer("alice", { received: 9000, since: new Date(9) })]), 1000);
  const rates = ratesBetween(before, now);
  assert.deepEqual([rates.messages, rates.received], [0, 0]);
});

test("percentiles", () => {
  const hundred = Array.from({ length: 100 }, (_, index) => index + 1);
  assert.deepEqual([percentile(hundred, 50), percentile(hundred, 99), percentile(hundred, 100), percentile([], 50), percentile([7], 99)], [50, 99, 100, undefined, 7]);
  assert.deepEqual(spread([3, undefined, 1, 2]), { count: 3, p50: 2, p99: 3, most: 3 });
  assert.equal(spread([undefined, Number.NaN]), undefined);
});

test("a history is bounded, and breaks its lines where nothing was known", () => {
  const history = new History(4, 3000);
  history.push(1000, { one: 1 });
  history.push(2000, { one: 2, two: 5 });
  assert.deepEqual(history.column("two"), [null, 5]);
  history.push(9000, { one: 3 });
  assert.deepEqual(history.times, [1, 2, 2.001, 9]);
  assert.deepEqual(history.column("one"), [1, 2, null, 3]);
  history.push(10_000, { one: 4 });
  history.push(11_000, { one: 4 });
  history.push(12_000, { one: 4 });
  assert.equal(history.times.length, 4);
  assert.deepEqual(history.column("two"), [null, null, null, null]);
  history.push(500, { one: 9 });
  assert.deepEqual([history.times, history.column("one")], [[0.5], [9]]);
});
