// Driving, as a person does it: against a lab, in a browser.
import assert from "node:assert/strict";
import { after, before, beforeEach, test } from "node:test";
import { letGo, stands, start } from "./lab.mjs";

/** Of the lab. */
const CHANNELS = 10;

let lab;
let alice;
let arm;

before(async () => {
  lab = await start();
  arm = await lab.watch("carol", "/robot/arm");
  alice = await lab.page("alice");
  await alice.getByRole("button", { name: "Grab" }).click();
  await alice.getByRole("button", { name: "Give back" }).waitFor();
});
after(async () => {
  arm?.end();
  await lab?.end();
});

beforeEach(async () => {
  // One that failed leaves nothing held, and nothing in the list.
  await alice.evaluate(() => delete document.visibilityState);
  for (const key of ["d", "w", "s", "ArrowLeft", "ArrowRight"]) await alice.keyboard.up(key);
  await alice.mouse.up();
  await widen(alice);
  for (const button of await alice.locator('mom-commands li [data-action="remove"]').all()) await alice.locator('mom-commands li [data-action="remove"]').first().click();
});

const commands = (page) => page.locator("mom-commands");
const state = (page) => page.locator("mom-jog .state p").first();
const line = (page) => page.getByLabel("New command", { exact: true });

/** Pictures may be three seconds old: where tests run the machine may be busy. */
async function widen(page) {
  await page.locator('mom-jog input[name="limit"]').evaluate((input) => {
    input.value = "3000";
    input.dispatchEvent(new Event("input", { bubbles: true }));
  });
}

async function add(page, text) {
  await line(page).fill(text);
  await line(page).press("Enter");
}

/** Waits until a locator's text fits; a failure tells what it says instead, and what the page has noted. */
async function says(locator, pattern) {
  try {
    await locator.filter({ hasText: pattern }).first().waitFor({ timeout: 20_000 });
  } catch (error) {
    const texts = await locator.allInnerTexts();
    const notes = await locator.page().locator("mom-notices li, mom-stopped li, mom-token p, .refusal").allInnerTexts();
    throw new Error(`not ${pattern}: ${JSON.stringify(texts)}; noted: ${JSON.stringify(notes)}`, { cause: error });
  }
}

test("a list of three commands is sent, and each goes through its states", async () => {
  await alice.evaluate(() => {
    // Each badge's words, as they come.
    const words = (window.seen = new Set());
    const root = document.querySelector("mom-console").shadowRoot.querySelector("mom-drive").shadowRoot.querySelector("mom-commands").shadowRoot;
    new MutationObserver(() => root.querySelectorAll(".badge").forEach((badge) => words.add(badge.textContent.trim().replace(/\s+/g, " ")))).observe(root, { subtree: true, childList: true, characterData: true });
  });
  for (const text of ["move 100 50 200 0 0; grip close; wait 1500", "by 0 0 -20 0 0", "wait 300; home"]) await add(alice, text);
  await commands(alice).getByRole("button", { name: /Send all \(3\)/ }).click();
  await alice.waitForFunction(() => document.querySelector("mom-console").shadowRoot.querySelector("mom-drive").shadowRoot.querySelector("mom-commands").shadowRoot.querySelectorAll("li.finished").length === 3, null, { timeout: 30_000 });
  const seen = await alice.evaluate(() => [...window.seen]);
  for (const word of ["waiting", "executing 1 of 3", "executing 3 of 3", "finished"]) assert.ok(seen.includes(word), `${word}: ${seen}`);
  await says(commands(alice).locator(".pose"), /x\s*0\.0 mm/);
  await commands(alice).getByRole("button", { name: "Clear finished" }).click();
  assert.equal(await commands(alice).locator("li").count(), 0);
});

test("a mistake is marked at its line and column, and nothing is sent", async () => {
  await line(alice).fill("home; grip closed");
  await says(commands(alice).locator(".new .mistake"), "Column 12: statement 2: there is no `closed`; did you mean `close`?");
  assert.ok(await commands(alice).getByRole("button", { name: "Add", exact: true }).isDisabled());
  await line(alice).fill("");
  await commands(alice).getByRole("button", { name: "As text" }).click();
  const area = commands(alice).locator("textarea");
  await area.fill("home\n  mvoe 1 2 3 4 5 # there\nwait -1\n");
  await says(commands(alice).locator(".mistake"), "Line 2, column 3: statement 1: there is no `mvoe`");
  await says(commands(alice).locator(".mistake"), "Line 3, column 6");
  await commands(alice).locator(".mistake").first().click();
  assert.equal(await area.evaluate((area) => area.value.slice(area.selectionStart, area.selectionEnd)), "mvoe");
  await commands(alice).getByRole("button", { name: "Use as the list" }).click();
  await commands(alice).getByRole("button", { name: /Send all/ }).click();
  await says(commands(alice), "command 2 cannot be read, so nothing was sent");
  assert.equal(await commands(alice).locator("li.waiting").count(), 3);
});

test("an error says what to do, the rest waits, and the list survives a reload", async () => {
  // What is outside of the card's ranges is told before; what the joints do not reach only the arm knows.
  await line(alice).fill("move 100 50 900 0 0");
  await says(commands(alice).locator(".new .mistake"), "Column 13: statement 1: z is 900, `move` takes 0 to 450 mm");
  for (const text of ["move 300 0 450 90 45", "home"]) await add(alice, text);
  await commands(alice).getByRole("button", { name: /Send all/ }).click();
  await says(commands(alice).locator("li.error"), "joint");
  await says(commands(alice), "The rest waits: a command failed");
  assert.equal(await commands(alice).locator("li.waiting").count(), 1);
  await commands(alice).getByRole("button", { name: /Use the nearest pose/ }).click();
  await says(commands(alice).locator("li.waiting .text"), /^move (?!300 0 450 90 45)-?\d/);
  await add(alice, "wait 20000");
  await commands(alice).getByRole("button", { name: "Send command 3" }).click();
  await commands(alice).locator("li.executing").waitFor();
  await alice.reload();
  await commands(alice).locator("li.unknown").waitFor();
  assert.equal(await commands(alice).locator("li.waiting").count(), 2);
  await alice.getByRole("button", { name: "Grab" }).click();
  await alice.getByRole("button", { name: "Give back" }).waitFor();
});

test("two who want to drive: one is refused in words, asks, and gets it; nothing more is sent by the other", async (t) => {
  const bob = await lab.page("bob", { t });
  await bob.getByRole("button", { name: "Grab" }).click();
  await says(bob.locator("mom-token .refusal"), "is held by alice");
  await says(commands(bob), "Grab /robot/token first");
  for (const text of ["wait 15000", "home"]) await add(alice, text);
  await commands(alice).getByRole("button", { name: /Send all/ }).click();
  await commands(alice).locator("li.executing").waitFor();
  await bob.getByRole("button", { name: "Ask the owner" }).first().click();
  await bob.getByRole("button", { name: "Ask", exact: true }).click();
  // Not before it has stood there for a moment.
  await alice.locator('mom-console .news button:not([aria-disabled="true"])').filter({ hasText: "Accept" }).click();
  await bob.getByRole("button", { name: "Give back" }).waitFor();
  await says(commands(alice).locator("li.error"), /lost \/robot\/token: bob.* has it now; the device has ended the command/);
  await says(commands(alice), "The rest waits");
  assert.equal(await commands(alice).locator("li.waiting").count(), 1);
  // The arm is bob's now.
  await add(bob, "home");
  await commands(bob).getByRole("button", { name: /Send all/ }).click();
  await commands(bob).locator("li.finished").waitFor({ timeout: 20_000 });
  assert.equal(await commands(alice).locator("li.waiting").count(), 1);
  await bob.getByRole("button", { name: "Give back" }).click();
  // The hub has heard it: two connections are in no order.
  await says(alice.locator("mom-token"), "Nobody holds it.");
  await alice.getByRole("button", { name: "Grab" }).click();
  await alice.getByRole("button", { name: "Give back" }).waitFor();
});

/** Notes when a key is pressed and let go, by this machine's clock. */
async function follow(page) {
  await page.evaluate(() => {
    addEventListener("keydown", () => (window.began = Date.now()), { capture: true, once: true });
    addEventListener("keyup", () => (window.ended = Date.now()), { capture: true, once: true });
  });
}

/** How long the arm took to set off, and how long it went on after the end, in ms, by the times of its own words. */
async function ranOn(page) {
  await says(commands(page).locator(".pose"), "at rest");
  const { began, ended } = await page.evaluate(() => ({ began: window.began, ended: window.ended }));
  const poses = arm.heard.filter(({ name }) => name === "state").map(({ timestamp, content }) => ({ at: Date.parse(timestamp), pose: JSON.stringify(content.pose) }));
  const changes = poses.filter(({ pose }, index) => index > 0 && pose !== poses[index - 1].pose).map(({ at }) => at);
  return { setOff: changes.find((at) => at > began) - began, stood: changes.at(-1) - ended };
}

/**
 * That the arm stands within 300 ms of an end, or in twice the time in which it set off: where the machine is busy, both words take long. One of four times has to be so.
 */
async function standsSoon(page, key, end, again = async () => undefined) {
  const took = [];
  for (let turn = 0; turn < 4; turn += 1) {
    if (turn) await again();
    await follow(page);
    await page.keyboard.down(key);
    await moves(page);
    await end();
    took.push(await ranOn(page));
    if (took.at(-1).stood < Math.max(300, 2 * took.at(-1).setOff)) return;
  }
  assert.fail(`it set off in, and went on for: ${took.map(({ setOff, stood }) => `${setOff}, ${stood}`).join("; ")} ms`);
}

async function moves(page) {
  await says(state(page), "Driving: 50 mm/s");
  await says(commands(page).locator(".pose"), ", moving");
}

test("held keys move the arm, and it stands soon after they are let go", async () => {
  await alice.getByRole("switch", { name: "Drive by keys" }).click();
  await says(alice.locator("mom-jog .state"), /Picture of .*± /);
  await standsSoon(alice, "d", () => alice.keyboard.up("d"));
  assert.match(await state(alice).innerText(), /At rest/);
  // What is typed into a field moves nothing.
  await line(alice).press("d");
  assert.equal(await line(alice).inputValue(), "d");
  assert.match(await state(alice).innerText(), /At rest/);
  await line(alice).fill("");
  await alice.getByRole("switch", { name: "Drive by keys" }).focus();
});

test("hiding the page locks driving, until everything was let go", async () => {
  const show = () => alice.evaluate(() => {
    delete document.visibilityState;
    document.dispatchEvent(new Event("visibilitychange"));
  });
  const hide = () => alice.evaluate(() => {
    Object.defineProperty(document, "visibilityState", { configurable: true, get: () => "hidden" });
    window.ended = Date.now();
    document.dispatchEvent(new Event("visibilitychange"));
  });
  await standsSoon(alice, "ArrowLeft", hide, async () => {
    await show();
    await alice.keyboard.up("ArrowLeft");
  });
  await says(state(alice), "Rested: this page was hidden");
  await show();
  // The key is down still and repeats: nothing moves.
  await alice.keyboard.down("ArrowLeft");
  assert.match(await state(alice).innerText(), /Rested/);
  await alice.keyboard.up("ArrowLeft");
  await alice.keyboard.down("ArrowRight");
  await moves(alice);
  await alice.keyboard.up("ArrowRight");
  await ranOn(alice);
});

test("an old picture locks driving and says so", async () => {
  const limit = alice.locator('mom-jog input[name="limit"]');
  const narrow = () => limit.evaluate((input) => {
    window.ended = Date.now();
    input.value = "0";
    input.dispatchEvent(new Event("input", { bubbles: true }));
  });
  await standsSoon(alice, "w", narrow, async () => {
    await widen(alice);
    await alice.keyboard.up("w");
  });
  await says(state(alice), "Locked: the picture is too old. Let go, then hold again.");
  await widen(alice);
  // Still held: still locked.
  assert.match(await state(alice).innerText(), /Locked/);
  await alice.keyboard.up("w");
  await says(state(alice), "Rested: the picture is too old");
});

test("a picture is named after its own camera, and without one of a camera that sees the arm nobody drives", async () => {
  const shown = alice.locator("mom-jog .state");
  await says(shown, "Picture of /camera/x");
  const toggle = async (name) => alice.locator("mom-cameras").getByRole("button", { name, exact: true }).first().click();
  await toggle("x");
  // The next one is big now, and asked for pictures.
  await says(shown, /Picture of \/camera\/(pan|y|top|wrist)/);
  const others = await alice.locator('mom-cameras button[aria-pressed="true"]').allInnerTexts();
  for (const name of others) await toggle(name);
  await says(shown, "no camera that sees the device is shown");
  await alice.keyboard.down("w");
  await says(state(alice), "Locked: no camera that sees the device is shown.");
  await alice.keyboard.up("w");
  for (const name of ["x", ...others]) await toggle(name);
  await says(shown, "Picture of /camera/x");
  await alice.getByRole("switch", { name: "Drive by keys" }).focus();
});

test("STOP ends driving", async () => {
  await alice.keyboard.down("s");
  await moves(alice);
  await alice.keyboard.press("Escape");
  await says(state(alice), "Locked: STOP was pressed");
  await says(commands(alice).locator(".pose"), "stopped");
  await alice.keyboard.up("s");
  const release = async () => {
    await letGo(alice);
    await commands(alice).locator(".pose").filter({ hasText: "at rest", hasNotText: "stopped" }).waitFor();
  };
  await release();
  // Space as well, though the switch has the focus.
  await alice.getByRole("switch", { name: "Drive by keys" }).focus();
  await alice.keyboard.press(" ");
  await says(commands(alice).locator(".pose"), "stopped");
  assert.equal(await alice.getByRole("switch", { name: "Drive by keys" }).getAttribute("aria-checked"), "true");
  await release();
  await alice.getByRole("switch", { name: "Drive by keys" }).focus();
});

test("a button moves as long as it is held", async () => {
  const up = alice.locator("mom-jog").getByRole("button", { name: /^Up/ });
  const box = await up.boundingBox();
  await up.scrollIntoViewIfNeeded();
  await up.hover();
  await alice.mouse.down();
  await moves(alice);
  await alice.mouse.up();
  await says(commands(alice).locator(".pose"), "at rest");
  assert.ok(box && box.height >= 24);
});

test("directions are those of the camera, if that is wanted", async () => {
  const frame = alice.locator("mom-jog").getByLabel("Directions");
  await frame.selectOption("camera");
  await alice.locator("mom-jog").getByText("No matrix from the camera yet").waitFor({ state: "hidden" });
  await alice.getByRole("switch", { name: "Drive by keys" }).focus();
  const x = async () => Number(await commands(alice).locator(".pose dd .mono").first().innerText());
  const before = await x();
  await alice.keyboard.down("w");
  await moves(alice);
  await alice.keyboard.up("w");
  await says(commands(alice).locator(".pose"), "at rest");
  // Camera x looks towards lesser x.
  assert.ok((await x()) < before, `${before} ${await x()}`);
  await frame.selectOption("table");
});

test("a gamepad drives while its dead-man button is held", async () => {
  await alice.evaluate(() => {
    const buttons = Array.from({ length: 17 }, () => ({ pressed: false, value: 0 }));
    window.pad = { index: 0, id: "A pad", connected: true, mapping: "standard", axes: [0, 0, 0, 0], buttons };
    navigator.getGamepads = () => (window.pad ? [window.pad] : []);
    dispatchEvent(new Event("gamepadconnected"));
  });
  const push = (axis, held) => alice.evaluate(([axis, held]) => {
    window.pad.axes[0] = axis;
    window.pad.buttons[5] = { pressed: held, value: held ? 1 : 0 };
  }, [axis, held]);
  await push(1, false);
  await says(state(alice), "Locked: the dead-man button was not held");
  // It must be let go first.
  await push(1, true);
  await alice.locator("mom-jog summary").click();
  await says(alice.locator("mom-jog"), /: ?held|held/);
  assert.match(await state(alice).innerText(), /Locked/);
  await push(0, false);
  await says(state(alice), "Rested");
  await push(1, true);
  await moves(alice);
  await alice.evaluate(() => (window.pad = null));
  await says(state(alice), "Rested: the gamepad is gone");
  await says(commands(alice).locator(".pose"), "at rest");
});

test("commands are put in order by keyboard, and a list can be paused", async () => {
  for (const text of ["wait 1", "wait 2", "wait 4000"]) await add(alice, text);
  const order = () => commands(alice).locator("li .text").allInnerTexts();
  await commands(alice).getByRole("button", { name: "Move up command 3" }).focus();
  await alice.keyboard.press("Alt+ArrowUp");
  await alice.keyboard.press("Alt+ArrowUp");
  assert.deepEqual(await order(), ["wait 4000", "wait 1", "wait 2"]);
  await commands(alice).getByRole("button", { name: /Send all/ }).click();
  await commands(alice).getByRole("button", { name: "Pause", exact: true }).click();
  await says(commands(alice), "The rest waits: paused");
  assert.equal(await commands(alice).locator("li.finished").count(), 1);
  assert.equal(await commands(alice).locator("li.waiting").count(), 2);
});

test("an agent is lent the token, works, and gives it back when it is cancelled", async () => {
  const objects = alice.locator("mom-objects");
  await objects.locator("tbody tr").filter({ hasText: "red" }).waitFor({ timeout: 20_000 });
  await objects.getByRole("button", { name: "Give the token to the agent" }).click();
  await says(objects.locator(".progress"), /[0-9]+ commands?/);
  await says(alice.locator("mom-token"), "servo holds it");
  await objects.getByRole("button", { name: "Cancel: take the token back" }).click();
  await says(objects.locator(".progress"), "Cancelled");
  await alice.getByRole("button", { name: "Give back" }).waitFor();
});

test("objects are seen, and the lab is reset after a question", async () => {
  const objects = alice.locator("mom-objects");
  for (const name of ["red", "green", "blue"]) await objects.locator("tbody tr").filter({ hasText: name }).waitFor({ timeout: 20_000 });
  await objects.getByRole("button", { name: "Reset the lab…" }).click();
  await objects.getByRole("dialog").getByRole("button", { name: "Reset", exact: true }).click();
  await says(commands(alice).locator(".pose"), /x\s*0\.0 mm\s*y\s*0\.0 mm\s*z\s*300\.0 mm/);
});

test("a reset that the arm would refuse says why", async () => {
  const objects = alice.locator("mom-objects");
  await alice.locator("mom-stop").getByRole("button", { name: /^STOP/ }).click();
  await stands(alice, CHANNELS);
  await says(commands(alice), "The device is stopped");
  await objects.getByRole("button", { name: "Reset the lab…" }).click();
  await objects.getByRole("dialog").getByRole("button", { name: "Reset", exact: true }).click();
  await says(objects.locator(".refusal"), "let it go first");
  await letGo(alice);
  await objects.getByRole("button", { name: "Reset the lab…" }).click();
  await objects.getByRole("dialog").getByRole("button", { name: "Reset", exact: true }).click();
  await objects.locator(".refusal").waitFor({ state: "detached" });
});

test("what is said in the chat is text, whatever it looks like", async (t) => {
  const bob = await lab.page("bob", { t });
  const field = (page) => page.getByLabel("Message", { exact: true });
  const nasty = '<img src=x onerror="alert(1)"><b>bold</b>';
  await field(bob).fill(nasty);
  await field(bob).press("Enter");
  await says(alice.locator("mom-chat .said"), nasty);
  assert.equal(await alice.locator("mom-chat .log img, mom-chat .log b").count(), 0);
  await field(alice).fill("one\ntwo");
  await field(alice).press("Shift+Enter");
  assert.match(await field(alice).inputValue(), /\n/);
  // A page of his that is gone may still have the name for a while.
  const name = (await bob.locator("mom-chat .said.mine strong").first().innerText()).replace(" (you)", "");
  await field(alice).fill(`/${name} only for you`);
  await field(alice).press("Enter");
  await says(bob.locator("mom-chat .said"), "only for you");
  await says(alice.locator("mom-chat .said.mine"), `to ${name}`);
  await field(alice).fill("/nobody hello");
  await field(alice).press("Enter");
  await says(alice.locator("mom-chat"), "nobody is not here");
});

test("nothing went wrong in the page", () => assert.deepEqual(alice.faults, []));

test("a camera is calibrated by an agent that is lent the token, until it is cancelled", async () => {
  const panel = alice.locator("mom-calibrate");
  await panel.locator("select").selectOption({ label: "x" });
  await panel.getByRole("button", { name: "Calibrate: lend the token" }).click();
  await says(panel.locator(".progress"), /Pose [1-9][0-9]* of 20/);
  await says(alice.locator("mom-token"), "calibrate holds it");
  await panel.getByRole("button", { name: "Cancel the calibration" }).click();
  await says(panel.locator(".progress"), "Cancelled");
  await alice.getByRole("button", { name: "Give back" }).waitFor();
});
