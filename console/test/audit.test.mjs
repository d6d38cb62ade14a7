import assert from "node:assert/strict";
import { before, test } from "node:test";
import { load } from "./bundle.mjs";

let facts;
let logs;
before(async () => {
  facts = await load("panels/audit/facts.ts");
  logs = await load("panels/audit/log.svelte.ts");
});

test("a fact is written as the log writes it", () => {
  const { factOf, jsonLine, jsonLines } = facts;
  const fact = factOf({ fence: 1882461516595201n, what: "granted", later: 1, seq: 12, at: new Date(0), peer: "ally" });
  assert.equal(jsonLine(fact), '{"at":"1970-01-01T00:00:00.000Z","seq":12,"what":"granted","peer":"ally","fence":1882461516595201,"later":1}');
  assert.equal(jsonLines([fact, fact]).split("\n").length, 3);
});

test("a fence is told by its lower 20 bits", () => {
  assert.equal(facts.lower(1882461516595201), String(1882461516595201 % 2 ** 20));
  assert.equal(facts.lower(5n), "5");
});

test("filters become what the hub is asked", () => {
  const { EMPTY, contentOf, filterOf, isOver } = facts;
  assert.deepEqual(contentOf(EMPTY, 0), {});
  const now = Date.UTC(2026, 10, 24);
  const filter = { ...EMPTY, user: " bob ", what: "refused,granted", quick: "1h", until: "2026-11-24T01:00" };
  assert.deepEqual(contentOf(filter, now), { user: "bob", what: ["refused", "granted"], since: new Date(now - 3_600_000) });
  assert.deepEqual(contentOf({ ...EMPTY, what: "lost" }, now), { what: "lost" });
  const own = filterOf((key) => ({ since: "2026-11-24T01:00:00Z", until: "nonsense" })[key] ?? "");
  assert.equal(own.quick, "own");
  assert.deepEqual(contentOf(own, now), { since: new Date("2026-11-24T01:00:00Z") });
  assert.equal(isOver({ ...EMPTY, quick: "own", until: "2026-11-23T00:00:00Z" }, now), true);
  assert.equal(isOver({ ...EMPTY, quick: "own", until: "2026-11-25T00:00:00Z" }, now), false);
});

test("a fact leads to the question that it answers", () => {
  const { explainable, factOf } = facts;
  const asked = (value) => explainable(factOf(value));
  assert.deepEqual(asked({ what: "refused", verb: "send", message: "command", context: "/robot/arm", user: "bob" }), { path: "/robot/arm", user: "bob", verb: "send", message: "command" });
  assert.deepEqual(asked({ what: "granted", context: "/t", user: "bob" }), { path: "/t", user: "bob", verb: "grab", message: undefined });
  assert.equal(asked({ what: "refused", verb: "login", context: "/" }), undefined);
  assert.equal(asked({ what: "refused", verb: "grab" }), undefined);
});

/** A hub with a log of so many facts, which reads so many of them for each request. */
function hubWith(count, reads = Infinity) {
  const hub = {
    isUp: true,
    asked: [],
    facts: Array.from({ length: count }, (_, index) => ({ seq: index + 1, what: index % 100 ? "login" : "refused" })),
    hubTime: () => 1000,
    async call(_ask, _family, _name, _path, content) {
      hub.asked.push(content);
      const all = hub.facts.filter(({ seq }) => (content.before === undefined || seq < content.before) && (content.after === undefined || seq > content.after)).reverse();
      const read = all.slice(0, reads);
      const fits = read.filter(({ what }) => content.what === undefined || what === content.what);
      const told = fits.slice(0, content.most);
      const more = all.length > read.length || fits.length > told.length;
      const next = fits.length > told.length ? told.at(-1).seq : read.at(-1)?.seq;
      return { facts: told, latest: hub.facts.length, source: "file", ...(more ? { more: true, next } : {}) };
    },
  };
  return hub;
}

test("pages are read back in time until the beginning", async () => {
  const log = new logs.AuditLog(hubWith(450));
  await log.load(facts.EMPTY);
  assert.deepEqual([log.facts.length, log.facts[0].seq, log.more], [200, 450, true]);
  await log.older();
  await log.older();
  assert.deepEqual([log.facts.length, log.facts.at(-1).seq, log.more, log.topCut], [450, 1, false, false]);
});

test("parts of the log without a fact are read on", async () => {
  const hub = hubWith(2000, 150);
  const log = new logs.AuditLog(hub);
  await log.load({ ...facts.EMPTY, what: "refused" });
  assert.deepEqual([log.facts.length, log.more], [20, false]);
  assert.ok(hub.asked.length > 10);
});

test("following asks for what is new, and nothing comes twice", async () => {
  const hub = hubWith(10);
  const log = new logs.AuditLog(hub);
  await log.load(facts.EMPTY);
  assert.equal(await log.poll(), 0);
  hub.facts.push({ seq: 11, what: "login" }, { seq: 12, what: "gone" });
  assert.equal(await log.poll(), 2);
  assert.deepEqual(log.facts.slice(0, 3).map(({ seq }) => seq), [12, 11, 10]);
  assert.equal(await log.poll(), 0);
  assert.equal(hub.asked.at(-1).after, 12);
});

test("a flood of new facts is read in parts, and what is left between is read by going back", async () => {
  const hub = hubWith(10, 150);
  const log = new logs.AuditLog(hub);
  await log.load(facts.EMPTY);
  for (let seq = 11; seq <= 1000; seq += 1) hub.facts.push({ seq, what: "login" });
  assert.equal(await log.poll(), 300);
  while (log.more) await log.older();
  assert.deepEqual(log.facts.map(({ seq }) => seq), Array.from({ length: 1000 }, (_, index) => 1000 - index));
});

test("no more than so many are kept", async () => {
  const hub = hubWith(6000);
  const log = new logs.AuditLog(hub);
  await log.load(facts.EMPTY);
  while (log.more && !log.topCut) await log.older();
  assert.deepEqual([log.facts.length, log.topCut, await log.poll()], [logs.MOST, true, 0]);
  await log.load(facts.EMPTY);
  assert.deepEqual([log.topCut, log.facts[0].seq], [false, 6000]);
});

test("a refusal is shown, and an answer that comes too late is not", async () => {
  const hub = hubWith(10);
  const log = new logs.AuditLog(hub);
  const first = log.load(facts.EMPTY);
  const second = log.load({ ...facts.EMPTY, what: "refused" });
  await Promise.all([first, second]);
  assert.deepEqual(log.facts.map(({ what }) => what), ["refused"]);
  hub.call = async () => Promise.reject(new Error("you may not"));
  await log.load(facts.EMPTY);
  assert.deepEqual([log.failure.text, log.facts.length, log.busy], ["you may not", 0, false]);
});
