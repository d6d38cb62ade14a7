// Pictures and the cursor in a browser, before a lab.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { after, before, beforeEach, test } from "node:test";
import { deflateSync } from "node:zlib";
import { load } from "./bundle.mjs";
import { start, staysQuick, until } from "./lab.mjs";

let lab;
before(async () => (lab = await start()));
after(() => lab?.end());
beforeEach(() => lab.free());

/** A page of its own on which alice has logged in. */
const open = (t, viewport = { width: 1280, height: 1000 }, prepare = undefined, options = {}) => lab.page("alice", { t, viewport, prepare, ...options });

/** Waits until the page has drawn what has happened. */
const settle = (page) => page.evaluate(() => new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve))));

const only = (...paths) => `localStorage.setItem("mom-cameras", JSON.stringify({ shown: ${JSON.stringify(paths)}, added: ${JSON.stringify(paths.filter((path) => !path.startsWith("/camera/")))}, layout: "big" }))`;

const AXES = ["x", "y", "z", "spin", "tilt"];
const LABELS = { x: "Cursor x", y: "Cursor y", z: "Cursor z, height", spin: "Cursor spin", tilt: "Cursor tilt", tip: "Cursor across the table" };

async function pose(page) {
  const values = [];
  for (const axis of AXES) values.push(Number(await page.locator("mom-cursor").getByLabel(axis === "x" || axis === "y" || axis === "z" ? `${axis} (mm)` : `${axis} (°)`, { exact: true }).inputValue()));
  return values;
}

/** Where the big picture is: on a phone beside the controls. */
const big = (page) => (page.viewportSize().width < 600 ? "mom-drive mom-camera" : "mom-cameras mom-camera");
const handle = (page, grip) => page.locator(big(page)).getByRole("slider", { name: LABELS[grip], exact: true });

/** Where a handle is, pixels of the page. */
async function place(page, grip) {
  const box = await handle(page, grip).locator(".target").boundingBox();
  return [box.x + box.width / 2, box.y + box.height / 2];
}

/** Drags a handle, taken hold of a little beside its middle, so that its middle should go along these places. */
async function drag(page, grip, places) {
  const [x, y] = await place(page, grip);
  await page.mouse.move(x + 3, y - 2);
  await page.mouse.down();
  let far = 0;
  for (const [u, v] of places) {
    await page.mouse.move(u + 3, v - 2);
    let off = Infinity;
    for (let frames = 0; frames < 60 && off >= 2; frames += 1) {
      await settle(page);
      const at = await place(page, grip);
      off = Math.hypot(at[0] - u, at[1] - v);
    }
    far = Math.max(far, off);
  }
  await page.mouse.up();
  return far;
}

const between = (from, to, steps = 5) => Array.from({ length: steps }, (_, step) => from.map((value, at) => value + ((to[at] - value) * (step + 1)) / steps));

for (const camera of ["/camera/x", "/camera/y", "/camera/top"]) {
  test(`each handle changes its degree alone and follows the pointer in ${camera}`, async (t) => {
    const page = await open(t, undefined, only(camera));
    await handle(page, "tip").waitFor();
    for (const grip of [...AXES, "tip"]) {
      const first = await pose(page);
      const from = await place(page, grip);
      // The keys say where the handle is to go.
      await handle(page, grip).focus();
      const keys = grip === "tip" ? ["Shift+ArrowRight", "Shift+ArrowRight", "Shift+ArrowUp"] : ["Shift+ArrowRight", "Shift+ArrowRight"];
      for (const key of keys) await page.keyboard.press(key);
      const second = await pose(page);
      const to = await place(page, grip);
      for (const key of keys) await page.keyboard.press(key.replace("Right", "Left").replace("Up", "Down"));
      assert.deepEqual(await pose(page), first, "the keys lead back");
      // One that is seen end-on stays where it is while its degree changes: it is dragged along its dashed line.
      const isEndOn = /end-on/.test(await handle(page, grip).locator("title").textContent());
      const tip = await place(page, "tip");
      const way = isEndOn ? from.map((value, at) => value + (30 * (value - tip[at])) / Math.hypot(from[0] - tip[0], from[1] - tip[1])) : to;
      // A turn goes along its curve, in which the places between are not on a straight line.
      const far = await drag(page, grip, grip === "spin" || grip === "tilt" ? [way] : between(from, way));
      const third = await pose(page);
      const changed = AXES.filter((_, at) => third[at] !== first[at]);
      assert.deepEqual(changed, grip === "tip" ? ["x", "y"] : [grip], `${grip} in ${camera}: ${first} became ${third}`);
      assert.ok(far < 2, `${grip} was ${far.toFixed(2)} px from the pointer`);
      if (grip === "spin" || grip === "tilt" || grip === "tip") if (!isEndOn) third.forEach((value, at) => assert.ok(Math.abs(value - second[at]) < 2, `${grip}: ${third} is not ${second}`));
    }
  });
}

test("an arrow is dragged by its line as well, and the cursor moves in all pictures", async (t) => {
  const page = await open(t, undefined, only("/camera/x", "/camera/y"));
  const big = page.locator("mom-camera.big");
  await big.locator(".handle").first().waitFor();
  const at = async (camera, grip) => {
    const box = await page.locator(camera).getByRole("slider", { name: LABELS[grip], exact: true }).locator(".target").boundingBox();
    return [box.x + box.width / 2, box.y + box.height / 2];
  };
  const [tip, z, other] = [await at("mom-camera.big", "tip"), await at("mom-camera.big", "z"), await at("mom-camera[small]", "tip")];
  const middle = tip.map((value, index) => (value + z[index]) / 2);
  await page.mouse.move(...middle);
  await page.mouse.down();
  await page.mouse.move(middle[0], middle[1] - 40, { steps: 4 });
  await page.mouse.up();
  const [x, y, height, spin, tilt] = await pose(page);
  assert.deepEqual([x, y, spin, tilt], [0, 0, 0, 0]);
  assert.ok(height > 210, `${height} mm`);
  const moved = await at("mom-camera[small]", "tip");
  assert.ok(moved[1] < other[1] - 2, "it has moved in the other picture as well");
});

test("a finger drags a handle, and what the browser cancels is taken back", async (t) => {
  const page = await open(t, { width: 412, height: 900 }, only("/camera/x"), { hasTouch: true, isMobile: true });
  await handle(page, "y").waitFor();
  const touch = await page.context().newCDPSession(page);
  const send = (type, x, y) => touch.send("Input.dispatchTouchEvent", { type, touchPoints: x === undefined ? [] : [{ x, y, id: 1 }] });
  await page.locator(`${big(page)} .picture`).first().scrollIntoViewIfNeeded();
  for (const ends of ["touchEnd", "touchCancel"]) {
    const before = await pose(page);
    const scrolled = await page.evaluate(() => scrollY);
    const [x, y] = await place(page, "y");

    // A finger is not exact.
    await send("touchStart", x + 10, y - 8);
    for (let step = 1; step <= 5; step += 1) await send("touchMove", x + 10 + 6 * step, y - 8 + 4 * step);
    await settle(page);
    await until(page, async () => Math.abs((await place(page, "y"))[0] - (x + 30)) < 2);
    const meanwhile = await pose(page);
    assert.deepEqual(AXES.filter((_, at) => meanwhile[at] !== before[at]), ["y"]);
    await send(ends);
    await settle(page);
    assert.deepEqual(await pose(page), ends === "touchEnd" ? meanwhile : before);
    assert.equal(await page.evaluate(() => scrollY), scrolled, "the page stands");
  }
});

test("keys move the cursor, the workspace ends it, and Home leads to the robot", async (t) => {
  const page = await open(t, undefined, only("/camera/x"));
  await handle(page, "z").focus();
  await page.keyboard.press("ArrowUp");
  await page.keyboard.press("Shift+ArrowUp");
  assert.deepEqual(await pose(page), [0, 0, 211, 0, 0]);
  assert.equal(await handle(page, "z").getAttribute("aria-valuetext"), "211.0 mm");
  for (let times = 0; times < 6; times += 1) await page.keyboard.press("PageUp");
  assert.equal((await pose(page))[2], 450);
  await page.locator("mom-cursor").getByText("z is at the limit of the workspace").waitFor();
  await page.keyboard.press("Home");
  assert.equal((await pose(page))[2], 300);
  await page.locator("mom-cursor").getByText("is at the limit").waitFor({ state: "detached" });
  await page.locator("mom-cursor").getByRole("button", { name: "Above red" }).click();
  assert.deepEqual(await pose(page), [-150, 100, 40, 0, 0]);
  await page.locator("mom-cursor").getByRole("button", { name: "To the robot" }).click();
  assert.deepEqual(await pose(page), [0, 0, 300, 0, 0]);
});

test("what lines are shown is remembered", async (t) => {
  const page = await open(t, undefined, `if (!localStorage.getItem("mom-cameras")) ${only("/camera/x")}`);
  const pathOf = page.locator("mom-camera svg .lines .pose");
  await pathOf.waitFor({ state: "attached" });
  assert.match(await pathOf.getAttribute("d"), /^M/);
  await page.locator("mom-cameras").getByLabel("Pose, measured").uncheck();
  assert.equal(await pathOf.getAttribute("d"), "");
  await page.reload();
  await pathOf.waitFor({ state: "attached" });
  assert.equal(await page.locator("mom-cameras").getByLabel("Pose, measured").isChecked(), false);
});

test("only who holds the token changes a camera's settings, and sees why not", async (t) => {
  const page = await open(t, undefined, only("/camera/x"));
  const camera = page.locator("mom-camera");
  await camera.getByText("Settings", { exact: true }).click();
  await camera.getByText("Only the owner of /robot/token may change the settings: it is free").waitFor();
  assert.ok(await camera.getByRole("button", { name: "Apply" }).isDisabled());
  await page.locator("mom-token").getByRole("button", { name: "Grab" }).click();
  await camera.getByLabel("Width (px)").fill("320");
  await camera.getByLabel("Height (px)").fill("240");
  await camera.getByRole("button", { name: "Apply" }).click();
  await camera.getByText("Changed by alice").waitFor();
  await camera.getByText("320 × 240").waitFor();
  await camera.getByLabel("Width (px)").fill("640");
  await camera.getByLabel("Height (px)").fill("480");
  await camera.getByRole("button", { name: "Apply" }).click();
  await camera.getByText("640 × 480").waitFor();
  await page.locator("mom-token").getByRole("button", { name: "Give back" }).click();
});

test("who drives gets new pictures though nothing moves", async (t) => {
  const page = await open(t, undefined, only("/camera/x"));
  const camera = page.locator("mom-camera");
  await camera.getByText("shown").first().waitFor();
  const shown = () => page.evaluate(() => globalThis.shown);
  await page.evaluate(() => {
    globalThis.shown = 0;
    const take = ImageBitmapRenderingContext.prototype.transferFromImageBitmap;
    ImageBitmapRenderingContext.prototype.transferFromImageBitmap = function (bitmap) {
      globalThis.shown += 1;
      return take.call(this, bitmap);
    };
  });
  assert.ok((await shown()) <= 1);
  await page.locator("mom-token").getByRole("button", { name: "Grab" }).click();
  await until(page, async () => (await shown()) >= 4);
  // It is at most a second old.
  await camera.locator(".age .warning").waitFor({ state: "detached" });
  await page.locator("mom-token").getByRole("button", { name: "Give back" }).click();
});

test("a camera that turns is turned by who holds its token", async (t) => {
  const page = await open(t, undefined, only("/camera/pan"));
  const camera = page.locator("mom-camera");
  await camera.getByText("Aim", { exact: true }).click();
  await camera.getByText("/camera/pan-token is free").waitFor();
  assert.ok(await camera.getByRole("button", { name: "Turn right" }).isDisabled());
  await camera.getByRole("button", { name: "Grab" }).click();
  await camera.getByRole("button", { name: "Turn right" }).click();
  await camera.getByText("pan 5.0°, tilt -20.0°").waitFor();
  await camera.getByRole("button", { name: "Look home" }).click();
  await camera.getByText("pan 0.0°, tilt -20.0°").waitFor();
  await camera.getByRole("button", { name: "Give back" }).click();
});

test("the picture is saved as the camera has sent it", async (t) => {
  const page = await open(t, undefined, only("/camera/x"));
  const camera = page.locator("mom-camera");
  await camera.getByText("shown").first().waitFor();
  const [download] = await Promise.all([page.waitForEvent("download"), camera.getByRole("button", { name: "Save picture" }).click()]);
  assert.match(download.suggestedFilename(), /^camera-x-\d{4}-\d\d-\d\d-\d{9}\.jpg$/);
  const bytes = readFileSync(await download.path());
  assert.deepEqual([...bytes.subarray(0, 3)], [0xff, 0xd8, 0xff]);
});

/** A PNG whose pixels tell a time: one square of a row for each bit. */
function stamped(micros, width = 320, height = 240) {
  const rows = Buffer.alloc((width + 1) * height);
  for (let y = 0; y < height; y += 1) for (let x = 0; x < width; x += 1) rows[y * (width + 1) + 1 + x] = y < 40 && x < 8 * 40 ? ((micros >> BigInt(Math.floor(x / 8))) & 1n ? 255 : 0) : (x + y) & 0xff;
  const chunk = (name, data) => {
    const body = Buffer.concat([Buffer.from(name), data]);
    const out = Buffer.alloc(8 + data.length + 4);
    out.writeUInt32BE(data.length, 0);
    body.copy(out, 4);
    out.writeUInt32BE(crc(body), 8 + data.length);
    return out;
  };
  const header = Buffer.alloc(13);
  header.writeUInt32BE(width, 0);
  header.writeUInt32BE(height, 4);
  header[8] = 8;
  return Buffer.concat([Buffer.from([137, 80, 78, 71, 13, 10, 26, 10]), chunk("IHDR", header), chunk("IDAT", deflateSync(rows, { level: 1 })), chunk("IEND", Buffer.alloc(0))]);
}

function crc(bytes) {
  let sum = 0xffffffff;
  for (const byte of bytes) {
    sum ^= byte;
    for (let bit = 0; bit < 8; bit += 1) sum = sum & 1 ? (sum >>> 1) ^ 0xedb88320 : sum >>> 1;
  }
  return ~sum >>> 0;
}

const { connect, Time } = await load("../../clients/js/src/index.ts");

/** Finds an element in the page, whatever shadow tree it is in. */
const DEEP = "globalThis.deep = (root, selector) => root.querySelector(selector) ?? [...root.querySelectorAll('*')].map((each) => each.shadowRoot && deep(each.shadowRoot, selector)).find(Boolean);";

/** A page that shows what bob sends to the chat, and what he sends it by. */
async function shown(t) {
  const client = await connect(`http://${lab.host}`, { user: "bob", password: "bob" });
  t.after(() => client.close());
  const page = await open(t, undefined, `${DEEP}${only("/chat")}`);
  await page.locator("mom-camera").getByText("Waiting for a picture").waitFor();
  return { page, client, channel: await client.channel("/chat") };
}

test("the age that the page tells is that of the stamp in the picture's own pixels", async (t) => {
  const { page, channel } = await shown(t);
  await page.evaluate(() => {
    const { deep } = globalThis;
    const { shadowRoot } = deep(document, "mom-camera");
    const copy = new OffscreenCanvas(320, 240).getContext("2d", { willReadFrequently: true });
    globalThis.told = [];
    const take = ImageBitmapRenderingContext.prototype.transferFromImageBitmap;
    ImageBitmapRenderingContext.prototype.transferFromImageBitmap = function (bitmap) {
      copy.drawImage(bitmap, 0, 0, 320, 240);
      const pixels = copy.getImageData(0, 20, 320, 1).data;
      let stamp = 0;
      // Microseconds of the last twelve days or so.
      for (let bit = 39; bit >= 0; bit -= 1) stamp = stamp * 2 + (pixels[(bit * 8 + 4) * 4] > 127 ? 1 : 0);
      const age = () => (((Date.now() * 1000) % 2 ** 40) - stamp) / 1000;
      const least = age();
      take.call(this, bitmap);
      // The page tells the age as soon as this has been drawn, in the frame that comes.
      requestAnimationFrame(() => requestAnimationFrame(() => globalThis.told.push({ least, said: shadowRoot.querySelector(".glass")?.textContent, most: age() })));
    };
  });
  for (let count = 1; count <= 20; count += 1) {
    const now = BigInt(Date.now()) * 1000n;
    await channel.send("image", { image: stamped(now % 2n ** 40n), "media-type": "image/png", width: 320, height: 240, view: "stamped", taken: new Time(now) });
    await page.waitForFunction((count) => globalThis.told.length >= count, count);
  }
  const millis = (value, unit) => Number(value) * (unit === "s" ? 1000 : 1);
  const found = (await page.evaluate(() => globalThis.told)).slice(3).map(({ least, said, most }) => {
    const [, value, unit, error, errorUnit] = /shown ([\d.]+) (ms|s) ± ([\d.]+) (ms|s)/.exec(said) ?? [];
    return { least, said: millis(value, unit), error: millis(error, errorUnit), most };
  });
  t.diagnostic(`glass to glass: ${found.map(({ least, said, error, most }) => `${least.toFixed(0)}-${said}±${error}-${most.toFixed(0)}`).join(" ")} ms (when it came to the canvas - what the page says - two frames later)`);
  // The page's clock is as wrong as its quickest exchange with the hub was long, and the page says how much that is.
  // What remains is the frame between the drawing and what is told of it.
  const off = found.map(({ least, said, error, most }) => Math.max(0, least - said - error, said - error - most)).sort((one, other) => one - other);
  assert.ok(off[Math.floor(off.length / 2)] < 20, `off by ${off}`);
});

test("four cameras leave the page's thread free", async (t) => {
  const { page, client, channel } = await shown(t);
  // A picture of the lab, with all that is said beside it.
  const camera = await client.channel("/camera/x");
  await camera.send("request", {});
  let shot;
  for await (const event of camera.events()) {
    if (event.type !== "message" || event.name !== "image") continue;
    shot = event.content;
    break;
  }
  await page.evaluate(() => {
    const first = globalThis.deep(document, "mom-camera");
    // Three more of them; each decodes and draws its own.
    for (let more = 0; more < 3; more += 1) {
      const camera = document.createElement("mom-camera");
      for (const { name, value } of first.attributes) camera.setAttribute(name, value);
      first.parentElement.append(camera);
    }
    globalThis.shown = new Map();
    const take = ImageBitmapRenderingContext.prototype.transferFromImageBitmap;
    ImageBitmapRenderingContext.prototype.transferFromImageBitmap = function (bitmap) {
      globalThis.shown.set(this, (globalThis.shown.get(this) ?? 0) + 1);
      return take.call(this, bitmap);
    };
  });
  const show = async (count) => {
    for (let at = 0; at < count; at += 1) {
      const before = await page.evaluate(() => [...globalThis.shown.values()].reduce((all, one) => all + one, 0));
      await channel.send("image", { ...shot, taken: client.clock.now() ?? Time.now() });
      await page.waitForFunction((before) => [...globalThis.shown.values()].reduce((all, one) => all + one, 0) > before, before);
    }
  };
  // Until all four have joined, and one knows what they do.
  do await show(1);
  while (await page.evaluate(() => globalThis.shown.size < 4));
  await show(10);
  await staysQuick(t, page, () => show(40));
});

test("what is not a picture, or too large, is told in words", async (t) => {
  const { page, channel } = await shown(t);
  const camera = page.locator("mom-camera");
  await channel.send("image", { image: new Uint8Array(1000), "media-type": "image/jpeg", width: 320, height: 240 });
  await camera.getByText("An image of 1000 B cannot be read").waitFor();
  await channel.send("camera-error", { text: "the lens cap is on <b>" });
  await camera.getByText("the lens cap is on <b>").waitFor();
  await channel.send("camera-recovered", { text: "the camera shows again" });
  await camera.getByText("the lens cap").waitFor({ state: "detached" });
  // A matrix of nonsense and lines of nonsense break nothing.
  await channel.send("image", { image: stamped(1n), "media-type": "image/png", width: 320, height: 240, matrix: [1, 2, "3"], overlays: [{ name: "pose", points: [[1], "x", null] }, 7] });
  await camera.getByText("This image has no matrix").waitFor();
});

test("a channel that is not there is told in words", async (t) => {
  const page = await open(t, undefined, only("/nowhere"));
  await page.locator("mom-camera").getByText("No picture:").waitFor();
});
