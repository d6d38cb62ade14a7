import assert from "node:assert/strict";
import { createHash, createHmac, randomBytes } from "node:crypto";
import { readFileSync } from "node:fs";
import test from "node:test";
import { Double, Frames, PREFACE, Reader, Time, Unpacker, WORDS, Writer, chunk, decode, encode, hmac, pack, sha256 } from "../dist/test/internals.js";

/** A golden file of mom-proto: the hex of one frame. */
const golden = (name) => {
  const text = readFileSync(new URL(`../../../mom-proto/tests/golden/binary/${name}.hex`, import.meta.url), "utf8");
  return Uint8Array.from(Buffer.from(text.replace(/^#.*$/gm, "").replace(/\s/g, ""), "hex"));
};
const hex = (bytes) => Buffer.from(bytes).toString("hex");

const PARCELS = {
  login: { family: "login", name: "login", id: 1, context: "/", content: { name: "alice", password: "secret" } },
  command: {
    family: "message",
    name: "command",
    id: 7,
    number: 5,
    sender: "alice",
    timestamp: new Time(1_795_255_200_000_123n),
    fence: 2 ** 20 + 3,
    received: new Time(1_795_255_200_000_456n),
    age: 0,
    content: "grip open",
  },
  all_slots: {
    family: "event",
    name: "lights",
    id: 300,
    context: "/a/b",
    number: 129,
    reference: 2,
    address: ["bob", "hub"],
    priority: -5,
    expires: 250,
    delivery: "fleeting",
    age: -1,
    ageError: 9,
    echo: false,
    receipt: true,
    extra: { colour: "red" },
    content: [null, true, -1, 0.5, new Time(1n), Uint8Array.of(0, 255)],
  },
};

for (const [name, parcel] of Object.entries(PARCELS)) {
  test(`golden file ${name}`, () => {
    assert.equal(hex(encode(parcel)), hex(golden(name)));
    assert.deepEqual(decode(golden(name).subarray(5)), parcel);
  });
}

const packed = (value) => {
  const writer = new Writer();
  pack(writer, value);
  return writer.take();
};
const unpacked = (bytes, exact) => new Unpacker(new Reader(bytes), exact).value();

test("values come back as they were", () => {
  const values = [
    null, true, false, 0, 127, 128, 255, 256, 65535, 65536, 2 ** 32 - 1, 2 ** 32, 2 ** 53 - 1, 2n ** 53n, 2n ** 63n - 1n, -1, -32, -33, -128, -129, -32768,
    -32769, -(2 ** 31), -(2 ** 31) - 1, -(2 ** 53) + 1, -(2n ** 53n), -(2n ** 63n), 0.5, -1.5e300, "", "ä€😀", "x".repeat(31), "x".repeat(32), "x".repeat(256),
    "x".repeat(65536), new Uint8Array(0), new Uint8Array(255), new Uint8Array(256), new Uint8Array(65536), [], [1, [2, [3]]], Array(16).fill(1), Array(65536).fill(1),
    {}, { a: 1, __proto__: null }, Object.fromEntries(Array.from({ length: 300 }, (_, key) => [`k${key}`, key])), new Time(-1n), new Time(-62167219200000000n),
    new Time(253402300799999999n),
  ];
  for (const value of values) {
    const back = unpacked(packed(value));
    if (typeof value === "object" && value && Object.getPrototypeOf(value) === null) assert.deepEqual({ ...back }, { ...value });
    else assert.deepEqual(back, value);
  }
  assert.equal(unpacked(packed(new Date(5))).micros, 5000n);
  assert.equal(hex(packed(new Double(1))), "cb3ff0000000000000");
  assert.deepEqual(unpacked(packed({ b: new Double(1), 1: 2 }), true), new Map([["1", 2], ["b", new Double(1)]]));
  assert.deepEqual([...unpacked(packed(new Map([["b", 1], ["1", 2]])), true).keys()], ["b", "1"]);
  assert.deepEqual(Object.keys(unpacked(Uint8Array.from([0x81, 0xa9, ...Buffer.from("__proto__"), 1]))), ["__proto__"]);
  assert.deepEqual(unpacked(packed({ a: undefined, b: 1 })), { b: 1 });
});

test("what has no form on the wire is refused here", () => {
  let deep = 1;
  for (let depth = 0; depth < 33; depth++) deep = [deep];
  for (const value of [NaN, Infinity, 2n ** 63n, "\u0000", "\ud800", "\uffff", () => 1, Symbol("x"), undefined, deep]) {
    assert.throws(() => packed(value), { name: "MomError", kind: "local" }, String(value?.name));
  }
});

test("what is not a value is a fault of the content and of nothing else", () => {
  const bad = ["c1", "c403 00", "a2 c328", "a1 00", "92 01", "df ffffffff", "82 a161 01 a161 02", "81 01 02", "cb 7ff8000000000000", "cf ffffffffffffffff", "d4 01 00", "01 02", "91".repeat(33) + "01"];
  for (const digits of bad) {
    const parcel = decode(Uint8Array.from([0x22, 9, ...Buffer.from(digits.replace(/\s/g, ""), "hex")]));
    assert.equal(parcel.name, "chat");
    assert.equal(parcel.content, undefined, digits);
    assert.ok(parcel.fault, digits);
  }
});

test("the table of words is that of mom-proto, and words of later versions are sent as text", () => {
  const rust = readFileSync(new URL("../../../mom-proto/src/binary/words.rs", import.meta.url), "utf8");
  const words = [.../WORDS[^=]*= (?:&?\[)([\s\S]*?)\];/.exec(rust)[1].matchAll(/"([^"]+)"/g)].map(([, word]) => word);
  assert.deepEqual(WORDS.slice(0, words.length), words);
  assert.equal(hex(encode({ family: "message", name: "uninhibited" })), "00000003000 26f".replace(/ /g, ""));
  assert.equal(hex(encode({ family: "message", name: "lost" })), "0000000700 0208 6c6f7374".replace(/ /g, ""));
});

test("what a later version says is skipped", () => {
  // Bit 20 with two bytes, an unknown word, a padded number.
  const later = decode(Uint8Array.from([0xa2, 0x80, 0xc0, 0, 9, 2, 7, 7, 0xc3]));
  assert.deepEqual(later, { family: "message", name: "chat", content: true });
  assert.equal(decode(Uint8Array.from([0x82, 8, 0xff, 1, 5])).name, "");
  assert.equal(decode(Uint8Array.from([0x12, 9, 0x87, 0x80, 0x80, 0])).id, 7);
});

/** A stream with parcels in chunks of this size. */
const inChunks = (size, ...parcels) => {
  const frames = parcels.flatMap((parcel, number) => {
    const frame = encode(parcel);
    const chunks = [];
    for (let at = 0; at < frame.length - 4; at += size) chunks.push(chunk(number + 1, frame.subarray(4), at, Math.min(frame.length - 4, at + size)));
    return [chunks];
  });
  // One of each in turn.
  const mixed = [];
  while (frames.some((chunks) => chunks.length)) for (const chunks of frames) if (chunks.length) mixed.push(chunks.shift());
  return Buffer.concat([PREFACE, ...mixed]);
};

test("parcels are put together from chunks and pieces of any size", () => {
  const large = { family: "message", name: "image", content: new Uint8Array(randomBytes(1000)) };
  for (const size of [1, 2, 7, 100, 5000]) {
    const stream = inChunks(size, large, PARCELS.login, PARCELS.all_slots);
    for (const piece of [1, 3, 64, stream.length]) {
      const frames = new Frames();
      const read = [];
      for (let at = 0; at < stream.length; at += piece) for (const frame of frames.push(Uint8Array.from(stream.subarray(at, at + piece)))) read.push(decode(frame));
      assert.equal(read.length, 3);
      assert.deepEqual(new Set(read.map((parcel) => parcel.name)), new Set(["image", "login", "lights"]));
      assert.deepEqual(read.find((parcel) => parcel.name === "image"), large);
    }
  }
});

test("a stream that breaks the rules is refused", () => {
  const frame = (...bytes) => [0, 0, 0, bytes.length, ...bytes];
  const refused = (...bytes) => assert.throws(() => [...new Frames().push(Uint8Array.from([...PREFACE, ...bytes]))], { name: "MomError" });
  refused(...frame(2, 0));
  refused(0, 0, 0, 0);
  refused(...frame(1, 1, 2, 0));
  refused(...frame(1, 1, 4));
  refused(...frame(1, 1, 8));
  refused(...frame(1, 1, 3, 1, 0, 0));
  refused(...frame(1, 1, 3, 5, 0));
  refused(...frame(1, 1, 1, 5), ...frame(1, 1, 1, 5));
  refused(...Array.from({ length: 9 }, (_, stream) => frame(1, stream, 1, 5)).flat());
  assert.throws(() => [...new Frames().push(Uint8Array.from(Buffer.from("HTTP/1.1")))], /not from a hub/);
  assert.throws(() => [...new Frames().push(Uint8Array.from([...PREFACE.subarray(0, 4), 2, 0]))], /version 2/);
  const small = new Frames();
  small.most = 10;
  assert.throws(() => [...small.push(Uint8Array.from([...PREFACE, 0, 0, 0, 11]))], { code: "too-large" });
  const skipped = [...new Frames().push(Uint8Array.from([...PREFACE, ...frame(200, 1), ...frame(1, 1, 1, 5), ...frame(1, 1, 4), ...frame(0, 2, 9)]))];
  assert.deepEqual(skipped.map((parcel) => decode(parcel).name), ["chat"]);
});

test("SHA-256 and HMAC are those of everybody", () => {
  for (const length of [0, 1, 55, 56, 63, 64, 65, 119, 1000]) {
    const bytes = randomBytes(length);
    const key = randomBytes(length % 100);
    assert.equal(hex(sha256(bytes)), createHash("sha256").update(bytes).digest("hex"));
    assert.equal(hex(hmac(key, bytes, bytes)), createHmac("sha256", key).update(bytes).update(bytes).digest("hex"));
  }
});

test("times are exact to the microsecond", () => {
  for (const text of ["2026-11-21T10:00:00.000123Z", "1969-12-31T23:59:59.999999Z", "0000-01-01T00:00:00.000000Z", "9999-12-31T23:59:59.999999Z"]) {
    assert.equal(Time.of(text).toString(), text);
  }
  assert.equal(Time.of("2026-11-21T10:00:00Z").toDate().toISOString(), "2026-11-21T10:00:00.000Z");
  assert.throws(() => Time.of("2026-11-21 10:00"), RangeError);
  assert.ok(Math.abs(Number(Time.now().micros) / 1000 - Date.now()) < 50);
});
