// The console's figures, measured in a browser against a lab: npm run figures -- [--minutes 30]. Those of STOP are of press.mjs.
import { parseArgs } from "node:util";
import { start } from "../test/lab.mjs";

const { values } = parseArgs({ options: { minutes: { type: "string", default: "1" } } });
const minutes = Number(values.minutes);
const say = (name, figure) => console.log(`${name.padEnd(52)} ${figure}`);
const wait = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
const now = () => performance.timeOrigin + performance.now();

/** Counts long tasks of the page's own thread from its beginning on. */
function observe() {
  window.tasks = [];
  new PerformanceObserver((list) => list.getEntries().forEach(({ duration, startTime }) => window.tasks.push([startTime, duration]))).observe({ type: "longtask", buffered: true });
}

async function heap(page) {
  const session = await page.context().newCDPSession(page);
  await session.send("HeapProfiler.enable");
  await session.send("HeapProfiler.collectGarbage");
  const { usedSize } = await session.send("Runtime.getHeapUsage");
  const { nodes } = await session.send("Memory.getDOMCounters");
  await session.detach();
  return { mebibytes: usedSize / 2 ** 20, nodes };
}

async function longest(page, from) {
  return page.evaluate((from) => Math.max(0, ...window.tasks.filter(([at]) => at >= from).map(([, long]) => long)), from);
}

const lab = await start();

// The first load.
const page = await lab.open("about:blank");
await page.addInitScript(observe);
let [bytes, requests] = [0, 0];
page.on("response", (response) => {
  requests += 1;
  bytes += Number(response.headers()["content-length"] ?? 0);
});
await page.goto(lab.address);
await page.getByRole("button", { name: "Log in" }).waitFor();
say("first load, until the login can be typed", `${(bytes / 1024).toFixed(1)} KiB compressed, ${requests} requests`);
await page.getByLabel("User", { exact: true }).fill("alice");
await page.getByRole("textbox", { name: "Password" }).fill("alice");
const entered = now();
await page.getByRole("button", { name: "Log in" }).click();
await page.locator("mom-camera").getByText(/shown .*after/).first().waitFor();
say("first picture after the login", `${(now() - entered).toFixed(0)} ms`);
say("all of the page Drive", `${(bytes / 1024).toFixed(1)} KiB compressed, ${requests} requests`);

// Four cameras, and the arm in motion.
await page.getByRole("button", { name: "Grab" }).first().click();
const script = Array.from({ length: 40 }, (_, turn) => `move ${turn % 2 ? 200 : -200} ${turn % 4 < 2 ? 150 : -150} 150 0 0`).join("; ");
const drive = async () => {
  await page.getByLabel("New command", { exact: true }).fill(script);
  await page.getByLabel("New command", { exact: true }).press("Enter");
  await page.getByRole("button", { name: /Send all/ }).click();
};
for (const camera of ["y", "top", "wrist"]) {
  const button = page.locator("mom-cameras").getByRole("button", { name: new RegExp(`^/?(camera/)?${camera}$`) }).first();
  if ((await button.getAttribute("aria-pressed")) !== "true") await button.click();
}
await drive();
await wait(10_000);
const first = await heap(page);
const from = await page.evaluate(() => performance.now());
const end = now() + minutes * 60_000;
while (now() < end) {
  await wait(Math.min(5000, Math.max(0, end - now())));
  // While a script is under way, it can be paused.
  if (await page.getByRole("button", { name: /^Paus/ }).isVisible()) continue;
  await page.getByRole("button", { name: "Clear finished" }).click();
  await drive();
}
say(`longest task in ${minutes} min with four cameras`, `${(await longest(page, from)).toFixed(0)} ms`);
const last = await heap(page);
say("memory of the page's thread, at the begin and the end", `${first.mebibytes.toFixed(1)} and ${last.mebibytes.toFixed(1)} MiB; ${first.nodes} and ${last.nodes} nodes`);
await page.getByRole("button", { name: "Give back" }).first().click();
await lab.end();
