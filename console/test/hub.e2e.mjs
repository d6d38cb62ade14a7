// The pages of contexts, peers and health in a browser, against a lab and against a hub with rules of its own.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { findings, go, start, staysQuick, until } from "./lab.mjs";
import { RawPeer } from "./rawpeer.mjs";

/** Room for many, and for what is large; not all may read the figures. */
const CONFIG = `
users = "lab-users.toml"
root = "all"
connections = 2000
connections-before-login = 500
connections-per-address = 1500
connections-per-user = 1200
[login]
guests = true
[limits]
parcel = 33554432
outbox = 33554432
[managers.all]
kind = "roles"
[[managers.all.rules]]
name = "figures are for operators"
users = ["alice"]
where = ["/"]
deny = ["stats"]
[[managers.all.rules]]
allow = ["*"]
[[contexts]]
path = "/chat"
kind = "channel"
[[contexts]]
path = "/pictures"
kind = "channel"
`;

let lab;
let hub;

before(async (t) => {
  lab = await start();
  hub = await start({ config: () => CONFIG });
});
after(async (t) => {
  await hub?.end();
  await lab?.end();
});

/** A peer without a page, which leaves at the test's end. */
async function peer(t, at, user) {
  const one = await RawPeer.login(at.host, user);
  t.after(() => one.close());
  return one;
}

const login = (t, at, user, hash) => at.page(user, { t, path: `/${hash}` });
const accessible = async (page) => assert.deepEqual(await findings(page), []);

const row = (page, path) => page.locator("mom-tree").locator(`[id="row-${path}"]`);

test("the tree shows the lab, and keys go through it", async (t) => {
  const page = await login(t, lab, "alice", "#/contexts");
  await row(page, "/robot/arm").waitFor();
  await row(page, "/camera/x").waitFor();
  const tree = page.getByRole("tree");
  await tree.focus();
  const active = () => tree.getAttribute("aria-activedescendant");
  await page.keyboard.press("Home");
  await page.keyboard.press("ArrowDown");
  await page.keyboard.press("ArrowDown");
  assert.equal(await active(), "row-/camera");
  await page.keyboard.press("ArrowLeft");
  await row(page, "/camera/x").waitFor({ state: "detached" });
  assert.equal(await row(page, "/camera").getAttribute("aria-expanded"), "false");
  await page.keyboard.press("ArrowRight");
  await row(page, "/camera/x").waitFor();
  await page.keyboard.press("End");
  await page.keyboard.press("r");
  assert.equal(await active(), "row-/model/red");
  await page.keyboard.press("r");
  assert.equal(await active(), "row-/robot");
  await page.keyboard.press("ArrowRight");
  await page.keyboard.press("Enter");
  await page.waitForURL(/#\/contexts\?path=\/robot\/arm$/);
  await page.locator("mom-context").getByText("command guarded by /robot/token").waitFor();
  await page.locator("mom-watch").getByRole("listbox").waitFor();
  await page.locator("mom-context .drawn canvas").first().waitFor();
  await page.getByLabel("Filter (path or kind)").fill("token");
  await row(page, "/robot/token").waitFor();
  await row(page, "/chat").waitFor({ state: "detached" });
});

test("what is created and deleted by others is seen at once, and who joins", async (t) => {
  const page = await login(t, lab, "alice", "#/contexts");
  await row(page, "/robot/arm").waitFor();
  const carol = await peer(t, lab, "carol");
  await carol.ask("context", "create", "/news", { kind: "session" });
  await row(page, "/news").waitFor();
  await carol.ask("context", "join", "/news");
  await carol.ask("context", "create", "/news/paper", { kind: "channel", keep: { parcels: 7 } });
  await row(page, "/news").dblclick();
  await row(page, "/news/paper").getByText("keeps 7 messages").waitFor();
  await carol.ask("context", "join", "/news/paper");
  await row(page, "/news/paper").getByText("1 member", { exact: false }).waitFor();
  await carol.ask("context", "delete", "/news");
  await row(page, "/news").waitFor({ state: "detached" });
});

test("what others say is text, and a message is sent with a receipt", async (t) => {
  const page = await login(t, lab, "alice", "#/contexts?path=/chat");
  const said = page.locator("mom-watch").getByRole("option");
  await page.locator("mom-watch").getByRole("listbox").waitFor();
  await said.filter({ hasText: "has joined" }).waitFor();
  const carol = await peer(t, lab, "carol");
  await carol.ask("context", "join", "/chat");
  const markup = "<img src=x onerror=alert(1)><b>bold</b>";
  await carol.say("/chat", "<i>name</i>", { [markup]: markup, deep: { deeper: [1, { deepest: true }] } });
  const option = said.filter({ hasText: "<i>name</i>" });
  await option.waitFor();
  await option.click();
  const detail = page.locator("mom-watch .detail");
  await detail.getByText(markup).first().waitFor();
  assert.equal(await page.locator("mom-watch").locator("img, b, i").count(), 0);
  await page.getByText("Send a message").click();
  await page.getByLabel("Content", { exact: true }).fill("good morning");
  await page.locator("mom-watch").getByRole("button", { name: "Send" }).click();
  await page.getByText("Taken by 2 receivers.").waitFor();
  // It is paused as long as the user reads.
  await page.locator("mom-watch").getByRole("button", { name: "Follow" }).click();
  await said.filter({ hasText: "good morning" }).waitFor();
  await page.getByLabel("Content as").selectOption("json");
  await page.getByLabel("Content", { exact: true }).fill("{");
  await page.locator("mom-watch").getByRole("button", { name: "Send" }).click();
  await page.getByText("This is not JSON").waitFor();
  await accessible(page);
});

test("an operator makes and deletes a context; others are told by which rule they may not", async (t) => {
  const page = await login(t, lab, "carol", "#/contexts?path=/");
  const context = page.locator("mom-context");
  await context.getByRole("button", { name: "Create here" }).click();
  const dialog = context.getByRole("dialog");
  await dialog.getByLabel("Name", { exact: true }).fill("workshop");
  await dialog.getByRole("radio", { name: "channel" }).check();
  await dialog.getByRole("checkbox", { name: "the newest of each sender and name" }).check();
  await accessible(page);
  // A question never stands before STOP.
  await page.locator("mom-stop").getByRole("button", { name: /STOP/ }).click({ trial: true });
  await dialog.getByRole("button", { name: "Create", exact: true }).click();
  await row(page, "/workshop").waitFor();
  await page.waitForURL(/path=\/workshop$/);
  const alice = await login(t, lab, "alice", "#/contexts?path=/workshop");
  await alice.locator("mom-context").getByRole("button", { name: "Delete" }).click();
  await alice.getByRole("button", { name: "Delete it" }).click();
  await alice.getByText("Refused: Delete /workshop").waitFor();
  await alice.locator("mom-context .refusal").getByText("lab", { exact: true }).waitFor();
  await context.getByRole("button", { name: "Delete" }).click();
  await page.getByRole("button", { name: "Delete it" }).click();
  await row(page, "/workshop").waitFor({ state: "detached" });
  await alice.locator("mom-context").getByText("/workshop does not exist").waitFor();
  await row(alice, "/workshop").waitFor({ state: "detached" });
  // What stands in the configuration cannot be deleted, and the page says so.
  await row(page, "/chat").click();
  await context.getByText("It is part of the hub's configuration").waitFor();
  assert.equal(await context.getByRole("button", { name: "Delete" }).getAttribute("aria-disabled"), "true");
});

test("peers are those of mom top; an operator expels one, others are told why they may not", async (t) => {
  const page = await login(t, lab, "carol", "#/peers");
  const peers = page.locator("mom-peers");
  const bob = await peer(t, lab, "bob");
  await peers.getByRole("row", { name: /^arm / }).waitFor();
  const bobs = peers.getByRole("row", { name: new RegExp(`^${bob.name} .*tcp json`) });
  await bobs.waitFor();
  await peers.getByText(/\d+ connections/).waitFor();
  await peers.getByText(/messages\/s, \d+ dropped\/s/).waitFor();
  await peers.getByRole("button", { name: "peer", exact: true }).click();
  await peers.getByRole("button", { name: "peer", exact: true }).click();
  assert.equal(await peers.getByRole("columnheader", { name: "peer" }).getAttribute("aria-sort"), "descending");
  await peers.getByLabel(/^Filter/).fill("bob");
  await peers.getByRole("row", { name: /^arm / }).waitFor({ state: "detached" });
  const alice = await login(t, lab, "alice", "#/peers");
  const toExpel = async (page) => {
    await page.locator("mom-peers").getByRole("button", { name: `Expel ${bob.name}` }).click();
    await page.getByLabel("Message to the peer").fill("time to go");
    await page.getByLabel(/^For /).fill("0.001");
    await page.getByRole("button", { name: "Expel it" }).click();
  };
  // She is told beforehand.
  const expel = alice.locator("mom-peers").getByRole("button", { name: `Expel ${bob.name}` });
  await expel.and(alice.locator('[aria-disabled="true"]')).waitFor();
  assert.match(await expel.getAttribute("title"), /lab/);
  await toExpel(page);
  await peers.getByText(`${bob.name} is expelled.`).waitFor();
  await bob.ended;
  await bobs.waitFor({ state: "detached" });
});

test("health draws what the hub does, with one cursor", async (t) => {
  const page = await login(t, lab, "carol", "#/health");
  const health = page.locator("mom-health");
  await health.getByText(/messages\/s, \d+ dropped\/s/).waitFor();
  await health.locator(".drawn canvas").nth(5).waitFor();
  await health.getByText("Memory by user").waitFor();
  await health.getByRole("link", { name: "/camera/x" }).waitFor();
});

test("who may not ask for the figures of the hub is told by which rule, and sees the rest", async (t) => {
  const page = await login(t, hub, "alice", "#/health");
  await page.locator("mom-health").getByText("all/figures are for operators").waitFor();
  await page.locator("mom-health").getByText("This page", { exact: true }).waitFor();
  await go(page, "#/peers");
  await page.locator("mom-peers").getByText("all/figures are for operators").waitFor();
  // Names are no figures.
  await page.locator("mom-peers").getByRole("row", { name: /^alice/ }).waitFor();
  await accessible(page);
});

test("a page with a thousand peers stays quick", async (t) => {
  const guests = [];
  t.after(() => guests.forEach((guest) => guest.close()));
  while (guests.length < 1000) guests.push(...(await Promise.all(Array.from({ length: 50 }, () => RawPeer.guest(hub.host)))));
  const page = await login(t, hub, "carol", "#/peers");
  const peers = page.locator("mom-peers");
  await peers.getByText(/^1,0\d\d peers$/).waitFor();
  await peers.getByText(/and 7\d\d more peers, which the hub does not list/).waitFor();
  assert.ok((await peers.getByRole("row").count()) < 80);
  let way = -1500;
  await staysQuick(t, page, async () => {
    way = -way;
    for (let turn = 0; turn < 5; turn += 1) {
      const top = await peers.getByRole("row").nth(1).innerText();
      await peers.locator(".rows").evaluate((element, way) => void (element.scrollTop += way), way);
      await until(page, async () => (await peers.getByRole("row").nth(1).innerText()) !== top);
    }
  });
});

for (const [path, how, spec] of [["/flood", "that the hub thins out", { kind: "channel" }], ["/kept", "that keeps, so that the hub may not thin it out", { kind: "channel", keep: { parcels: 100 } }]]) {
  test(`ten thousand messages a second in a channel ${how} do not hold the page up, and it says that it leaves some out`, async (t) => {
    const carol = await peer(t, lab, "carol");
    await carol.ask("context", "create", path, spec);
    await carol.ask("context", "join", path);
    const page = await login(t, lab, "alice", `#/contexts?path=${path}`);
    const watch = page.locator("mom-watch");
    await watch.getByRole("option").filter({ hasText: "has joined" }).waitFor();
    let end;
    await staysQuick(t, page, async () => {
      if (!end) t.after((end = carol.flood(path, "tick", { pose: { x: 1.5, y: 2, z: 3 }, text: "<b>tick</b>" }, 10_000)));
      await watch.getByText(/^thinned: showing \d+ of about [\d,]+ a second$/).waitFor();
      // As long as it draws a while.
      await page.locator("mom-watch").evaluate(
        ({ shadowRoot }) =>
          new Promise((resolve) => {
            let drawn = 0;
            new MutationObserver(() => (drawn += 1) === 20 && resolve()).observe(shadowRoot, { subtree: true, childList: true, characterData: true });
          }),
      );
    });
    // It still obeys.
    await watch.getByRole("button", { name: "Pause" }).click();
    await watch.getByText("paused", { exact: false }).waitFor();
    end();
    await carol.ask("context", "delete", path);
  });
}

test("an image that is too large is shown as words, one that is not as a picture", async (t) => {
  const carol = await peer(t, hub, "carol");
  await carol.ask("context", "join", "/pictures");
  const page = await login(t, hub, "alice", "#/contexts?path=/pictures");
  const watch = page.locator("mom-watch");
  await watch.getByRole("option").filter({ hasText: "has joined" }).waitFor();
  const image = (bytes, more = {}) => ({ image: { $binary: bytes.toString("base64") }, ...more });
  await carol.say("/pictures", "image", image(Buffer.from("iVBORw0KGgoAAAANSUhEUgAAAAIAAAACCAIAAAD91JpzAAAAEElEQVR4nGP4z8AARAwQCgAf7gP9i18U1AAAAABJRU5ErkJggg==", "base64"), { "media-type": "image/png", width: 2, height: 2 }));
  await watch.getByRole("option").filter({ hasText: "image 2×2" }).click();
  await watch.locator("canvas").waitFor();
  await watch.getByRole("button", { name: "Follow" }).click();
  await carol.say("/pictures", "image", image(Buffer.alloc(12 * 1024 * 1024)));
  await watch.getByRole("option").filter({ hasText: "image, 12.0 MiB, not shown: too large" }).waitFor();
  await carol.say("/pictures", "image", image(Buffer.from("no image")));
  await watch.getByRole("option").filter({ hasText: "cannot be read" }).waitFor();
  await carol.say("/pictures", "image", "no image either");
  await watch.getByRole("option").filter({ hasText: "no image either" }).waitFor();
});

test("content of hostile depth and size is bounded", async (t) => {
  const carol = await peer(t, hub, "carol");
  await carol.ask("context", "join", "/chat");
  const page = await login(t, hub, "alice", "#/contexts?path=/chat");
  const watch = page.locator("mom-watch");
  await watch.getByRole("option").filter({ hasText: "has joined" }).waitFor();
  let deep = "bottom";
  for (let depth = 0; depth < 30; depth += 1) deep = { down: deep };
  await carol.say("/chat", "deep", deep);
  await carol.say("/chat", "wide", Object.fromEntries(Array.from({ length: 4000 }, (_, index) => [`key ${index}`, "x".repeat(10)])));
  await carol.say("/chat", "long", "x".repeat(1_000_000));
  await carol.say("/chat", "proto", { __proto__x: 1, constructor: { toString: "mine" } });
  await watch.getByRole("option").filter({ hasText: "proto" }).waitFor();
  await watch.getByRole("option").filter({ hasText: "wide" }).click();
  await watch.getByText("3,800 more").waitFor();
  await watch.getByRole("option").filter({ hasText: "long" }).click();
  await watch.getByText("A large part was left out.").waitFor();
  await watch.getByRole("option").filter({ hasText: "proto" }).click();
  await watch.getByText("mine").first().waitFor();
});
