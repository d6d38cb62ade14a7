// The page Audit at a hub that looks back on thousands of facts: newest first, filters, following, paging, details and export.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { after, before, beforeEach, test } from "node:test";
import { go, start } from "./lab.mjs";
import { RawPeer } from "./rawpeer.mjs";

const FACTS = 5200;
const BEGIN = Date.now() - 7 * 3_600_000;

/** The lines of a log as a hub would have written it, one each second. */
function log() {
  const rule = "lab/people look, talk, drive and stop";
  const whats = ["refused", "granted", "lost", "login", "gone"];
  return Array.from({ length: FACTS }, (_, index) => {
    const what = whats[index % 5];
    const user = ["alice", "bob", "carol"][index % 3];
    const context = index % 2 ? "/robot/token" : "/robot/arm";
    const more = {
      refused: { verb: index % 2 ? "grab" : "send", context, ...(index % 2 ? {} : { message: "command" }), rule, code: "held", by: "carol" },
      granted: { context, rule: "robot-token", fence: 1882461516595201 + index },
      lost: { context, rule: "robot-token", fence: 1882461516595201 + index, reason: "preempted", by: "carol" },
      login: { from: "127.0.0.1:50000" },
      gone: {},
    };
    const fact = { at: new Date(BEGIN + index * 1000).toISOString(), seq: index + 1, what, peer: user, user, level: 1, ...more[what] };
    return `${JSON.stringify(index % 50 ? fact : { ...fact, count: 1200 })}\n`;
  }).join("");
}

let lab;
let page;
let lines;

before(async () => {
  lab = await start({ config: '\n[audit]\npath = "audit.jsonl"\n', files: { "audit.jsonl": log() } });
  page = await lab.page("carol", { timezoneId: "UTC" });
  lines = page.locator("mom-audit tbody tr[data-seq]");
});
after(() => lab?.end());
beforeEach(async () => {
  // What one test has set does not concern the next.
  await go(page, "#/health");
  await page.locator("mom-audit").waitFor({ state: "detached" });
});

const first = async () => Number(await lines.first().getAttribute("data-seq"));
const line = (...words) => words.reduce((found, hasText) => found.filter({ hasText }), lines).first();
const box = () => page.getByRole("region", { name: "Audit" });
const address = (hash) => page.waitForFunction((hash) => location.hash === hash, hash);
const status = () => page.locator("mom-audit").getByRole("status").first();
/** What the page says of how much it shows. */
const shows = (pattern) => status().filter({ hasText: pattern }).waitFor();

/** A user asks for what nobody may have. */
async function refused(user, context) {
  const peer = await RawPeer.login(lab.host, user);
  await assert.rejects(peer.ask("context", "create", context, { kind: "session" }), /denied/);
  peer.close();
}

test("the newest first, and only lines that are seen", async () => {
  await go(page, "#/audit");
  await shows(/^200 lines, [\d,]+ facts/);
  assert.ok((await first()) > FACTS);
  assert.ok((await lines.count()) < 60, `${await lines.count()} lines`);
  await line("login", "carol").waitFor();
});

test("following: what is new comes in, at the top only", async () => {
  await go(page, "#/audit");
  await shows(/^200 lines/);
  await refused("bob", "/news");
  await line("refused", "bob", "/news", "denied").waitFor();
  // A reader further down stays there.
  const before = await first();
  await box().evaluate((element) => (element.scrollTop = 1000));
  await page.locator(`tr[data-seq="${before}"]`).waitFor({ state: "detached" });
  const shown = await status().innerText();
  await refused("bob", "/newer");
  await page.waitForFunction((shown) => document.querySelector("mom-console").shadowRoot.querySelector("mom-audit").shadowRoot.querySelector('[role="status"]').innerText !== shown, shown);
  assert.ok((await box().evaluate((element) => element.scrollTop)) > 1000);
  await page.getByRole("checkbox", { name: "Follow" }).uncheck();
  await page.getByText("not following").waitFor();
});

test("filters are asked of the hub, and stand in the address", async () => {
  await go(page, "#/audit");
  await page.getByRole("button", { name: "refused", exact: true }).click();
  await page.getByLabel("User", { exact: true }).fill("bob");
  await address("#/audit?user=bob&what=refused");
  await line("refused", "bob").waitFor();
  await lines.filter({ hasNotText: /refused[\s\S]*bob/ }).first().waitFor({ state: "detached" });
  await go(page, "#/audit?user=carol&what=refused&context=/camera");
  await page.getByText("No fact matches these filters.").waitFor();
  await page.getByRole("button", { name: "Clear filters" }).click();
  await address("#/audit");
  await shows(/^200 lines/);
  await go(page, "#/audit?user=carol&what=refused%2Cgranted&context=/robot/token");
  await line("/robot/token", "carol").waitFor();
  await lines.filter({ hasNotText: /\/robot\/token/ }).first().waitFor({ state: "detached" });
  assert.equal(await page.getByLabel("User", { exact: true }).inputValue(), "carol");
  assert.equal(await page.getByRole("button", { name: "granted", exact: true }).getAttribute("aria-pressed"), "true");
});

test("a time, and one of one's own", async () => {
  await go(page, "#/audit");
  await page.getByRole("combobox", { name: "Time" }).selectOption("1h");
  await page.waitForFunction(() => location.hash.includes("quick=1h"));
  await shows(/^\d+ lines?\b(?!,)/);
  assert.ok((await lines.count()) < 60);
  await lines.filter({ hasText: "robot-token" }).first().waitFor({ state: "detached" });
  await page.getByRole("combobox", { name: "Time" }).selectOption("own");
  await page.getByLabel("Until").fill(new Date(BEGIN + 1_000_000).toISOString().slice(0, 19));
  await page.waitForFunction(() => {
    const line = document.querySelector("mom-console").shadowRoot.querySelector("mom-audit").shadowRoot.querySelector("tr[data-seq]");
    return Number(line?.dataset.seq) <= 1001;
  });
  assert.ok((await first()) >= 999, `${await first()}`);
  assert.equal(await page.getByRole("checkbox", { name: "Follow" }).isDisabled(), true);
});

test("all of a fact, and where it leads", async () => {
  await go(page, "#/audit?what=granted");
  await page.getByRole("button", { name: /^Details of fact/ }).first().click();
  const details = page.getByRole("region", { name: /^Fact \d+/ });
  assert.match(await details.innerText(), /fence\s+\d+ \(lower 20 bits of 188246151\d+\)/);
  assert.match(await details.getByRole("link", { name: "Explain" }).getAttribute("href"), /^#\/access\?path=%2Frobot%2F\w+&user=\w+&verb=grab$/);
  assert.match(await details.getByRole("link", { name: "Show the context" }).getAttribute("href"), /^#\/contexts\?path=/);
  await details.getByRole("button", { name: /^Only this user/ }).click();
  await page.waitForFunction(() => /user=\w+/.test(location.hash));
  await go(page, "#/audit?what=refused&context=/robot/token");
  await lines.filter({ hasNotText: "/robot/token" }).first().waitFor({ state: "detached" });
  await page.locator("tr.refused button").first().focus();
  await page.keyboard.press("Enter");
  await page.keyboard.press("ArrowDown");
  await details.waitFor();
  await details.getByRole("link", { name: "Explain" }).click();
  await page.locator("mom-access").getByText(/ may (not )?grab \/robot\/token/).first().waitFor();
  assert.match(await page.evaluate(() => location.hash), /^#\/access\?path=/);
});

test("thousands of facts: back in time, and bounded", async () => {
  await go(page, "#/audit");
  await shows(/^200 lines/);
  for (let shown = 400; shown <= 5200; shown += 200) {
    await page.getByRole("button", { name: "Older facts" }).click();
    if (shown <= 5000) await shows(new RegExp(`^${shown.toLocaleString("en")} lines`));
  }
  await page.getByText("The page shows at most 5,000 facts").waitFor();
  assert.ok((await lines.count()) < 60);
  await page.getByText("not following").waitFor();
  await page.getByRole("button", { name: "To the newest" }).click();
  await shows(/^200 lines/);
  assert.ok((await first()) > FACTS);
});

test("what is shown can be downloaded as the log writes it", async () => {
  await go(page, "#/audit?what=lost&user=alice");
  await shows(/^200 lines/);
  await lines.filter({ hasNotText: "lost" }).first().waitFor({ state: "detached" });
  const [download] = await Promise.all([page.waitForEvent("download"), page.getByRole("button", { name: "Download as JSON lines" }).click()]);
  assert.equal(download.suggestedFilename(), "audit.jsonl");
  const written = readFileSync(await download.path(), "utf8").trim().split("\n").map((line) => JSON.parse(line));
  assert.equal(written.length, 200);
  assert.deepEqual(Object.keys(written[0]).slice(0, 9), ["at", "seq", "what", "peer", "user", "level", "context", "rule", "fence"]);
  assert.ok(written.every(({ what, user }) => what === "lost" && user === "alice"));
});

test("who may not read it is told by which rule", async (t) => {
  const alice = await lab.page("alice", { t, path: "/#/audit" });
  await alice.getByText("Refused: the audit log").waitFor();
  await alice.getByText("lab/people look, talk, drive and stop").or(alice.getByText(/alice may not audit/)).first().waitFor();
});

test("nothing went wrong in the page", () => assert.deepEqual(page.faults, []));
