// STOP, pressed in a browser: at once, over whichever connection there is, and what the page shows of devices meanwhile.
import assert from "node:assert/strict";
import { generateKeyPairSync } from "node:crypto";
import { readFileSync } from "node:fs";
import { after, before, beforeEach, test } from "node:test";
import { letGo, NETWORK, start, until } from "./lab.mjs";
import { FakeRobot, withRobots } from "./robot.mjs";

const PATH = "/bench/robot";
/** The uplink of a bad place, bytes a second. */
const UPLINK = 80_000;

const { privateKey, publicKey } = generateKeyPairSync("ed25519");
const users = readFileSync(new URL("../../config/lab-users.toml", import.meta.url), "utf8").replace(/^#:schema.*$/m, "");
const erin = `\n[[users]]\nname = "erin"\nkeys = ["ed25519 ${publicKey.export({ type: "spki", format: "der" }).subarray(-32).toString("base64")}"]\nlevel = 1\ngroups = []\n`;

let hub;
let robot;
/** When the robot has stopped. */
let stops = [];

before(async () => {
  hub = await start({ config: withRobots("/bench"), relay: true, files: { "lab-users.toml": users + erin } });
  robot = await FakeRobot.start(hub.host, "/bench");
  robot.onStop = (stopped) => stopped && stops.push(performance.now());
});
after(async () => {
  await robot?.end();
  await hub?.end();
});
beforeEach(async () => {
  hub.relay.thaw();
  Object.assign(hub.relay, { frozen: false, uplink: Infinity });
  await free();
  stops = [];
});

/** Lets all go, not by the page. */
async function free() {
  const { code, out } = await hub.mom("bob", "unstop");
  assert.ok(!(await robot.client.stops(PATH)).stopped, `${code}: ${out}`);
}

const button = (page) => page.locator("mom-stop button.stop");
const moves = (page) => page.locator("mom-status");
const drive = (t, options) => hub.page("alice", { t, allow: NETWORK, ...options });

async function middle(page) {
  const { x, y, width, height } = await button(page).boundingBox();
  return [x + width / 2, y + height / 2];
}

/** Presses, and gives how long it took until the robot stood, in ms. */
async function press(page, how = () => page.keyboard.down("Escape"), then = () => page.keyboard.up("Escape")) {
  const begun = performance.now();
  await how();
  await until(page, () => stops.length);
  await then();
  return stops[0] - begun;
}

/** That the stop has come by another peer than the page's: not over its link, whenever that goes on. */
async function goesAround(page) {
  // Nothing can be loaded while the link is frozen.
  const [me] = (await page.locator("mom-console .user .cut").innerText()).split(",");
  const { by } = await robot.client.stops(PATH);
  assert.ok(by !== me && by.split("~")[0] === me.split("~")[0], `${by}, and the page is ${me}`);
}

test("a mouse that is pressed on STOP and leaves it has stopped; one press is one stop", async (t) => {
  const page = await drive(t);
  const [x, y] = await middle(page);
  await page.mouse.move(x, y);
  await press(page, () => page.mouse.down(), () => page.mouse.move(x, y + 200));
  await page.mouse.up();
  await letGo(page);
  await page.locator("mom-stop .report").getByText("may move").first().waitFor();
  const before = await robot.client.stops(PATH);
  stops = [];
  await press(page, () => button(page).click(), () => undefined);
  await button(page).dblclick({ trial: true });
  const { number } = await robot.client.stops(PATH);
  // The next number after that of the press before: nothing was stopped in between, nor twice.
  assert.equal(number, before.number + 1);
});

test("a finger that slides off STOP has stopped", async (t) => {
  const page = await drive(t, { hasTouch: true });
  const [x, y] = await middle(page);
  const session = await page.context().newCDPSession(page);
  const touch = (type, touchPoints) => session.send("Input.dispatchTouchEvent", { type, touchPoints });
  await press(page, () => touch("touchStart", [{ x, y }]), () => touch("touchMove", [{ x, y: y + 25 }]));
  await touch("touchEnd", []);
});

test("STOP with the focus stops when a key goes down, and by a click of assistive technology", async (t) => {
  const page = await drive(t);
  for (const key of [" ", "Enter"]) {
    await button(page).focus();
    await press(page, () => page.keyboard.down(key), () => page.keyboard.up(key));
    await free();
    stops = [];
  }
  await press(page, () => button(page).evaluate((button) => button.click()), () => undefined);
});

test("STOP is red in both colour schemes, and far from what lets go, which asks first and names who stopped what and why", async (t) => {
  const page = await drive(t);
  const boxOf = (locator) => locator.boundingBox();
  for (const [colorScheme, viewport] of [["light", { width: 1280, height: 900 }], ["dark", { width: 360, height: 740 }]]) {
    await page.emulateMedia({ colorScheme });
    await page.setViewportSize(viewport);
    assert.equal(await button(page).evaluate((button) => getComputedStyle(button).backgroundColor), "rgb(211, 34, 42)");
    const [stop, free] = [await boxOf(button(page)), await boxOf(page.getByRole("button", { name: "Let go" }))];
    assert.ok(free.x - (stop.x + stop.width) >= 24, `${free.x - (stop.x + stop.width)} px`);
  }
  await page.setViewportSize({ width: 1280, height: 900 });
  await robot.client.stop(PATH, { reason: "smoke" });
  await page.locator("mom-stopped").getByText(/Stopped by carol.*: smoke/).waitFor();
  await page.getByRole("button", { name: "Let go" }).click();
  const question = page.locator("mom-stop").getByRole("dialog");
  await question.getByText(/Stopped by carol.*: smoke/).waitFor();
  await question.getByText(PATH, { exact: true }).waitFor();
  const [stop, yes] = [await boxOf(button(page)), await boxOf(question.getByRole("button", { name: "Free this one" }))];
  assert.ok(yes.y - (stop.y + stop.height) >= 24);
  assert.ok((await robot.client.stops(PATH)).stopped, "nothing was let go yet");
  // STOP closes the question: what it named is not what holds now.
  await page.keyboard.press("Escape");
  await question.waitFor({ state: "hidden" });
});

test("who has stopped what, and why, stands in the frame of every page as long as it holds", async (t) => {
  const page = await drive(t);
  const line = page.locator("mom-stopped li");
  await robot.client.stop(PATH, { reason: "a hand is in it" });
  for (const name of ["Contexts", "Peers", "Health"]) {
    await page.getByRole("link", { name, exact: true }).click();
    await line.getByText(/Stopped by carol.*: a hand is in it/).waitFor();
    await line.getByText(PATH).waitFor();
  }
  await free();
  await line.waitFor({ state: "detached" });
});

test("the report says how each device's rest is known, as it becomes known, and the line above how it stands", async (t) => {
  const page = await drive(t);
  await page.getByRole("combobox", { name: "Device" }).selectOption(PATH);
  const line = page.locator("mom-stop .report li").filter({ hasText: PATH });
  await robot.moves(true);
  await moves(page).getByText("moving", { exact: true }).waitFor();
  await press(page);
  // It obeys at once, and rolls.
  await line.getByText("obeys, coming to rest…").waitFor();
  await moves(page).getByText("stopped, moving").waitFor();
  assert.equal(await line.locator(".good").count(), 0);
  await line.locator(".danger").getByText(/obeys, still moving after/).waitFor();
  await robot.moves(false);
  await line.locator(".good").getByText(/at rest, measured, after/).waitFor();
  await moves(page).getByText("stopped, at rest, measured").waitFor();
  for (const [said, inReport, inLine] of [
    [{ rest: "not-measured" }, /at rest, not measured, after/, "stopped, at rest, not measured"],
    [{ rest: undefined }, /obeys, rest unknown after/, "stopped, rest unknown"],
    [{ rest: undefined, reached: undefined }, /obeys after .*, rest not reported/, "stopped, rest not reported"],
    [{ moving: true, rest: undefined, reached: false }, /obeys, and is not reached$/, /stopped, not reached since \d\d:\d\d:\d\d$/],
    [{ "unreached-since": (Date.now() - 3_600_000) * 1000 }, /obeys, and is not reached since \d\d:\d\d:\d\d$/, /stopped, not reached since \d\d:\d\d:\d\d$/],
  ]) {
    await robot.tells(said);
    await line.getByText(inReport).waitFor();
    await moves(page).getByText(inLine).waitFor();
  }
  await robot.moves(false);
});

test("of many devices those that need attention come first", async (t) => {
  const page = await drive(t);
  await page.evaluate(async () => {
    const { hubOf } = await import("/panels.js");
    const devices = Array.from({ length: 120 }, (_, at) => ({ path: `/herd/${at}`, device: "herd", word: "obeys", after: 5, rest: "measured", told: 340 }));
    devices[90] = { ...devices[90], rest: "moving", told: 3000 };
    devices[110] = { path: "/herd/110", device: "herd", word: "silent" };
    hubOf().order = { order: "stop", top: "/", at: Date.now(), devices, refused: [], newer: [], empty: [], denied: [], over: true, taken: true, missed: false, trying: [] };
  });
  const report = page.locator("mom-stop .report");
  await report.getByText("118 of 120 at rest").waitFor();
  const lines = await report.locator("li").allInnerTexts();
  assert.match(lines[0], /\/herd\/90 .*still moving after 3\.0 s/);
  assert.match(lines[1], /\/herd\/110 .*has not confirmed/);
  assert.deepEqual([lines.length, lines.at(-1)], [53, "and 68 more, which need no attention"]);
  assert.equal(await page.locator("mom-stop .report.calm").count(), 0);
});

test("a stop goes around a link that is frozen", async (t) => {
  const page = await drive(t);
  await moves(page).getByText("connected").waitFor();
  hub.relay.freeze();
  const took = await press(page);
  await goesAround(page);
  assert.ok(took < 1000, `${took} ms`);
  hub.relay.thaw();
  await page.locator("mom-stop .report").getByText(/at rest, measured, after/).waitFor();
});

test("a stop goes around a link that is frozen for who has logged in by a key, too", async (t) => {
  const page = await hub.open("/", { t, allow: NETWORK });
  await page.getByText("Key", { exact: true }).click();
  await page.getByLabel("User", { exact: true }).fill("erin");
  await page.getByLabel("Private key (PEM, Ed25519)").fill(privateKey.export({ type: "pkcs8", format: "pem" }));
  await page.getByRole("button", { name: "Log in" }).click();
  await moves(page).getByText("connected").waitFor();
  hub.relay.freeze();
  const took = await press(page);
  await goesAround(page);
  assert.ok(took < 1000, `${took} ms`);
  hub.relay.thaw();
});

test("a stop goes around the link's own attempts, which hang", async (t) => {
  const page = await drive(t);
  hub.relay.freeze();
  hub.relay.frozen = true;
  await moves(page).getByText("link lost, resuming").waitFor();
  // The attempt that is under way has no answer still.
  await until(page, () => hub.relay.hangs > 0);
  hub.relay.frozen = false;
  const took = await press(page);
  // What hangs has ten seconds.
  assert.ok(took < 1000, `${took} ms`);
  hub.relay.thaw();
});

test("a stop gets out as soon as the network does, though all that was tried before hangs", async (t) => {
  const page = await drive(t);
  hub.relay.freeze();
  hub.relay.frozen = true;
  await page.keyboard.press("Escape");
  await until(page, () => hub.relay.hangs > 1);
  hub.relay.frozen = false;
  const took = await press(page, () => undefined, () => undefined);
  assert.ok(took < 1500, `${took} ms`);
  await page.locator("mom-stop .report").getByText(/at rest, measured, after/).waitFor();
  hub.relay.thaw();
});

test("a stop gets through where the page itself fills a narrow uplink", async (t) => {
  const page = await drive(t);
  hub.relay.uplink = UPLINK;
  await page.evaluate(async () => {
    const { hubOf } = await import("/panels.js");
    for (let count = 0; count < 100; count += 1) void hubOf().call("send", "/chat", "chat", "x".repeat(40_000), { echo: false }).catch(() => undefined);
  });
  await until(page, () => hub.relay.waits);
  const took = await press(page);
  // What waits takes 50 s.
  assert.ok(took < 1000, `${took} ms`);
  hub.relay.uplink = Infinity;
});

test("where nobody takes it, the devices that were not reached are named", async (t) => {
  const page = await drive(t);
  await page.getByRole("combobox", { name: "Device" }).waitFor();
  Object.assign(hub.relay, { closed: true });
  hub.relay.cut();
  await moves(page).getByText(/link lost/).first().waitFor();
  await page.keyboard.press("Escape");
  await page.locator("mom-stop .report").getByText(/Not reached.*\/bench\/robot/).waitFor();
  hub.relay.closed = false;
  await until(page, () => stops.length);
});

test("what was dropped while the link was lost is asked for again, and is unknown until it is told", async (t) => {
  const page = await drive(t);
  const select = page.getByRole("combobox", { name: "Device" });
  await select.selectOption(PATH);
  await robot.moves(true);
  await moves(page).getByText("moving").waitFor();
  const unknown = moves(page).getByText(/unknown since \d\d:\d\d:\d\d/);
  hub.relay.closed = true;
  // What the robot says into a connection that is dead already is lost with it.
  hub.relay.freeze();
  await robot.moves(false);
  hub.relay.cut();
  await unknown.waitFor();
  hub.relay.closed = false;
  await moves(page).getByText("connected").waitFor();
  await moves(page).getByText("at rest").waitFor();
});

test("a device that is gone is unknown since then, and known again when it is back", async (t) => {
  const page = await drive(t);
  await page.getByRole("combobox", { name: "Device" }).selectOption(PATH);
  const unknown = moves(page).getByText(/unknown since \d\d:\d\d:\d\d/);
  await robot.moves(true);
  // Of a device that the page has never heard nothing is unknown.
  await moves(page).getByText("moving").waitFor();
  await robot.end();
  await unknown.waitFor();
  robot = await FakeRobot.start(hub.host, "/bench");
  robot.onStop = (stopped) => stopped && stops.push(performance.now());
  await unknown.waitFor({ state: "detached" });
});
