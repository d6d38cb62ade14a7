// The page of a fleet in a browser, against a lab with ten robots, and against a hub with a thousand of which only words are there.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { findings, letGo, start, staysQuick, until } from "./lab.mjs";
import { RawPeer } from "./rawpeer.mjs";

const CONFIG = `
[[contexts]]
path = "/fleet"
kind = "session"
[[contexts]]
path = "/fleet/status"
kind = "channel"
delivery = "latest"
keep = { latest = true }
`;

let lab;
let hub;

before(async () => {
  lab = await start({ lab: ["--fleet", "10"] });
  hub = await start({ config: CONFIG });
});
after(async () => {
  await hub?.end();
  await lab?.end();
});

async function open(t, at, user, options = {}) {
  const page = await at.page(user, { t, path: "/#/fleet", ...options });
  const fleet = page.locator("mom-fleet");
  await fleet.locator("tr[data-unit]").first().waitFor();
  return { page, fleet, row: (unit) => fleet.locator(`tr[data-unit="${unit}"]`) };
}

const accessible = async (page) => {
  assert.deepEqual(await findings(page), []);
  assert.ok(await page.evaluate(() => document.documentElement.scrollWidth <= innerWidth), "nothing is wider than the page");
};
const selected = (fleet) => fleet.locator('tr[aria-selected="true"]').evaluateAll((rows) => rows.map(({ dataset }) => Number(dataset.unit)));

const head = (fleet) => fleet.getByRole("region", { name: "Fleet", exact: true });

/** Presses a button of the selection, and waits for what it says. */
async function act(fleet, name, says) {
  await head(fleet).getByRole("button", { name, exact: true }).click();
  await fleet.getByText(says).first().waitFor();
}

test("all robots are in the table, which sorts and filters; rows are selected by keys and clicks", async (t) => {
  const { page, fleet, row } = await open(t, lab, "alice");
  const table = fleet.getByRole("grid", { name: "Robots" });
  // They come in portions, in no order.
  await until(page, async () => (await table.getAttribute("aria-rowcount")) === "11");
  await row(1).getByText("standing").waitFor();
  await row(1).getByText("100 %").waitFor();
  await row(1).locator(".trip").getByText(/^\d+\.\d ms$/).waitFor();
  await row(1).getByText("free").waitFor();
  await fleet.getByRole("button", { name: "10 standing" }).waitFor();
  await accessible(page);

  await table.focus();
  await page.keyboard.press("Home");
  await page.keyboard.press("ArrowDown");
  await page.keyboard.press("Shift+ArrowDown");
  await page.keyboard.press("Shift+ArrowDown");
  assert.deepEqual(await selected(fleet), [2, 3, 4]);
  assert.equal(await table.getAttribute("aria-activedescendant"), "robot-4");
  await page.keyboard.press("Control+ArrowDown");
  await page.keyboard.press("Control+ArrowDown");
  await page.keyboard.press("Enter");
  assert.deepEqual(await selected(fleet), [2, 3, 4, 6]);
  await fleet.getByText("Selected: 4 robots, 2-4, 6").waitFor();
  await page.keyboard.press("Control+a");
  assert.equal((await selected(fleet)).length, 10);

  await row(7).click();
  await row(9).click({ modifiers: ["Shift"] });
  await row(8).click({ modifiers: ["Control"] });
  await fleet.getByRole("checkbox", { name: "Select robot 1", exact: true }).click();
  assert.deepEqual(await selected(fleet), [1, 7, 9]);

  await fleet.getByRole("button", { name: "Robot", exact: true }).click();
  assert.equal(await fleet.locator("tbody tr[data-unit]").first().getAttribute("data-unit"), "10");
  const filter = fleet.getByRole("searchbox", { name: /^Filter/ });
  await filter.fill("8-20 standing");
  await row(1).waitFor({ state: "detached" });
  await fleet.getByText("3 of 10 robots").waitFor();
  await filter.fill("lost");
  await fleet.getByText("No robot matches the filter.").waitFor();
  await fleet.getByRole("button", { name: "Show all" }).click();
  await row(1).waitFor();
});

test("a token that another peer owns is refused in words, with what can be done", async (t) => {
  const carol = await RawPeer.login(lab.host, "carol");
  t.after(() => carol.close());
  await carol.ask("context", "join", "/fleet");
  for (const unit of [9, 10]) {
    await carol.ask("context", "join", `/fleet/${unit}`);
    await carol.ask("token", "grab", `/fleet/${unit}/token`);
  }
  const { page, fleet, row } = await open(t, lab, "alice");
  await row(9).getByText("carol").waitFor();
  await row(8).click();
  await row(10).click({ modifiers: ["Shift"] });
  await head(fleet).getByRole("button", { name: "Grab", exact: true }).click();
  const refusal = fleet.getByRole("alert").filter({ hasText: "Refused: grab robots 9, 10" });
  await refusal.waitFor();
  await refusal.getByText("robot-token", { exact: false }).first().waitFor();
  await refusal.getByText(/carol/).first().waitFor();
  await fleet.getByText("Grabbed: robot 8.").waitFor();
  await accessible(page);
  // What is sent to them all the same is refused for want of the token, and the dialog leads on.
  await fleet.getByRole("button", { name: "Send…" }).click();
  const dialog = fleet.getByRole("dialog", { name: "Send to robots" });
  await dialog.getByLabel("Robots (1,3-5 or all)").fill("8,10");
  await dialog.getByLabel("Command").selectOption("leds");
  await dialog.getByRole("checkbox", { name: "LED 7" }).uncheck();
  await dialog.getByText("leds 127").waitFor();
  await dialog.getByRole("button", { name: "Send once" }).click();
  await dialog.getByText("Only the owner of /fleet/10/token sends commands there: grab it first.").first().waitFor();
  await dialog.getByRole("status").filter({ hasText: "1 refused" }).filter({ hasText: "1 finished" }).waitFor();
  await accessible(page);
  await carol.ask("token", "release", "/fleet/10/token");
  await row(10).getByText("free").waitFor();
  await dialog.getByRole("button", { name: "Grab the tokens" }).click();
  await fleet.getByText("Grabbed: robot 10.").waitFor();
  await dialog.getByRole("button", { name: "Send once" }).click();
  await dialog.getByText("2 finished", { exact: true }).waitFor();
});

test("a robot is sent to a point, and arrives in the table and in both logs", async (t) => {
  const { page, fleet, row } = await open(t, lab, "alice");
  await row(1).click();
  await act(fleet, "Grab", "Grabbed: robot 1.");
  await row(1).getByText("you").waitFor();
  await fleet.getByRole("button", { name: "Send…" }).click();
  const dialog = fleet.getByRole("dialog", { name: "Send to robots" });
  await dialog.getByLabel("x (mm)").fill("100000");
  await dialog.getByText("x (mm): a whole number from -9999 to 99999").waitFor();
  await dialog.getByLabel("x (mm)").fill("900");
  await dialog.getByLabel("y (mm)").fill("500");
  // The dialog does not stand before STOP.
  await page.locator("mom-stop").getByRole("button", { name: /STOP/ }).click({ trial: true });
  await dialog.getByRole("button", { name: "Send once" }).click();
  await row(1).getByText("driving").waitFor();
  await dialog.getByText("1 finished", { exact: true }).waitFor();
  await row(1).getByText(/^(8[89]\d|90\d|91\d), (49\d|50\d|51\d),/).waitFor();
  await row(1).getByText("standing").waitFor();
  await dialog.getByRole("button", { name: "Close" }).click();
  await fleet.getByRole("region", { name: "Outgoing" }).getByRole("row", { name: /1 goto 900 500 finished/ }).waitFor();
  const incoming = fleet.getByRole("region", { name: "Incoming" });
  await incoming.getByText("finished goto 900 500").waitFor();
  await incoming.getByText("its token is alice's").waitFor();
  const [file] = await Promise.all([page.waitForEvent("download"), fleet.getByRole("button", { name: "Save as text" }).first().click()]);
  assert.equal(file.suggestedFilename(), "fleet-outgoing.txt");
  await act(fleet, "Give back", "Given back: robot 1.");
  await row(1).getByText("free").waitFor();
});

test("a click on the map sends several there, which keep their places to each other", async (t) => {
  const { fleet, row } = await open(t, lab, "alice");
  await row(2).click();
  await row(3).click({ modifiers: ["Shift"] });
  const drive = fleet.getByRole("button", { name: "Drive here" });
  assert.equal(await drive.getAttribute("aria-disabled"), "true");
  await act(fleet, "Grab", "Grabbed: robots 2, 3.");
  await fleet.locator('button:text-is("Drive here")[aria-disabled="false"]').click();
  const map = fleet.getByRole("img", { name: /^Map of 10 robots, 2 selected/ });
  const { width, height } = await map.boundingBox();
  await map.click({ position: { x: width / 2, y: height * 0.9 } });
  const sent = fleet.getByRole("region", { name: "Outgoing" }).locator("tbody tr");
  await sent.nth(1).waitFor();
  const goals = (await sent.allInnerTexts()).map((text) => /goto (-?\d+) (-?\d+)/.exec(text).slice(1).map(Number)).sort(([one], [other]) => one - other);
  assert.deepEqual([goals[1][0] - goals[0][0], goals[1][1] - goals[0][1]], [1000, 0]);
  // To stop needs no token, and tells only these.
  await act(fleet, "Stop these", "Told to stop: robots 2, 3.");
  await row(2).getByText("stopped").waitFor();
  await row(3).getByText("stopped").waitFor();
  assert.equal(await row(4).getByText("stopped").count(), 0);
  await freeThese(fleet);
  await fleet.getByText("Let go: robots 2, 3.").waitFor();
  await row(2).getByText("standing").waitFor();
});

/** Lets the selected robots go, as their user does: asks, reads what it is, and says so. */
async function freeThese(fleet) {
  const free = head(fleet).getByRole("button", { name: "Let these go…" });
  await free.and(fleet.locator('[aria-disabled="false"]')).click();
  await fleet.getByRole("dialog", { name: "Let these move again?" }).getByRole("button", { name: /^Free th/ }).click();
}

test("what lets robots go asks, names who stopped which of them and why, and is far from what stops", async (t) => {
  const { page, fleet, row } = await open(t, lab, "alice");
  const free = head(fleet).getByRole("button", { name: "Let these go…" });
  const question = fleet.getByRole("dialog", { name: "Let these move again?" });
  await row(7).click();
  await row(8).click({ modifiers: ["Shift"] });
  assert.equal(await free.getAttribute("title"), "None of the selected robots is stopped, as far as this page knows.");
  const bob = await RawPeer.login(lab.host, "bob");
  t.after(() => bob.close());
  // In channels that the page is not in, at a time when it does not look for stops.
  await bob.ask("context", "stop", "/fleet/7/robot", { reason: "a hand is in it" });
  await bob.ask("context", "stop", "/fleet/9/robot", { reason: "smoke" });
  for (const unit of [7, 9]) await row(unit).getByText("stopped").waitFor();
  await free.and(fleet.locator('[aria-disabled="false"]')).click();
  await question.getByText(/^Stopped by bob.*: a hand is in it/).waitFor();
  await question.getByText("/fleet/7/robot", { exact: true }).waitFor();
  assert.equal(await question.getByText(/fleet\/[89]|smoke/).count(), 0, "nothing else is named");
  await accessible(page);
  // Nothing is let go before the answer, and a stop takes the question away.
  assert.equal((await bob.ask("context", "info", "/fleet/7/robot")).content.stop.reason, "a hand is in it");
  await head(fleet).getByRole("button", { name: "Stop these" }).click();
  await question.waitFor({ state: "hidden" });
  await row(8).getByText("stopped").waitFor();
  // Up to the stops that are named: what is stopped again meanwhile stays so.
  await fleet.getByText("Told to stop: robots 7, 8.").waitFor();
  await free.click();
  await question.getByText(/^Stopped by alice.*: Stop these, in the fleet of the console/).waitFor();
  await bob.ask("context", "stop", "/fleet/8/robot", { reason: "smoke" });
  await question.getByRole("button", { name: "Free these 2" }).click();
  await fleet.getByText("Let go: robot 7.").waitFor();
  await fleet.getByRole("alert").filter({ hasText: "let go robot 8" }).getByText(/bob.* stopped it again: smoke/).waitFor();
  await row(7).getByText("standing").waitFor();
  await row(8).getByText("stopped").waitFor();

  const box = (locator) => locator.boundingBox();
  /** How far apart two boxes are, whichever way. */
  const apart = (one, other) => Math.max(other.x - one.x - one.width, one.x - other.x - other.width, other.y - one.y - one.height, one.y - other.y - other.height);
  // The head, which grows by what is stopped, does not cover the question.
  await free.click();
  for (const width of [1280, 360]) {
    await page.setViewportSize({ width, height: 780 });
    await question.getByRole("heading", { name: "Let these move again?" }).click({ trial: true });
  }
  await question.getByRole("button", { name: "Cancel" }).click();
  const stops = [page.locator("mom-stop button.stop"), head(fleet).getByRole("button", { name: "Stop these" })];
  await free.click();
  for (const width of [1280, 800, 500, 360]) {
    await page.setViewportSize({ width, height: 780 });
    await page.evaluate(() => scrollTo(0, 0));
    for (const frees of [free, question.getByRole("button", { name: "Free this one" })]) {
      for (const stop of stops) {
        const space = apart(await box(stop), await box(frees));
        assert.ok(space >= 24, `${space} px at ${width}`);
      }
    }
  }
  await question.getByRole("button", { name: "Cancel" }).click();
  await page.setViewportSize({ width: 1280, height: 900 });
  await lab.mom("bob", "unstop", "/fleet");
  await row(9).getByText("standing").waitFor();
});

test("what is known of a robot's rest stands beside it, and since when one is lost", async (t) => {
  const { fleet, row } = await open(t, lab, "alice");
  await row(4).click();
  const rest = fleet.getByRole("region", { name: "Robot 4", exact: true }).locator("dt", { hasText: /^Rest$/ }).locator("+ dd");
  await rest.getByText("at rest, measured").waitFor();
  await act(fleet, "Stop these", "Told to stop: robot 4.");
  await rest.getByText("stopped, at rest, measured").waitFor();
  await freeThese(fleet);
  await row(4).getByText("standing").waitFor();

  const carol = await RawPeer.login(hub.host, "carol");
  t.after(() => carol.close());
  for (const path of ["/fleet", "/fleet/status"]) await carol.ask("context", "join", path);
  const tell = (unit, content) => carol.write({ family: "message", name: `robot-${unit}`, context: "/fleet/status", delivery: "latest", echo: false, content: { unit, linked: true, reached: true, moving: false, stopped: false, ...content } });
  tell(901, { stopped: true, moving: true });
  tell(902, { linked: false, reached: false, moving: true, "unreached-since": (Date.now() - 60_000) * 1000 });
  tell(903, { stopped: true, reached: false, moving: true });
  const other = await open(t, hub, "alice");
  await other.fleet.getByRole("searchbox", { name: /^Filter/ }).fill("901-903");
  await other.row(901).getByText("stopped, moving").waitFor();
  await other.row(902).getByText(/^lost since \d\d:\d\d:\d\d$/).waitFor();
  await other.row(903).getByText("lost", { exact: true }).waitFor();
});

test("what is repeated ends by its button, at a refusal, and at Escape", async (t) => {
  const { page, fleet, row } = await open(t, lab, "bob");
  await row(5).click();
  await act(fleet, "Grab", "Grabbed: robot 5.");
  await fleet.getByRole("button", { name: "Send…" }).click();
  const dialog = fleet.getByRole("dialog", { name: "Send to robots" });
  await dialog.getByLabel("Command").selectOption("leds");
  await dialog.getByLabel("Repeat every (ms)").fill("99");
  await dialog.getByText("Repeat every (ms): a whole number from 100 to 3600000").waitFor();
  await dialog.getByLabel("Repeat every (ms)").fill("100");
  await dialog.getByRole("button", { name: "Send repeatedly" }).click();
  await dialog.getByText(/^Repeating every 100 ms: sent ([3-9]|\d\d+) times/).waitFor();
  await dialog.getByRole("button", { name: "Stop repeating" }).click();
  await dialog.getByText(/then ended: by the button\.$/).waitFor();

  await dialog.getByRole("button", { name: "Send repeatedly" }).click();
  await dialog.getByText(/^Repeating every 100 ms: sent ([3-9]|\d\d+) times/).waitFor();
  const carol = await RawPeer.login(lab.host, "carol");
  t.after(() => carol.close());
  await carol.ask("context", "join", "/fleet");
  await carol.ask("context", "join", "/fleet/5");
  await carol.ask("token", "grab", "/fleet/5/token");
  await dialog.getByText(/then ended: it was refused\.$/).waitFor();
  await carol.ask("token", "release", "/fleet/5/token");
  await row(5).getByText("free").waitFor();

  await dialog.getByRole("button", { name: "Grab the tokens" }).click();
  await row(5).getByText("you").waitFor();
  await dialog.getByRole("button", { name: "Send repeatedly" }).click();
  await dialog.getByText(/^Repeating every 100 ms: sent ([3-9]|\d\d+) times/).waitFor();
  await page.keyboard.press("Escape");
  await dialog.getByText(/then ended: STOP\.$/).waitFor();
  await row(5).getByText("stopped").waitFor();
  const lines = await lab.watch("carol", "/fleet/5/robot");
  t.after(lines.end);
  await letGo(page);
  await row(5).getByText("standing").waitFor();
  assert.deepEqual(lines.heard.filter(({ name }) => name === "command"), []);
});

test("a robot's camera is shown, once a second", async (t) => {
  const { fleet, row } = await open(t, lab, "alice");
  await row(6).click();
  await fleet.getByText("Camera, 1 picture a second").waitFor();
  await fleet.locator("mom-camera").getByText(/^(0\.[5-9]|1\.[0-4])\/s$/).waitFor();
});

test("pictures that come faster are thinned by the hub, and a robot without a camera says so", async (t) => {
  const carol = await RawPeer.login(hub.host, "carol");
  t.after(() => carol.close());
  for (const path of ["/fleet", "/fleet/status"]) await carol.ask("context", "join", path);
  for (const unit of [6, 7]) {
    const content = { unit, linked: true, x: 0, y: 0, heading: 0, battery: 50, moving: false, stopped: false, fence: 1 };
    await carol.write({ family: "message", name: `robot-${unit}`, context: "/fleet/status", delivery: "latest", echo: false, content });
  }
  const { fleet, row } = await open(t, hub, "alice");
  await row(6).click();
  await fleet.getByText("This robot has no camera: there is no /fleet/6/camera.").waitFor();
  await carol.ask("context", "create", "/fleet/7", { kind: "session" });
  await carol.ask("context", "join", "/fleet/7");
  await carol.ask("context", "create", "/fleet/7/camera", { kind: "channel" });
  await carol.ask("context", "join", "/fleet/7/camera");
  await row(7).click();
  await fleet.getByText("Camera, 1 picture a second").waitFor();
  const image = { image: { $binary: "iVBORw0KGgoAAAANSUhEUgAAAAIAAAACCAIAAAD91JpzAAAAEElEQVR4nGP4z8AARAwQCgAf7gP9i18U1AAAAABJRU5ErkJggg==" }, "media-type": "image/png", width: 2, height: 2 };
  t.after(carol.flood("/fleet/7/camera", "image", image, 20));
  // Of 20 a second the hub passes on one.
  await fleet.locator("mom-camera").getByText(/^1\.[0-4]\/s$/).waitFor();
});

for (const [width, colorScheme] of [[360, "dark"], [1280, "dark"]]) {
  test(`it is accessible at ${width} px, ${colorScheme}, with the dialog as well`, async (t) => {
    const { page, fleet, row } = await open(t, lab, "alice", { viewport: { width, height: 760 }, colorScheme, reducedMotion: "reduce" });
    await row(4).click();
    await fleet.getByText("Robot 4", { exact: true }).waitFor();
    await fleet.getByText("Nobody holds it.").waitFor();
    await accessible(page);
    await fleet.getByRole("button", { name: "Send…" }).click();
    const dialog = fleet.getByRole("dialog", { name: "Send to robots" });
    for (const verb of ["via", "motor", "leds"]) {
      await dialog.getByLabel("Command").selectOption(verb);
      await accessible(page);
    }
  });
}

test("a thousand robots that tell their states every second stay readable, and the page quick", async (t) => {
  const carol = await RawPeer.login(hub.host, "carol");
  t.after(() => carol.close());
  await carol.ask("context", "join", "/fleet");
  await carol.ask("context", "join", "/fleet/status");
  let round = 0;
  const tell = (unit) => {
    const angle = round / 20 + unit;
    const content = { unit, linked: unit % 100 !== 0, x: Math.round((unit % 40) * 1000 + 300 * Math.cos(angle)), y: Math.round(Math.floor(unit / 40) * 1000 + 300 * Math.sin(angle)), heading: (unit * 7 + round) % 360, leds: 0, battery: unit % 101, switches: 0, expired: false, "round-trip": 400 + ((unit * 31 + round) % 900), moving: unit % 3 === 0, stopped: false, waiting: 0, fence: 1, ...(unit % 5 ? {} : { owner: "bob" }) };
    return carol.write({ family: "message", name: `robot-${unit}`, context: "/fleet/status", delivery: "latest", echo: false, content });
  };
  for (let unit = 1; unit <= 1000; unit += 1) tell(unit);
  // A late joiner gets all that is kept.
  await carol.say("/fleet/status", "told", {});
  const timer = setInterval(() => {
    round += 1;
    for (let unit = (round % 10) + 1; unit <= 1000; unit += 10) tell(unit);
  }, 100);
  t.after(() => clearInterval(timer));
  const { page, fleet, row } = await open(t, hub, "alice");
  const table = fleet.getByRole("grid", { name: "Robots" });
  await until(page, async () => (await table.getAttribute("aria-rowcount")) === "1001");
  assert.ok((await fleet.locator("tbody tr").count()) < 100);
  await fleet.getByRole("button", { name: /^10 lost$/ }).waitFor();
  await staysQuick(t, page, async () => {
    await fleet.getByRole("button", { name: "Age", exact: true }).click();
    await fleet.getByRole("button", { name: "Battery", exact: true }).click();
    await row(101).waitFor();
    await table.focus();
    await page.keyboard.press("Control+a");
    await fleet.getByText(/^Selected: 1000 robots/).waitFor();
    await page.keyboard.press("End");
    await row(908).waitFor();
    for (let down = 0; down < 5; down += 1) {
      const top = await fleet.locator("tbody tr[data-unit]").first().innerText();
      await fleet.locator(".rows").evaluate((element) => void (element.scrollTop -= 1500));
      await until(page, async () => (await fleet.locator("tbody tr[data-unit]").first().innerText()) !== top);
    }
    assert.ok((await fleet.locator("tbody tr").count()) < 100);
    // As long as it hears of each some times.
    const heard = round;
    await until(page, () => round > heard + 30);
  });
  // None is forgotten among so many.
  await fleet.getByRole("button", { name: "Age", exact: true }).click();
  await fleet.locator(".rows").evaluate((element) => void (element.scrollTop = 0));
  await until(page, async () => /^(\d+(\.\d)? ms|[12]\.\d s)$/.test(await fleet.locator("tbody tr[data-unit] .age").first().innerText()));
});
