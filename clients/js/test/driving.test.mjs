// Driving over sockets: the lab's arm, a cart in a process of its own that is killed, devices that say what a test has them say, and a
// broker that goes.
import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { existsSync, mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { createInterface } from "node:readline";
import test from "node:test";
import { fileURLToPath } from "node:url";
import { device, number, sleep, verb } from "../dist/device.js";
import { Commander, DriveError, drive } from "../dist/drive.js";
import { connect } from "../dist/mom-client.js";
import { as, program, startLab, until } from "./lab.mjs";

const ARM = "/robot/arm";
const [, example] = /## Drive a device\n[\s\S]*?```js\n([\s\S]*?)```/.exec(readFileSync(new URL("../README.md", import.meta.url), "utf8"));

/** The first line of a program that fits; an error if it ends before. */
function lineOf(child, pattern) {
  return new Promise((resolve, reject) => {
    child.once("error", reject);
    child.once("exit", (code) => reject(new Error(`it ended with ${code} before it said ${pattern}`)));
    createInterface(child.stdout).on("line", (line) => pattern.test(line) && resolve(pattern.exec(line)));
  });
}

/** The whole lab, with the arm: `mom` beside the broker. */
async function startArm(t) {
  const mom = join(dirname(program), "mom");
  assert.ok(existsSync(mom), `${mom} is missing: build it by \`cargo build -p mom\``);
  const folder = mkdtempSync(join(tmpdir(), "mom-js-"));
  const env = { ...process.env, XDG_STATE_HOME: folder, STATE_DIRECTORY: "" };
  const stdio = ["ignore", "pipe", process.env.MOM_LOG ? "inherit" : "ignore"];
  const child = spawn(mom, ["lab", "--listen", "127.0.0.1:0"], { stdio, env });
  t.after(async () => {
    const ended = new Promise((resolve) => child.once("exit", resolve));
    if (child.exitCode === null && child.kill()) await ended;
    rmSync(folder, { recursive: true, force: true });
  });
  return Number((await lineOf(child, /:\/\/127\.0\.0\.1:(\d+)/))[1]);
}

/** Opens clients at a hub, which are closed with the test. */
const opener = (t, port) => async (user, options) => {
  const client = await connect(`ws://127.0.0.1:${port}`, as(user, options));
  t.after(() => client.close());
  return client;
};

/** A broker of the test's own. */
async function broker(t) {
  const lab = await startLab();
  t.after(() => lab.stop());
  return { lab, open: opener(t, lab.port) };
}

/** A command that is under way, once the device carries it out; and its end. */
async function executing(arm, command) {
  let end;
  await new Promise((resolve, reject) => {
    end = arm.carryOut(command, { told: ({ state }) => state === "executing" && resolve() });
    end.then(({ text }) => reject(new Error(`it has ended: ${text}`)));
  });
  return { end };
}

/** What a device says of commands, as a peer of its channel hears it. */
async function statuses(client) {
  const events = (await client.channel(ARM)).events();
  return (state) => until(events, (event) => event.type === "message" && event.name === "status" && event.content.state === state);
}

test("the arm carries commands out, tells how far it is, and refuses what it cannot do", async (t) => {
  const open = opener(t, await startArm(t));
  const alice = await open("alice");
  const arm = await drive(alice, ARM);
  const told = [];
  const home = await arm.carryOut("home; wait 10", { told: ({ state, statement, of }) => told.push(`${state} ${statement}/${of}`) });
  const name = "finished";
  assert.deepEqual(home, { how: { kind: name, of: 2 }, finished: true, name, text: name, hint: undefined, error: undefined });
  assert.deepEqual(told, ["waiting 0/2", "executing 1/2", "executing 2/2"]);
  const { z } = arm.state.pose;
  const up = await arm.carryOut({ text: "by 0 0 10 0 0", basedOn: "newest" });
  assert.equal(up.text, "finished");
  assert.ok(Math.abs(arm.state.pose.z - z - 10) < 1, `from ${z} to ${arm.state.pose.z}`);
  const far = await arm.carryOut("move 9000 0 0 0 0");
  assert.deepEqual([far.finished, far.name, far.error.name, far.error.code], [false, "workspace-boundary", "workspace-boundary", 5002]);
  assert.match(far.text, /^statement 1: .* \[workspace-boundary 5002\]$/);
  const wrong = await arm.carryOut("mvoe 1");
  assert.match(wrong.text, /^statement 1: there is no `mvoe`; did you mean `move`\? \[syntax 5001\]$/);
  const { channels } = await alice.stop(ARM);
  const stopped = await arm.carryOut("home");
  assert.deepEqual([stopped.name, stopped.hint], ["stopped", "let it go with: mom unstop /robot/arm"]);
  await alice.unstop(ARM, channels[0].number);
  assert.equal((await arm.carryOut("home")).text, "finished");
  await arm.end();
  assert.equal((await (await alice.token("/robot/token")).info()).owner, undefined);
});

test("who loses the token to a higher level hears that the arm has ended the command", async (t) => {
  const open = opener(t, await startArm(t));
  const arm = await drive(await open("alice"), ARM);
  const { end } = await executing(arm, "wait 60000");
  await assert.rejects(arm.carryOut("home"), { name: "DriveError", text: "a command to /robot/arm is under way" });
  const carols = await drive(await open("carol"), ARM);
  const { how, name, text, hint } = await end;
  assert.deepEqual([how.kind, how.lost, how.ended, name, hint], ["lost", { reason: "preempted", by: "carol" }, true, "lost", undefined]);
  assert.equal(text, "lost /robot/token: carol has a higher level and took it; the device has ended the command");
  const later = await arm.carryOut("home");
  assert.equal(later.text, "lost /robot/token: carol has a higher level and took it; nothing of the command ran");
  // Which halts nothing of hers.
  const hers = await executing(carols, "wait 500");
  await arm.end();
  assert.equal((await hers.end).text, "finished");
  await carols.end();
});

test("who ends the work while a command runs hears that the arm has ended it", async (t) => {
  const open = opener(t, await startArm(t));
  const hears = await statuses(await open("bob"));
  const alice = await open("alice");
  const arm = await drive(alice, ARM);
  const { end } = await executing(arm, "wait 60000");
  await arm[Symbol.asyncDispose ?? Symbol.for("Symbol.asyncDispose")]();
  const { content } = await hears("error");
  assert.deepEqual([content.peer, content.error.name], ["alice", "halted"]);
  assert.equal((await end).text, "lost /robot/token: released; the device has ended the command");
  assert.equal(arm.guard.isLost.reason, "released");
  assert.equal((await arm.carryOut("home")).text, "lost /robot/token: released; nothing of the command ran");
  await arm.end();
  assert.equal((await alice.stops(ARM)).stopped, false);
});

test("the README's example drives the arm", async (t) => {
  assert.ok(example.trimEnd().split("\n").filter(Boolean).length <= 15);
  const port = await startArm(t);
  const open = opener(t, port);
  const said = [];
  const console = { log: (...words) => said.push(words.map((word) => word.state ?? word).join(" ")) };
  const AsyncFunction = (async () => undefined).constructor;
  const code = example.replace(/^import .*$/gm, "");
  await new AsyncFunction("connect", "drive", "console", code)(() => open("alice"), drive, console);
  assert.deepEqual(said, ["waiting", "executing", "executing", "the grip is at 200 mm"]);
});

/** A cart that waits, in a process of its own. */
const CART = `
import { WebSocket } from "ws";
import { device } from "./dist/device.js";
import { connect } from "./dist/mom-client.js";
const client = await connect(process.argv[1], { user: "arm", password: "arm", webSocket: WebSocket });
await client.obey("/robot/arm", device("cart", { does: "A cart", verbs: {}, halt() {}, position: () => ({}) }));
console.log("obeys");
`;

test("a device that is killed while it carries a command out is gone", async (t) => {
  const { lab, open } = await broker(t);
  const cwd = fileURLToPath(new URL("..", import.meta.url));
  const args = ["--input-type=module", "-e", CART, `ws://127.0.0.1:${lab.port}`];
  const cart = spawn(process.execPath, args, { cwd, stdio: ["ignore", "pipe", "inherit"] });
  t.after(() => cart.kill("SIGKILL"));
  await lineOf(cart, /obeys/);
  const arm = await drive(await open("alice"), ARM);
  const { end } = await executing(arm, "wait 60000");
  cart.kill("SIGKILL");
  const { how, name, text, hint } = await end;
  assert.deepEqual([how, name], [{ kind: "gone", device: "arm", missed: true }, "gone"]);
  assert.equal(text, "the hub has lost the connection of arm, the device in /robot/arm; what became of the command is not known");
  assert.equal(hint, "see who is there: mom tree /robot");
  // Of it nothing is heard any more.
  const silent = "the device in /robot/arm has not said that it has ended its command, though the hub was asked to halt it, and 3 times to stop it";
  await assert.rejects(arm.end(), { text: silent, hint: "go and look; switch it off where it moves" });
});

test("where nobody is, nobody answers", async (t) => {
  const { open } = await broker(t);
  const arm = await drive(await open("alice"), ARM);
  const { name, text, hint } = await arm.carryOut("home");
  assert.deepEqual([name, text, hint], ["no-answer", "no device answers in /robot/arm", "see who is there: mom tree /robot"]);
  await arm.end();
});

test("what is not to be driven is refused", async (t) => {
  const { open } = await broker(t);
  const [alice, bob] = [await open("alice"), await open("bob")];
  await assert.rejects(drive(alice, "/chat"), { name: "DriveError", text: "no token guards /chat, so it cannot be owned" });
  const arm = await drive(alice, ARM);
  await assert.rejects(drive(bob, ARM), { name: "MomError", code: "held", owner: "alice" });
  const waits = drive(bob, ARM, { wait: 20_000 });
  await arm.end();
  await (await waits).end();
});

/** A device that says what a test has it say: `answer` gives reports for a command, `stopped` for a stop. */
async function puppet(t, open, { answer = () => [], stopped = () => [], state } = {}) {
  const client = await open("arm");
  const channel = await client.channel(ARM, { device: true });
  const say = (parcel, reports) => {
    for (const report of reports) {
      const content = { id: parcel.id, peer: parcel.sender, fence: parcel.fence, statement: 0, of: 1, ...report };
      void channel.send("status", content, { echo: false, reference: parcel.id });
    }
  };
  const heard = [];
  const events = channel.events();
  void (async () => {
    for await (const { type, name, parcel } of events) {
      if (type !== "message") continue;
      if (name === "command") say(heard[heard.push(parcel) - 1], answer(parcel, heard.length));
      if (name === "stop") say(heard.at(-1), stopped(parcel));
    }
  })();
  if (state) await channel.sendAcknowledged("state", state, { echo: false, delivery: "latest" });
  return { client, channel, heard, tell: (reports) => say(heard.at(-1), reports) };
}

const HALTED = { state: "error", error: { name: "halted", code: 5101, text: "it was stopped" } };

test("a device that does not end its command at the hub's halt is stopped", async (t) => {
  const { open } = await broker(t);
  await puppet(t, open, { answer: () => [{ state: "executing", statement: 1 }], stopped: () => [HALTED] });
  const alice = await open("alice");
  const arm = await drive(alice, ARM);
  const { end } = await executing(arm, "home");
  const ended = arm.end();
  assert.equal(arm.end(), ended);
  await assert.rejects(ended, (error) => {
    assert.ok(error instanceof DriveError);
    assert.equal(error.text, "the device in /robot/arm did not end its command when the hub halted it, so it was stopped");
    assert.equal(error.hint, "see what is wrong with it, then let it go with: mom unstop /robot/arm");
    return true;
  });
  assert.equal((await end).how.ended, true);
  const { stopped, reason } = await alice.stops(ARM);
  assert.deepEqual([stopped, reason], [true, "it did not end a command when its token was given back"]);
});

test("what came while the device was changing hands is sent again when it stands for its owner", async (t) => {
  const { open } = await broker(t);
  const changing = { state: "error", error: { name: "changing-hands", code: 5105, text: "it still moves", retry: true } };
  const at = await puppet(t, open, { answer: (_, count) => [count === 1 ? changing : { state: "finished", statement: 1 }] });
  const arm = await drive(await open("alice"), ARM);
  await at.channel.sendAcknowledged("state", { moving: true, fence: arm.guard.fence - 1 }, { echo: false });
  const told = [];
  const end = await arm.carryOut("home", {
    told: (progress) => {
      told.push(progress);
      void at.channel.send("state", { moving: false, fence: arm.guard.fence }, { echo: false });
    },
  });
  assert.equal(end.text, "finished");
  assert.deepEqual(told, [{ kind: "again", why: "changing-hands", text: "it still moves" }]);
  assert.deepEqual(at.heard.map(({ content, fence }) => [content, fence]), [["home", arm.guard.fence], ["home", arm.guard.fence]]);
  await arm.end();
});

test("a command says what it is based on, how long it is worth something, what it answers, and the bytes that it names", async (t) => {
  const { open } = await broker(t);
  const at = await puppet(t, open, { answer: () => [{ state: "finished", statement: 1 }] });
  const arm = await drive(await open("alice"), ARM);
  const sound = Uint8Array.of(1, 2, 3);
  const end = arm.carryOut({ text: "play horn", attachments: { horn: sound }, basedOn: 40, expires: 5000, whenAsked: true });
  await at.channel.sendAcknowledged("next", undefined, { echo: false, extra: {} });
  assert.equal((await end).text, "finished");
  const [{ content, extra, expires, reference }] = at.heard;
  assert.deepEqual([content.script, [...content.attachments.horn], extra["based-on"], expires], ["play horn", [1, 2, 3], 40, 5000]);
  assert.ok(reference > 0);
  await arm.end();
});

test("who holds the token for a commander says that it is lost", async (t) => {
  const { open } = await broker(t);
  await puppet(t, open, { answer: () => [{ state: "executing", statement: 1 }] });
  const [alice, carol] = [await open("alice"), await open("carol")];
  const channel = await alice.channel(ARM);
  const guard = await (await alice.token("/robot/token")).grab();
  const commander = new Commander(alice, channel, guard.fence);
  assert.equal(await new Commander(alice, channel, guard.fence).lost({ reason: "expired" }), undefined);
  const { end } = await executing(commander, "home");
  await (await carol.token("/robot/token")).grab();
  const lost = await commander.lost(await guard.lost);
  assert.equal(lost, await end);
  assert.equal(lost.text, "lost /robot/token: carol has a higher level and took it; the device has not said that it has ended the command");
  assert.equal(lost.hint, "go and look; switch it off where it moves");
  await commander.end(() => assert.fail("there is nothing to give back"));
});

test("a token that the hub does not take back is told", async (t) => {
  const { open } = await broker(t);
  const alice = await open("alice");
  const channel = await alice.channel(ARM);
  const guard = await (await alice.token("/robot/token")).grab();
  const cause = new Error("no");
  const refuses = () => {
    throw cause;
  };
  await assert.rejects(new Commander(alice, channel, guard.fence).end(refuses), { text: "release /robot/token: no", cause });
});

test("with the link the token is lost", async (t) => {
  const { lab, open } = await broker(t);
  await puppet(t, open, { answer: () => [{ state: "executing", statement: 1 }] });
  const arm = await drive(await open("alice", { link: false, reconnect: false }), ARM);
  const { end } = await executing(arm, "home");
  lab.signal("SIGKILL");
  const { name, text } = await end;
  const lost = "the connection to the hub is lost, and the token with it";
  assert.deepEqual([name, text], ["disconnected", `${lost}; what became of the command is not known`]);
  assert.equal((await arm.carryOut("home")).text, `${lost}; nothing of the command ran`);
  await arm.end();
});

test("what is said before the token was granted is known: the newest state", async (t) => {
  const { open } = await broker(t);
  const by = verb.relative("Drives so far", { way: number() }, (_, signal) => sleep(10, signal));
  const cart = device("cart", { does: "A cart", verbs: { by }, halt() {}, position: () => ({ x: 7 }), stopsWithin: 50 });
  await (await open("arm")).obey(ARM, cart);
  const [alice, bob] = [await open("alice"), await open("bob")];
  const alices = await drive(alice, ARM);
  const bobs = drive(bob, ARM, { wait: 20_000 });
  await alices.end();
  const arm = await bobs;
  assert.equal((await arm.carryOut({ text: "by 5", basedOn: "newest" })).text, "finished");
  assert.equal(arm.state.x, 7);
  await arm.end();
});
