// From the press on STOP to the robot's receipt of it, in a browser: npm run press -- [--presses 50] [--links healthy,frozen,uplink,herd] [--robots 1000] [--herds 1].
//
// By mouse, by a finger that slides off the button, and by key; over a link that is well, over one that is frozen, and over an uplink of 80 kB/s that is full. The robot is a program of its own.
// A herd is many robots at one hub: until the last of them has heard it, and until the page has reported that all stand. They are in as many programs as `--herds` says.
import { fork } from "node:child_process";
import { generateKeyPairSync } from "node:crypto";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { parseArgs } from "node:util";
import { connect } from "../../clients/js/dist/mom-client.js";
import { start } from "../test/lab.mjs";
import { withRobots } from "../test/robot.mjs";

const { values } = parseArgs({
  options: { presses: { type: "string", default: "50" }, links: { type: "string", default: "healthy,frozen,uplink,herd" }, robots: { type: "string", default: "1000" }, herds: { type: "string", default: "1" } },
});
const presses = Number(values.presses);
const UPLINK = 80_000;
const SLIDE = 60;
const PATH = "/bench/robot";
/** A press that is not heard for so long is given up, ms. */
const GIVEN_UP = 30_000;
/** Many robots have come after so long, ms. */
const COMING = 300_000;
const { WebSocket } = createRequire(new URL("../../clients/js/package.json", import.meta.url))("ws");
const wait = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

function percentile(sorted, part) {
  return sorted[Math.min(sorted.length - 1, Math.ceil(part * sorted.length) - 1)];
}

function say(what, times, lost = 0) {
  const sorted = times.toSorted((one, other) => one - other);
  const said = sorted.length ? `p50 ${percentile(sorted, 0.5).toFixed(1)} ms, p99 ${percentile(sorted, 0.99).toFixed(1)} ms, most ${sorted.at(-1).toFixed(1)} ms` : "none";
  console.log(`${what.padEnd(48)} ${said} (${sorted.length} of ${sorted.length + lost}${lost ? `, ${lost} not heard within ${GIVEN_UP / 1000} s` : ""})`);
}

/** What a program of robots says. */
function listensTo(program) {
  const kill = () => program.kill();
  process.once("exit", kill);
  const heard = [];
  let told = () => undefined;
  program.on("message", (word) => {
    heard.push(word);
    told();
  });
  return {
    get heard() {
      return heard.length;
    },
    /** Waits for a word; null if it does not come. */
    async hears(wanted, from = 0, within = GIVEN_UP) {
      const end = performance.now() + within;
      for (;;) {
        const found = heard.slice(from).find((word) => word.heard === wanted);
        if (found || performance.now() > end) return found ?? null;
        await Promise.race([new Promise((resolve) => (told = resolve)), wait(200)]);
      }
    },
    end: kill,
  };
}

/** Who lets go, over a connection of its own: what is measured is the stop. */
const helperAt = (lab) => connect(`ws://${lab.host}`, { user: "bob", password: "bob", webSocket: WebSocket });

/** A page that notes when it is pressed. */
async function pageAt(lab) {
  const page = await lab.page("alice", { path: "/#/contexts", hasTouch: true });
  await page.evaluate(() => {
    for (const name of ["pointerdown", "keydown"]) addEventListener(name, (event) => (window.pressed = performance.timeOrigin + event.timeStamp), true);
  });
  return page;
}

/** How STOP is pressed; each gives what ends the press. */
async function waysOf(page) {
  const session = await page.context().newCDPSession(page);
  const middle = async () => {
    const { x, y, width, height } = await page.locator("mom-stop button.stop").boundingBox();
    return { x: x + width / 2, y: y + height / 2 };
  };
  return {
    async mouse() {
      const { x, y } = await middle();
      await page.mouse.move(x, y);
      await page.mouse.down();
      return async () => {
        await page.mouse.move(x, y + SLIDE);
        await page.mouse.up();
      };
    },
    async "touch with a slide"() {
      const { x, y } = await middle();
      const touch = (type, touchPoints) => session.send("Input.dispatchTouchEvent", { type, touchPoints });
      await touch("touchStart", [{ x, y }]);
      await touch("touchMove", [{ x, y: y + SLIDE / 2 }]);
      await touch("touchMove", [{ x, y: y + SLIDE }]);
      return () => touch("touchEnd", []);
    },
    async key() {
      await page.keyboard.down("Escape");
      return () => page.keyboard.up("Escape");
    },
  };
}

/** One robot, over links that are well and that are not. */
async function pressOne(wanted) {
  const lab = await start({ config: withRobots("/bench"), relay: true });
  const robot = listensTo(fork(new URL("robot.mjs", import.meta.url), [lab.host, PATH]));
  await robot.hears("ready");
  const helper = await helperAt(lab);
  const page = await pageAt(lab);
  const status = page.locator("mom-status");
  const ways = await waysOf(page);

  const links = {
    healthy: { begin: async () => undefined, end: async () => undefined, press: async () => undefined, after: async () => undefined },
    frozen: {
      begin: async () => undefined,
      end: async () => undefined,
      press: async () => lab.relay.freeze(),
      async after() {
        lab.relay.thaw();
        await status.getByText("connected").waitFor();
      },
    },
    uplink: {
      async begin() {
        lab.relay.uplink = UPLINK;
        // The page itself has more to say than goes through.
        await page.evaluate(async () => {
          const { hubOf } = await import("/panels.js");
          const content = "x".repeat(40_000);
          let waiting = 0;
          window.busy = setInterval(() => {
            for (; waiting < 40; waiting += 1) void hubOf().call("send", "/chat", "chat", content, { echo: false }).catch(() => undefined).then(() => (waiting -= 1));
          }, 50);
        });
        await wait(3000);
      },
      press: async () => undefined,
      after: async () => undefined,
      async end() {
        await page.evaluate(() => clearInterval(window.busy));
        lab.relay.uplink = Infinity;
        await wait(2000);
      },
    },
  };

  for (const link of wanted) {
    const { begin, press, after, end } = links[link];
    await begin();
    for (const [way, down] of Object.entries(ways)) {
      const times = [];
      let lost = 0;
      for (let turn = 0; turn < presses; turn += 1) {
        await press();
        const from = robot.heard;
        await page.evaluate(() => delete window.pressed);
        const up = await down();
        const stop = await robot.hears("stop", from);
        await up();
        if (stop) times.push(stop.at - (await page.evaluate(() => window.pressed)));
        else lost += 1;
        await after();
        const { number } = await helper.stops(PATH);
        await helper.unstop(PATH, number);
        await robot.hears("unstop", from);
        // A person does not press ten times a second.
        await wait(200);
      }
      say(`${link}, ${way}`, times, lost);
    }
    await end();
  }
  await helper.close();
  robot.end();
  await lab.end();
}

/** The lab with so many robots more, which the user "herd" may be, and its key. */
function herdOf(robots) {
  const { privateKey, publicKey } = generateKeyPairSync("ed25519");
  const raw = publicKey.export({ type: "spki", format: "der" }).subarray(-32).toString("base64");
  const users = readFileSync(new URL("../../config/lab-users.toml", import.meta.url), "utf8").replace(/^#:schema.*$/m, "");
  const herd = `\n[[users]]\nname = "herd"\nkeys = ["ed25519 ${raw}"]\nlevel = 0\ngroups = ["device"]\n`;
  const first = "[[managers.lab.rules]]";
  const rule = `${first}\nname = "the herd"\nusers = ["herd"]\nwhere = ["/herd/**"]\nallow = ["join", "lookup", "send", "device"]\n\n`;
  const context = (path, kind, more = "") => `[[contexts]]\npath = "${path}"\nkind = "${kind}"\n${more}`;
  const contexts = Array.from({ length: robots }, (_, at) => {
    const path = `/herd/${at + 1}`;
    return context(path, "session") + context(`${path}/token`, "token", 'manager = "robot-token"\n') + context(`${path}/robot`, "channel", `guard = { token = "${path}/token", names = ["command"] }\n`);
  });
  return {
    config: (lab) => lab.replace(first, rule + first) + context("/herd", "session") + contexts.join(""),
    files: { "lab-users.toml": users + herd },
    key: privateKey.export({ type: "pkcs8", format: "der" }).toString("base64"),
  };
}

/** Notes when the page's report says that all stand. */
function noteReport(robots) {
  const root = document.querySelector("mom-console").shadowRoot.querySelector("mom-stop").shadowRoot;
  delete window.reported;
  const look = () => {
    if (window.reported === undefined && root.querySelector(".report")?.textContent.includes(`${robots} of ${robots} stand`)) window.reported = performance.timeOrigin + performance.now();
  };
  window.reporting?.disconnect();
  window.reporting = new MutationObserver(look);
  window.reporting.observe(root, { subtree: true, childList: true, characterData: true });
}

/** Many robots: until the last has heard it, by the page and by a program in its place; the time in the order parts what is the page's from what is the hub's and the robots'. */
async function pressHerd() {
  const [robots, herds] = [Number(values.robots), Number(values.herds)];
  const { config, files, key } = herdOf(robots);
  const lab = await start({ config, files });
  const each = Math.ceil(robots / herds);
  const parts = Array.from({ length: herds }, (_, at) => [at * each + 1, Math.min(robots, (at + 1) * each)]);
  const programs = parts.map(([first, last]) => listensTo(fork(new URL("herd.mjs", import.meta.url), [lab.host, "/herd", first, last], { env: { ...process.env, HERD_KEY: key } })));
  const all = async (wanted, from, within) => {
    const words = await Promise.all(programs.map((program, at) => program.hears(wanted, from?.[at], within)));
    return words.includes(null) ? null : words;
  };
  if (!(await all("ready", undefined, COMING))) throw new Error("the robots did not come");
  const helper = await helperAt(lab);
  const page = await pageAt(lab);
  const ways = { ...(await waysOf(page)), "no page": null };
  for (const [way, down] of Object.entries(ways)) {
    const figures = { "first told": [], "last told": [], "the order said": [], "last told after that": [], "all reported": [], "robots' programs busy": [] };
    let lost = 0;
    for (let turn = 0; turn < presses; turn += 1) {
      const from = programs.map(({ heard }) => heard);
      await page.evaluate(() => delete window.pressed);
      await page.evaluate(noteReport, robots);
      const begun = performance.timeOrigin + performance.now();
      const answer = down ? null : helper.stop("/", { reason: "no page" });
      const up = await down?.();
      const words = await all("stop", from);
      await up?.();
      const pressed = down ? await page.evaluate(() => window.pressed) : begun;
      if (words) {
        const [first, last] = [Math.min(...words.map(({ first }) => first)), Math.max(...words.map(({ last }) => last))];
        const ordered = Date.parse(/"timestamp":"([^"]+)"/.exec(words[0].said)?.[1] ?? /"\$time":"([^"]+)"/.exec(words[0].said)?.[1]);
        figures["first told"].push(first - pressed);
        figures["last told"].push(last - pressed);
        if (!Number.isNaN(ordered)) {
          figures["the order said"].push(ordered - pressed);
          figures["last told after that"].push(last - ordered);
        }
        figures["robots' programs busy"].push(Math.max(...words.map(({ busy }) => busy)));
      } else lost += 1;
      if (down && words) {
        await page.waitForFunction(() => window.reported !== undefined, null, { timeout: GIVEN_UP });
        figures["all reported"].push((await page.evaluate(() => window.reported)) - pressed);
      }
      if (answer) {
        await answer;
        figures["all reported"].push(performance.timeOrigin + performance.now() - begun);
      }
      const numbers = Object.entries(Object.assign({}, ...(words ?? []).map(({ numbers }) => numbers)));
      for (let at = 0; at < numbers.length; at += 400) await helper.unstop("/herd", Object.fromEntries(numbers.slice(at, at + 400)));
      await all("unstop", from);
      await wait(500);
    }
    for (const [figure, times] of Object.entries(figures)) if (times.length) say(`${robots} robots, ${way}: ${figure}`, times, figure === "last told" ? lost : 0);
  }
  await helper.close();
  for (const program of programs) program.end();
  await lab.end();
}

const wanted = values.links.split(",");
const alone = wanted.filter((link) => link !== "herd");
if (alone.length) await pressOne(alone);
if (wanted.includes("herd")) await pressHerd();
