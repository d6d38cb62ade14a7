// What stands in the history of notices: each error and each stop (M45); and what of it is reported to the hub, if the page's user wants that (M56).
import assert from "node:assert/strict";
import { writeFileSync } from "node:fs";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { NETWORK, go, letGo, logIn, start, until } from "./lab.mjs";
import { RawPeer } from "./rawpeer.mjs";

let lab;
before(async () => {
  lab = await start();
  const carol = await RawPeer.login(lab.host, "carol");
  await carol.ask("context", "create", "/workshop", { kind: "channel" });
  carol.close();
});
after(() => lab?.end());

const history = (page) => page.getByRole("region", { name: "History" });

async function open(page) {
  await page.getByRole("button", { name: /^History/ }).click();
  await history(page).waitFor();
}

/** Waits until so many notices fit; a failure tells what they say instead. */
async function noted(page, pattern, tone, count = 1, within = 20_000) {
  const all = history(page).locator(`li.${tone}`);
  try {
    await until(page, async () => (await all.filter({ hasText: pattern }).count()) === count, within);
  } catch (error) {
    throw new Error(`not ${count} of ${pattern}: ${JSON.stringify(await history(page).locator("li").allInnerTexts())}`, { cause: error });
  }
}

/** What operators read, once there are so many of this text. */
async function reported(page, hub, pattern, count) {
  let found = [];
  await until(page, async () => {
    found = (await hub.mom("carol", "logs", "--json")).out.split("\n").filter((line) => line.startsWith("{")).map((line) => JSON.parse(line));
    return found.filter(({ text }) => pattern.test(text)).length === count;
  });
  return found;
}

/** What a page shows of an error that nothing in it catches. */
const fault = (page, text) => page.evaluate((said) => void setTimeout(() => { throw new Error(said); }), text);

test("a form's refusal, a failed login and a fault of the page are notices", async (t) => {
  const alice = await lab.open("/", { t });
  await logIn(alice, "alice", "wrong");
  await alice.getByText("Wrong user or password.").waitFor();
  await logIn(alice, "alice");
  await go(alice, "#/contexts?path=/workshop");
  const context = alice.locator("mom-context");
  await context.getByRole("button", { name: "Delete" }).click();
  await alice.getByRole("button", { name: "Delete it" }).click();
  await alice.getByText("Refused: Delete /workshop").waitFor();
  await open(alice);
  await noted(alice, /The login failed/, "error");
  await noted(alice, /Delete \/workshop: /, "error");
  await fault(alice, "made for the test");
  await noted(alice, /Error in this page: made for the test/, "error");
  await until(alice, () => alice.faults.length === 1);
  alice.faults.length = 0;
});

test("each stop of others is a notice, also one for the same reason while the first holds", async (t) => {
  const alice = await lab.page("alice", { t, path: "/#/health" });
  await open(alice);
  const stop = (path) => lab.mom("bob", "stop", path, "--reason", "smoke");
  await stop("/robot/arm");
  await noted(alice, /Stopped by bob.*: smoke/, "warning");
  // By the hub's clock it is another one.
  await new Promise((resolve) => setTimeout(resolve, 1500)); // tidy: two stops differ by the time at which they were said
  await stop("/robot/arm");
  await noted(alice, /Stopped by bob.*: smoke/, "warning", 2);
  await letGo(alice);
  await noted(alice, /No longer: Stopped by bob.*: smoke/, "info");
});

test("a device that does not obey, and a STOP that reaches none, are notices", async (t) => {
  const hub = await start({ config: "\n[login]\nguests = true\n" });
  t.after(hub.end);
  const arm = await RawPeer.login(hub.host, "arm");
  t.after(() => arm.close());
  await arm.ask("context", "join", "/robot");
  await arm.ask("context", "join", "/robot/arm", { device: true });
  const alice = await hub.page("alice", { t });
  await open(alice);
  await alice.keyboard.press("Escape");
  await noted(alice, /Stop: \/robot\/arm arm: has not confirmed/, "error");
  const guest = await hub.open("/", { t });
  await guest.getByRole("radio", { name: "Guest" }).check();
  await guest.getByRole("button", { name: "Log in" }).click();
  await open(guest);
  await guest.keyboard.press("Escape");
  await noted(guest, /Stop: \/: no device here obeys stop/, "warning");
});

test("a command that fails is a notice, whoever sent it", async (t) => {
  const alice = await lab.page("alice", { t });
  await open(alice);
  writeFileSync(join(lab.folder, "far.txt"), "move 5000 0 0 0 0\n");
  await lab.mom("bob", "run", "--no-check", join(lab.folder, "far.txt"));
  await noted(alice, /\/robot\/arm: a command of bob.* failed: /, "warning");
});

test("a lost link and its return are notices, and a STOP that nobody confirms is one", async (t) => {
  const hub = await start({ relay: true });
  t.after(hub.end);
  const page = await hub.page("alice", { t, allow: NETWORK });
  await open(page);
  hub.relay.closed = true;
  hub.relay.cut();
  await page.locator("mom-status").getByText("link lost, resuming").waitFor();
  await page.keyboard.press("Escape");
  // While the link may be resumed, for 30 s, the order is not over.
  await noted(page, /Stop: \/: NOT CONFIRMED/, "error", 1, 60_000);
  hub.relay.closed = false;
  await noted(page, /The link to the hub is back/, "info");
});

test("errors are reported to the hub only if the page's user wants that, also after a reload, and never the password", async (t) => {
  const alice = await lab.page("alice", { t });
  await open(alice);
  const consent = history(alice).getByRole("checkbox", { name: "Report errors to the hub" });
  assert.equal(await consent.isChecked(), false);
  await fault(alice, "not reported");
  await noted(alice, /not reported/, "error");
  await consent.check();
  await fault(alice, "password alice is reported");
  const [report, ...more] = await reported(alice, lab, /is reported/, 1);
  assert.match(report.text, /^Error in this page: password … is reported/);
  assert.deepEqual([report.level, report.program, report.from, more], ["error", "mom-console", "127.0.0.1", []]);
  // What is refused has the code of that.
  await alice.reload();
  await alice.getByRole("button", { name: "Log out" }).waitFor();
  await go(alice, "#/contexts?path=/workshop");
  await alice.locator("mom-context").getByRole("button", { name: "Delete" }).click();
  await alice.getByRole("button", { name: "Delete it" }).click();
  const all = await reported(alice, lab, /Delete \/workshop: /, 1);
  assert.equal(all.at(-1).code, "denied");
  await open(alice);
  assert.equal(await consent.isChecked(), true);
  await consent.uncheck();
  await fault(alice, "no more");
  await noted(alice, /no more/, "error");
  assert.equal((await reported(alice, lab, /./, 2)).length, 2);
  alice.faults.length = 0;
});
