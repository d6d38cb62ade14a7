// A device that nothing has ever heard of is driven by its card, and a bad card harms nothing.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { ARM, MOUNT, hostile } from "./cards.mjs";
import { Crane, horn, withYard } from "./crane.mjs";
import { findings, letGo, start, staysQuick, until } from "./lab.mjs";
import { RawPeer } from "./rawpeer.mjs";

let [hub, crane] = [];

before(async () => {
  hub = await start({ config: withYard });
  crane = await Crane.start(hub.host);
});
after(async () => {
  await crane?.end().catch(() => undefined);
  await hub?.end();
});

const commands = (page) => page.locator("mom-commands");
const form = (page) => commands(page).locator("form");
const line = (page) => page.getByLabel("New command", { exact: true });
const row = (page, state, text) => commands(page).locator(`li.${state}`, { hasText: text });
const told = (page, name) => commands(page).locator(".pose dl > div", { has: page.getByText(name, { exact: true }) }).locator("dd");

async function opened(t, user = "alice", options = {}) {
  const page = await hub.page(user, { t, ...options });
  await page.getByRole("combobox", { name: "Device" }).selectOption("/yard/crane");
  await form(page).waitFor();
  return page;
}

async function grab(page) {
  await page.getByRole("button", { name: "Grab" }).click();
  await page.getByRole("button", { name: "Give back" }).waitFor();
  return page;
}

test("its verbs are there, and none of an arm's controls", async (t) => {
  const page = await opened(t);
  assert.deepEqual(await form(page).getByLabel("Verb").locator("option").allInnerTexts(), ["hoist", "swing", "magnet", "creep"]);
  await form(page).getByText("A crane in the yard").waitFor();
  await form(page).getByText("Hoists the hook to a height").waitFor();
  await page.getByText("This device has no live driving of its own here").waitFor();
  for (const gone of ["mom-jog", "mom-objects", "mom-calibrate", "mom-cursor"]) assert.equal(await page.locator(gone).count(), 0, gone);
  for (const name of ["Grip open", "From cursor", "Home"]) assert.equal(await commands(page).getByRole("button", { name }).count(), 0, name);
  assert.equal(await told(page, "height").innerText(), "0 mm");
});

test("a form for each verb: a value that is wrong stands at its field, and is not sent", async (t) => {
  const page = await grab(await opened(t));
  const height = form(page).getByLabel("height (mm)");
  assert.deepEqual(await height.evaluate(({ type, min, max, step }) => [type, min, max, step]), ["number", "0", "1200", "any"]);
  const described = (field) => field.evaluate((field) => (field.getAttribute("aria-describedby") ?? "").split(" ").filter(Boolean).map((id) => field.getRootNode().getElementById(id)?.textContent));
  assert.deepEqual(await described(height), ["0 to 1200 mm"]);
  // Nothing is filled in: the field is led to, and says what is missing.
  await form(page).getByRole("button", { name: "Run now" }).click();
  await form(page).getByText("height is missing").waitFor();
  await until(page, () => height.evaluate((field) => field.getRootNode().activeElement === field));
  await height.fill("1300");
  await form(page).getByText("height is 1300, `hoist` takes 0 to 1200 mm").waitFor();
  assert.equal(await height.getAttribute("aria-invalid"), "true");
  assert.deepEqual(await described(height), ["0 to 1200 mm", "height is 1300, `hoist` takes 0 to 1200 mm"]);
  await height.press("Enter");
  await form(page).getByRole("button", { name: "Run now" }).click();
  assert.equal(await commands(page).locator("li").count(), 0);
  assert.deepEqual(crane.begun, []);
  await form(page).getByLabel("Verb").selectOption("magnet");
  await form(page).getByText("moves nothing").waitFor();
  assert.deepEqual(await form(page).getByLabel("to", { exact: true }).locator("option").allInnerTexts(), ["Choose…", "on", "off"]);
  await page.getByRole("button", { name: "Give back" }).click();
});

test("it is driven by the form and by what is typed, is seen to move, and to stop", async (t) => {
  const page = await grab(await opened(t));
  // By the form, with the keyboard alone.
  await form(page).getByLabel("Verb").focus();
  await form(page).getByLabel("Verb").selectOption("magnet");
  await page.keyboard.press("Tab");
  await page.keyboard.press("o");
  await form(page).locator("output", { hasText: "magnet on" }).waitFor();
  for (let tabs = 0; tabs < 3; tabs += 1) await page.keyboard.press("Tab");
  await page.keyboard.press("Enter");
  await row(page, "finished", "magnet on").waitFor();
  await told(page, "magnet").filter({ hasText: "on" }).waitFor();
  assert.equal(crane.magnet, "on");
  // By the line: relative as well, where it may be.
  await line(page).fill("hiost 5");
  await commands(page).locator(".new .mistake", { hasText: "Column 1: statement 1: there is no `hiost`; did you mean `hoist`?" }).waitFor();
  await line(page).fill("hoist 40; hoist 4000");
  await commands(page).locator(".new .mistake", { hasText: "Column 17: statement 2: height is 4000, `hoist` takes 0 to 1200 mm" }).waitFor();
  assert.ok(await commands(page).getByRole("button", { name: "Add and send" }).isDisabled());
  await line(page).fill("swing 20; hoist 40; wait 10");
  await commands(page).getByRole("button", { name: "Add and send" }).click();
  await row(page, "finished", "swing 20").waitFor();
  await told(page, "angle").filter({ hasText: "20 °" }).waitFor();
  assert.deepEqual([crane.angle, crane.height], [20, 40]);
  // By a verb that is relative, from the form, at once: it waits until the device rests from the one before.
  await form(page).getByLabel("Verb").selectOption("swing");
  await form(page).getByText("counted from where it is").waitFor();
  await form(page).getByLabel("angle (°)").fill("-5");
  await form(page).getByRole("button", { name: "Run now" }).click();
  await row(page, "finished", "swing -5").waitFor();
  assert.equal(crane.angle, 15);
  // A velocity stands alone.
  await line(page).fill("creep 20; wait 5");
  await commands(page).locator(".new .mistake", { hasText: "`creep` stands alone in its script" }).waitFor();
  await line(page).fill("");
  // It moves, and stands at STOP.
  await form(page).getByLabel("Verb").selectOption("hoist");
  await form(page).getByLabel("height (mm)").fill("1200");
  await form(page).getByRole("button", { name: "Run now" }).click();
  await row(page, "executing", "hoist 1200").waitFor();
  await until(page, async () => Number.parseFloat(await told(page, "height").innerText()) > 60);
  await page.locator("mom-stop").getByRole("button", { name: /^STOP/ }).click();
  await row(page, "error", "hoist 1200").waitFor();
  await commands(page).locator(".pose", { hasText: "at rest, measured" }).waitFor();
  const { height } = crane;
  assert.ok(height > 60 && height < 1200, `${height}`);
  await until(page, async () => Math.abs(Number.parseFloat(await told(page, "height").innerText()) - height) < 0.1);
  assert.ok(await form(page).getByRole("button", { name: "Run now" }).isDisabled());
  await letGo(page);
  await until(page, () => form(page).getByRole("button", { name: "Run now" }).isEnabled());
  assert.equal(crane.height, height);
  await page.getByRole("button", { name: "Give back" }).click();
});

test("its emergency stop is told, and nobody lets it go before it was reset", async (t) => {
  const page = await grab(await opened(t));
  await form(page).getByLabel("Verb").selectOption("hoist");
  await form(page).getByLabel("height (mm)").fill("100");
  crane.isPressed = true;
  t.after(() => (crane.isPressed = false));
  const standing = (words) => page.locator("mom-stopped li", { hasText: words }).first();
  await standing("its emergency stop was pressed").waitFor();
  const hindered = commands(page).locator("p.warning", { hasText: "The emergency stop at the device is pressed: reset it there" });
  await hindered.waitFor();
  await letGo(page);
  await standing("its emergency stop was pressed").waitFor({ state: "detached" });
  assert.ok(await hindered.isVisible());
  assert.ok(await form(page).getByRole("button", { name: "Run now" }).isDisabled());
  crane.isPressed = false;
  await standing("its emergency stop was reset").waitFor();
  await hindered.waitFor({ state: "detached" });
  assert.ok(await form(page).getByRole("button", { name: "Run now" }).isDisabled());
  await letGo(page);
  await until(page, () => form(page).getByRole("button", { name: "Run now" }).isEnabled());
  await page.getByRole("button", { name: "Give back" }).click();
});

test("a form's statement goes into the line or the list, and none is run without the token", async (t) => {
  const page = await opened(t, "bob");
  await form(page).getByLabel("Verb").selectOption("hoist");
  await form(page).getByLabel("height (mm)").fill("10");
  assert.ok(await form(page).getByRole("button", { name: "Run now" }).isDisabled());
  await form(page).getByRole("button", { name: "Write into the line" }).click();
  await form(page).getByLabel("height (mm)").fill("20");
  await form(page).getByRole("button", { name: "Write into the line" }).click();
  assert.equal(await line(page).inputValue(), "hoist 10; hoist 20");
  await form(page).getByLabel("height (mm)").press("Enter");
  await row(page, "waiting", "hoist 20").waitFor();
});

test("another card: the device comes back with another verb, and without one", async (t) => {
  const page = await opened(t);
  await line(page).fill("horn 3");
  await commands(page).locator(".new .mistake", { hasText: "there is no `horn`" }).waitFor();
  await crane.end();
  crane = await Crane.start(hub.host, { more: { horn } });
  await form(page).getByText("The device has come with other verbs.").waitFor();
  await commands(page).locator(".new .mistake").waitFor({ state: "detached" });
  await line(page).fill("");
  await form(page).getByLabel("Verb").selectOption("horn");
  assert.equal(await form(page).getByLabel("times").getAttribute("placeholder"), "2");
  await grab(page);
  await form(page).getByRole("button", { name: "Run now" }).click();
  await row(page, "finished", "horn").waitFor();
  // One that says nothing of itself is driven as before: its refusal says that a command is relative.
  await crane.end();
  crane = await Crane.start(hub.host, { carded: false });
  await commands(page).getByText("This device does not say what commands it knows").waitFor();
  assert.equal(await form(page).count(), 0);
  await line(page).fill("swing 7");
  await commands(page).getByRole("button", { name: "Add and send" }).click();
  await row(page, "finished", "swing 7").waitFor();
  assert.equal(crane.angle, 7);
  await page.getByRole("button", { name: "Give back" }).click();
  await crane.end();
  crane = await Crane.start(hub.host);
  await form(page).waitFor();
});

test("a card that is as large and as bad as a hub takes it harms nothing", async (t) => {
  await crane.end();
  const device = await RawPeer.login(hub.host, "carol");
  t.after(async () => {
    device.close();
    await device.ended;
    crane = await Crane.start(hub.host);
  });
  await device.ask("context", "join", "/yard");
  const card = JSON.parse(JSON.stringify(hostile({ choices: 2200 }), (_, value) => (Number.isNaN(value) ? undefined : value)).replaceAll("\\u0007", ""));
  await device.ask("context", "join", "/yard/crane", { device: { card } });
  const page = await opened(t);
  await device.say("/yard/crane", "state", { moving: false, stopped: false, s1: "<b>bold</b>", s2: "left ".repeat(50) });
  await staysQuick(t, page, async () => {
    for (const device of ["/robot/arm", "/yard/crane"]) await page.getByRole("combobox", { name: "Device" }).selectOption(device);
    await form(page).waitFor();
    for (const name of ["pick", "many", "nan", "n".repeat(64), "constructor"]) await form(page).getByLabel("Verb").selectOption(name);
    await line(page).fill("pick wrong; many 1");
    await commands(page).locator(".new .mistake").waitFor();
    await line(page).fill("");
  });
  await form(page).getByLabel("Verb").selectOption("pick");
  await form(page).getByText("one of 2200 words").waitFor();
  await form(page).getByLabel("word", { exact: true }).fill("w00z");
  await form(page).locator("output", { hasText: "pick w00z" }).waitFor();
  // What may be said again has fields for each time.
  await form(page).getByLabel("Verb").selectOption("via");
  await form(page).getByRole("button", { name: "Once more" }).click();
  for (const [place, label] of ["x (mm)", "y (mm)", "x no. 2 (mm)", "y no. 2 (mm)"].entries()) await form(page).getByLabel(label, { exact: true }).fill(`${place}`);
  await form(page).locator("output", { hasText: "via 0 1 2 3" }).waitFor();
  await form(page).getByRole("button", { name: "Remove the last" }).click();
  await form(page).locator("output", { hasText: /^via 0 1$/ }).waitFor();
  await form(page).getByLabel("Verb").selectOption("many");
  await form(page).getByText("It takes 200 arguments").waitFor();
  await form(page).getByText("6 more are not listed").waitFor();
  assert.equal(await form(page).locator("img, script").count(), 0);
  assert.equal(await page.evaluate(() => globalThis.pwned), undefined);
  assert.equal((await told(page, "s1").innerText()).trim(), "<b>bold</b>");
  for (const width of [1280, 400]) {
    await page.setViewportSize({ width, height: 900 });
    await until(page, () => page.evaluate(() => document.documentElement.scrollWidth <= innerWidth));
  }
});

for (const [width, colorScheme] of [[1280, "light"], [1280, "dark"], [400, "light"], [400, "dark"]]) {
  test(`it is accessible at ${width} px, ${colorScheme}, with errors as well`, async (t) => {
    const page = await opened(t, "alice", { viewport: { width, height: 900 }, colorScheme });
    for (const name of ["hoist", "swing", "magnet", "creep"]) {
      await form(page).getByLabel("Verb").selectOption(name);
      await form(page).getByRole("button", { name: "Add to the list" }).click();
      await form(page).getByText("is missing").waitFor();
      assert.deepEqual(await findings(page), [], name);
    }
    await until(page, () => page.evaluate(() => document.documentElement.scrollWidth <= innerWidth));
  });
}

test("the lab's devices have the cards by which tests read scripts", async (t) => {
  const lab = await start();
  t.after(lab.end);
  for (const [path, card] of [["/robot/arm", ARM], ["/camera/pan", MOUNT]]) {
    const { state, "stops-within": within, ...own } = JSON.parse((await lab.mom("carol", "card", path, "--json")).out);
    assert.deepEqual(own, card);
    assert.ok(state.length > 0 && within > 0);
  }
});
