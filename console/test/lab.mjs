// What tests from end to end need: a lab or a broker that serves the console, a relay that can be cut, a browser, and people's pages.
//
// MOM_BIN names the program `mom`, beside which is `mom-broker`; CHROMIUM the browser. With MOM_PREVIEW the page comes from `dist` as it is now, not from the program.
import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createServer as createPages } from "node:http";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { createInterface } from "node:readline";
import { fileURLToPath } from "node:url";
import { chromium } from "playwright-core";
import { RawPeer } from "./rawpeer.mjs";
import { listening, startRelay } from "./relay.mjs";

const root = fileURLToPath(new URL("..", import.meta.url));
export const project = dirname(root);
export const mom = process.env.MOM_BIN ?? join(project, "target/debug/mom");
const broker = join(dirname(mom), "mom-broker");
const BROWSER = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run"];

/** Whether the page comes from `dist` as it is now. */
export const isPreview = Boolean(process.env.MOM_PREVIEW);

/** Resources that a hub which is away does not give are errors of the network, and expected. */
export const NETWORK = /WebSocket connection|Failed to load resource|net::ERR|ERR_/;

/** Starts a program that says where it listens; gives the process and its port. */
async function startProgram(program, args, env = {}) {
  const child = spawn(program, args, { stdio: ["ignore", "pipe", process.env.MOM_LOG ? "inherit" : "ignore"], env: { ...process.env, ...env } });
  // A test that breaks down leaves nothing behind.
  const kill = () => child.kill("SIGKILL");
  process.once("exit", kill);
  child.once("exit", () => process.off("exit", kill));
  const port = await new Promise((resolve, reject) => {
    child.once("error", reject);
    child.once("exit", (code) => reject(new Error(`${program} ended with ${code} before it listened`)));
    createInterface({ input: child.stdout }).on("line", (line) => {
      const found = /:\/\/127\.0\.0\.1:(\d+)/.exec(line);
      if (found) resolve(Number(found[1]));
    });
  });
  return { child, port };
}

/** Serves pages that a test has written: by path, `{body, headers}`. */
export async function servePages(pages) {
  return listening(
    createPages((asked, answer) => {
      const { pathname } = new URL(asked.url, "http://page");
      const page = pages[pathname];
      answer.writeHead(page ? 200 : pathname === "/favicon.ico" ? 204 : 404, { "content-type": "text/html; charset=utf-8", ...page?.headers });
      answer.end(page?.body);
    }),
  );
}

/** The headers of the hub's page; an error if it serves none. */
async function headersOfPage(port) {
  const { headers } = await fetch(`http://127.0.0.1:${port}/`, { headers: { accept: "text/html" } });
  if (isPreview || headers.get("content-security-policy")) return headers;
  throw new Error(`${mom} and ${broker} have no console in them: build it by \`cargo xtask console\`, then them by \`cargo build -p mom -p mom-broker\``);
}

/** Serves `dist` in front of a hub, under the policy of its own page. */
async function startPreview(port, headers) {
  const { preview } = await import("vite");
  const hub = `http://127.0.0.1:${port}`;
  const policy = headers.get("content-security-policy");
  let own;
  const asHub = (passed, asked) => asked.headers.origin === own && passed.setHeader("origin", hub);
  const proxy = Object.fromEntries(["/mom", "/tunnel", "/api", "/log"].map((path) => [path, { target: hub, ws: path === "/mom", configure: (server) => server.on("proxyReq", asHub).on("proxyReqWs", asHub) }]));
  const build = {
    name: "build-of-dist",
    configurePreviewServer({ middlewares }) {
      middlewares.use("/api/console", (_, answer) => {
        const { build } = JSON.parse(readFileSync(join(root, "dist/build.json"), "utf8"));
        answer.setHeader("content-type", "application/json").end(JSON.stringify({ console: build }));
      });
    },
  };
  const server = await preview({ root, configFile: false, base: "./", plugins: [build], logLevel: "silent", build: { outDir: "dist" }, preview: { host: "127.0.0.1", port: 0, proxy, ...(policy ? { headers: { "content-security-policy": policy } } : {}) } });
  const at = server.httpServer.address().port;
  own = `http://127.0.0.1:${at}`;
  return { port: at, end: () => server.close() };
}

/** One browser for all labs of a file. */
const shared = { browser: undefined, users: 0 };

async function browserForOne() {
  shared.users += 1;
  shared.browser ??= chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: BROWSER });
  return await shared.browser;
}

async function browserNoMore() {
  shared.users -= 1;
  if (shared.users) return;
  const { browser } = shared;
  shared.browser = undefined;
  await (await browser).close();
}

/**
 * Starts a hub with the console and a browser. Without options it is `mom lab`, with all its devices, or with what the arguments of `lab` say; with others it is a broker alone. Its configuration is the lab's with
 * `config` added, or what `config` makes of it; `files` are beside it, and FOLDER in `args` is where they are. Pages of `origins` are let in. What `relay` passes on can be
 * cut; pages from there are let in unless it is `unlisted`.
 */
export async function start({ config, origins = [], relay: relayed = false, files = {}, args = [], lab = [], env = {} } = {}) {
  const alone = config !== undefined || origins.length > 0 || relayed || args.length > 0;
  const folder = mkdtempSync(join(tmpdir(), "mom-console-"));
  const ends = [() => rmSync(folder, { recursive: true, force: true })];
  const end = async () => {
    for (const one of ends.splice(0).reverse()) await one();
  };
  try {
    const relay = relayed ? await startRelay() : null;
    if (relay) ends.push(relay.end);
    let program;
    if (alone) {
      const read = (name) => readFileSync(join(project, "config", name), "utf8").replace(/^#:schema.*$/m, "");
      const all = [...origins, ...(relay && relayed !== "unlisted" ? [relay.origin] : [])];
      const own = read("lab.toml").replace("[web]", `[web]\norigins = ${JSON.stringify(all)}`);
      const written = typeof config === "function" ? config(own) : own + (config ?? "");
      for (const [name, text] of Object.entries({ "lab.toml": written, "lab-users.toml": read("lab-users.toml"), ...files })) writeFileSync(join(folder, name), text);
      const options = ["--config", join(folder, "lab.toml"), "--listen", "127.0.0.1:0", ...args.map((arg) => arg.replace("FOLDER", folder))];
      program = await startProgram(broker, options, { XDG_STATE_HOME: folder, STATE_DIRECTORY: "", ...env });
    } else {
      program = await startProgram(mom, ["lab", ...lab, "--listen", "127.0.0.1:0"], { XDG_STATE_HOME: folder, STATE_DIRECTORY: "", ...env });
    }
    const { child, port } = program;
    ends.push(async () => {
      if (child.exitCode !== null || child.signalCode !== null) return;
      const gone = new Promise((resolve) => child.once("exit", resolve));
      child.kill("SIGCONT");
      child.kill("SIGTERM");
      await gone;
    });
    const headers = await headersOfPage(port);
    const preview = isPreview ? await startPreview(port, headers) : null;
    if (preview) ends.push(preview.end);
    if (relay) relay.to = preview?.port ?? port;
    const browser = await browserForOne();
    ends.push(browserNoMore);
    return labOf({ child, port, folder, relay, browser, end, address: relay?.origin ?? `http://127.0.0.1:${preview?.port ?? port}` });
  } catch (error) {
    await end();
    throw error;
  }
}

function labOf({ child, port, folder, relay, browser, end, address }) {
  const contexts = new Set();
  const login = (user) => ({ ...process.env, MOM_HUB: `bin://127.0.0.1:${port}`, MOM_USER: user, MOM_PASSWORD: user });
  return {
    child,
    port,
    host: `127.0.0.1:${port}`,
    folder,
    relay,
    browser,
    /** Where its page is. */
    address,
    /**
     * A page of its own; what it throws, and what its policy does not let in, is among its `faults`, but for what `allow` fits. With the test `t` it is closed at the test's
     * end, which then fails if there were faults.
     */
    async open(path = "/", { t, allow, prepare, ...options } = {}) {
      const context = await browser.newContext({ viewport: { width: 1280, height: 900 }, ...options });
      contexts.add(context);
      t?.after(() => context.close());
      const page = await context.newPage();
      page.setDefaultTimeout(20_000);
      page.faults = [];
      page.on("pageerror", (error) => page.faults.push(error.message));
      page.on("console", (message) => message.type() === "error" && !allow?.test(message.text()) && page.faults.push(message.text()));
      t?.after(() => assert.deepEqual(page.faults, []));
      if (prepare) await page.addInitScript(prepare);
      await page.goto(/^[a-z]+:/.test(path) ? path : address + path);
      return page;
    },
    /** The same, logged in; `path` may name a page of the console. */
    async page(user, { path = "/", ...options } = {}) {
      const page = await this.open(path, options);
      await logIn(page, user);
      return page;
    },
    /** Collects what is said in a context from now on, until `end` is called: lines of `mom watch --json`. */
    async watch(user, path) {
      const run = spawn(mom, ["watch", "--json", "--messages", path], { env: login(user), stdio: ["ignore", "pipe", "ignore"] });
      process.once("exit", () => run.kill("SIGKILL"));
      const heard = [];
      await new Promise((resolve) => createInterface({ input: run.stdout }).on("line", (line) => resolve(heard.push(JSON.parse(line)))));
      return { heard, end: () => run.kill("SIGKILL") };
    },
    /** Runs the command line against the hub. */
    mom(user, ...args) {
      return new Promise((resolve, reject) => {
        const run = spawn(mom, args, { env: login(user), stdio: ["ignore", "pipe", "pipe"] });
        let out = "";
        run.stdout.on("data", (data) => (out += data));
        run.stderr.on("data", (data) => (out += data));
        run.once("error", reject);
        run.once("exit", (code) => resolve({ code, out }));
      });
    },
    /** Takes the robot's token from a peer that still has it, so that a test begins as it were the first one. */
    async free() {
      const carol = await RawPeer.login(this.host, "carol");
      await carol.ask("context", "join", "/robot");
      await carol.ask("token", "break", "/robot/token");
      carol.close();
    },
    async end() {
      // Pages that are still open need not see the hub go.
      for (const context of contexts) await context.close();
      await end();
    },
  };
}

/** Logs a user of the lab in, whose password is the name. */
export async function logIn(page, user, password = user) {
  await page.getByLabel("User", { exact: true }).fill(user);
  await page.getByRole("textbox", { name: "Password" }).fill(password);
  await page.getByRole("button", { name: "Log in" }).click();
  if (password === user) await page.getByRole("button", { name: "Log out" }).waitFor();
}

/** Leads a page of the console to another one. */
export const go = (page, hash) => page.evaluate((to) => (location.hash = to), hash);

/** Waits until something holds, for 20 seconds at most. */
export async function until(page, what, within = 20_000) {
  for (const end = Date.now() + within; !(await what()); ) {
    assert.ok(Date.now() < end, `waited for ${what}`);
    await page.evaluate(() => new Promise((resolve) => requestAnimationFrame(resolve)));
  }
}

/** How long the longest task of pages' threads occupied the processor while something was done, ms. What its clock says would count other programs as well. */
async function busiest(page, during) {
  const browser = page.context().browser();
  await browser.startTracing(page, { categories: ["toplevel", "devtools.timeline", "disabled-by-default-devtools.timeline"] });
  let trace;
  try {
    await during();
  } finally {
    trace = JSON.parse((await browser.stopTracing()).toString()).traceEvents;
  }
  const main = new Set(trace.filter(({ name, args }) => name === "thread_name" && args.name === "CrRendererMain").map(({ pid, tid }) => `${pid} ${tid}`));
  const tasks = trace.filter(({ name, pid, tid, tdur }) => /RunTask/.test(name) && tdur !== undefined && main.has(`${pid} ${tid}`)).map(({ tdur }) => tdur / 1000);
  assert.ok(tasks.length > 10, `${tasks.length} tasks are in the trace`);
  return Math.max(...tasks);
}

/** What a page does in one task for comparison: it lays out a table of 250 rows of six cells. */
const yardstick = () =>
  new Promise((resolve) => {
    const list = document.createElement("table");
    list.style = "position: absolute; visibility: hidden";
    for (let row = 0; row < 250; row += 1) {
      const line = list.insertRow();
      for (let cell = 0; cell < 6; cell += 1) line.insertCell().textContent = `${row} ${cell}`;
    }
    document.body.append(list);
    const { height } = list.getBoundingClientRect();
    list.remove();
    // There are other tasks as well.
    let left = 12;
    const { port1, port2 } = new MessageChannel();
    port1.onmessage = () => ((left -= 1) ? port2.postMessage(height) : resolve(height));
    port2.postMessage(height);
  });

/**
 * Fails if a task of the page takes so many times as long as one that this machine's speed is known by. What holds for each of three stretches is the page's; one stretch may
 * have the browser's own work in it.
 */
export async function staysQuick(t, page, during, most = 4) {
  const found = [];
  while (found.length < 3 && !(found.at(-1) < most)) {
    const unit = Math.min(await busiest(page, () => page.evaluate(yardstick)), await busiest(page, () => page.evaluate(yardstick)));
    const longest = await busiest(page, during);
    t.diagnostic(`the longest task takes ${longest.toFixed(1)} ms of the processor, the one for comparison ${unit.toFixed(1)} ms`);
    found.push(longest / unit);
  }
  assert.ok(found.at(-1) < most, `tasks take ${found.map((times) => times.toFixed(1)).join(", ")} times as long as the one for comparison`);
}

const axe = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");

/** What axe finds wrong with a page, one line each. */
export async function findings(page) {
  if (!(await page.evaluate(() => "axe" in globalThis))) await page.evaluate(axe);
  const { violations } = await page.evaluate(() => globalThis.axe.run(document, { resultTypes: ["violations"], runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"] }));
  return violations.flatMap(({ id, help, nodes }) => nodes.map(({ target, failureSummary }) => `${id} (${help}) at ${target.flat().join(" >> ")}: ${failureSummary}`));
}

/** Waits until the frame shows that so many channels are stopped: a device may say that it stands before the hub has told of the last channel. */
export const stands = (page, channels) =>
  until(page, async () => {
    const groups = await page.locator("mom-stopped li .mono").evaluateAll((all) => all.map(({ title }) => title.split("\n").length));
    return groups.reduce((sum, paths) => sum + paths, 0) === channels;
  });

/** Lets go of what is stopped, as its user does: asks, reads what it is, and says so. */
export async function letGo(page) {
  await page.locator("mom-stop").getByRole("button", { name: "Let go" }).click();
  await page.locator("mom-stop").getByRole("dialog").getByRole("button", { name: /^Free th/ }).click();
}
