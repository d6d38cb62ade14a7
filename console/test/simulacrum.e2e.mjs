// The mirror of a robot and the modeller in a browser, against a hub with a peer that says what the middle of a robot says.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { after, before, test } from "node:test";
import { findings, letGo, start, staysQuick, until } from "./lab.mjs";
import { RawPeer } from "./rawpeer.mjs";
import { CUBO, FakeRobot, withRobots } from "./robot.mjs";

let hub;
let robot;
let other;

before(async () => {
  hub = await start({ config: withRobots("/cubo", "/many", "/zoe") });
  robot = (await FakeRobot.start(hub.host, "/cubo")).run();
  other = (await FakeRobot.start(hub.host, "/zoe", "carol", CUBO.slice(0, 2))).run();
});
after(async () => {
  await robot?.end();
  await other?.end();
  await hub?.end();
});

async function open(t, user, options = {}) {
  const page = await hub.page(user, { t, path: "/#/simulacrum", ...options });
  const mirror = page.locator("mom-simulacrum");
  await mirror.locator("tbody[data-element]").nth(15).waitFor();
  return { page, mirror, row: (name) => mirror.locator(`tbody[data-element="${name}"]`), bit: (place) => mirror.locator(`[data-bit="${place}"]`) };
}

const accessible = async (page) => {
  // What is scrolled under the head has no size to be touched.
  await page.evaluate(() => scrollTo(0, 0));
  assert.deepEqual(await findings(page), []);
  assert.ok(await page.evaluate(() => document.documentElement.scrollWidth <= innerWidth), "nothing is wider than the page");
};

// A lamp is a new one at each packet, and one that was replaced has no style: it is looked up and read in one turn of the page.
const lamp = (bit) => bit.evaluate((item) => {
  const { animationName: animation, backgroundColor: colour } = getComputedStyle(item.querySelector(".light.down"));
  return { animation, colour };
});

async function grab(mirror) {
  await mirror.getByRole("button", { name: "Grab", exact: true }).click();
  await mirror.getByRole("button", { name: "Give back" }).waitFor();
}

const release = async (mirror) => {
  await mirror.getByRole("button", { name: "Give back" }).click();
  await mirror.getByText("Nobody holds it.").waitFor();
};

test("all elements stand in the order of the map, with their values, states and ages", async (t) => {
  const { page, mirror, row } = await open(t, "alice");
  assert.deepEqual(await mirror.locator("tbody[data-element]").evaluateAll((rows) => rows.map(({ dataset }) => dataset.element)), CUBO.map(({ name }) => name));
  await row("surroundings").getByText("812 mm, 340 lx, 41.5 dB, 0, 296.4 K, 11.9 V").waitFor();
  await row("message-recorded").getByText("1 event").waitFor();
  await mirror.getByText("session up").waitFor();
  await mirror.getByText("−2.4 s ± 1.9 ms").waitFor();
  await mirror.getByText("none dropped").waitFor();
  // A value that does not change is as new as the robot's last word.
  const age = row("pose").locator(".age");
  await until(page, async () => /^\d+(\.\d)? ms/.test(await age.innerText()));

  // What is wanted and not confirmed is marked until it is.
  await robot.say("joints", { wanted: [10, 20, 30] });
  await row("joints").locator(".apart").getByText("not confirmed").waitFor();
  await row("joints").getByText("10, 20, 30 deg").waitFor();
  await robot.say("joints", { value: [10, 20, 30] });
  await row("joints").getByText("as wanted").waitFor();
  assert.equal(await row("joints").locator(".apart").count(), 0);
  await row("joints").getByRole("img", { name: /^joints, the last 60 s: 0 deg to 10 deg$/ }).waitFor();

  await robot.say("lips", { activated: false });
  await row("lips").getByText("not yet off").waitFor();
  await robot.say("lips", { active: false });
  await row("lips").getByText("off", { exact: true }).waitFor();
  await robot.say("lips", { activated: true, active: true });
  await robot.say("service-button", { events: 2 });
  await row("service-button").getByText("2 events").waitFor();

  // A lost session: ages run on.
  await robot.travel({ linked: false, dropped: { sealed: 3, old: 12 } });
  for (const name of ["pose", "left-wheel"]) await robot.say(name, { linked: false, active: false });
  await mirror.getByText("lost: no session").waitFor();
  await mirror.getByText("dropped: old 12, sealed 3").waitFor();
  await row("pose").getByText("not yet active").waitFor();
  await until(page, async () => /^[1-9]\d*\.\d s/.test(await age.innerText()));
  await robot.travel({ linked: true, dropped: {} });
  for (const name of ["pose", "left-wheel"]) await robot.say(name, { linked: true, active: true });
  await mirror.getByText("session up").waitFor();
});

test("how the robot stands is said as it is known", async (t) => {
  const { mirror } = await open(t, "alice");
  const rest = mirror.locator("dt", { hasText: /^Rest$/ }).locator("+ dd");
  await rest.getByText("at rest, measured").waitFor();
  for (const [said, words] of [
    [{ rest: "not-measured" }, /^at rest, not measured$/],
    [{ moving: true, rest: undefined }, /^moving$/],
    [{ reached: false }, /^not reached since \d\d:\d\d:\d\d$/],
  ]) {
    await robot.tells(said);
    await rest.getByText(words).waitFor();
  }
  // Who comes later cannot know since when, unless the robot says so.
  const late = await open(t, "bob");
  await late.mirror.getByText(/^not reached since \d\d:\d\d:\d\d or before$/).waitFor();
  await robot.moves(false);
  await rest.getByText("at rest, measured").waitFor();
});

test("bits light up as they travel, in either direction, and stay hidden where they are sealed and not told", async (t) => {
  const { page, mirror, bit } = await open(t, "bob");
  const packet = mirror.getByRole("region", { name: "The packet" });
  await bit(0).getByText("Bit 0, left-wheel: to the robot").waitFor({ state: "attached" });
  assert.equal((await lamp(bit(0))).animation, "down");
  await bit(7).getByText("Bit 7, pose: from the robot").waitFor({ state: "attached" });
  await bit(2).getByText("Bit 2, joints: not in the newest packets").waitFor({ state: "attached" });
  const down = packet.getByRole("group", { name: "To the robot" });
  for (const [field, value] of [["Model", "0xc0b0"], ["Encryption", "none"], ["Type", "data"], ["Session", "a1b2c3d4e5f6"]]) assert.equal(await down.locator("dt", { hasText: field }).locator("+ dd").innerText(), value);
  await down.getByText("c000", { exact: true }).waitFor();
  await down.getByText("00640064", { exact: true }).waitFor();
  await packet.getByText("2.8 KiB/s").waitFor();
  await packet.getByText("0.4 %").waitFor();

  robot.bits = { down: [2], up: [2, 14] };
  await robot.travel();
  await bit(2).getByText("Bit 2, joints: both ways").waitFor({ state: "attached" });
  await bit(0).getByText("Bit 0, left-wheel: not in the newest packets").waitFor({ state: "attached" });
  // One that was lit fades.
  assert.ok(await bit(0).locator(".down.seen:not(.on)").count());
  assert.equal(await bit(5).locator(".seen").count(), 0);

  robot.sealed = true;
  await robot.travel();
  await down.getByText("ChaCha20-Poly1305").waitFor();
  assert.equal(await down.getByText("sealed", { exact: true }).count(), 2);
  assert.equal(await down.getByText(/5e5e/).count(), 0);
  await bit(14).getByText("Bit 14, posture: from the robot").waitFor({ state: "attached" });
  await accessible(page);
  robot.sealed = false;
  robot.bits = { down: [0, 1], up: [7] };
  await robot.travel();
});

test("with reduced motion a bit is lit as long as it is in the newest packet", async (t) => {
  const { bit } = await open(t, "bob", { reducedMotion: "reduce" });
  await bit(0).locator(".down.on").waitFor({ state: "attached" });
  const [lit, dark] = [await lamp(bit(0)), await lamp(bit(2))];
  assert.equal(lit.animation, "none");
  assert.notEqual(lit.colour, dark.colour);
});

test("the owner sets, executes, switches and asks, each under the fence", async (t) => {
  const { page, mirror, row } = await open(t, "alice");
  robot.heard.length = 0;
  const sent = mirror.getByRole("region", { name: "Sent" });
  await row("left-wheel").getByRole("button", { name: "left-wheel" }).click();
  const set = row("left-wheel").getByRole("button", { name: "Set" });
  // Without the token nothing is sent, and it is said why.
  assert.equal(await set.getAttribute("aria-disabled"), "true");
  await row("left-wheel").getByText("Grab /cubo/token first").waitFor();
  await set.click({ force: true });
  await accessible(page);
  await grab(mirror);
  await until(page, async () => (await set.getAttribute("aria-disabled")) === "false");

  const value = row("left-wheel").getByLabel("Value (mm/s)");
  await value.fill("fast");
  await row("left-wheel").getByText("“fast” is not a number").waitFor();
  await value.fill("100");
  await row("left-wheel").getByLabel("for (ms)").fill("");
  await row("left-wheel").getByText("A speed needs a time.").waitFor();
  await set.click();
  assert.deepEqual(robot.heard, []);
  await row("left-wheel").getByLabel("for (ms)").fill("1000");
  await value.press("Enter");
  await sent.getByText("set left-wheel 100 for 1000").waitFor();
  await sent.getByText(/^finished/).waitFor();
  await row("left-wheel").locator(".value").getByText("100 mm/s").waitFor();

  await row("joints").getByRole("button", { name: "joints" }).click();
  const joints = row("joints").getByLabel("Values (deg)");
  await joints.fill("-90 0");
  await row("joints").getByText("3 numbers are needed, not 2").waitFor();
  await joints.fill("-90, 0, 20.5");
  await row("joints").getByRole("button", { name: "Set" }).click();
  await row("joints").getByText("−90, 0, 20.5 deg").first().waitFor();

  await row("gesture").getByRole("button", { name: "gesture" }).click();
  await row("gesture").getByLabel("Parameters").fill("3");
  await row("gesture").getByRole("button", { name: "Execute" }).click();
  await row("camera").getByRole("button", { name: "camera" }).click();
  await row("camera").getByRole("button", { name: "Ask" }).click();
  await row("motion").getByRole("button", { name: "motion" }).click();
  await row("motion").getByRole("button", { name: "Deactivate" }).click();
  await row("motion").getByText("off", { exact: true }).waitFor();
  await row("motion").getByRole("button", { name: "Activate", exact: true }).click();
  await row("motion").getByText("active", { exact: true }).waitFor();
  await row("message-recorded").getByRole("button", { name: "message-recorded" }).click();
  await row("message-recorded").getByRole("button", { name: "Clear buffers" }).click();
  await until(page, () => robot.heard.length === 7);
  assert.deepEqual(robot.heard.map(({ content }) => content), ["set left-wheel 100 for 1000", "set joints -90 0 20.5", "do gesture 3", "ask camera", "deactivate motion", "activate motion", "clear"]);
  assert.ok(robot.heard.every(({ fence, permitted }) => fence > 0 && permitted), "each had the fence of the token's owner");

  // What the robot refuses stands there in words, with what to do.
  await row("speaker").getByRole("button", { name: "speaker" }).click();
  await row("speaker").getByLabel("Values").fill("1");
  await row("speaker").getByRole("button", { name: "Set" }).click();
  const refusal = sent.getByRole("alert").filter({ hasText: "Refused: set speaker 1" });
  await refusal.getByText("speaker takes no numbers").waitFor();
  await refusal.getByText("Edit the command: the mistake is marked.").waitFor();
  await accessible(page);
  await refusal.getByRole("button", { name: "Dismiss" }).click();
  await refusal.waitFor({ state: "detached" });

  // STOP stops it, and then nothing is sent.
  await page.keyboard.press("Escape");
  await row("motion").getByText("The device is stopped: let it go first.").waitFor();
  await letGo(page);
  await until(page, async () => (await set.getAttribute("aria-disabled")) === "false");
  await release(mirror);
});

test("T is sent when the slider is let go, and is confirmed or not", async (t) => {
  const { page, mirror } = await open(t, "alice");
  const period = mirror.getByRole("region", { name: "T, the time between two packets" });
  const slider = period.getByRole("slider", { name: "T (ms)" });
  const fact = (name) => period.locator("dt", { hasText: name }).locator("+ dd").innerText();
  assert.ok(await slider.isDisabled());
  await grab(mirror);
  await until(page, () => slider.isEnabled());
  robot.heard.length = 0;
  assert.equal(await fact("Wanted"), "20 ms");
  robot.obeys = false;
  // It is sent when no key has come for 300 ms, and keys of a test may be slower than that.
  await slider.evaluate((slider) => {
    slider.value = "39";
    slider.dispatchEvent(new Event("input", { bubbles: true }));
  });
  await slider.focus();
  await page.keyboard.press("ArrowRight");
  await until(page, () => robot.heard.length > 0);
  assert.deepEqual(robot.heard.map(({ content }) => content), ["period 40"]);
  assert.deepEqual([await fact("Wanted"), await fact("Confirmed")], ["40 ms", "not yet"]);
  await robot.travel({ period: 40, confirmed: false });
  await until(page, async () => (await fact("Confirmed")) === "not yet");
  await robot.travel({ confirmed: true });
  await until(page, async () => (await fact("Confirmed")) === "40 ms");

  // With the pointer: nothing is sent before it is let go.
  robot.obeys = true;
  robot.heard.length = 0;
  await slider.scrollIntoViewIfNeeded();
  const { x, y, width, height } = await slider.boundingBox();
  await page.mouse.move(x + width * 0.2, y + height / 2);
  await page.mouse.down();
  await page.mouse.move(x + width * 0.5, y + height / 2, { steps: 4 });
  const wanted = await fact("Wanted");
  assert.deepEqual(robot.heard, []);
  await page.mouse.up();
  await until(page, async () => (await fact("Confirmed")) === wanted);
  assert.deepEqual(robot.heard.map(({ content }) => content), [`period ${parseInt(wanted, 10)}`]);
  await robot.travel({ period: 20 });
  await release(mirror);
});

test("a token that another peer owns is refused in words", async (t) => {
  const bob = await RawPeer.login(hub.host, "bob");
  t.after(() => bob.close());
  await bob.ask("context", "join", "/cubo");
  await bob.ask("token", "grab", "/cubo/token");
  const { page, mirror, row } = await open(t, "alice");
  await mirror.getByText(/^bob(~\d)? holds it/).waitFor();
  await mirror.getByRole("button", { name: "Grab", exact: true }).click();
  await mirror.getByRole("alert").filter({ hasText: "Refused: grab" }).getByRole("button", { name: "Wait in the queue" }).waitFor();
  await row("camera").getByRole("button", { name: "camera" }).click();
  await row("camera").getByText("Grab /cubo/token first").waitFor();
  await accessible(page);
});

test("of several robots one is chosen, and the address names it", async (t) => {
  const { page, mirror } = await open(t, "bob");
  await mirror.getByRole("combobox", { name: "Robot" }).selectOption("/zoe");
  await mirror.locator("tbody[data-element]").nth(2).waitFor({ state: "detached" });
  assert.match(page.url(), /#\/simulacrum\?path=%2Fzoe%2Fsimulacrum$/);
  await page.reload();
  await mirror.locator("tbody[data-element]").nth(1).waitFor();
  assert.equal(await mirror.locator("tbody[data-element]").count(), 2);
  await mirror.getByText("Bit 1, right-wheel: to the robot").waitFor({ state: "attached" });
});

test("what its last owner has begun is waited for, and then the command goes on", async (t) => {
  const page = await hub.page("alice", { t });
  await page.getByRole("combobox", { name: "Device" }).selectOption("/zoe/robot");
  const list = page.locator("mom-commands");
  const send = async (statement) => {
    await list.getByLabel("New command", { exact: true }).fill(statement);
    await list.getByRole("button", { name: "Add and send" }).click();
  };
  await grab(page);
  other.heard.length = 0;
  other.hindrance = { name: "changing-hands", code: 5105, text: "it is changing hands and still moves", retry: true };
  await send("activate left-wheel");
  await list.locator("li.sending").getByText("Sent again as soon as possible: it is changing hands and still moves").waitFor();
  other.hindrance = undefined;
  // It does not stand for its owner yet.
  const { fence } = other.heard[0];
  await other.tells({ fence: fence - 1 });
  await other.moves(true);
  assert.equal(other.heard.length, 1);
  await other.tells({ moving: false, fence });
  await list.locator("li.finished").waitFor();
  assert.deepEqual(other.heard, [1, 2].map(() => ({ content: "activate left-wheel", fence, permitted: true })));

  // What waits to be sent again is not sent after STOP.
  other.hindrance = { name: "changing-hands", code: 5105, text: "it is changing hands and still moves", retry: true };
  await other.moves(true);
  await send("deactivate left-wheel");
  await list.locator("li.sending").getByText("Sent again as soon as possible").waitFor();
  await page.keyboard.press("Escape");
  await list.locator("li.error").getByText("STOP was pressed.", { exact: true }).waitFor();
  other.hindrance = undefined;
  await other.tells({ moving: false, fence });
  await letGo(page);
  await list.getByText("The device is stopped: let it go first.").first().waitFor({ state: "hidden" });
  assert.equal(other.heard.length, 3);
  await release(page);
});

test("a robot that goes while it carries something out ends it, in words", async (t) => {
  const page = await hub.page("alice", { t, path: "/#/simulacrum?path=%2Fzoe%2Fsimulacrum" });
  const mirror = page.locator("mom-simulacrum");
  const row = mirror.locator('tbody[data-element="left-wheel"]');
  await grab(mirror);
  await row.getByRole("button", { name: "left-wheel" }).click();
  const activate = row.getByRole("button", { name: "Activate", exact: true });
  await until(page, async () => (await activate.getAttribute("aria-disabled")) === "false");
  other.obeys = false;
  await activate.click();
  const sent = mirror.getByRole("region", { name: "Sent" });
  await sent.getByText("executing", { exact: true }).waitFor();
  await other.end();
  await sent.getByText(/carol.* has left \/zoe\/robot; what became of the command is not known$/).waitFor();
  await sent.getByText("see who is there: mom tree /zoe").waitFor();
  other = (await FakeRobot.start(hub.host, "/zoe", "carol", CUBO.slice(0, 2))).run();
  await release(mirror);
});

for (const [width, colorScheme] of [[360, "light"], [360, "dark"], [1280, "light"], [1280, "dark"]]) {
  test(`both pages are accessible at ${width} px, ${colorScheme}`, async (t) => {
    const { page, mirror, row } = await open(t, "alice", { viewport: { width, height: 760 }, colorScheme, reducedMotion: "reduce" });
    for (const name of ["left-wheel", "gesture", "pose"]) await row(name).getByRole("button", { name }).click();
    await mirror.getByText("Nobody holds it.").or(mirror.getByText(/holds it/)).first().waitFor();
    await accessible(page);
    const { modeller } = await model(page);
    await modeller.getByRole("textbox", { name: "Range of lips" }).fill("9..1");
    await modeller.getByText("The range is reversed").waitFor();
    await accessible(page);
  });
}

async function model(page) {
  await page.evaluate(() => (location.hash = "#/modeller"));
  const modeller = page.locator("mom-modeller");
  await modeller.getByRole("button", { name: "Example: CUBO" }).click();
  await modeller.getByText("Loaded cubo.toml: 16 elements.").waitFor();
  const size = (row, way) => modeller.getByRole("region", { name: "The packet" }).getByRole("row", { name: new RegExp(`^${row}`) }).getByRole("cell").nth(way).innerText();
  return { modeller, size };
}

test("a model is made: packets follow, mistakes stand at their field, and it is downloaded", async (t) => {
  const page = await hub.page("bob", { t, path: "/#/modeller" });
  const { modeller, size } = await model(page);
  assert.deepEqual([await size("Full packet", 0), await size("Full packet", 1), await size("Each second", 0)], ["1,999 B", "700 B", "99,950 B/s"]);
  const packet = modeller.getByRole("region", { name: "The packet" });
  await packet.getByRole("button", { name: "motion" }).click();
  assert.equal(await size("Selected elements", 0), "34 B");
  await packet.getByRole("checkbox", { name: "speaker is in the packet" }).check();
  assert.equal(await size("Selected elements", 0), "1,992 B");
  await packet.getByRole("button", { name: "All" }).click();

  await modeller.getByLabel("T (ms)").fill("40");
  assert.equal(await size("Each second at T = 40 ms", 0), "49,975 B/s");
  await modeller.getByRole("textbox", { name: "Max. bytes of speaker" }).fill("1000");
  assert.equal(await size("Full packet", 0), "1,043 B");
  // Its sound has no room then: less of it has.
  await modeller.getByText("20 ms of it take up to 1956 bytes: more than this element may have.").waitFor();
  await modeller.getByRole("textbox", { name: "Sound of speaker" }).fill("pcm 25000");
  const rate = modeller.getByRole("textbox", { name: "Rate (unit/s) of joints" });
  await rate.fill("-1");
  const mistake = await rate.getAttribute("aria-describedby");
  assert.equal(await modeller.locator(`#${mistake}`).innerText(), "A rate in units per second, more than 0.");
  const download = modeller.getByRole("button", { name: "Download as TOML" });
  assert.equal(await download.getAttribute("aria-disabled"), "true");
  await rate.fill("90");
  // An element of another kind has other fields; what stands in one that it has not is said.
  await modeller.getByRole("combobox", { name: "Kind of lips" }).selectOption("sensor");
  await modeller.getByText("A sensor has none: clear this field.").waitFor();
  await modeller.getByRole("combobox", { name: "Kind of lips" }).selectOption("effector");
  await modeller.getByRole("button", { name: "Move down: left-wheel" }).click();
  assert.equal(await modeller.locator("tr[data-element]").first().getAttribute("data-element"), "right-wheel");
  await modeller.getByRole("button", { name: "Add an element" }).click();
  await modeller.getByText("It is missing.").first().waitFor();
  await modeller.getByRole("textbox", { name: "Name of element 16" }).fill("lamp");
  await modeller.getByRole("combobox", { name: "Type of lamp" }).selectOption("u8");
  await modeller.getByText("No mistakes.").waitFor();
  assert.equal(await size("Device map, 17 bits", 0), "3");

  const [file] = await Promise.all([page.waitForEvent("download"), download.click()]);
  assert.equal(file.suggestedFilename(), "cubo.toml");
  const path = await file.path();
  await page.reload();
  await modeller.locator('tr[data-element="lamp"]').waitFor();
  await modeller.getByRole("button", { name: "Remove: lamp" }).click();
  await modeller.locator('input[type="file"]').setInputFiles(path);
  await modeller.getByText("Replace the current model?").waitFor();
  await modeller.getByRole("button", { name: "Replace it" }).click();
  await modeller.locator('tr[data-element="lamp"]').waitFor();
  assert.equal(await size("Device map, 17 bits", 0), "3");
  await modeller.locator('input[type="file"]').setInputFiles({ name: "bad.toml", mimeType: "text/plain", buffer: Buffer.from("name = ") });
  await modeller.getByText(/^bad\.toml was not loaded\. Not valid TOML, line 1, column \d+:/).waitFor();
  await modeller.getByText("mom rsp generate cubo.toml --rust cubo.rs --c cubo.h --docs cubo.md").waitFor();
});

/** What is downloaded by a button. */
async function downloaded(page, button) {
  const [file] = await Promise.all([page.waitForEvent("download"), button.click()]);
  return { name: file.suggestedFilename(), text: readFileSync(await file.path(), "utf8") };
}

test("the middle of a robot writes code of the model, and gives the robot's own", async (t) => {
  const page = await hub.page("bob", { t, path: "/#/modeller" });
  const { modeller } = await model(page);
  const code = modeller.getByRole("region", { name: "Code for both ends" });
  const rust = code.getByRole("button", { name: "Rust" });
  const enabled = (button) => until(page, async () => (await button.getAttribute("aria-disabled")) === "false");
  await enabled(rust);
  // More than a message of others may have.
  const text = "// What packets are made of.\n".repeat(3000);
  robot.answer = ({ language }) => ({ language, name: "cubo.rs", text });
  assert.deepEqual(await downloaded(page, rust), { name: "cubo.rs", text });
  await code.getByRole("status").getByText("Downloaded cubo.rs: 3,000 lines.").waitFor();
  assert.deepEqual(robot.asked.map(({ language }) => language), ["rust"]);
  assert.match(robot.asked[0].model, /^name = "cubo"\n[^]*^sound = "pcm 48900"$/m);

  robot.answer = ({ language }) => ({ language, error: "line 3, column 1: there is no key `peroid`" });
  await code.getByRole("button", { name: "C header" }).click();
  await code.getByRole("alert").getByText("No code was made. The middle says: line 3, column 1: there is no key `peroid`").waitFor();
  robot.answer = () => undefined;
  await code.getByRole("button", { name: "Description" }).click();
  await code.getByRole("status").getByText("Waiting for the middle of /cubo…").waitFor();
  assert.equal(await rust.getAttribute("aria-disabled"), "true");
  await code.getByRole("alert").getByText("The middle of /cubo did not answer within 5 s.").waitFor();
  await enabled(rust);
  await modeller.getByLabel("T (ms)").fill("1");
  assert.deepEqual([await rust.getAttribute("aria-disabled"), await rust.getAttribute("title")], ["true", "Correct the mistakes first."]);
  await accessible(page);

  // Of several robots one is chosen; a changed model is replaced when that is confirmed.
  const load = modeller.getByRole("button", { name: "Load from robot" });
  const robots = modeller.getByRole("combobox", { name: "Robot", exact: true });
  await robots.selectOption("/many");
  await load.click();
  await modeller.getByRole("alert").getByText("The model of /many was not loaded. The middle of /many is not there.").waitFor();
  await robots.selectOption("/zoe");
  other.answer = ({ language }) => ({ language, name: "zoe.toml", text: 'name = "zoe"\nid = 7\n[[element]]\nname = "wheel"\nkind = "effector"\ntype = "i16"\n' });
  await load.click();
  await modeller.getByText("Replace the current model?").waitFor();
  assert.deepEqual(other.asked, [{ language: "toml" }]);
  await modeller.getByRole("button", { name: "Replace it" }).click();
  await modeller.getByText("Loaded zoe.toml of /zoe: 1 element.").waitFor();
  await modeller.getByText("No mistakes.").waitFor();
  assert.equal(await modeller.getByLabel("Name", { exact: true }).inputValue(), "zoe");
});

test("what CUBO's own middle writes is downloaded, and its model has no mistakes", async (t) => {
  const lab = await start({ lab: ["--cubo"] });
  t.after(() => lab.end());
  const page = await lab.page("alice", { t, path: "/#/modeller" });
  const { modeller } = await model(page);
  const code = modeller.getByRole("region", { name: "Code for both ends" });
  for (const [button, name, words] of [["Rust", "cubo.rs", /^pub mod elements \{$/m], ["C header", "cubo.h", /^#define CUBO_/m], ["Description", "cubo.md", /^# /m]]) {
    const made = code.getByRole("button", { name: button });
    await until(page, async () => (await made.getAttribute("aria-disabled")) === "false");
    const file = await downloaded(page, made);
    assert.equal(file.name, name);
    assert.match(file.text, words);
    await code.getByRole("status").getByText(`Downloaded ${name}: ${file.text.split("\n").length - 1} lines.`.replace(/(\d)(\d{3}) /, "$1,$2 ")).waitFor();
  }
  await modeller.getByRole("button", { name: "Load from robot" }).click();
  await modeller.getByText("Loaded cubo.toml of /fleet/1: 16 elements.").waitFor();
  assert.equal(await modeller.getByRole("list", { name: "Notes on the file" }).count(), 0);
  await modeller.getByText("No mistakes.").waitFor();
  assert.equal(await modeller.getByRole("textbox", { name: "Sound of speaker" }).inputValue(), "pcm 48900");
});

test("a robot of 256 elements that all change ten times a second leaves the page quick", async (t) => {
  const many = await FakeRobot.start(hub.host, "/many", "carol", Array.from({ length: 256 }, (_, place) => ({ name: `sensor-${place}`, kind: "sensor", value: [0, 0], unit: ["mm", "deg"] })));
  let [round, ended] = [0, false];
  const tell = async () => {
    for (; !ended; round += 1) {
      await Promise.all(Array.from({ length: 256 }, (_, place) => many.say(`sensor-${place}`, { value: [round, place] })));
      await many.travel();
      await new Promise((resolve) => setTimeout(resolve, 80));
    }
  };
  const telling = tell();
  t.after(async () => {
    ended = true;
    await telling;
    await many.end();
  });
  const page = await hub.page("alice", { t, path: "/#/simulacrum?path=/many/simulacrum" });
  const mirror = page.locator("mom-simulacrum");
  await mirror.locator("tbody[data-element]").nth(255).waitFor();
  await staysQuick(t, page, async () => {
    const begun = round;
    await until(page, () => round > begun + 20);
  });
});
