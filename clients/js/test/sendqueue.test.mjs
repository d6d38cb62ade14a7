// The send queue: the cases that all of MOM's queues replay (tests/cases), then what is this client's own.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import test from "node:test";
import { Frames, Ledger, Outbox, PREFACE, Time, decode, encode } from "../dist/test/internals.js";

const cases = JSON.parse(readFileSync(new URL("../../../tests/cases/send-queue.json", import.meta.url), "utf8"));

/** An outbox and the ledger of its link, a pipe that takes as much as it is told to, and what the hub hears of it. */
class Queue {
  heard = [];
  said = {};
  clock = 1_000_000;
  /** What the pipe has taken, piece by piece, and the streams that are open at the hub. */
  pieces = [];
  open = new Set();
  ledger = new Ledger();
  #labels = [];
  #parcels = {};
  #frames = null;

  constructor() {
    this.outbox = new Outbox((entry, reason) => this.#told(entry.parcel, reason));
    this.outbox.wrote = (entry) => this.ledger.wrote(entry);
    this.outbox.now = () => this.clock;
    this.#connect();
  }

  #connect() {
    this.#frames = new Frames();
    assert.deepEqual([...this.#frames.push(PREFACE)], []);
    this.open.clear();
  }

  #told({ id }, reason) {
    const label = this.#labels[id];
    assert.ok(!(label in this.said), `${label} is told twice: ${this.said[label]} and ${reason}`);
    this.said[label] = reason;
  }

  put({ is, family = "message", name, context = "/robot/arm", bytes, guarded = false, awaited = false, stop, peer, sender, ...slots }) {
    assert.equal(sender, undefined, "only the hub has senders");
    const parcel = { family, name, context, id: this.#labels.push(is) - 1, ...slots };
    if (bytes !== undefined) parcel.content = new Uint8Array(bytes);
    if (stop !== undefined) parcel.extra = { stop };
    if (peer !== undefined) parcel.content = { peer };
    this.#parcels[is] = parcel;
    try {
      this.outbox.put(parcel, { delivery: parcel.delivery ?? "reliable", token: guarded ? "/robot/token" : undefined, awaited });
    } catch (error) {
      assert.equal(error.kind, "connection", error);
      this.#told(parcel, error.code);
    }
  }

  fill(is) {
    const { most, bytes } = this.outbox;
    for (let size = most - bytes; ; size--) {
      const parcel = { family: "message", name: "map", context: "/robot/arm", id: this.#labels.length, content: new Uint8Array(size) };
      if (bytes + encode(parcel).length > most) continue;
      this.put({ is, name: "map", bytes: size });
      return assert.equal(this.outbox.bytes, most);
    }
  }

  /** What the hub hears while the pipe takes more. */
  take(more) {
    const heard = [];
    const pipe = {
      get waiting() {
        return more(heard) ? 0 : Infinity;
      },
      send: (bytes) => {
        this.pieces.push(bytes);
        const [kind, stream, flags] = bytes.subarray(4);
        if (kind === 1) this.open[flags & 6 ? "delete" : "add"](stream);
        for (const frame of this.#frames.push(bytes)) {
          const parcel = decode(frame);
          heard.push(parcel.name === "resent" ? "resent" : this.#labels[parcel.id]);
        }
      },
    };
    this.outbox.pump(pipe);
    return heard;
  }

  step(step) {
    const [[word, value], ...others] = Object.entries(step);
    assert.deepEqual(others, []);
    switch (word) {
      case "put": return this.put(value);
      case "fill": return this.fill(value);
      case "takes": return assert.deepEqual(this.take((heard) => heard.length < value.length), value);
      case "begins": {
        const before = this.pieces.length;
        assert.deepEqual(this.take(() => this.pieces.length === before), []);
        const begin = encode(this.#parcels[value]).subarray(4, 64);
        return assert.ok(Buffer.from(this.pieces[before]).includes(begin), `${value} has not begun`);
      }
      case "hears": {
        assert.deepEqual(this.take(() => true), value);
        return assert.deepEqual([this.outbox.bytes, this.open.size], [0, 0]);
      }
      case "lose": return this.outbox.lose();
      case "resume": {
        this.#connect();
        const unread = this.ledger.resumed({ read: value });
        assert.ok(unread, `${value} were not sent`);
        return this.outbox.back(unread, { family: "time", name: "resent" });
      }
      case "told": {
        assert.deepEqual(this.said, value);
        this.said = {};
        return;
      }
      case "clock": return void (this.clock += value);
      default: assert.fail(`${word} is not a step`);
    }
  }
}

function replay(steps) {
  const queue = new Queue();
  steps.forEach((step, place) => {
    try {
      queue.step(step);
    } catch (error) {
      error.message = `step ${place + 1}, ${JSON.stringify(step)}: ${error.message}`;
      throw error;
    }
  });
}

test("each case of all send queues", async (suite) => {
  const mine = cases.filter(({ on }) => !on || on.includes("js"));
  assert.ok(mine.length > 50);
  for (const { name, steps } of mine) await suite.test(name, () => replay(steps));
});

/** A message, a stop, … of the cases below. */
const note = (is, more) => ({ put: { is, name: "note", ...more } });
const stop = (is, more) => ({ put: { is, name: "stop", ...more } });
const unstop = (is, more) => ({ put: { is, name: "unstop", ...more } });
const command = (is, more) => ({ put: { is, name: "command", guarded: true, ...more } });
const goal = (is, more) => ({ put: { is, name: "goal", delivery: "latest", context: "/chat", ...more } });
const request = (is, family, name, context, more) => ({ put: { is, family, name, context, ...more } });
const release = (is, more) => request(is, "token", "release", "/robot/token", { fence: 3, ...more });
const lost = (read) => [{ lose: true }, { resume: read }];
const ends = (hears, told = {}) => [{ hears }, { told }];

/** What the table says, and no case of all queues does. */
const MORE = {
  "a stop withdraws an unstop that is half sent": [unstop("u", { bytes: 300_000 }), { begins: "u" }, stop("s"), ...ends(["s"], { u: "withdrawn" })],
  "a stop withdraws what waits behind a release": [command("c"), release("r"), unstop("u"), stop("s"), ...ends(["s", "c", "r"], { u: "withdrawn" })],
  "an unstop that is withdrawn holds nothing back": [note("m", { priority: -100 }), unstop("u"), note("n", { context: "/chat" }), stop("s"), ...ends(["s", "n", "m"], { u: "withdrawn" })],
  "an awaited stop that has left leaves the others as they are": [stop("a", { awaited: true }), stop("b"), { takes: ["a"] }, stop("c"), ...ends(["c"])],
  "a stop is kept also where all messages are guarded": [stop("s", { guarded: true }), ...lost(0), ...ends(["s", "resent"])],
  "who is named twice is named": [stop("a", { address: ["a", "a"] }), stop("b", { address: ["a"] }), ...ends(["b"])],
  "a stop is kept whatever its class": [stop("s", { delivery: "latest" }), stop("f", { delivery: "fleeting", context: "/crane/arm" }), { hears: ["s", "f"] }, ...lost(0), ...ends(["s", "f", "resent"])],
  "a stop is not dropped where the queue is full": [stop("s", { delivery: "fleeting" }), { fill: "f" }, note("n"), ...ends(["s", "f", "n"])],
  "a stop that was not read goes before what was said before it": [note("m"), { hears: ["m"] }, stop("s"), { hears: ["s"] }, ...lost(0), ...ends(["s", "m", "resent"])],
  "of two stops that were not read the newer one goes again": [stop("a"), { hears: ["a"] }, stop("b"), { hears: ["b"] }, ...lost(0), ...ends(["b", "resent"])],
  "awaited stops that were not read all go again": [stop("a", { awaited: true }), { hears: ["a"] }, stop("b"), { hears: ["b"] }, ...lost(0), stop("c"), ...ends(["a", "c", "resent"])],
  "stops that go again leave before those that are new": [stop("a", { context: "/crane/arm" }), { hears: ["a"] }, { lose: true }, stop("b"), { resume: 0 }, ...ends(["a", "b", "resent"])],
  "a stop of the first loss goes again after the second": [stop("s"), { hears: ["s"] }, ...lost(0), ...lost(0), stop("n"), ...ends(["n", "resent"])],
  "a half sent unstop is not replaced": [unstop("a", { bytes: 300_000 }), { begins: "a" }, unstop("b"), ...ends(["a", "b"])],
  "a request to stop waits behind nothing": [note("m"), request("s", "context", "stop", "/robot/arm"), ...ends(["s", "m"])],
  "a request for an unstop leaves behind what was said below its context": [note("m"), request("u", "context", "unstop", "/robot"), ...ends(["m", "u"])],
  "a request to stop is sent again after a loss, one for an unstop is not": [request("u", "context", "unstop", "/robot"), { hears: ["u"] }, request("s", "context", "stop", "/robot"), { hears: ["s"] }, ...lost(0), ...ends(["s", "resent"], { u: "unknown" })],
  "an unstop may be too old": [unstop("u", { expires: 5 }), { clock: 5 }, ...ends([], { u: "expired" })],
  "a request has no age": [request("j", "context", "join", "/x", { expires: 5 }), { clock: 10 }, ...ends(["j"])],
  "a half sent message that is too old is aborted": [note("m", { bytes: 300_000, expires: 5 }), { begins: "m" }, { clock: 10 }, note("n"), ...ends(["n"], { m: "expired" })],
  "a message may leave to the end of its time": [note("m", { expires: 5 }), { clock: 4 }, ...ends(["m"])],
  "the answer to a request leaves behind the commands of its token": [command("c"), request("x", "token", "accept", "/robot/token", { peer: "bob" }), ...ends(["c", "x"])],
  "the answer to an offer waits for nothing": [command("c"), request("x", "token", "accept", "/robot/token"), ...ends(["x", "c"])],
  "the answer to a request is not sent after a loss": [request("x", "token", "accept", "/robot/token", { peer: "bob" }), { hears: ["x"] }, ...lost(0), ...ends(["resent"], { x: "unknown" })],
  "the answer to an offer is sent again": [request("x", "token", "accept", "/robot/token"), { hears: ["x"] }, ...lost(0), ...ends(["x", "resent"])],
  "a peer named in a request of another family changes nothing": [command("c"), request("i", "context", "invite", "/robot/token", { peer: "bob" }), ...ends(["i", "c"])],
  "what waits behind a release is dropped at a loss, too": [command("c"), release("r"), unstop("u"), command("d"), note("n"), ...lost(0), ...ends(["resent", "r", "n"], { c: "lost", d: "lost", u: "lost" })],
  "a release that must not be sent late holds nothing back": [note("m", { priority: -100, guarded: true, name: "note" }), release("r", { fence: undefined }), note("n"), ...lost(0), ...ends(["resent", "n"], { m: "lost", r: "lost" })],
  "a release whose command is too old leaves": [command("c", { expires: 5 }), release("r"), { clock: 10 }, ...ends(["r"], { c: "expired" })],
  "what waits, waits one after the other": [command("c"), release("r"), note("n"), request("l", "context", "leave", "/robot/arm"), note("x"), ...ends(["c", "r", "n", "l", "x"])],
  "create waits for nothing": [note("m"), request("d", "context", "create", "/robot/arm"), ...ends(["d", "m"])],
  "leave of the root leaves behind everything": [note("m", { context: "/chat", priority: -100 }), request("l", "context", "leave", "/"), ...ends(["m", "l"])],
  "what is said after a release does not take the place of what was said before it": [goal("a", { priority: -50 }), command("c"), release("r"), goal("b", { priority: -50 }), ...ends(["c", "r", "b"], { a: "replaced" })],
  "behind a release, too, a newer message has the place of the older": [command("c"), release("r"), goal("a"), note("x", { context: "/chat" }), goal("b"), ...ends(["c", "r", "b", "x"], { a: "replaced" })],
  "but not before what waits there": [command("c"), release("r"), goal("a"), request("l", "context", "leave", "/chat"), goal("b"), ...ends(["c", "r", "l", "b"], { a: "replaced" })],
  "and what waits before it does not matter": [command("c"), release("r"), note("y", { context: "/chat" }), request("l", "context", "leave", "/chat"), goal("a"), note("x", { context: "/chat" }), goal("b"), ...ends(["c", "r", "y", "l", "b", "x"], { a: "replaced" })],
  "behind a release, at another priority it is queued up anew": [command("c"), release("r"), goal("a"), note("x", { context: "/chat", priority: 5 }), goal("b", { priority: 5 }), ...ends(["c", "r", "x", "b"], { a: "replaced" })],
  "at another priority it is queued up anew": [goal("a"), note("x", { context: "/chat", priority: 5 }), goal("b", { priority: 5 }), ...ends(["x", "b"], { a: "replaced" })],
  "a third takes the place of the second": [goal("a"), note("x", { context: "/chat" }), goal("b"), goal("c"), ...ends(["c", "x"], { a: "replaced", b: "replaced" })],
  "what has left is not replaced": [goal("a"), { hears: ["a"] }, goal("b"), ...ends(["b"])],
  "one after another priority replaces the newest": [goal("a"), goal("b", { priority: 5 }), goal("c"), ...ends(["c"], { a: "replaced", b: "replaced" })],
  "latest and fleeting that had left are told as unknown": [goal("a"), note("f", { delivery: "fleeting" }), { hears: ["a", "f"] }, ...lost(0), ...ends(["resent"], { a: "unknown", f: "unknown" })],
  "the oldest fleeting message gives way to what needs room": [note("a", { delivery: "fleeting", bytes: 200 }), note("b", { delivery: "fleeting", priority: 5 }), { fill: "f" }, note("n"), ...ends(["b", "f", "n"], { a: "queue-full" })],
  "fleeting messages behind a release give way, too": [command("c"), release("r"), note("a", { delivery: "fleeting", bytes: 200 }), { fill: "f" }, note("n"), ...ends(["c", "r", "f", "n"], { a: "queue-full" })],
  "as many as need be": [note("a", { delivery: "fleeting", priority: -1 }), note("b", { delivery: "fleeting" }), { fill: "f" }, note("n", { bytes: 60 }), ...ends(["f", "n"], { a: "queue-full", b: "queue-full" })],
  "a fleeting message that is half sent goes on": [note("a", { delivery: "fleeting", bytes: 300_000 }), { begins: "a" }, { fill: "f" }, note("n", { delivery: "fleeting", priority: 5 }), ...ends(["a", "f"], { n: "queue-full" })],
  "a full queue is not too full": [note("a", { delivery: "fleeting" }), { fill: "f" }, ...ends(["a", "f"])],
  "signs of life leave before requests, and behind stops": [request("g", "token", "grab", "/t"), request("p", "time", "ping", "/"), stop("s"), ...ends(["s", "p", "g"])],
  "signs of life wait for nothing": [command("c"), release("r"), request("p", "time", "ping", "/"), ...ends(["p", "c", "r"])],
  "signs of life leave before what goes again": [note("a"), { hears: ["a"] }, ...lost(0), request("p", "time", "ping", "/"), ...ends(["p", "a", "resent"])],
  "signs of life that waited at a loss are forgotten": [request("p", "time", "ping", "/"), ...lost(0), ...ends(["resent"])],
  "what waits for the second resume goes again in its order": [note("a"), note("b"), note("c"), { hears: ["a", "b", "c"] }, ...lost(0), { takes: ["a"] }, ...lost(0), ...ends(["a", "b", "c", "resent"])],
  "what goes again leaves before requests": [note("a"), { hears: ["a"] }, ...lost(0), request("g", "token", "grab", "/t"), ...ends(["a", "resent", "g"])],
  "a leave that goes again waits for nothing": [request("l", "context", "leave", "/robot"), { hears: ["l"] }, { lose: true }, note("n"), { resume: 0 }, ...ends(["l", "resent", "n"])],
  "what goes again may be too old": [note("a", { expires: 5 }), { hears: ["a"] }, { lose: true }, { clock: 10 }, { resume: 0 }, ...ends(["resent"], { a: "expired" })],
  "a message without a priority has the priority 0": [note("a", { priority: 0 }), note("b"), note("c", { priority: 0 }), ...ends(["a", "b", "c"])],
  "priorities have bounds": [note("a", { priority: -1000 }), note("b", { priority: -100 }), note("c", { priority: 100 }), note("d", { priority: 1000 }), request("g", "token", "grab", "/t"), ...ends(["g", "c", "d", "a", "b"])],
};

for (const [name, steps] of Object.entries(MORE)) test(name, () => replay(steps));

/** An outbox with a pipe that keeps the pieces that it is given, up to 64 KiB at a time. */
function piped() {
  const pieces = [];
  const pipe = { waiting: 0, send: (bytes) => (pieces.push(bytes), (pipe.waiting += bytes.length)) };
  const [outbox, done] = [new Outbox(() => undefined), []];
  outbox.wrote = (entry) => done.push(entry.parcel.name);
  const say = (name, more = {}) => outbox.put({ family: "message", name, context: "/c", ...more }, more);
  const pump = () => {
    pipe.waiting = 0;
    outbox.pump(pipe);
    return pieces.splice(0);
  };
  return { outbox, done, pipe, say, pump };
}

const KIB = 1024;
/** The stream of a chunk, and its flags. */
const streamOf = (piece) => [piece[5], piece[6]];

test("a pipe is given 64 KiB ahead of time, and 1 MiB where the page is hidden", () => {
  const { say, pump } = piped();
  say("image", { content: new Uint8Array(4096 * KIB) });
  const lengths = pump().map((piece) => piece.length);
  assert.ok(lengths.every((length) => length > 16 * KIB && length < 16 * KIB + 16), lengths);
  assert.equal(lengths.length, 4);
  globalThis.document = { hidden: false };
  try {
    assert.equal(pump().length, 4);
    globalThis.document.hidden = true;
    assert.equal(pump().length, 64);
  } finally {
    delete globalThis.document;
  }
});

test("what is no longer than two pieces goes whole", () => {
  const { outbox, done, say, pump } = piped();
  const length = (size) => encode({ family: "message", name: "image", context: "/c", content: new Uint8Array(size) }).length;
  const size = 32 * KIB - (length(32 * KIB) - 32 * KIB);
  assert.equal(length(size), 32 * KIB);
  say("image", { content: new Uint8Array(size) });
  assert.equal(pump().length, 1);
  say("image", { content: new Uint8Array(size + 1) });
  assert.deepEqual(pump().map(streamOf), [[1, 1], [1, 2]]);
  say("stop", { content: new Uint8Array(256 * KIB) });
  assert.equal(pump().length, 1);
  assert.deepEqual([done, outbox.bytes], [["image", "image", "stop"], 0]);
});

test("four streams are open at most, and no more bytes than one parcel may have", () => {
  const large = new Uint8Array(100 * KIB);
  const { outbox, pipe, say, pump } = piped();
  const piece = () => {
    // One piece at a time.
    const pieces = [];
    outbox.pump({ get waiting() { return pieces.length ? Infinity : 0; }, send: (bytes) => pieces.push(bytes) });
    return pieces.map((bytes) => streamOf(bytes)[0])[0];
  };
  const begun = [1, 2, 3, 4, 5].map((priority) => (say("image", { content: large, priority }), piece()));
  assert.deepEqual(begun, [1, 2, 3, 4, 4]);
  // What is small goes between them, and when one has ended the next may begin.
  const other = encode({ family: "message", name: "image", context: "/c", content: new Uint8Array(30 * KIB), priority: 9 }).length - 30 * KIB;
  const largest = 32 * KIB - other;
  say("image", { content: new Uint8Array(largest + 1), priority: 8 });
  say("image", { content: new Uint8Array(largest), priority: 9 });
  const [whole, next] = pump();
  assert.deepEqual([whole[4], whole.length, next[4], next[5]], [0, 32 * KIB, 1, 4]);
  while (pump().length);
  assert.deepEqual([pipe.waiting, outbox.bytes], [0, 0]);
  outbox.parcelLimit = 2 * encode({ family: "message", name: "image", context: "/c", content: large, priority: 1 }).length;
  assert.deepEqual([1, 2, 3].map((priority) => (say("image", { content: large, priority }), piece())), [7, 8, 8]);
  while (pump().length);
  outbox.parcelLimit = 90 * KIB;
  const size = encode({ family: "message", name: "image", context: "/c", content: large }).length - 4;
  assert.throws(() => say("image", { content: large }), { code: "too-large", text: `the parcel has ${size} bytes; the hub accepts at most 92160` });
  outbox.parcelLimit = encode({ family: "message", name: "image", context: "/c", content: large, priority: 1 }).length - 4;
  say("image", { content: large, priority: 1 });
  assert.equal(piece(), 10);
});

test("streams are numbered anew after a loss, and what was given up before it is not aborted", () => {
  const { outbox, say, pump } = piped();
  say("unstop", { content: new Uint8Array(200 * KIB) });
  assert.equal(pump().length, 4);
  say("stop");
  outbox.lose();
  outbox.back([]);
  say("image", { content: new Uint8Array(200 * KIB) });
  assert.deepEqual(pump().slice(0, 2).map((piece) => [piece[4], piece[5]]), [[0, encode({ family: "message", name: "stop", context: "/c" })[5]], [1, 1]]);
});

test("what waits for capacity is told when there is some", async () => {
  const { outbox, say, pump } = piped();
  outbox.most = 100 * KIB;
  say("image", { content: new Uint8Array(150 * KIB) });
  outbox.most = outbox.bytes;
  let rooms = 0;
  const room = outbox.room().then(() => (rooms += 1));
  outbox.pump({ waiting: 64 * KIB, send: assert.fail });
  outbox.most -= 1;
  pump();
  await Promise.resolve();
  assert.deepEqual([rooms, outbox.bytes > outbox.most], [0, true]);
  while (pump().length);
  await room;
  say("image", { content: new Uint8Array(150 * KIB) });
  const again = outbox.room();
  assert.equal(outbox.take((entry) => entry.parcel.name === "chat").length, 0);
  assert.equal(outbox.take(() => true).length, 1);
  await again;
  assert.equal(outbox.bytes, 0);
});

test("what is said without more is reliable, and awaited by nobody", () => {
  const { outbox, done, pump } = piped();
  const ledger = new Ledger();
  outbox.wrote = (entry) => (done.push(entry.parcel.content ?? entry.parcel.name), ledger.wrote(entry));
  const say = (name, content) => outbox.put({ family: "message", name, context: "/c", content });
  say("note");
  for (const content of [1, 2]) say("stop", content);
  pump();
  outbox.lose();
  outbox.back(ledger.resumed({ read: 0 }));
  pump();
  assert.deepEqual(done, [2, "note", 2, "note"]);
});

test("what may not leave yet holds back what is less urgent", () => {
  const { outbox, done, say, pump } = piped();
  outbox.permits = (entry) => entry.parcel.name !== "image";
  say("image");
  say("chat");
  say("stop");
  pump();
  assert.deepEqual(done, ["stop"]);
});

test("a timestamp says when the time of a message begins", () => {
  const { outbox, done, say, pump } = piped();
  outbox.now = () => 10_000;
  say("old", { expires: 1000, timestamp: new Time(8_999_000n) });
  say("new", { expires: 1000, timestamp: new Time(9_001_000n) });
  pump();
  assert.deepEqual(done, ["new"]);
  const clock = new Outbox(() => undefined).now();
  assert.ok(Math.abs(clock - Date.now()) < 1000, "it is the clock of timestamps");
});

test("the bounds of a queue are those of a hub", () => {
  const { most, parcelLimit } = new Outbox(() => undefined);
  assert.deepEqual([most, parcelLimit], [4 << 20, 8 << 20]);
});

test("a ledger keeps what is reliable, and of the rest the place", () => {
  const ledger = new Ledger();
  const entry = (name, reliable) => ({ frame: { length: 10 }, name, reliable, parcel: {} });
  for (const one of [entry("a", true), entry("b", false), entry("c", true), entry("d", false)]) ledger.wrote(one);
  assert.deepEqual([ledger.sent, ledger.bytes], [4, 20]);
  assert.equal(ledger.acknowledged({ read: 5 }), false);
  assert.equal(ledger.acknowledged({ read: 1 }), true);
  assert.equal(ledger.acknowledged({ read: 0 }), false);
  assert.equal(ledger.acknowledged({ read: 1 }), true);
  assert.deepEqual([ledger.sent, ledger.bytes, ledger.kept.map((one) => one.name)], [4, 10, ["b", "c", "d"]]);
  assert.equal(ledger.acknowledged({ read: 2 }), true);
  assert.equal(ledger.bytes, 10);
  assert.deepEqual(ledger.resumed({ read: 2 }).map((one) => one.name), ["c", "d"]);
  assert.deepEqual([ledger.sent, ledger.bytes, ledger.kept], [2, 0, []]);
  assert.equal(ledger.resumed({ read: 3 }), null);
});

test("a ledger tells what was read, in time", () => {
  const first = new Ledger();
  assert.deepEqual([first.heard(64 * KIB - 1, {}), first.heard(1, {})], [false, true]);
  const ledger = new Ledger();
  assert.equal(ledger.tell(), null);
  ledger.heard(1, {});
  assert.deepEqual([ledger.tell()?.read, ledger.tell()], [1, null]);
  for (let count = 1; count < 256; count++) assert.equal(ledger.heard(1, {}), false);
  assert.equal(ledger.heard(1, {}), true);
  assert.deepEqual([ledger.tell()?.read, ledger.tell(), ledger.read], [257, null, 257]);
  assert.equal(ledger.heard(64 * KIB - 1, {}), false);
  assert.equal(ledger.heard(1, {}), true);
  assert.equal(ledger.tell()?.read, 259);
  assert.equal(ledger.heard(64 * KIB - 1, {}), false);
  // A resume tells it, too.
  ledger.resumed({ read: 0 });
  assert.equal(ledger.tell(), null);
  assert.equal(ledger.heard(64 * KIB - 1, {}), false);
});

// The numbers are those of docs/PROTOCOL.md.
test("a ledger sees whether the hub has counted the same parcels", () => {
  const ids = [1, 2, 2 ** 32 + 3];
  const checksums = [2_166_136_261, 67_918_732, 3_983_810_698, 1_456_420_779];
  const reader = new Ledger();
  assert.deepEqual(reader.said, { read: 0, checksum: checksums[0] });
  ids.forEach((id, at) => {
    reader.heard(1, { id });
    assert.deepEqual(reader.said, { read: at + 1, checksum: checksums[at + 1] });
  });
  const other = new Ledger();
  other.heard(1, { reference: 1 });
  assert.equal(other.said.checksum, checksums[1], "a reference stands where there is no id");
  other.heard(1, null);
  assert.deepEqual(other.said, { read: 2 }, "of what nobody could read no checksum is known");
  for (const read of [0, 1, 2, 3]) {
    const sent = new Ledger();
    for (const id of ids) sent.wrote({ frame: { length: 10 }, reliable: id !== 2, parcel: { id } });
    const wrong = checksums[(read + 1) % 4];
    assert.equal(sent.acknowledged({ read, checksum: checksums[read] }), true);
    assert.equal(sent.resumed({ read, checksum: wrong }), null);
    assert.notEqual(sent.resumed({ read }), null, "earlier hubs do not say it");
  }
});
