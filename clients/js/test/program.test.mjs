// What ends the program of the README's robot: signals and exceptions, in a process of its own, at a broker. A halt is the last thing.
import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { once } from "node:events";
import { readFileSync } from "node:fs";
import { createInterface } from "node:readline";
import test from "node:test";
import { fileURLToPath } from "node:url";
import { runs } from "../dist/device.js";
import { connect } from "../dist/mom-client.js";
import { as, startLab } from "./lab.mjs";

const [, example] = /## A robot\n[\s\S]*?```js\n([\s\S]*?)```/.exec(readFileSync(new URL("../README.md", import.meta.url), "utf8"));

/** Motors that say what they are told, and functions that go on when they were to end: `late` for a while, `stuck` for ever. */
const MOTORS = `
import { writeSync } from "node:fs";
import { WebSocket } from "ws";
globalThis.WebSocket = WebSocket;
const say = (...words) => writeSync(1, words.join(" ") + "\\n");
const goesOn = {
  late: (resolve) => setTimeout(() => (say("sets"), resolve()), 50),
  stuck: () => setInterval(say, 5, "sets"),
};
const motors = {
  brake: () => say("brake"),
  driveTo: (x, signal) => new Promise((resolve) => {
    signal.addEventListener("abort", () => goesOn[process.env.GOES_ON](resolve));
    say("drives", x);
  }),
  position: () => 7,
};
const ends = {
  throw: () => { throw new Error("no power"); },
  reject: () => void Promise.reject(new Error("no power")),
  exit: () => process.exit(3),
};
process.stdin.on("data", (how) => ends[how]());
`;

/** The robot in a process of its own, at a lab, where it drives. */
async function driving(t, { goesOn = "late", stopsWithin = 500 } = {}) {
  const lab = await startLab();
  t.after(() => lab.stop());
  const said = example.replace("mom://lab.example.org", `ws://127.0.0.1:${lab.port}`).replace('"secret"', '"arm"').replace("stopsWithin: 500", `stopsWithin: ${stopsWithin}`);
  const child = spawn(process.execPath, ["--input-type=module", "-e", MOTORS + said], {
    cwd: fileURLToPath(new URL("..", import.meta.url)),
    env: { ...process.env, GOES_ON: goesOn },
    stdio: ["pipe", "pipe", "pipe"],
  });
  t.after(() => child.kill("SIGKILL"));
  const robot = { child, told: [], log: "" };
  child.stderr.on("data", (data) => (robot.log += data));
  robot.lines = createInterface(child.stdout);
  robot.lines.on("line", (line) => robot.told.push(line));
  robot.ended = Promise.all([once(child, "exit"), once(robot.lines, "close")]).then(([[code]]) => code);
  robot.hears = async (words) => {
    while (!robot.told.includes(words)) await Promise.race([once(robot.lines, "line"), robot.ended.then((code) => assert.fail(`${words}: it ended with ${code}: ${robot.log}`))]);
  };
  const alice = await connect(`ws://127.0.0.1:${lab.port}`, as("alice"));
  t.after(() => alice.close());
  const arm = await alice.channel("/robot/arm");
  const events = arm.events();
  // It obeys when it has heard how it stands.
  for await (const event of events) if (event.type === "message" && event.name === "state" && event.content.rest) break;
  const { fence } = await (await alice.token("/robot/token")).grab();
  await arm.sendAcknowledged("command", "go 10", { fence });
  await robot.hears("drives 10");
  robot.told.length = 0;
  return robot;
}

const SIGNALS = { SIGINT: 130, SIGTERM: 143, SIGHUP: 129 };

for (const [signal, code] of Object.entries(SIGNALS)) {
  test(`at ${signal} it halts, lets its function end, and halts again`, async (t) => {
    const robot = await driving(t);
    robot.child.kill(signal);
    assert.equal(await robot.ended, code, robot.log);
    assert.deepEqual([robot.told[0], robot.told.at(-1), robot.told.includes("sets")], ["brake", "brake", true], robot.told);
    assert.equal(robot.log, "");
  });
}

for (const how of ["throw", "reject"]) {
  test(`where nobody catches what its program does, it halts, says why, and ends: ${how}`, async (t) => {
    const robot = await driving(t);
    robot.child.stdin.write(how);
    assert.equal(await robot.ended, 1, robot.log);
    assert.deepEqual([robot.told[0], robot.told.at(-1), robot.told.includes("sets")], ["brake", "brake", true], robot.told);
    assert.match(robot.log, /no power/);
  });
}

test("a function that does not end keeps it no longer than it may take to stand", async (t) => {
  const robot = await driving(t, { goesOn: "stuck" });
  robot.child.kill("SIGTERM");
  assert.equal(await robot.ended, 143, robot.log);
  assert.deepEqual([robot.told.includes("sets"), robot.told.at(-1)], [true, "brake"], robot.told);
});

test("a second signal ends it at once, with a halt", async (t) => {
  const robot = await driving(t, { goesOn: "stuck", stopsWithin: 600_000 });
  robot.child.kill("SIGTERM");
  await robot.hears("sets");
  robot.child.kill("SIGINT");
  assert.equal(await robot.ended, 143, robot.log);
  assert.equal(robot.told.at(-1), "brake");
});

test("it is halted where its own program ends it", async (t) => {
  const robot = await driving(t);
  robot.child.stdin.write("exit");
  assert.equal(await robot.ended, 3, robot.log);
  assert.equal(robot.told.at(-1), "brake");
});

test("in a page it does nothing", () => {
  const { process } = globalThis;
  try {
    delete globalThis.process;
    const obeying = {};
    assert.equal(runs(obeying), obeying);
  } finally {
    globalThis.process = process;
  }
  assert.equal(process.listenerCount("SIGTERM"), 0);
});
