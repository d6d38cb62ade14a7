// The page Access: the table of who may do what, one question, and another rule file tried on what was recorded.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { after, before, beforeEach, test } from "node:test";
import { go, start } from "./lab.mjs";
import { RawPeer } from "./rawpeer.mjs";

/** Tokens of which a chair, and a queue, decides. */
const MORE = `
[record]
path = "control.jsonl"
[managers.seminar]
kind = "chain"
of = ["lab", "chair"]
[managers.chair]
kind = "moderated"
chairs = { groups = ["operator"] }
[managers.turns]
kind = "chain"
of = ["lab", { kind = "queue", lease = 60000 }]
[[contexts]]
path = "/desk"
kind = "token"
manager = "seminar"
[[contexts]]
path = "/turns"
kind = "token"
manager = "turns"
`;
const RULE = 'allow = ["join", "lookup", "list", "info", "members", "stats", "send", "grab"';

let lab;
let alice;
let page;
let config;

before(async () => {
  lab = await start({ config: MORE });
  config = readFileSync(`${lab.folder}/lab.toml`, "utf8");
  alice = await RawPeer.login(lab.host, "alice");
  await alice.ask("context", "join", "/robot");
  for (const token of ["/robot/token", "/turns"]) await alice.ask("token", "grab", token);
  const bob = await RawPeer.login(lab.host, "bob");
  await bob.ask("context", "join", "/robot");
  await assert.rejects(bob.ask("token", "grab", "/robot/token"), /held/);
  bob.close();
  page = await lab.page("carol");
});
after(async () => {
  alice?.close();
  await lab?.end();
});
beforeEach(async () => {
  // What one test has opened or written does not concern the next.
  await go(page, "#/health");
  await page.locator("mom-access").waitFor({ state: "detached" });
  await page.evaluate(() => Object.keys(sessionStorage).forEach((key) => key.startsWith("mom what-if ") && sessionStorage.removeItem(key)));
});

const line = (text) => config.split("\n").findIndex((one) => one.includes(text)) + 1;
const said = (text) => page.getByText(text).first().waitFor();
const cell = (name) => page.getByRole("button", { name });
const ask = async (user, verb, message) => {
  await page.getByLabel("User (empty: yourself)").fill(user);
  await page.getByRole("combobox", { name: "Verb" }).selectOption(verb);
  if (message !== undefined) await page.getByLabel("Message (empty: any other)").fill(message);
  await page.getByRole("button", { name: "Ask", exact: true }).click();
};

test("a link shows users and verbs in words, and a cell its reason with file and line", async () => {
  await go(page, "#/access?path=/robot/token&users=alice+bob+carol");
  const refused = cell("bob, grab: refuse");
  assert.equal((await refused.innerText()).replace(/\s+/g, " ").trim(), "✕ refuse");
  await refused.click();
  await said("bob (level 1) may not grab /robot/token.");
  const reason = page.getByRole("region", { name: "Reason" });
  const text = await reason.innerText();
  for (const words of ["/robot/token is held by alice", `lab.toml:${line("of = [\"lab\", { kind = \"level-or-lease\"")}, managers.robot-token.of[1]`, "robot-token of /robot/token (token)", "retry-after="]) assert.ok(text.includes(words), `${words} in ${text}`);
  assert.equal(await refused.getAttribute("aria-pressed"), "true");
  assert.match(await reason.getByRole("link", { name: "audit log" }).getAttribute("href"), /^#\/audit\?context=%2Frobot%2Ftoken&user=bob&verb=grab&what=refused$/);
  await cell("carol, grab: allow").click();
  await said("from its owner");
  await cell("alice, break: refuse").click();
  await said("none of lab covers it");
  await said(`lab.toml:${line("[managers.lab]")}, managers.lab`);
});

test("who has to wait, and who is to be asked, stand there in words", async () => {
  await go(page, "#/access?path=/desk&users=alice+bob");
  await cell("alice, grab: ask").click();
  await said("alice (level 1) may, if those who are asked allow it, grab /desk.");
  await go(page, "#/access?path=/turns&users=bob");
  await cell("bob, grab: wait").click();
  await said("bob (level 1) has to wait to grab /turns.");
});

test("messages of a channel have lines of their own, with what the guard wants", async () => {
  await go(page, "#/access?path=/robot/token&users=alice+bob+carol");
  await page.getByLabel("Context").fill("/robot/arm");
  await page.getByRole("button", { name: "Show", exact: true }).click();
  await page.waitForFunction(() => location.hash === "#/access?path=%2Frobot%2Farm&users=alice+bob+carol");
  await cell("bob, send command: allow with ownership of /robot/token").click();
  await said("/robot/token, owned by alice now");
  await cell("bob, send state: refuse").waitFor();
  await cell("bob, send (any other): allow").waitFor();
  assert.equal(await page.evaluate(() => location.hash), "#/access?path=%2Frobot%2Farm&users=alice+bob+carol&user=bob&verb=send&message=command");
});

test("a question is answered in a sentence and stays in the address", async () => {
  await go(page, "#/access?path=/robot/arm&users=alice+bob");
  await ask("bob", "send", "state");
  await said("bob (level 1) may not send state to /robot/arm.");
  await said("lab/only the arm tells its state");
  assert.match(await page.evaluate(() => location.hash), /user=bob&verb=send&message=state/);
  await page.getByLabel("User (empty: yourself)").fill("alicia");
  await page.getByRole("button", { name: "Ask", exact: true }).click();
  await said(/there is no user "alicia"/);
});

test("a link of the audit log asks its question", async () => {
  await go(page, "#/access?path=/robot/token&user=bob&verb=grab");
  await said("bob (level 1) may not grab /robot/token.");
});

const editor = () => page.getByRole("textbox", { name: "Configuration (lab.toml)" });
const attempt = (of = page) => of.getByRole("button", { name: "Try on the recorded traffic" });
const selected = () => editor().evaluate((field) => field.value.slice(field.selectionStart, field.selectionEnd));

test("a rule leads to its line in the running configuration", async () => {
  await go(page, "#/access?path=/robot/token&user=bob&verb=grab");
  await page.getByRole("button", { name: "Show the rule in the file" }).click();
  await editor().waitFor();
  await page.waitForFunction(() => document.querySelector("mom-console").shadowRoot.querySelector("mom-access").shadowRoot.activeElement?.selectionStart > 0);
  assert.match(await selected(), /level-or-lease/);
  assert.equal(await editor().inputValue(), config);
  await said("This is the running configuration.");
});

test("faults stand at their lines", async () => {
  await go(page, "#/access?view=what-if");
  const at = line(RULE);
  const wrong = RULE.replace('"grab"', '"grap"');
  await editor().fill(config.replace(RULE, wrong));
  await said(`Line ${at} is changed.`);
  await attempt().click();
  await said("1 fault in the file");
  await said(`✕ ${at}`);
  assert.equal(await editor().getAttribute("aria-invalid"), "true");
  await page.getByRole("button", { name: `Line ${at}:` }).click();
  assert.ok((await selected()).includes(wrong));
});

test("what differs is a table whose lines lead into the editor, and edits can be kept and dropped", async () => {
  await go(page, "#/access?view=what-if");
  const changed = config.replace(RULE, RULE.replace(', "grab"', ""));
  await editor().fill(changed);
  await page.getByRole("checkbox", { name: "Also list equal decisions" }).check();
  await attempt().click();
  await said(/inputs decided again: .* differ/);
  const region = page.getByRole("region", { name: "Decisions that differ" }).last();
  const row = region.getByRole("row", { name: /alice grab \/robot\/token/ }).first();
  assert.match(await row.innerText(), /alice owns \/robot\/token[\s\S]*refused denied/);
  await page.getByLabel("Find in the differences").fill("ALICE grab /turns");
  await said(/^1 of \d/);
  assert.equal(await region.getByRole("row").count(), 2);
  await region.getByRole("button", { name: /^line \d+$/ }).first().click();
  assert.match(await selected(), /managers\.lab\]/);

  const [download] = await Promise.all([page.waitForEvent("download"), page.getByRole("button", { name: "Download" }).click()]);
  assert.equal(download.suggestedFilename(), "lab.toml");
  assert.equal(readFileSync(await download.path(), "utf8"), changed);
  await page.getByRole("button", { name: "Who may do what" }).click();
  await page.getByRole("button", { name: "Try a rule file" }).click();
  await said(`Line ${line(RULE)} is changed.`);
  assert.equal(await editor().inputValue(), changed);
  await page.getByRole("button", { name: "Revert to the running one" }).click();
  await said("This is the running configuration.");
  await attempt().click();
  await said(/inputs decided again: nothing differs\./);
});

test("where nothing is recorded the page says how to record", async (t) => {
  const other = await start({ config: "" });
  t.after(other.end);
  const there = await other.page("carol", { t, path: "/#/access?view=what-if" });
  await there.getByText("This hub records no traffic").waitFor();
  await there.getByText('path = "control.jsonl"').waitFor();
  assert.equal(await attempt(there).isDisabled(), true);
});

test("without the right there are words with the rule, and one's own rights", async (t) => {
  const there = await lab.page("bob", { t, path: "/#/access?path=/robot/token&users=alice+bob" });
  await there.getByText("Refused: to explain access").waitFor();
  await there.getByText("Only your own access is shown.").waitFor();
  await there.getByRole("button", { name: "bob, grab: refuse" }).waitFor();
  await there.getByRole("button", { name: "Try a rule file" }).click();
  await there.getByText("bob may not what-if /").waitFor();
});

test("nothing went wrong in the page", () => assert.deepEqual(page.faults, []));
