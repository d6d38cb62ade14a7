// Every page is accessible: axe finds nothing, on a phone and at a desk, by day and by night; and nothing is wider than the page.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { findings, go, start } from "./lab.mjs";
import { RawPeer } from "./rawpeer.mjs";

/** A lab, whose devices show and say things, and a broker that records, with a log to read. */
let [lab, hub, bob] = [];

before(async () => {
  lab = await start();
  hub = await start({ config: '\n[record]\npath = "control.jsonl"\n[audit]\npath = "audit.jsonl"\n[login]\nguests = true\n' });
  // Something to find in the log, and in what was recorded.
  bob = await RawPeer.login(hub.host, "bob");
  await bob.ask("context", "join", "/robot");
  await bob.ask("token", "grab", "/robot/token");
  await assert.rejects(bob.ask("context", "create", "/news", { kind: "session" }), /denied/);
});
after(async () => {
  bob?.close();
  await hub?.end();
  await lab?.end();
});

const text = (words) => (page) => page.getByText(words).first().waitFor();
const editor = (page) => page.getByRole("textbox", { name: /^Configuration/ });
/** Tries the running configuration with a change. */
const attempt = (from, to, words) => async (page) => {
  await page.getByText("This is the running configuration.").or(page.getByText("is changed.")).first().waitFor();
  await editor(page).fill((await editor(page).inputValue()).replace(from, to));
  await page.getByRole("button", { name: "Try on the recorded traffic" }).click();
  await text(words)(page);
};

/** What each page shows while it is looked at: its name, where it is, and when it is there. */
const states = {
  drive: [["", "#/drive", (page) => page.locator("mom-cameras mom-camera").getByRole("slider", { name: "Cursor across the table" }).first().waitFor()]],
  // There is none here; test/fleet.e2e.mjs has one.
  fleet: [["none", "#/fleet", text("There is no /fleet/status at this hub.")]],
  // Nor a mirrored robot; test/simulacrum.e2e.mjs has one.
  simulacrum: [["none", "#/simulacrum", text("No robot is mirrored at this hub.")]],
  modeller: [["", "#/modeller", text("No mistakes.")]],
  contexts: ["/", "/robot/arm", "/robot/token", "/camera/x", "/chat"].map((path) => [path, `#/contexts?path=${path}`, (page) => page.locator("mom-context").getByText(path, { exact: true }).first().waitFor()]),
  peers: [["", "#/peers", (page) => page.locator("mom-peers").getByRole("row", { name: /^arm / }).waitFor()]],
  health: [["", "#/health", (page) => page.locator("mom-health").getByRole("link", { name: "/camera/x" }).waitFor()]],
  access: [
    ["table and reason", "#/access?path=/robot/token&users=alice+bob+carol&user=alice&verb=grab", text("alice (level 1) may not grab")],
    ["refusal", "#/access?path=/robot/token&users=alice+nobody", text(/there is no user "nobody"/)],
    ["faults", "#/access?view=what-if", attempt('"grab", "renew", "give"', '"grap", "renew", "give"', /^✕ \d+$/)],
    ["differences", "#/access?view=what-if", attempt('"grap", "renew", "give"', '"renew", "give"', /inputs decided again: .* differ/)],
  ],
  audit: [
    ["list", "#/audit", (page) => page.locator("mom-audit tbody tr[data-seq]").first().waitFor()],
    [
      "details and own times",
      "#/audit?what=refused&quick=own",
      async (page) => {
        await page.getByRole("button", { name: /^Details of fact/ }).first().click();
        await page.getByRole("region", { name: /^Fact \d/ }).waitFor();
      },
    ],
  ],
};
const AT_HUB = ["access", "audit"];

for (const [width, colorScheme] of [[360, "light"], [1280, "light"], [1280, "dark"]]) {
  test(`axe finds nothing at ${width} px, ${colorScheme}`, async (t) => {
    const options = { t, viewport: { width, height: 800 }, colorScheme, reducedMotion: "reduce" };
    const look = (page, name, prepare) =>
      t.test(name, async () => {
        await prepare();
        assert.deepEqual(await findings(page), []);
        assert.ok(await page.evaluate(() => document.documentElement.scrollWidth <= innerWidth), "nothing is wider than the page");
      });

    const embedded = await lab.open("/embed.html", options);
    await look(embedded, "embed.html", () => embedded.getByRole("button", { name: "Log in" }).waitFor());
    await look(embedded, "embed.html, logged in", async () => {
      await embedded.getByLabel("User", { exact: true }).fill("bob");
      await embedded.getByRole("textbox", { name: "Password" }).fill("bob");
      await embedded.getByRole("button", { name: "Log in" }).click();
      await embedded.getByText("Nobody holds it.").waitFor();
    });
    const entry = await hub.open("/", options);
    for (const way of ["Password", "Key", "Guest"]) await look(entry, `login by ${way}`, () => entry.getByRole("radio", { name: way }).check());

    const pages = { lab: await lab.page("alice", options), hub: await hub.page("carol", options) };
    const ids = await pages.lab.evaluate(() => [...document.querySelector("mom-console").shadowRoot.querySelectorAll("nav a")].map((link) => link.getAttribute("href").slice(2)));
    assert.deepEqual([...ids].sort(), Object.keys(states).sort(), "each page is looked at");
    for (const id of ids) {
      const page = AT_HUB.includes(id) ? pages.hub : pages.lab;
      for (const [state, hash, ready] of states[id]) {
        await look(page, `${id} ${state}`, async () => {
          await go(page, hash);
          await ready(page);
        });
      }
    }
    await look(pages.lab, "stopped", async () => {
      await pages.lab.keyboard.press("Escape");
      await pages.lab.locator("mom-stop").getByText("at rest, measured, after").first().waitFor();
    });
  });
}
