import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { load } from "./bundle.mjs";

const { read, write, quoted, commandOf, LONGEST_FILE } = await load("panels/modeller/file.ts");
const { check, countOf, rangeOf, listOf, numberOf, wholeOf } = await load("panels/modeller/check.ts");
const { packetSize, payloadSize, blank, moved, nextKey, emptyDraft, hasField, FIELDS } = await load("panels/modeller/model.ts");
const { draftOf } = await load("panels/modeller/kept.ts");
const { Generator, PATIENCE, linesOf } = await load("panels/modeller/generator.svelte.ts");
const { plain } = await load("worker/plain.ts");

const file = (name) => readFileSync(new URL(`../../config/${name}`, import.meta.url), "utf8");
const cubo = (await read(file("cubo.toml"))).draft;
const MOTION = ["left-wheel", "right-wheel", "joints", "lips"];

/** A model with these elements, and what is wrong in it: by element and field, `largest` of the model and so on. */
function mistakes(elements, model = {}) {
  const draft = { ...emptyDraft(), ...model, elements: elements.map((element, index) => blank(index + 1, element)) };
  const checked = check(draft);
  return { ...checked, at: (place, field) => checked.elements[place][field] };
}

const wheel = { name: "wheel", kind: "effector", type: "i16" };

test("CUBO has no mistakes, and its packets are as large as the paper says (S26)", () => {
  const { count, payloads, period } = check(cubo);
  assert.deepEqual([count, period, payloads.length], [0, 20, 16]);
  const of = (names) => packetSize(payloads, "down", (place) => names.includes(cubo.elements[place].name));
  assert.equal(of(MOTION), 34);
  assert.equal(of([...MOTION, "speaker"]), 1992);
  assert.equal(packetSize(payloads, "down"), 1999);
  assert.equal(packetSize(payloads, "up"), 700);
  assert.deepEqual(cubo.elements.flatMap(({ name }, place) => (payloads[place].isBlob ? [name] : [])), ["lcd", "camera"]);
});

test("each kind has its payloads in both directions (S5)", () => {
  for (const [kind, down, up] of [["effector", 4, 0], ["sensor", 0, 4], ["monitor", 0, 4], ["command", 5, 1], ["memory-command", 5, 1], ["event", 1, 5], ["memory-event", 1, 7], ["module", 0, 0]]) {
    const payload = { kind, data: 4, isBytes: false, isBlob: false };
    assert.deepEqual([payloadSize(payload, "down"), payloadSize(payload, "up")], [down, up], kind);
  }
  // The length of bytes and that of a memory event are one.
  assert.equal(payloadSize({ kind: "memory-event", data: 2 + 100, isBytes: true, isBlob: false }, "up"), 103);
});

test("a model that is written reads as the same model", async () => {
  const again = await read(write(cubo));
  assert.deepEqual(again.draft, cubo);
  const odd = { ...emptyDraft(), name: "odd", id: "300", doc: 'Says "hallo" \\ ü\n\u007f', watchdog: "0", elements: [
    blank(1, { name: "a", kind: "effector", type: "f32", count: "3", unit: "m/s^2", scale: "0.5", range: "-1.5..1e3", safe: "0, 1, 2", rate: "2.5", motion: "interpolated" }),
    blank(2, { name: "b", kind: "effector", type: "i32", count: "x, y", unit: "mm, ", range: "-1..1, -2..2", motion: "incremental" }),
    blank(3, { name: "c", kind: "monitor", of: "a", period: "20" }),
    blank(4, { name: "d", kind: "module", members: "a, b" }),
    blank(5, { name: "e", kind: "command", lasts: "1500" }),
    blank(6, { name: "f", kind: "event", type: "bytes", max: "7" }),
  ] };
  assert.equal(check(odd).count, 0, JSON.stringify(check(odd).elements));
  const { draft } = await read(write(odd));
  assert.deepEqual({ ...draft, period: "", largest: "" }, { ...odd, id: "0x12c", elements: [{ ...odd.elements[0], range: "-1.5..1000" }, ...odd.elements.slice(1)] });
  assert.equal(write(draft), write({ ...odd, id: "0x12c" }));
  assert.match(write(odd), /^range = \[\[-1, 1\], \[-2, 2\]\]$/m);
  assert.equal(quoted("a\u007f\n"), '"a\\u007f\\n"');
});

test("a file that is not a model is refused with its place, and what is not known in it is told", async () => {
  assert.match((await read('name = "a"\nid = = 1')).mistake, /^Not valid TOML, line 2, column 6: /);
  assert.match((await read("element = 3")).mistake, /\[\[element\]\]/);
  assert.match((await read("#".repeat(LONGEST_FILE + 1))).mistake, /larger than/);
  const { draft, notes } = await read('name = "a"\nid = 2024-01-01\ncolour = 1\n# hm\n[[element]]\nname = "w"\nkind = "effectr"\nspeed = 3\nrange = [1]\nparts = ["a", "b"]\ncount = 3\nmotion = "incremental"\ninterpolate = true\n');
  assert.equal(notes.length, 5);
  assert.match(notes.join("\n"), /“colour”.*\n.*“speed” of w.*\n.*parts.*\n.*interpolated.*\n.*Comments/);
  const { model, elements } = check(draft);
  assert.match(model.id, /whole number from 0 to 65535/);
  assert.match(elements[0].kind, /“effectr”/);
  assert.deepEqual((await read("")).draft.elements, []);
});

test("each mistake stands at its field", () => {
  for (const [element, field, words] of [
    [{ ...wheel, name: "" }, "name", /missing/],
    [{ ...wheel, name: "Left" }, "name", /not a name/],
    [{ ...wheel, name: "a--b" }, "name", /not a name/],
    [{ ...wheel, type: "" }, "type", /missing/],
    [{ ...wheel, type: "u64" }, "type", /“u64”/],
    [{ ...wheel, count: "0" }, "count", /1 to 65535/],
    [{ ...wheel, count: "x, x" }, "count", /Two parts/],
    [{ ...wheel, count: "x, Y" }, "count", /“Y” is not a name/],
    [{ ...wheel, unit: "m s" }, "unit", /not a unit/],
    [{ ...wheel, count: "3", unit: "m, s" }, "unit", /2 values for 3 numbers/],
    [{ ...wheel, scale: "0" }, "scale", /1e-12/],
    [{ ...wheel, range: "5" }, "range", /not a range/],
    [{ ...wheel, range: "5..1" }, "range", /reversed/],
    [{ ...wheel, range: "0..40000" }, "range", /i16 holds -32768 to 32767/],
    [{ ...wheel, range: "5..9" }, "safe", /set a safe value/],
    [{ ...wheel, range: "5..9", safe: "4" }, "safe", /4 is outside/],
    [{ ...wheel, safe: "x" }, "safe", /not a number/],
    [{ ...wheel, motion: "incremental", safe: "1" }, "safe", /incremental/],
    [{ ...wheel, rate: "0" }, "rate", /more than 0/],
    [{ ...wheel, count: "2", scale: "1, 2", rate: "5" }, "rate", /several scales/],
    [{ ...wheel, motion: "jumping" }, "motion", /“jumping”/],
    [{ ...wheel, kind: "sensor", rate: "5" }, "rate", /A sensor has none/],
    [{ ...wheel, kind: "sensor", period: "70000" }, "period", /0 to 60000/],
    [{ ...wheel, period: "20" }, "period", /An effector has none/],
    [{ ...wheel, lasts: "20" }, "lasts", /An effector has none/],
    [{ name: "wave", kind: "command", lasts: "70000" }, "lasts", /0 to 60000/],
    [{ ...wheel, type: "bytes" }, "max", /missing/],
    [{ ...wheel, type: "bytes", max: "9", unit: "mm" }, "unit", /not to bytes/],
    [{ ...wheel, max: "9" }, "max", /Only bytes/],
    [{ name: "e", kind: "event", unit: "mm" }, "unit", /choose a type/],
    [{ name: "m", kind: "monitor" }, "of", /missing/],
    [{ name: "m", kind: "monitor", of: "x" }, "of", /no element “x”/],
    [{ name: "m", kind: "monitor", of: "m" }, "of", /m is not one/],
    [{ name: "m", kind: "module" }, "members", /missing/],
    [{ name: "m", kind: "module", members: "x" }, "members", /no element/],
    [{ name: "m", kind: "module", members: "m" }, "members", /cannot contain modules/],
    [{ ...wheel, doc: "x".repeat(4097) }, "doc", /4096/],
  ]) assert.match(mistakes([element]).at(0, field) ?? "", words, JSON.stringify(element));
  assert.equal(mistakes([{ ...wheel, range: "-327680..327670", scale: "10" }]).count, 0);
  assert.match(mistakes([wheel, wheel]).at(1, "name"), /Two elements/);
  assert.match(mistakes([{ ...wheel, name: "a1" }, { ...wheel, name: "a-1" }]).at(1, "name"), /same name for a1/);
  const two = [wheel, { name: "m", kind: "module", members: "wheel, wheel" }, { name: "n", kind: "module", members: "wheel" }];
  assert.match(mistakes(two).at(1, "members"), /listed twice/);
  assert.match(mistakes(two).at(2, "members"), /member of m already/);
});

test("bytes are sound if they say so, and their blocks have room", async () => {
  const speaker = { name: "speaker", kind: "effector", type: "bytes", max: "1956" };
  for (const [element, words] of [
    [{ sound: "pcm 44101" }, /A codec and its samples per second/],
    [{ sound: "pcm 7950" }, /A codec/],
    [{ sound: "mp3 44100" }, /A codec/],
    [{ sound: "pcm" }, /A codec/],
    [{ sound: "opus 44100" }, /A codec/],
    [{ sound: "pcm 48950" }, /20 ms of it take up to 1958 bytes/],
    [{ sound: "opus 48000", max: "1274" }, /up to 1275 bytes/],
    [{ sound: "pcm 16000", type: "i16", max: "" }, /Only bytes can be sound/],
    [{ sound: "pcm 16000", type: "", max: "" }, /Only bytes can be sound/],
    [{ sound: "pcm 16000", kind: "command" }, /A command has none/],
  ]) assert.match(mistakes([{ ...speaker, ...element }]).at(0, "sound") ?? "", words, JSON.stringify(element));
  for (const sound of ["pcm 48900", "pcm 8000", "opus 48000", " opus 8000 ", ""]) {
    const elements = [{ ...speaker, sound }, { ...speaker, name: "microphone", kind: "sensor", sound }];
    assert.equal(mistakes(elements).count, 0, sound);
  }
  assert.deepEqual(cubo.elements.flatMap(({ name, sound }) => (sound ? [[name, sound]] : [])), [["speaker", "pcm 48900"], ["microphone", "pcm 16000"]]);
  assert.match(write(cubo), /^max = 640\nsound = "pcm 16000"$/m);
  assert.deepEqual([hasField("sensor", "bytes", "sound"), hasField("sensor", "bytes", "unit"), hasField("event", "bytes", "sound"), hasField("sensor", "u8", "sound")], [true, false, false, false]);
});

test("the model itself is checked: its numbers, how many elements, and how large a packet is", () => {
  for (const [model, field, words] of [
    [{ id: "" }, "id", /missing/],
    [{ id: "0x10000" }, "id", /0 to 65535/],
    [{ name: "A" }, "name", /not a name/],
    [{ period: "4" }, "period", /5 to 1000/],
    [{ watchdog: "30" }, "watchdog", /40 ms/],
    [{ period: "400", watchdog: "500" }, "watchdog", /800 ms/],
    [{ largest: "63" }, "largest", /64 to 65507/],
  ]) assert.match(mistakes([wheel], model).model[field] ?? "", words, JSON.stringify(model));
  for (const model of [{ watchdog: "0" }, { period: "400" }, { id: "0xffff" }]) assert.equal(mistakes([wheel], model).count, 0);
  assert.match(mistakes([]).whole[0], /at least one element/);
  assert.match(mistakes(Array.from({ length: 257 }, (_, index) => ({ name: `e${index}`, kind: "event" }))).whole[0], /257/);
  assert.match(mistakes([wheel, { name: "talk", kind: "command", type: "bytes", max: "2000" }]).model.largest, /to the robot.* has 2042 B.*such as talk/);
  assert.equal(mistakes([{ ...wheel, type: "bytes", max: "2000" }]).payloads[0].isBlob, true);
});

test("what is typed is read", () => {
  assert.deepEqual(listOf("a, , b"), ["a", "", "b"]);
  assert.deepEqual([listOf(" "), countOf(""), countOf("3"), countOf("x, y")], [[], { count: 1, parts: undefined }, { count: 3, parts: undefined }, { count: 2, parts: ["x", "y"] }]);
  assert.deepEqual([rangeOf("-1.5..2"), rangeOf("1..2..3"), rangeOf("a..2")], [[-1.5, 2], undefined, undefined]);
  assert.deepEqual([numberOf("1e3"), wholeOf("0xff"), Number.isNaN(numberOf("")), Number.isNaN(wholeOf("1.5"))], [1000, 255, true, true]);
  assert.equal(commandOf("cubo"), "mom rsp generate cubo.toml --rust cubo.rs --c cubo.h --docs cubo.md");
});

test("rows move, and what was kept comes back, whatever it is", () => {
  const rows = [1, 2, 3].map((key) => blank(key, { name: `e${key}` }));
  const names = (of) => of.map(({ name }) => name).join("");
  assert.deepEqual([names(moved(rows, 3, -1)), names(moved(rows, 1, -1)), names(moved(rows, 3, 1)), nextKey(rows), nextKey([])], ["e1e3e2", "e1e2e3", "e1e2e3", 4, 1]);
  assert.deepEqual(draftOf(JSON.parse(JSON.stringify(cubo))), cubo);
  for (const stored of [null, 3, {}, { elements: 3 }]) assert.equal(draftOf(stored), undefined);
  assert.deepEqual(draftOf({ name: 3, elements: [null, { name: "a", kind: 7 }] }).elements.map(({ name, kind }) => [name, kind]), [["a", ""]]);
  assert.equal(check(emptyDraft()).count, 0);
  assert.deepEqual(FIELDS.filter((field) => hasField("module", "", field)), ["name", "kind", "members", "doc"]);
});

/** A hub with these mirrors, whose middle says what `says` is asked to; `asked` is what it was asked. */
function hubOf({ robots = ["/fleet/1"], delivered = 1, send } = {}) {
  const sessions = new Set(robots.flatMap((robot) => robot.split("/").slice(1).map((_, depth, parts) => `/${parts.slice(0, depth + 1).join("/")}`)));
  const all = [...[...sessions].map((path) => ({ path, kind: "session" })), ...robots.flatMap((path) => [{ path: `${path}/simulacrum`, kind: "channel" }, { path: `${path}/robot`, kind: "channel" }, { path: `${path}/token`, kind: "token" }])];
  let handlers;
  const hub = {
    isUp: true,
    asked: [],
    watched: [],
    robots: all,
    watch: (what, heard) => {
      handlers = heard;
      hub.watched.push(what);
      queueMicrotask(() => hub.joins !== false && heard.joined({}));
      return () => hub.watched.splice(hub.watched.indexOf(what), 1);
    },
    call: async (call, ...args) => {
      if (call === "list") return hub.robots.filter(({ path }) => path !== "/" && (path.slice(0, path.lastIndexOf("/")) || "/") === args[0]);
      hub.asked.push(args);
      return send ? send() : { id: 7, delivered };
    },
  };
  const says = (content, reference = 7, more = {}) => handlers.events([{ type: "message", name: "generated", content, reference, cut: false, ...more }]);
  return { hub, says, heard: () => handlers };
}

const settled = () => new Promise((resolve) => setImmediate(resolve));

async function generator(options) {
  const fake = hubOf(options);
  const made = new Generator(fake.hub);
  await made.mirrors.look();
  return { ...fake, made };
}

test("a middle is asked for code of a model, and the answer to this question is taken", async () => {
  const { hub, made, says } = await generator();
  const asking = made.ask("c", "name = 1");
  await settled();
  assert.deepEqual(hub.watched, [{ path: "/fleet/1/simulacrum", kind: "channel", names: ["generated"], newest: true, answers: true }]);
  assert.deepEqual(hub.asked, [["/fleet/1/simulacrum", "generate", { language: "c", model: "name = 1" }, { echo: false, expires: PATIENCE }]]);
  assert.equal(made.asking, "c");
  says({ language: "c", name: "other.h", text: "" }, 6);
  says({ language: "c", name: "cubo.h", text: "#pragma once\n" });
  assert.deepEqual(await asking, { name: "cubo.h", text: "#pragma once\n" });
  assert.deepEqual([made.asking, hub.watched], [undefined, []]);

  // Without a model it is the robot's; and an answer may come before the id of its question.
  let sent;
  const early = await generator({ send: () => new Promise((resolve) => (sent = resolve)) });
  const own = early.made.ask("toml");
  await settled();
  assert.deepEqual(early.hub.asked[0][2], { language: "toml" });
  early.says({ name: "cubo.toml", text: "id = 1\n" });
  sent({ id: 7, delivered: 1 });
  assert.equal((await own).name, "cubo.toml");
});

test("what fails is said in words: mistakes, refusals, nonsense, and silence", async (t) => {
  const { hub, made, says, heard } = await generator();
  const fails = async (act, words) => {
    const asking = made.ask("rust", "");
    const failed = assert.rejects(asking, words);
    await settled();
    await act();
    await failed;
    assert.deepEqual([made.asking, hub.watched], [undefined, []]);
  };
  await fails(() => says({ language: "rust", error: "line 3, column 1: there is no key `peroid`" }), /^Error: The middle says: line 3, column 1: there is no key `peroid`$/);
  for (const [content, more] of [["nonsense"], [{ name: "x" }], [{ text: "x" }], [{ name: "x", text: "x" }, { cut: true }]]) await fails(() => says(content, 7, more), /\/fleet\/1 sent an invalid answer/);
  await fails(() => heard().failed({ kind: "refused", code: "denied", text: "bob may not join", content: {} }), /bob may not join/);

  t.mock.timers.enable({ apis: ["setTimeout"] });
  await fails(() => t.mock.timers.tick(PATIENCE), /The middle of \/fleet\/1 did not answer within 5 s/);
  hub.joins = false;
  await fails(() => t.mock.timers.tick(PATIENCE), /did not answer/);
  t.mock.timers.reset();

  const alone = await generator({ delivered: 0 });
  await assert.rejects(alone.made.ask("rust", ""), /The middle of \/fleet\/1 is not there/);
  const refused = await generator({ send: () => Promise.reject(new Error("bob may not send generate")) });
  await assert.rejects(refused.made.ask("rust", ""), /bob may not send generate/);
});

test("nothing is asked without a link or a mirrored robot, and of several robots one is", async () => {
  const { hub, made } = await generator({ robots: ["/fleet/1", "/fleet/2"] });
  assert.deepEqual([made.mirrors.paths, made.path, made.hindrance], [["/fleet/1/simulacrum", "/fleet/2/simulacrum"], "/fleet/1/simulacrum", undefined]);
  made.choose("/fleet/2/simulacrum");
  assert.equal(made.path, "/fleet/2/simulacrum");
  hub.isUp = false;
  assert.match(made.hindrance, /no connection/);
  await assert.rejects(made.ask("rust"), /no connection/);
  hub.isUp = true;
  // One that is gone is not chosen any more.
  hub.robots = hub.robots.filter(({ path }) => !path.startsWith("/fleet/2"));
  await made.mirrors.look();
  assert.equal(made.path, "/fleet/1/simulacrum");
  hub.robots = [];
  await made.mirrors.look();
  assert.match(made.hindrance, /No robot is mirrored/);
  await assert.rejects(made.ask("rust"), /No robot is mirrored/);
  assert.match(new Generator(hub).hindrance, /Looking for/);
  assert.deepEqual(hub.asked, []);
});

test("an answer comes to the page as a whole, other messages within bounds; and lines are counted", () => {
  const text = "x".repeat(1 << 20);
  assert.deepEqual([plain({ text }).cut, plain({ text }).content.text.length], [true, 65_536]);
  assert.deepEqual(plain({ text }, true, true), { content: { text }, cut: false, size: 0 });
  assert.deepEqual(["", "a", "a\n", "a\nb\n", "\n"].map(linesOf), [0, 1, 1, 2, 1]);
});
