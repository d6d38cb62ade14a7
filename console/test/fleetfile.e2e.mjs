// An operator adds, changes and removes robots of a gateway's file in a browser (W12, W14): with the gateway and its robots as programs.
import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { once } from "node:events";
import { existsSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import { findings, start, until } from "./lab.mjs";

const project = dirname(fileURLToPath(new URL("..", import.meta.url)));
const programs = process.env.MOM_BIN ? dirname(process.env.MOM_BIN) : join(project, "target/debug");
const folder = mkdtempSync(join(tmpdir(), "mom-fleet-"));
const file = join(folder, "fleet.toml");
const children = [];

function program(name, args, env = {}) {
  const child = spawn(join(programs, "mom-device"), args, { argv0: name, stdio: "ignore", env: { ...process.env, XDG_STATE_HOME: folder, ...env } });
  children.push(child);
  process.once("exit", () => child.kill("SIGKILL"));
}

let hub;
let addresses;

before(async () => {
  const config = readFileSync(join(project, "config/fleet.toml"), "utf8").replace(/^#:schema.*$/m, "");
  hub = await start({ config: () => `${config}\n[web]\norigins = []\n` });
  const all = join(folder, "all.toml");
  program("mom-linuxbot", ["--robots", "3", "--write-fleet", all, "--listen", "127.0.0.1:0"]);
  const tables = () => (existsSync(all) ? readFileSync(all, "utf8").split("[[robot]]").slice(1) : []);
  while (tables().length < 3 || !tables()[2].includes("address")) await new Promise((resolve) => setTimeout(resolve, 20));
  addresses = tables().map((table) => /address = "(.*)"/.exec(table)[1]);
  writeFileSync(file, `# Ours.\n\n${tables().slice(0, 2).map((table) => `[[robot]]${table}`).join("")}`);
  program("mom-gateway", ["--fleet", file, "--hub", `bin://127.0.0.1:${hub.port}`, "--manager", "robot-token"], { MOM_PASSWORD: "gateway" });
});
after(async () => {
  for (const child of children) {
    child.kill("SIGTERM");
    if (child.exitCode === null && child.signalCode === null) await once(child, "exit");
  }
  await hub?.end();
  rmSync(folder, { recursive: true, force: true });
});

const open = async (t, user) => {
  const page = await hub.page(user, { t, path: "/#/fleet" });
  const fleet = page.locator("mom-fleet");
  await fleet.locator("tr[data-unit='2']").waitFor();
  return { page, fleet };
};

test("an operator adds, changes and removes a robot, and is told what is wrong at its field", async (t) => {
  const { page, fleet } = await open(t, "carol");
  await fleet.getByRole("button", { name: "Robots…" }).click();
  const dialog = fleet.getByRole("dialog", { name: "Robots of the fleet" });
  const address = dialog.getByRole("textbox", { name: "Address" });
  assert.equal(await dialog.getByRole("textbox", { name: "Unit number" }).inputValue(), "3");
  await dialog.getByRole("button", { name: "Add it" }).click();
  await dialog.getByText("Enter the robot's address").waitFor();
  await address.fill(addresses[0]);
  await dialog.getByRole("button", { name: "Add it" }).click();
  await dialog.getByText("is already the address of unit 1").waitFor();
  assert.equal(await address.getAttribute("aria-invalid"), "true");
  if (process.env.MOM_SHOTS) for (const width of [360, 900, 1400]) {
    await page.setViewportSize({ width, height: 900 });
    await page.screenshot({ path: join(process.env.MOM_SHOTS, `fleet-file-${width}.png`) });
  }
  assert.deepEqual(await findings(page), []);
  await address.fill(addresses[2]);
  await dialog.getByRole("textbox", { name: "Name" }).fill("by the door");
  await dialog.getByRole("button", { name: "Add it" }).click();
  await dialog.getByText(`unit 3 at ${addresses[2]} was added`).waitFor();
  await fleet.locator("tr[data-unit='3']").getByText("standing").waitFor();
  assert.match(readFileSync(file, "utf8"), /^# Ours\.\n[^]*name = "by the door"/);

  const which = dialog.getByRole("combobox", { name: "Robot" });
  await which.selectOption({ label: `3 by the door at ${addresses[2]}` });
  await dialog.getByRole("textbox", { name: "Name" }).fill("at the window");
  await dialog.getByRole("button", { name: "Change it" }).click();
  await dialog.getByText("at the window").first().waitFor();
  await until(page, () => /name = "at the window"/.test(readFileSync(file, "utf8")));
  // The same robot is still chosen: one press asks, the second removes.
  await dialog.getByRole("button", { name: "Remove it…" }).click();
  await dialog.getByText("Press again to remove it").waitFor();
  await dialog.getByRole("button", { name: "Remove robot 3" }).click();
  await dialog.getByText(`unit 3 at ${addresses[2]} was removed`).waitFor();
  await fleet.locator("tr[data-unit='3']").getByText("lost").waitFor();
  assert.doesNotMatch(readFileSync(file, "utf8"), /window/);
});

test("a robot that a user holds is left to them, and who is not an operator has no such form", async (t) => {
  const bob = await open(t, "bob");
  await bob.fleet.locator("tr[data-unit='1']").click();
  await bob.fleet.getByTitle("Grab the tokens of the selected robots").click();
  await bob.fleet.locator("tr[data-unit='1']").getByText("you").waitFor();
  assert.equal(await bob.fleet.getByRole("button", { name: "Robots…" }).count(), 0);
  const { fleet } = await open(t, "carol");
  await fleet.locator("tr[data-unit='1']").click();
  await fleet.getByRole("button", { name: "Robots…" }).click();
  const dialog = fleet.getByRole("dialog", { name: "Robots of the fleet" });
  assert.equal(await dialog.getByRole("textbox", { name: "Address" }).inputValue(), addresses[0]);
  await dialog.getByRole("button", { name: "Remove it…" }).click();
  await dialog.getByRole("button", { name: "Remove robot 1" }).click();
  await dialog.getByText("bob holds /fleet/1/token").waitFor();
  await fleet.locator("tr[data-unit='1']").getByText("standing").waitFor();
});
