// What the frame tells on every page, and that nothing which comes by itself moves what a hand is on.
import assert from "node:assert/strict";
import { after, before, beforeEach, test } from "node:test";
import { go, letGo, start, until } from "./lab.mjs";
import { RawPeer } from "./rawpeer.mjs";
import { FakeRobot, withRobots } from "./robot.mjs";

/** One with an arm, and one with robots on wheels. */
let [lab, wheels] = [];
before(async () => {
  lab = await start();
  wheels = await start({ lab: ["--fleet", "3"] });
});
after(async () => {
  await wheels?.end();
  await lab?.end();
});
beforeEach(() => lab.free());

const news = (page) => page.locator("mom-console .news");
const card = (page) => page.locator("mom-drive mom-token");
const history = (page) => page.getByRole("region", { name: "History" });

/** Waits until a locator's text fits; a failure tells what it says instead. */
async function says(locator, pattern) {
  try {
    await locator.filter({ hasText: pattern }).first().waitFor({ timeout: 20_000 });
  } catch (error) {
    throw new Error(`not ${pattern}: ${JSON.stringify(await locator.allInnerTexts())}`, { cause: error });
  }
}

async function grab(page) {
  await card(page).getByRole("button", { name: "Grab" }).click();
  await says(card(page), "You hold it");
}

async function ask(page, why) {
  await card(page).getByRole("button", { name: "Ask the owner" }).click();
  await page.getByLabel("Why (optional)").fill(why);
  await page.keyboard.press("Enter");
}

/** One who has joined the robot, without a page. */
async function peer(t, user) {
  const made = await RawPeer.login(lab.host, user);
  t.after(() => made.close());
  await made.ask("context", "join", "/robot");
  return made;
}

/** What has the focus, through shadow roots. */
const focused = (page) =>
  page.evaluate(() => {
    let at = document.activeElement;
    while (at?.shadowRoot?.activeElement) at = at.shadowRoot.activeElement;
    return `${at.localName} ${at.getAttribute("aria-label") ?? ""}`.trim();
  });

/** Where the first button of the sticks is in the page. */
const pad = (page) => page.locator("mom-jog .controls").evaluate((controls) => Math.round(controls.getBoundingClientRect().top + scrollY));

test("who asks for the token is told on another page, with the reason and in the title, and answered there", async (t) => {
  const alice = await lab.page("alice", { t });
  const bob = await lab.page("bob", { t });
  await grab(alice);
  await go(alice, "#/peers");
  await ask(bob, "the red block is mine");
  await says(news(alice), /bob.* asks for \/robot\/token: the red block is mine/);
  await until(alice, async () => /^bob.* asks for \/robot\/token – Peers – MOM$/.test(await alice.title()));
  await news(alice).getByRole("button", { name: "Accept" }).and(alice.locator(':not([aria-disabled="true"])')).click();
  await says(card(bob), "You hold it");
  await says(news(bob), "The owner gave you /robot/token.");
  await says(news(alice), /You lost \/robot\/token: bob.* has it now/);
  await until(alice, async () => (await alice.title()) === "Peers – MOM");
  // What has happened is there after a reload.
  await alice.reload();
  await alice.getByRole("button", { name: /^History/ }).click();
  await says(history(alice), /bob.* asks you for \/robot\/token: the red block is mine/);
  await says(history(alice), "You lost /robot/token");
  // Who logs out leaves nothing behind.
  await alice.getByRole("button", { name: "Log out" }).click();
  await alice.getByRole("button", { name: "Log in" }).waitFor();
  assert.deepEqual(await alice.evaluate(() => Object.keys(sessionStorage)), []);
});

test("who asks for a token that no panel shows is told as well", async (t) => {
  const alice = await wheels.page("alice", { t, path: "/#/fleet" });
  const fleet = alice.locator("mom-fleet");
  await fleet.locator('tr[data-unit="2"]').click();
  await fleet.locator('tr[data-unit="3"]').click({ modifiers: ["Control"] });
  await fleet.getByRole("button", { name: "Grab", exact: true }).click();
  await fleet.locator('tr[data-unit="3"]').getByText("you").waitFor();
  await go(alice, "#/health");
  const bob = await RawPeer.login(wheels.host, "bob");
  t.after(() => bob.close());
  for (const path of ["/fleet", "/fleet/3"]) await bob.ask("context", "join", path);
  const asked = bob.ask("token", "request", "/fleet/3/token", { within: 30_000, text: "my turn" });
  await says(news(alice), "bob asks for /fleet/3/token: my turn");
  await news(alice).getByRole("button", { name: "Accept" }).and(alice.locator(':not([aria-disabled="true"])')).click();
  await asked;
});

test("an offer is accepted on another page, a loan that ends and a token that is taken are told there", async (t) => {
  const alice = await lab.page("alice", { t, path: "/#/audit" });
  const bob = await peer(t, "bob");
  await bob.ask("token", "grab", "/robot/token");
  const name = /alice(~\d+)?(?=, level 1)/.exec(await alice.getByText(/alice(~\d+)?, level 1/).innerText())[0];
  await says(alice.locator("mom-status dl"), /Token\s*bob/);
  // An offer is addressed to this page alone.
  await bob.ask("token", "give", "/robot/token", { to: name, within: 30_000, for: 60_000 });
  await says(news(alice), /bob.* offers you \/robot\/token: for 1 min/);
  await news(alice).getByRole("button", { name: "Accept" }).and(alice.locator(':not([aria-disabled="true"])')).click();
  await go(alice, "#/drive");
  await says(card(alice), /You hold it/);
  await says(card(alice), /Lent by bob.*1 min|Lent by bob.* \d+ s/);
  await go(alice, "#/health");
  const carol = await peer(t, "carol");
  await carol.ask("token", "grab", "/robot/token");
  await says(news(alice), /You lost \/robot\/token: carol.* has a higher level and took it/);
});

test("what is stopped and which device is gone stands in one line of every page, and in the history", async (t) => {
  const alice = await lab.page("alice", { t, path: "/#/health" });
  const height = () => alice.locator("mom-console header").evaluate((header) => header.offsetHeight);
  const before = await height();
  await lab.mom("bob", "stop", "/robot/arm", "--reason", "smoke");
  await says(alice.locator("mom-stopped li"), /Stopped by bob.*: smoke/);
  assert.equal(await height(), before);
  await letGo(alice);
  await alice.locator("mom-stopped li").waitFor({ state: "detached" });
  await alice.getByRole("button", { name: /^History/ }).click();
  await says(history(alice), /No longer: Stopped by bob.*: smoke/);
  await history(alice).getByRole("button", { name: "Close" }).click();
});

test("a device that is gone is told on every page, until it is back; a mirrored robot has none of an arm's controls", async (t) => {
  const hub = await start({ config: withRobots("/cubo") });
  let robot = (await FakeRobot.start(hub.host, "/cubo")).run();
  t.after(async () => {
    await robot.end();
    await hub.end();
  });
  const alice = await hub.page("alice", { t });
  await alice.getByRole("combobox", { name: "Device" }).selectOption("/cubo/robot");
  await says(alice.locator("mom-drive"), "This is a mirrored robot");
  for (const gone of ["mom-jog", "mom-objects", "mom-calibrate", "mom-cursor"]) assert.equal(await alice.locator(gone).count(), 0, gone);
  await alice.getByRole("link", { name: "To its simulacrum" }).click();
  await alice.locator("mom-simulacrum tbody[data-element]").first().waitFor();
  await go(alice, "#/access");
  await robot.end();
  await says(news(alice), "The device of /cubo/robot has been gone since");
  robot = (await FakeRobot.start(hub.host, "/cubo")).run();
  await says(news(alice), "The device of /cubo/robot is back.");
});

test("nothing that comes by itself moves the sticks", async (t) => {
  const own = await start();
  t.after(own.end);
  for (const [width, height] of [[1280, 900], [800, 900], [360, 740]]) {
    const alice = await own.page("alice", { t, viewport: { width, height } });
    await alice.locator("mom-jog .controls").waitFor();
    await until(alice, async () => (await alice.locator("mom-drive mom-camera .picture svg").count()) > 0);
    const token = alice.locator("mom-drive mom-token");
    await says(token, "Nobody holds it.");
    const free = await pad(alice);
    const same = async (what) => assert.equal(await pad(alice), free, `${what} at ${width} px`);
    await token.getByRole("button", { name: "Grab" }).click();
    await says(token, "You hold it");
    await same("a token of one's own");
    const bob = await RawPeer.login(own.host, "bob");
    await bob.ask("context", "join", "/robot");
    const asked = bob.ask("token", "request", "/robot/token", { within: 60_000, text: "a long reason ".repeat(15) }).catch(() => undefined);
    await says(news(alice), "asks for /robot/token");
    await same("a request");
    await own.mom("bob", "stop", "/", "--reason", "a reason that is long enough for two lines of a narrow page");
    await says(alice.locator("mom-stopped li"), "Stopped by bob");
    await same("a stop");
    // Its line has room for both, also on a phone.
    const boxes = await alice.locator("mom-console .strip").evaluate((strip) => [strip, ...strip.querySelectorAll("button")].map((one) => one.getBoundingClientRect().toJSON()));
    boxes.slice(1).forEach((one, index) => {
      assert.ok(one.width >= 24 && one.right <= boxes[0].right + 1, `a button of ${one.width} px to ${one.right} of ${boxes[0].right} at ${width} px`);
      for (const other of boxes.slice(index + 2)) assert.ok(other.left >= one.right, `buttons overlap by ${one.right - other.left} px at ${width} px`);
    });
    // A lock, whose words take several lines.
    const up = alice.locator("mom-jog").getByRole("button", { name: /^Up/ });
    await up.focus();
    await alice.keyboard.down("Enter");
    await says(alice.locator("mom-jog .state p"), "Locked: the device is stopped");
    await same("a lock");
    await alice.keyboard.up("Enter");
    await letGo(alice);
    await same("what is let go");
    const carol = await RawPeer.login(own.host, "carol");
    await carol.ask("context", "join", "/robot");
    await carol.ask("token", "grab", "/robot/token");
    await says(token, /carol.* holds it/);
    await same("a token that was lost");
    await token.getByRole("button", { name: "Wait in the queue" }).click();
    await says(token, "You are number 1 in the queue.");
    await same("a place in the queue");
    await asked;
    for (const one of [bob, carol]) one.close();
    await alice.getByRole("button", { name: "Log out" }).click();
    await alice.getByRole("button", { name: "Log in" }).waitFor();
    await alice.context().close();
  }
});

test("the form to hand over overlaps nothing, and offers people and no devices", async (t) => {
  const alice = await lab.page("alice", { t });
  await peer(t, "bob");
  await grab(alice);
  await alice.getByRole("button", { name: "Hand over" }).click();
  const to = card(alice).getByRole("combobox", { name: "To" });
  await to.waitFor();
  const options = await to.locator("option").allInnerTexts();
  assert.ok(options.some((name) => name.startsWith("bob")), options.join());
  for (const device of ["arm", "camera-pan"]) assert.ok(!options.includes(device), `${device} of ${options}`);
  // Programs are no people.
  for (const name of await to.locator(":scope > option").allInnerTexts()) assert.match(name, /^(bob|carol)/);
  for (const width of [320, 360, 500, 641, 800, 960, 1280, 1900]) {
    await alice.setViewportSize({ width, height: 900 });
    const boxes = await card(alice).locator("form :is(input, select, button)").evaluateAll((all) => all.map((one) => one.getBoundingClientRect().toJSON()));
    const form = await card(alice).locator("form").boundingBox();
    boxes.forEach((one, index) => {
      assert.ok(one.left >= form.x - 1 && one.right <= form.x + form.width + 1, `beyond the form at ${width}`);
      for (const other of boxes.slice(index + 1)) {
        const apart = Math.max(other.left - one.right, one.left - other.right, other.top - one.bottom, one.top - other.bottom);
        assert.ok(apart >= 0, `${-apart} px of overlap at ${width}`);
      }
    });
  }
});

test("the focus is kept after a login, after a grab and after giving back", async (t) => {
  const alice = await lab.open("/", { t });
  await alice.getByLabel("User", { exact: true }).fill("alice");
  await alice.getByRole("textbox", { name: "Password" }).fill("alice");
  await alice.keyboard.press("Enter");
  await alice.getByRole("button", { name: "Log out" }).waitFor();
  assert.equal(await focused(alice), "main");
  const button = card(alice).getByRole("button", { name: "Grab" });
  await button.and(alice.locator(":enabled")).focus();
  await alice.keyboard.press("Enter");
  await says(card(alice), "You hold it");
  await until(alice, async () => (await focused(alice)) === "section Token /robot/token");
  await alice.keyboard.press("Tab");
  assert.equal(await focused(alice), "button");
  await alice.keyboard.press("Enter");
  await says(card(alice), "Nobody holds it.");
  await until(alice, async () => (await focused(alice)) === "section Token /robot/token");
  // Space stops there.
  await alice.keyboard.press("Space");
  await alice.locator("mom-stop .report").waitFor();
  await until(alice, () => alice.getByRole("button", { name: "Let go" }).isEnabled());
  await letGo(alice);
});

test("a reason that does not hold any more is not said of live driving", async (t) => {
  const alice = await lab.page("alice", { t });
  const state = alice.locator("mom-jog .state p").first();
  await says(card(alice), "Nobody holds it.");
  const up = alice.locator("mom-jog").getByRole("button", { name: /^Up/ });
  await up.focus();
  await alice.keyboard.down("Enter");
  await says(state, "Locked: you do not hold the token.");
  await alice.keyboard.up("Enter");
  await says(state, "Rested: you do not hold the token.");
  await grab(alice);
  await says(state, /^At rest$/);
});

test("Grab is the first choice where it takes the token, and a place in the queue is told as one that could be had", async (t) => {
  const alice = await lab.page("alice", { t });
  const button = card(alice).getByRole("button", { name: "Grab" });
  await says(card(alice), "Nobody holds it.");
  assert.match(await button.getAttribute("class"), /main/);
  const bob = await peer(t, "bob");
  await bob.ask("token", "grab", "/robot/token");
  await says(card(alice), /bob.* holds it/);
  assert.doesNotMatch((await button.getAttribute("class")) ?? "", /main/);
  await button.click();
  await says(card(alice).locator(".refusal"), "Place, if you wait");
  assert.equal(await card(alice).getByText(/You are number/).count(), 0);
});

test("who is put out of the hub is told at the login by whom and why", async (t) => {
  const own = await start();
  t.after(own.end);
  const bob = await own.page("bob", { t });
  const carol = await RawPeer.login(own.host, "carol");
  t.after(() => carol.close());
  await carol.ask("context", "expel", "/", { peer: "bob", text: "the lab closes at six", for: 60_000 });
  await bob.getByText("You were expelled from the hub by carol: the lab closes at six").first().waitFor();
  await bob.getByRole("button", { name: "Log in" }).waitFor();
});

test("the line that is always seen is about the robot of the page, and says which", async (t) => {
  const arm = await lab.page("alice", { t });
  await says(arm.locator("mom-status dl"), /Pose of \/robot/);
  const alice = await wheels.page("alice", { t });
  const line = alice.locator("mom-status dl");
  await says(line, /Pose of \/fleet\/1/);
  await go(alice, "#/fleet");
  await says(line, /Pose\s*no robot selected/);
  await alice.locator('mom-fleet tr[data-unit="2"]').click();
  await says(line, /Pose of \/fleet\/2/);
  await go(alice, "#/drive");
  await says(line, /Pose of \/fleet\/2/);
});

test("a robot on wheels has none of an arm's controls", async (t) => {
  const alice = await wheels.page("alice", { t });
  await alice.getByRole("combobox", { name: "Device" }).selectOption("/fleet/2/robot");
  await says(alice.locator("mom-drive"), "This is a robot on wheels");
  for (const gone of ["mom-jog", "mom-objects", "mom-calibrate", "mom-cursor"]) assert.equal(await alice.locator(gone).count(), 0, gone);
  const commands = alice.locator("mom-commands");
  // Its card says what it knows.
  await says(commands, "By form: 4 verbs");
  for (const name of ["Grip open", "From cursor", "Home"]) assert.equal(await commands.getByRole("button", { name }).count(), 0, name);
  await alice.getByRole("link", { name: "To Fleet" }).click();
  await alice.locator("mom-fleet").waitFor();
});

test("picture and sticks are seen together from 641 to 960 px", async (t) => {
  const alice = await lab.page("alice", { t });
  for (const [width, height] of [[641, 800], [768, 1024], [800, 700], [900, 700], [960, 700]]) {
    await alice.setViewportSize({ width, height });
    const [picture, sticks] = [alice.locator("mom-drive #picture mom-camera .picture"), alice.locator("mom-jog .sticks")];
    await picture.waitFor();
    await until(alice, () => alice.evaluate(() => document.documentElement.scrollWidth <= innerWidth));
    const [one, other] = [await picture.boundingBox(), await sticks.boundingBox()];
    const bottom = Math.max(one.y + Math.min(one.height, 240), other.y + other.height);
    assert.ok(bottom <= height, `${bottom} of ${height} at ${width}`);
    assert.ok(one.width >= 250 && other.x >= one.x + one.width, `${one.width} wide at ${width}`);
  }
});

test("each line of the audit log has its date", async (t) => {
  const hub = await start({ config: '\n[audit]\npath = "audit.jsonl"\n' });
  t.after(hub.end);
  const carol = await hub.page("carol", { t, path: "/#/audit" });
  const times = carol.locator("mom-audit tbody tr[data-seq] td.time");
  await times.first().waitFor();
  for (const time of await times.allInnerTexts()) assert.match(time, /\d{4}-\d\d-\d\d\s+\d\d:\d\d:\d\d/);
});

test("a click puts the cursor on a block or on the table, and so does a drag of its middle onto a block", async (t) => {
  const alice = await lab.page("alice", { t });
  const picture = alice.locator("mom-cameras mom-camera.big .picture svg");
  await picture.waitFor();
  await alice.locator("mom-cursor tbody tr").filter({ hasText: "block red" }).waitFor();
  const away = async (name) => Number.parseFloat(await alice.locator("mom-cursor tbody tr").filter({ hasText: `block ${name}` }).locator("td.number").first().innerText());
  /** Where a block is seen, in the page. */
  const seen = (name) =>
    alice.evaluate((name) => {
      const find = (root) => [...root.querySelectorAll("*")].flatMap((one) => [one, ...(one.shadowRoot ? find(one.shadowRoot) : [])]);
      const big = find(document).find((one) => one.matches("mom-camera.big"));
      const label = [...big.shadowRoot.querySelectorAll("svg text")].find((text) => text.textContent === name).getBoundingClientRect();
      return { x: label.x + label.width / 2, y: label.bottom + 12 };
    }, name);
  const blue = await seen("blue");
  await alice.mouse.click(blue.x, blue.y);
  await until(alice, async () => (await away("blue")) < 1);
  // The table, where nothing else is.
  const box = await picture.boundingBox();
  await alice.mouse.click(box.x + box.width * 0.35, box.y + box.height * 0.82);
  await until(alice, async () => (await alice.locator("mom-cursor .degrees input").nth(2).inputValue()) === "0");
  assert.ok((await away("blue")) > 50);
  // Its middle, from above the table onto a block.
  await alice.locator("mom-cursor .degrees input").nth(2).fill("200");
  const middle = await alice.locator("mom-cameras mom-camera.big").getByRole("slider", { name: "Cursor across the table" }).boundingBox();
  const red = await seen("green");
  await alice.mouse.move(middle.x + middle.width / 2, middle.y + middle.height / 2);
  await alice.mouse.down();
  await alice.mouse.move(red.x - 40, red.y, { steps: 4 });
  await alice.mouse.move(red.x, red.y, { steps: 4 });
  await alice.mouse.up();
  await until(alice, async () => (await away("green")) < 1);
});
