// Panels on pages of others: three lines, another origin, and policies of all kinds.
import assert from "node:assert/strict";
import { generateKeyPairSync, sign } from "node:crypto";
import { after, before, test } from "node:test";
import { servePages, start } from "./lab.mjs";

const POLICY = (files, hub, worker) =>
  `default-src 'none'; script-src ${files}; connect-src ${hub} ${hub.replace("http", "ws")}; style-src 'self'; base-uri 'none'${worker}`;

const issuer = generateKeyPairSync("ed25519");

/** What the page's own server makes for a user logged in there. */
function tokenOf(user, seconds) {
  const part = (value) => Buffer.from(JSON.stringify(value)).toString("base64url");
  const text = `${part({ alg: "EdDSA", typ: "JWT" })}.${part({ iss: "https://id.example.org", aud: "mom", sub: user, exp: Math.floor(Date.now() / 1000) + seconds })}`;
  return `${text}.${sign(null, Buffer.from(text), issuer.privateKey).toString("base64url")}`;
}

let [lab, site, stranger, door, doors] = [];
const pages = {};

before(async () => {
  [site, stranger] = await Promise.all([servePages(pages), servePages(pages)]);
  lab = await start({
    config: '\n[login]\nguests = true\n[login.jwt]\nissuer = "https://id.example.org"\naudience = "mom"\nalgorithms = ["EdDSA"]\nkey = "issuer.pem"\n',
    files: { "issuer.pem": issuer.publicKey.export({ type: "spki", format: "pem" }) },
    origins: [site.origin],
  });
  doors = `http://${lab.host}`;
  door = `ws://${lab.host} ${doors}`;
});
after(async () => {
  await lab?.end();
  await Promise.all([site?.end(), stranger?.end()]);
});

const three = (attributes, more = "", files = lab.address) =>
  `<!doctype html><html lang="en"><head><title>A page</title><script type="module" src="${files}/panels.js"></script></head><body>` +
  `<mom-connection address="${door}" ${attributes}></mom-connection>${more}</body></html>`;
const panels = `<mom-status device="/robot/arm"></mom-status><mom-stop></mom-stop><mom-token path="/robot/token"></mom-token>`;
const visit = (t, path, { at = site, allow } = {}) => lab.open(at.origin + path, { t, allow });

const grab = async (page) => {
  await page.getByRole("button", { name: "Grab" }).click();
  await page.getByText("You hold it").waitFor();
  await page.getByRole("button", { name: "Give back" }).click();
  await page.getByText("Nobody holds it.").waitFor();
};

test("three lines on another origin, in a worker of the page's own", async (t) => {
  pages["/plain"] = { body: three('user="alice" password="alice"', panels) };
  const page = await visit(t, "/plain");
  await grab(page);
  // The panels have their colours, whatever the page is like.
  const stop = page.getByRole("button", { name: "STOP" });
  assert.equal(await stop.evaluate((button) => getComputedStyle(button).backgroundColor), "rgb(211, 34, 42)");
  await page.evaluate(() => document.documentElement.style.setProperty("--mom-stop", "rgb(1, 2, 3)"));
  assert.equal(await stop.evaluate((button) => (button.getAnimations().forEach((one) => one.finish()), getComputedStyle(button).backgroundColor)), "rgb(1, 2, 3)");
  const [worker] = page.workers();
  assert.match(worker.url(), new RegExp(`^blob:${site.origin}/`));
});

test("a policy that lets in the hub and workers by blob:", async (t) => {
  const policy = POLICY(lab.address, doors, `; worker-src blob: ${lab.address}`);
  pages["/policy"] = { body: three('user="alice" password="alice"', panels), headers: { "content-security-policy": policy } };
  const page = await visit(t, "/policy");
  await grab(page);
  assert.equal(page.workers().length, 1);
});

for (const [name, worker] of [
  ["says nothing of workers", ""],
  ["forbids workers", "; worker-src 'none'"],
  ["lets blob: in, but not the hub's file", "; worker-src blob:"],
]) {
  test(`a policy that ${name}: the client runs in the page`, async (t) => {
    pages["/without"] = { body: three('user="alice" password="alice"', panels), headers: { "content-security-policy": POLICY(lab.address, doors, worker) } };
    const page = await visit(t, "/without", { allow: /worker|blob:/i });
    await grab(page);
    assert.equal(page.workers().length, 0);
  });
}

test("a guest sees what guests may see, with the reason", async (t) => {
  pages["/guest"] = { body: three("guest", panels) };
  const page = await visit(t, "/guest");
  await page.locator("mom-token").getByText(/guest may not/).waitFor();
});

test("a token of the page's own server, set by script", async (t) => {
  pages["/token"] = { body: three("", `${panels}<mom-login></mom-login>`) };
  const page = await visit(t, "/token", { allow: /./ });
  await page.getByRole("button", { name: "Log in" }).waitFor();
  const told = (name, token) =>
    page.evaluate(
      ([name, token]) =>
        new Promise((resolve) => {
          document.addEventListener(name, ({ detail }) => resolve(detail), { once: true });
          document.querySelector("mom-connection").setAttribute("token", token);
        }),
      [name, token],
    );
  assert.equal((await told("mom-refused", tokenOf("alice", -60))).code, "bad-login");
  const { user, level } = await told("mom-login", tokenOf("alice", 60));
  assert.deepEqual([user, level], ["alice", 1]);
  await grab(page);
  assert.equal(await page.evaluate(() => sessionStorage.length), 0);
  const out = page.evaluate(() => new Promise((resolve) => document.addEventListener("mom-logout", () => resolve(true), { once: true })));
  await page.evaluate(async (files) => (await import(`${files}/panels.js`)).hubOf().close(), lab.address);
  assert.equal(await out, true);
});

test("two connections of one page, each with its own user", async (t) => {
  const two = `<mom-connection connection="b" address="${door}" user="bob" password="bob"></mom-connection>`;
  pages["/two"] = { body: three('user="alice" password="alice"', `${two}<div id="a"><mom-token path="/robot/token"></mom-token></div><div id="b" connection="b"><mom-token path="/robot/token"></mom-token></div>`) };
  const page = await visit(t, "/two");
  await page.locator("#a").getByRole("button", { name: "Grab" }).click();
  await page.locator("#a").getByText("You hold it").waitFor();
  await page.locator("#b").getByText(/^alice.* holds it, level 1\.$/).waitFor();
  await page.locator("#a").getByRole("button", { name: "Give back" }).click();
  await page.locator("#b").getByText("Nobody holds it.").waitFor();
});

test("panels that come and go keep the connection", async (t) => {
  pages["/moves"] = { body: three('user="alice" password="alice"', panels) };
  const page = await visit(t, "/moves");
  await page.getByText("Nobody holds it.").waitFor();
  const peers = await page.evaluate(async (files) => {
    const { hubOf } = await import(`${files}/panels.js`);
    const before = hubOf().me.peer;
    const connection = document.querySelector("mom-connection");
    connection.remove();
    await new Promise(requestAnimationFrame);
    document.body.append(connection);
    await hubOf().call("list", "/");
    return [before, hubOf().me.peer];
  }, lab.address);
  assert.equal(peers[0], peers[1]);
});

test("a page that is not on the list is refused in words", async (t) => {
  // It has the files from another hub, which lists it: this one gives it none.
  const other = await start({ origins: [stranger.origin] });
  t.after(other.end);
  // It may be refused before the test listens.
  const listens = `<script>document.addEventListener("mom-refused", ({ detail }) => (window.refused = detail));</script>`;
  pages["/stranger"] = { body: three("guest", `${listens}${panels}<mom-login></mom-login>`, other.address) };
  const page = await visit(t, "/stranger", { at: stranger, allow: /./ });
  const words = `origins = ["${stranger.origin}"] in [web]`;
  await page.locator("mom-login").getByText(words).waitFor();
  await page.locator("mom-status").getByText(words).waitFor();
  const told = await page.waitForFunction(() => window.refused);
  assert.match(await told.evaluate(({ text }) => text), /The hub refuses pages from/);
});

test("the example: log in, hold the token, stop, log out", async (t) => {
  const page = await lab.open("/embed.html", { t });
  await page.getByLabel("User", { exact: true }).fill("alice");
  await page.getByRole("textbox", { name: "Password" }).fill("alice");
  await page.getByRole("button", { name: "Log in" }).click();
  await page.getByText("alice is logged in (level 1).").waitFor();
  await grab(page);
  await page.keyboard.press("Escape");
  await page.locator("mom-stop").getByText("Stop", { exact: true }).waitFor();
  await page.getByRole("button", { name: "Log out" }).click();
  await page.getByText("Nobody is logged in.").waitFor();
  await page.getByRole("button", { name: "Log in" }).waitFor();
});
