// Drives the robot and stops it, through a hub of its own: the real programs over real sockets.
import assert from "node:assert/strict";
import { spawn, spawnSync } from "node:child_process";
import { once } from "node:events";
import { readFileSync, rmSync, writeFileSync } from "node:fs";
import { createInterface } from "node:readline";
import { after, before, test } from "node:test";

const programs = [];
let hub;

function start(command, words, env, output) {
  const program = spawn(command, words, { env: { ...process.env, ...env }, stdio: ["ignore", ...(output === 1 ? ["pipe", "inherit"] : ["ignore", "pipe"])] });
  programs.push(program);
  return createInterface({ input: program.stdio[output] });
}

before(async () => {
  let address;
  for await (const line of start("mom-broker", ["--config", "hub.toml", "--listen", "127.0.0.1:0"], {}, 2)) {
    address = /addresses=\[([^\],]+)/.exec(line)?.[1];
    if (address) break;
  }
  hub = `bin://${address}`;
  const [ready] = await once(start(process.execPath, ["robot.mjs"], { MOM_HUB: `mom://${address}` }, 1), "line");
  assert.equal(ready, "newbot is ready");
});

after(async () => {
  for (const program of programs.reverse()) {
    program.kill();
    if (program.exitCode === null && program.signalCode === null) await once(program, "exit");
  }
});

function mom(words, input = "") {
  const env = { ...process.env, MOM_HUB: hub, MOM_USER: "operator", MOM_PASSWORD: readFileSync("operator.password", "utf8").trim() };
  return spawnSync("mom", words, { env, input, encoding: "utf8", timeout: 30_000 });
}

const run = (script) => mom(["run", "--channel", "/newbot/robot", "--token", "/newbot/token", "-"], script);

test("it says what it can do", () => {
  assert.match(mom(["card", "/newbot/robot"]).stdout, /drive/);
});

test("it drives, and refuses what is out of its range", () => {
  const done = run("drive 100; turn 30\ndrive -50\n");
  assert.equal(done.status, 0, done.stderr);
  const refused = run("drive 5000");
  assert.equal(refused.status, 1, refused.stderr);
  assert.match(refused.stderr, /-2000 to 2000 mm/);
});

/** Tries to drive until it is refused in these words: it looks at its emergency stop each 150 ms. */
function untilRefused(words) {
  for (let most = 100; most > 0; most--) if (words.test(run("drive 1").stdout)) return;
  assert.fail(`never: ${words}`);
}

test("its emergency stop holds until it is reset and the stop is lifted", (t) => {
  t.after(() => rmSync("estop", { force: true }));
  writeFileSync("estop", "");
  untilRefused(/emergency stop/);
  assert.match(mom(["unstop", "/newbot"]).stdout, /emergency stop/);
  assert.match(run("drive 1").stdout, /emergency stop/, "nobody lifts it from afar");
  rmSync("estop");
  untilRefused(/is stopped/);
  assert.equal(mom(["unstop", "/newbot"]).status, 0);
  const done = run("drive 20");
  assert.equal(done.status, 0, done.stderr);
});

test("a stop holds until it is lifted", () => {
  assert.equal(mom(["stop", "/newbot"]).status, 0);
  assert.notEqual(run("drive 100").status, 0);
  assert.equal(mom(["unstop", "/newbot"]).status, 0);
  const done = run("drive 20");
  assert.equal(done.status, 0, done.stderr);
});
