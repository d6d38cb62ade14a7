// What the page shows is never older than it says: what may be lost is asked for again, and what nobody tells any more is unknown.
import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./bundle.mjs";

const { Feeds } = await load("worker/feeds.ts");
const { Teller } = await load("hub/teller.svelte.ts");
const { Selection } = await load("hub/selection.svelte.ts");

/** A client whose events come from the test, and what is asked of it. */
function clientOf() {
  const asked = [];
  let wake = () => undefined;
  const waiting = [];
  return {
    name: "alice",
    asked,
    clock: { age: () => undefined },
    channel: async (path) => void asked.push(["join", path]),
    refresh: async (path) => void asked.push(["refresh", path]),
    info: async () => ({}),
    tell(event) {
      waiting.push({ path: "/robot/arm", ...event });
      wake();
    },
    peer: {
      leave: async () => undefined,
      async *events() {
        for (;;) {
          for (const event of waiting.splice(0)) yield event;
          await new Promise((resolve) => (wake = resolve));
        }
      },
    },
  };
}

/** Waits until something holds, for five seconds at most. */
async function until(what) {
  for (const end = performance.now() + 5000; !what(); ) {
    assert.ok(performance.now() < end, `waited for ${what}`);
    await new Promise((resolve) => setImmediate(resolve));
  }
}
const state = (content, more = {}) => ({ type: "message", name: "state", sender: "arm", content, history: false, parcel: {}, ...more });
const member = { peer: "arm", user: "arm", level: 0 };

async function watching(watch = { state: true }) {
  const client = clientOf();
  const words = [];
  const feeds = new Feeds((word) => words.push(word), () => undefined);
  feeds.reset(client);
  const watches = (id, more = watch) => feeds.watch(id, { path: "/robot/arm", kind: "channel", ...more });
  await watches(1);
  client.asked.length = 0;
  return { client, feeds, watches, heard: (id = 1) => words.filter(({ word, watch }) => word === "events" && watch === id).flatMap(({ events }) => events) };
}

/** That all that was told before has been heard, and nothing is asked for in this turn of timers. */
async function marked({ client, heard }) {
  client.tell(state({ mark: true }));
  await until(() => heard().some(({ content }) => content?.mark));
  await new Promise((resolve) => setTimeout(resolve));
}

test("a state that was dropped is asked for again, and so are all when the link goes on", async () => {
  const one = await watching();
  one.client.tell({ type: "dropped", reason: "queue-full", delivery: "latest", count: 1, sender: "arm", receiver: "alice" });
  await until(() => one.client.asked.length);
  assert.deepEqual(one.client.asked, [["refresh", "/robot/arm"]]);
  const other = await watching();
  other.feeds.ask();
  await until(() => other.client.asked.length);
  assert.deepEqual(other.client.asked, [["refresh", "/robot/arm"]]);
  // Not more often than the hub can bear.
  one.feeds.ask();
  await marked(one);
  assert.equal(one.client.asked.length, 1);
  one.feeds.unwatch(1);
});

test("drops after which newer ones come, those of others, and channels that tell no states are left alone", async () => {
  const one = await watching();
  for (const more of [{ reason: "rate" }, { reason: "replaced" }, { reason: "queue-full", receiver: "bob" }, { reason: "queue-full", delivery: "fleeting" }]) one.client.tell({ type: "dropped", count: 1, receiver: "alice", ...more });
  await marked(one);
  assert.deepEqual(one.client.asked, []);
  const pictures = await watching({ pictures: 100 });
  pictures.feeds.ask();
  await marked(pictures);
  assert.deepEqual(pictures.client.asked, []);
});

test("who begins to watch hears that the device has gone, until it tells again", async () => {
  const { client, watches, heard } = await watching();
  client.tell(state({ moving: true }));
  client.tell({ type: "lost", member, within: 1000 });
  await until(() => heard().length === 2);
  await watches(2);
  await until(() => heard(2).length === 2);
  assert.deepEqual(heard(2).map(({ type }) => type), ["message", "lost"]);
  client.tell({ type: "resumed", member });
  await until(() => client.asked.length);
  assert.deepEqual(client.asked.at(-1), ["refresh", "/robot/arm"]);
  client.tell(state({ moving: false }));
  await until(() => heard().length === 4);
  await watches(3);
  await until(() => heard(3).length);
  assert.deepEqual(heard(3).map(({ type, content }) => [type, content?.moving]), [["message", false]]);
});

test("a device is unknown once it has gone, while the link is down, and after that until it tells", () => {
  const hub = { unknownSince: () => undefined };
  const teller = new Teller(hub);
  const gone = (type, peer) => teller.happens({ type, path: "/robot/arm", what: { member: { peer } }, arrived: 500 });
  gone("lost", "arm");
  assert.equal(teller.unknownSince, undefined, "it has told nothing");
  teller.tells({ sender: "arm", arrived: 100 });
  gone("left", "bob");
  assert.equal(teller.unknownSince, undefined);
  gone("left", "arm");
  assert.equal(teller.unknownSince, 500);
  teller.tells({ sender: "arm", arrived: 600 });
  assert.equal(teller.unknownSince, undefined);
  hub.unknownSince = (arrived) => (arrived < 800 ? 700 : undefined);
  assert.equal(teller.unknownSince, 700);
  teller.tells({ sender: "arm", arrived: 900 });
  assert.equal(teller.unknownSince, undefined);
});

test("a picture that is still on its way when its camera is shown no more is not said to be shown", async (t) => {
  const { CameraView } = await load("panels/camera/view.svelte.ts");
  const frames = [];
  globalThis.requestAnimationFrame = (then) => frames.push(then);
  t.after(() => delete globalThis.requestAnimationFrame);
  const handlers = new Map();
  const hub = { link: {}, watch: ({ path }, all) => (handlers.set(path, all), () => undefined) };
  const [hidden, shown] = ["/camera/x", "/camera/y"].map((path) => {
    const view = new CameraView(hub, path, () => undefined);
    view.start(640);
    handlers.get(path).picture({ bitmap: { width: 2, height: 2 }, content: {}, size: 1, born: Date.now(), error: 1, arrived: Date.now(), skipped: 0, watch: 1 });
    return view;
  });
  hidden.hide();
  for (const then of frames) then();
  await until(() => shown.glass);
  assert.deepEqual([hidden.glass, frames.length], [null, 2]);
});

test("a camera sees a device if it says so, stands beside it, names its states, or tells of the only robot; no other does", () => {
  const selection = new Selection({});
  selection.cameras = ["/camera/x", "/fleet/7/camera"];
  const device = (path) => ({ path, token: `${path}-token` });
  selection.devices = [device("/robot/arm"), device("/camera/x")];
  const sees = (camera, of = "/robot/arm", posed = false) => selection.sees(camera, of, posed);
  assert.deepEqual([sees("/camera/x"), sees("/camera/x", "/robot/arm", true)], [false, true]);
  selection.devices = [device("/robot/arm"), device("/fleet/7/robot"), device("/fleet/8/robot")];
  assert.deepEqual([sees("/camera/x", "/robot/arm", true), sees("/fleet/7/camera"), sees("/fleet/7/camera", "/fleet/7/robot"), sees("/fleet/7/camera", "/fleet/8/robot")], [false, false, true, false]);
  selection.proves("/camera/x", "/robot/arm");
  assert.deepEqual([sees("/camera/x"), sees("/camera/x", "/fleet/8/robot")], [true, false]);
  // What is chosen is chosen for one device.
  selection.device = "/fleet/8/robot";
  selection.choose("/fleet/7/camera");
  assert.deepEqual([selection.camera, sees("/fleet/7/camera", "/fleet/8/robot")], ["/fleet/7/camera", true]);
  selection.device = "/robot/arm";
  assert.deepEqual([selection.camera, sees("/fleet/7/camera")], ["/camera/x", false]);
  selection.device = "/fleet/7/robot";
  assert.equal(selection.camera, "/fleet/7/camera");
});
