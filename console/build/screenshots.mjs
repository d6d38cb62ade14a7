// Makes the pictures of docs/console.md, docs/fleet.md and docs/simulacrum.md anew from a lab: npm run screenshots; some of them alone: npm run screenshots -- fleet, or -- cubo. MOM_BIN is the program; with MOM_PREVIEW=1 the page is that of dist
// as it is now, and not the one that the program has in it.
import { spawn } from "node:child_process";
import { writeFileSync } from "node:fs";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import { start } from "../test/lab.mjs";

const images = fileURLToPath(new URL("../../docs/images", import.meta.url));
/** Bytes of one picture. */
const MOST = 150_000;

const alone = process.argv[2];
const LABS = { fleet: ["--fleet", "10"], cubo: ["--cubo"] };
const lab = await start(alone ? { lab: LABS[alone] } : {});
const bench = await (await lab.browser.newContext()).newPage();

/** Writes pictures beside each other, no wider than `width`, as JPEG that is small enough. */
async function write(name, shots, width) {
  for (const quality of [0.84, 0.76, 0.68, 0.6, 0.5]) {
    const written = await bench.evaluate(
      async ({ shots, width, quality }) => {
        const all = await Promise.all(shots.map((shot) => createImageBitmap(new Blob([Uint8Array.from(atob(shot), (letter) => letter.charCodeAt(0))]))));
        const gap = 16;
        const whole = { width: all.reduce((sum, one) => sum + one.width, gap * (all.length - 1)), height: Math.max(...all.map((one) => one.height)) };
        const scale = Math.min(1, width / whole.width);
        const canvas = new OffscreenCanvas(Math.round(whole.width * scale), Math.round(whole.height * scale));
        const drawing = canvas.getContext("2d");
        drawing.imageSmoothingQuality = "high";
        drawing.fillStyle = "#f3f5f8";
        drawing.fillRect(0, 0, canvas.width, canvas.height);
        let x = 0;
        for (const one of all) {
          drawing.drawImage(one, x * scale, 0, one.width * scale, one.height * scale);
          x += one.width + gap;
        }
        const bytes = new Uint8Array(await (await canvas.convertToBlob({ type: "image/jpeg", quality })).arrayBuffer());
        let text = "";
        for (let at = 0; at < bytes.length; at += 8192) text += String.fromCharCode(...bytes.subarray(at, at + 8192));
        return btoa(text);
      },
      { shots: shots.map((shot) => shot.toString("base64")), width, quality },
    );
    const bytes = Buffer.from(written, "base64");
    if (bytes.length > MOST && quality > 0.5) continue;
    writeFileSync(join(images, `console-${name}.jpg`), bytes);
    console.log(`console-${name}.jpg  ${(bytes.length / 1000).toFixed(0)} kB at ${quality}`);
    return;
  }
}

/** As soon as all that moves has come to rest in it. */
async function look(page, width, height, scheme, hash) {
  await page.setViewportSize({ width, height });
  await page.emulateMedia({ colorScheme: scheme });
  if (hash) await page.evaluate((to) => (location.hash = to), hash);
  await page.evaluate(() => scrollTo(0, 0));
  await page.waitForTimeout(2500);
}

async function shoot(name, page, width, height, scheme, hash) {
  await look(page, width, height, scheme, hash);
  await write(name, [await page.screenshot()], Math.min(width, 1600));
}

async function page(user) {
  const opened = await lab.page(user);
  // The program may have another console than this one.
  await opened.getByRole("button", { name: "Not now" }).click({ timeout: 3000 }).catch(() => undefined);
  return opened;
}

/** Ten robots on their way into a formation, and carol, who sends to two of them. */
async function shootFleet(lab) {
  const env = { ...process.env, MOM_HUB: `bin://${lab.host}`, MOM_USER: "alice", MOM_PASSWORD: "alice" };
  const opened = await lab.page("carol");
  await opened.evaluate(() => (location.hash = "#/fleet"));
  const fleet = opened.locator("mom-fleet");
  await fleet.getByRole("button", { name: "10 standing" }).waitFor();
  const file = fileURLToPath(new URL("../../config/formation.txt", import.meta.url));
  const driving = spawn(process.env.MOM_BIN, ["fleet", "run", file], { env, stdio: "ignore" });
  const over = new Promise((resolve) => driving.once("exit", resolve));
  await fleet.getByRole("button", { name: /^[1-9]\d* driving$/ }).waitFor();
  await shoot("fleet", opened, 1280, 1000, "light");
  await over;
  for (const unit of [1, 2]) await fleet.getByRole("checkbox", { name: `Select robot ${unit}`, exact: true }).click();
  await fleet.getByRole("region", { name: "Fleet", exact: true }).getByRole("button", { name: "Grab", exact: true }).click();
  await fleet.getByRole("button", { name: "Send…" }).click();
  await fleet.getByRole("dialog").getByRole("button", { name: "Send once" }).click();
  await fleet.getByRole("dialog").getByRole("status").filter({ hasText: "finished" }).waitFor();
  await shoot("fleet-send-dark", opened, 1280, 1000, "dark");
}

/** CUBO on its way along a square, and its model. */
async function shootCubo(lab) {
  const env = { ...process.env, MOM_HUB: `bin://${lab.host}`, MOM_USER: "alice", MOM_PASSWORD: "alice" };
  const opened = await lab.page("carol");
  await opened.evaluate(() => (location.hash = "#/simulacrum"));
  await opened.locator("mom-simulacrum").getByText("session up").first().waitFor();
  const square = "set joints 40 -30 10; via 3000 2500 3000 3000 2500 3000 2500 2500";
  const driving = spawn(process.env.MOM_BIN, ["fleet", "send", "1", square], { env, stdio: "ignore" });
  await opened.locator("mom-token").getByText("alice holds it").waitFor();
  await opened.waitForTimeout(8000);
  // On a busy machine it may have been lost meanwhile.
  await opened.locator("mom-simulacrum").getByText("session up").first().waitFor();
  await shoot("simulacrum", opened, 1280, 1100, "light");
  await opened.evaluate(() => (location.hash = "#/modeller"));
  await opened.getByRole("button", { name: "Example: CUBO" }).click();
  await shoot("modeller-dark", opened, 1280, 1000, "dark");
  driving.kill();
}

async function shootLab() {
  const [alice, bob, carol] = [await page("alice"), await page("bob"), await page("carol")];
  const health = await page("carol");
  await health.evaluate(() => (location.hash = "#/health"));

  // Refused, and asked.
  const token = (of) => of.locator("mom-token");
  await token(alice).getByRole("button", { name: "Grab", exact: true }).click();
  await token(alice).getByText("You hold it").waitFor();
  await token(bob).getByText("alice holds it").waitFor();
  await token(bob).getByRole("button", { name: "Grab", exact: true }).click();
  await bob.getByText("Refused").first().waitFor();
  // The refusal lies over what is below the card.
  const [card, below] = [await token(bob).boundingBox(), await token(bob).locator(".below").boundingBox()];
  const refused = await bob.screenshot({ clip: { x: card.x, y: card.y, width: card.width, height: below.y + below.height - card.y } });
  await token(bob).getByRole("button", { name: "Ask the owner" }).first().click();
  await token(bob).getByLabel("Why (optional)").fill("the red block is mine");
  await token(bob).getByRole("button", { name: "Ask", exact: true }).click();
  const news = alice.locator("mom-console .strip .news");
  await news.getByText("asks for /robot/token").waitFor();
  await news.locator('button:not([aria-disabled="true"])', { hasText: "Decline" }).waitFor();
  await write("refused-and-asked", [refused, await news.screenshot()], 1400);
  await news.getByRole("button", { name: "Decline" }).click();

  // A list under way.
  const commands = alice.locator("mom-commands");
  for (const line of ["move -150 100 120 0 0; grip open", "move -150 100 20 0 0; grip close", "move -150 100 250 0 0; move 120 -60 250 30 0; wait 30000", "move 120 -60 40 30 0; grip open", "home"]) {
    await commands.getByLabel("New command").fill(line);
    await commands.getByRole("button", { name: "Add", exact: true }).click();
  }
  await carol.evaluate(() => (location.hash = "#/contexts?path=/robot/arm"));
  await carol.locator("mom-watch").waitFor();
  await commands.getByRole("button", { name: /Send all/ }).click();
  await commands.getByText("statement 2 of 3").waitFor();
  await shoot("drive-1280-light", alice, 1280, 960, "light");
  await shoot("drive-360-dark", alice, 360, 780, "dark");
  await shoot("drive-2560-dark", alice, 2560, 1300, "dark");

  await shoot("contexts", carol, 1280, 900, "light");
  await carol.evaluate(() => (location.hash = "#/access?path=/robot/token"));
  await look(carol, 1280, 900, "light");
  await carol.getByRole("button", { name: "All connected users" }).click();
  await carol.getByText("connected as bob").waitFor();
  await carol.locator(".matrix tr", { hasText: "grab" }).getByRole("button", { name: /bob/ }).click();
  await shoot("access", carol, 1280, 900, "light");
  await carol.evaluate(() => (location.hash = "#/audit"));
  await carol.getByText("refused").first().waitFor();
  await shoot("audit-dark", carol, 1280, 800, "dark");
  await shoot("health", health, 1280, 900, "light");
  const fleet = await start({ lab: ["--fleet", "10"] });
  await shootFleet(fleet).finally(() => fleet.end());
  const cubo = await start({ lab: LABS.cubo });
  await shootCubo(cubo).finally(() => cubo.end());
}

try {
  await { fleet: () => shootFleet(lab), cubo: () => shootCubo(lab), undefined: shootLab }[String(alone)]();
} finally {
  await lab.end();
}
