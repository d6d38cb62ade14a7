// The console's frame: who logs in, what survives a reload and a lost network, and STOP.
import assert from "node:assert/strict";
import { after, before, beforeEach, test } from "node:test";
import { isPreview, letGo, logIn, NETWORK, stands, start } from "./lab.mjs";

let lab;
before(async () => (lab = await start()));
after(() => lab?.end());
beforeEach(() => lab.free());

const token = (page) => page.locator("mom-token").first();
/** The peer's name: that of a page which was closed is kept for a while, so the next one has a number. */
const nameOf = async (page) => /alice(~\d+)?(?=, level 1)/.exec(await page.getByText(/alice(~\d+)?, level 1/).innerText())[0];
const report = (page) => page.locator("mom-stop .report");
/** The channels of the lab that alice may stop. */
const CHANNELS = 10;

test("a wrong password is refused in words, a right one lets in", async (t) => {
  const page = await lab.open("/", { t });
  await logIn(page, "alice", "wrong");
  await page.getByText("Wrong user or password.").waitFor();
  await logIn(page, "alice");
  await nameOf(page);
  await page.locator("mom-status dl").getByText(/connected \(ws\)/).waitFor();
  await page.locator("mom-status div").filter({ hasText: /Round trip\s*[\d.]+ ms/ }).waitFor();
});

test("the page is of the hub alone, within its policy, and small", async (t) => {
  const page = await lab.open("/", { t, allow: /Content Security Policy/ });
  const hosts = new Set();
  let bytes = 0;
  // What the load before still waits for is not of the one that is measured.
  await page.waitForLoadState("networkidle");
  page.on("response", async (response) => {
    hosts.add(new URL(response.url()).host);
    bytes += Number(response.headers()["content-length"] ?? 0);
  });
  await page.reload();
  await page.getByRole("button", { name: "Log in" }).waitFor();
  assert.deepEqual([...hosts], [new URL(lab.address).host]);
  assert.ok(isPreview || (bytes > 10_000 && bytes < 130 * 1024), `${bytes} bytes of the first load`);
  // A script that was injected into the page does not run.
  await page.evaluate(() => {
    const script = document.createElement("script");
    script.textContent = "window.broken = true";
    document.body.append(script);
  });
  assert.equal(await page.evaluate(() => window.broken), undefined);
});

test("a reload logs in again by itself, under the same name, and gives the token back at once", async (t) => {
  const page = await lab.page("alice", { t });
  await token(page).getByRole("button", { name: "Grab" }).click();
  await token(page).getByText("You hold it").waitFor();
  const name = await nameOf(page);
  await page.reload();
  assert.equal(await nameOf(page), name);
  // Neither another name nor a token that nobody can have until a lease is over.
  await token(page).getByText("Nobody holds it.").waitFor();
  await page.getByRole("button", { name: "Log out" }).click();
  await page.getByRole("button", { name: "Log in" }).waitFor();
  await page.reload();
  await page.getByRole("button", { name: "Log in" }).waitFor();
});

test("two tabs of one person are two peers, also when one is copied", async (t) => {
  const page = await lab.page("alice", { t });
  // It is encrypted before it is kept.
  await page.waitForFunction(() => sessionStorage.length > 0);
  const storage = await page.evaluate(() => ({ ...sessionStorage }));
  const copy = await page.context().newPage();
  await copy.addInitScript((kept) => Object.entries(kept).forEach(([key, value]) => sessionStorage.setItem(key, value)), storage);
  await copy.goto(lab.address);
  assert.notEqual(await nameOf(copy), await nameOf(page));
  // The first one lives.
  assert.match(await page.locator("mom-status dl").innerText(), /connected/);
});

test("Escape stops from anywhere and Space outside of fields, and each device says that it stands", async (t) => {
  const page = await lab.page("alice", { t });
  await page.getByLabel("New command", { exact: true }).focus();
  await page.keyboard.press("Space");
  assert.equal(await report(page).count(), 0, "Space belongs to the control that has the focus");
  await page.keyboard.press("Escape");
  await report(page).getByText(/\/robot\/arm\s*arm\s*at rest, measured, after/).waitFor();
  await report(page).getByText(/\/camera\/pan\s*camera-pan\s*at rest, measured, after/).waitFor();
  const status = page.locator("mom-status");
  await status.getByText("stopped").waitFor();
  await stands(page, CHANNELS);
  await letGo(page);
  await report(page).getByText(/arm\s*may move, after/).waitFor();
  await status.getByText("at rest").waitFor();
  await page.locator("main").focus();
  await page.keyboard.press("Space");
  await report(page).getByText(/arm\s*at rest, measured, after/).waitFor();
  await stands(page, CHANNELS);
  await letGo(page);
  await status.getByText("at rest").waitFor();
});

test("who has stopped it and why is in the frame, and only what it shows is let go", async (t) => {
  const said = async (reason) => assert.equal((await lab.mom("bob", "stop", "/camera/pan", "--reason", reason)).code, 0);
  await said("a hand is near");
  const page = await lab.page("alice", { t, path: "/#/contexts" });
  const standing = page.locator("mom-stopped li");
  await standing.getByText(/Stopped by bob.*: a hand is near/).waitFor();
  await standing.getByText("/camera/pan", { exact: true }).waitFor();
  // This page is not in that channel, and has not seen this one yet.
  await said("smoke");
  const free = page.getByRole("button", { name: "Let go" });
  await letGo(page);
  await report(page).getByText(/\/camera\/pan stays stopped: bob.* stopped it again: smoke/).waitFor();
  await standing.getByText(/Stopped by bob.*: smoke/).waitFor();
  await letGo(page);
  await report(page).getByText(/camera-pan\s*may move, after/).waitFor();
  await standing.waitFor({ state: "detached" });
  assert.equal(await free.isDisabled(), true);
});

test("with the link down STOP tries every door and says that nobody has confirmed it; then the link goes on", async (t) => {
  const page = await lab.page("alice", { t, allow: NETWORK });
  await token(page).getByRole("button", { name: "Grab" }).click();
  await token(page).getByText("You hold it").waitFor();
  lab.child.kill("SIGSTOP");
  try {
    await page.keyboard.press("Escape");
    await report(page).getByText("NOT CONFIRMED").waitFor();
    await report(page).getByText(/trying ws:.*http:/).waitFor();
    await page.locator("mom-status").getByText(/no answer|link lost/).waitFor();
  } finally {
    lab.child.kill("SIGCONT");
  }
  await report(page).getByText(/arm\s*at rest, measured, after/).waitFor();
  await page.locator("mom-status").getByText("connected").waitFor();
  await letGo(page);
  await report(page).getByText(/arm\s*may move/).waitFor();
});

test("a network that is cut and comes back keeps the peer and its token", async (t) => {
  const hub = await start({ relay: true });
  t.after(hub.end);
  const page = await hub.page("alice", { t, allow: NETWORK });
  await token(page).getByRole("button", { name: "Grab" }).click();
  await token(page).getByText("You hold it").waitFor();
  const fence = await token(page).getByText(/^Fence/).innerText();
  hub.relay.closed = true;
  hub.relay.cut();
  await page.locator("mom-status").getByText("link lost, resuming").waitFor();
  hub.relay.closed = false;
  await page.locator("mom-status").getByText("connected").waitFor();
  await nameOf(page);
  await token(page).getByText("You hold it").waitFor();
  assert.equal(await token(page).getByText(/^Fence/).innerText(), fence);
});

test("a page under an address that the hub does not know is told what its owner can add", async (t) => {
  const hub = await start({ relay: "unlisted" });
  t.after(hub.end);
  const page = await hub.open("/", { t, allow: NETWORK });
  await logIn(page, "alice", "not-tried");
  await page.getByText(`origins = ["${hub.address}"]`).waitFor();
});

test("a page of an older version says so, and is loaded anew", async (t) => {
  const page = await lab.page("alice", { t });
  await page.route("**/api/console", (route) => route.fulfill({ contentType: "application/json", body: JSON.stringify({ console: "0000000000000000", version: "9.9.9" }) }));
  await page.evaluate(() => document.dispatchEvent(new Event("visibilitychange")));
  await page.getByText("The hub has a newer version of this page.").waitFor();
  await page.unroute("**/api/console");
  const again = page.waitForEvent("load");
  await page.getByRole("button", { name: "Reload" }).click();
  await again;
  await nameOf(page);
  assert.equal(await page.getByText("newer version of this page").count(), 0);
});

test("who has no right for something is told so beforehand, by which rule", async (t) => {
  const page = await lab.page("alice", { t, path: "/#/contexts?path=/robot" });
  const make = page.locator("mom-context").getByRole("button", { name: "Create" });
  await page.locator("mom-context").getByText(/^Create here: /).waitFor();
  assert.equal(await make.getAttribute("aria-disabled"), "true");
  assert.match(await make.getAttribute("title"), /lab/);
  // It is not a button to Playwright, but a person can press it.
  await make.click({ force: true });
  assert.equal(await page.locator("mom-context dialog[open]").count(), 0);
});
