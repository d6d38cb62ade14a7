// What `mom new device` makes is at its own hub within a minute, and is driven, stopped and let go from the console.
import assert from "node:assert/strict";
import { spawn, spawnSync } from "node:child_process";
import { once } from "node:events";
import { mkdirSync, mkdtempSync, readFileSync, rmSync, symlinkSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { createInterface } from "node:readline";
import { test } from "node:test";
import { letGo, logIn, mom, project, start, until } from "./lab.mjs";

/** Makes a device in a folder of its own, as its README says, but for what npm would fetch. */
function made(t, name) {
  const folder = mkdtempSync(join(tmpdir(), "mom-newcomer-"));
  t.after(() => rmSync(folder, { recursive: true, force: true }));
  const made = spawnSync(mom, ["new", "device", name, "--lang", "js", "--from", project, "--out", folder], { encoding: "utf8" });
  assert.equal(made.status, 0, made.stderr);
  mkdirSync(join(folder, "node_modules"));
  symlinkSync(join(project, "clients/js"), join(folder, "node_modules/mom-client"));
  return folder;
}

test("from nothing to a robot that drives in the console", async (t) => {
  const began = performance.now();
  const folder = made(t, "cart");
  const read = (name) => readFileSync(join(folder, name), "utf8");
  const hub = await start({ config: () => read("hub.toml"), files: { "users.toml": read("users.toml") } });
  t.after(() => hub.end());
  const robot = spawn(process.execPath, ["robot.mjs"], { cwd: folder, env: { ...process.env, MOM_HUB: `mom://${hub.host}` }, stdio: ["ignore", "pipe", "inherit"] });
  t.after(async () => {
    robot.kill();
    if (robot.exitCode === null) await once(robot, "exit");
  });
  assert.deepEqual(await once(createInterface({ input: robot.stdout }), "line"), ["cart is ready"]);

  const page = await hub.open("/", { t });
  await logIn(page, "operator", read("operator.password").trim());
  const commands = page.locator("mom-commands");
  const form = commands.locator("form");
  const row = (state, text) => commands.locator(`li.${state}`, { hasText: text });
  // It is the only device here: there is nothing to choose.
  await form.waitFor();
  await page.getByRole("button", { name: "Grab" }).click();
  await form.getByLabel("Verb").selectOption("drive");
  const distance = form.getByRole("spinbutton").first();
  await distance.fill("50");
  await form.getByRole("button", { name: "Run now" }).click();
  await row("finished", "drive 50").waitFor();
  t.diagnostic(`from nothing to a robot that has driven: ${((performance.now() - began) / 1000).toFixed(1)} s`);
  const x = commands.locator(".pose dl > div", { has: page.getByText("x", { exact: true }) }).locator("dd");
  await until(page, async () => Math.abs(Number.parseFloat(await x.innerText()) - 50) < 5);

  await distance.fill("2000");
  await form.getByRole("button", { name: "Run now" }).click();
  await row("executing", "drive 2000").waitFor();
  await page.locator("mom-stop").getByRole("button", { name: /^STOP/ }).click();
  await row("error", "drive 2000").waitFor();
  await commands.locator(".pose", { hasText: "at rest" }).waitFor();
  assert.ok(Number.parseFloat(await x.innerText()) < 2000);
  await letGo(page);
  await distance.fill("-20");
  await until(page, () => form.getByRole("button", { name: "Run now" }).isEnabled());
  await form.getByRole("button", { name: "Run now" }).click();
  await row("finished", "drive -20").waitFor();
});
