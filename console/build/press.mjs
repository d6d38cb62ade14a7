// From the press on STOP to the robot's receipt of it, in a browser: npm run press -- [--presses 50] [--links healthy,frozen,uplink].
//
// By mouse, by a finger that slides off the button, and by key; over a link that is well, over one that is frozen, and over an uplink of 80 kB/s that is full. The robot is a program of its own.
import { fork } from "node:child_process";
import { createRequire } from "node:module";
import { parseArgs } from "node:util";
import { connect } from "../../clients/js/dist/mom-client.js";
import { start } from "../test/lab.mjs";
import { withRobots } from "../test/robot.mjs";

const { values } = parseArgs({ options: { presses: { type: "string", default: "50" }, links: { type: "string", default: "healthy,frozen,uplink" } } });
const presses = Number(values.presses);
const UPLINK = 80_000;
const SLIDE = 60;
const PATH = "/bench/robot";
/** A press that is not heard for so long is given up, ms. */
const GIVEN_UP = 30_000;
const { WebSocket } = createRequire(new URL("../../clients/js/package.json", import.meta.url))("ws");
const wait = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

const lab = await start({ config: withRobots("/bench"), relay: true });
const robot = fork(new URL("robot.mjs", import.meta.url), [lab.host, PATH]);
process.once("exit", () => robot.kill());
const heard = [];
let told = () => undefined;
robot.on("message", (word) => {
  heard.push(word);
  told();
});

/** Waits for a word of the robot's; null if it does not come. */
async function hears(wanted, from = 0) {
  const end = performance.now() + GIVEN_UP;
  for (;;) {
    const found = heard.slice(from).find((word) => word.heard === wanted);
    if (found || performance.now() > end) return found ?? null;
    await Promise.race([new Promise((resolve) => (told = resolve)), wait(200)]);
  }
}
await hears("ready");
/** Who lets go, over a connection of its own: what is measured is the stop. */
const helper = await connect(`ws://${lab.host}`, { user: "bob", password: "bob", webSocket: WebSocket });

const page = await lab.page("alice", { path: "/#/contexts", hasTouch: true });
const session = await page.context().newCDPSession(page);
await page.evaluate(() => {
  for (const name of ["pointerdown", "keydown"]) addEventListener(name, (event) => (window.pressed = performance.timeOrigin + event.timeStamp), true);
});
const status = page.locator("mom-status");
const middle = async () => {
  const { x, y, width, height } = await page.locator("mom-stop button.stop").boundingBox();
  return { x: x + width / 2, y: y + height / 2 };
};

const ways = {
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

function percentile(sorted, part) {
  return sorted[Math.min(sorted.length - 1, Math.ceil(part * sorted.length) - 1)];
}

for (const link of values.links.split(",")) {
  const { begin, press, after, end } = links[link];
  await begin();
  for (const [way, down] of Object.entries(ways)) {
    const times = [];
    let lost = 0;
    for (let turn = 0; turn < presses; turn += 1) {
      await press();
      const from = heard.length;
      await page.evaluate(() => delete window.pressed);
      const up = await down();
      const stop = await hears("stop", from);
      await up();
      if (stop) times.push(stop.at - (await page.evaluate(() => window.pressed)));
      else lost += 1;
      await after();
      const { number } = await helper.stops(PATH);
      await helper.unstop(PATH, number);
      await hears("unstop", from);
      // A person does not press ten times a second.
      await wait(200);
    }
    const sorted = times.toSorted((one, other) => one - other);
    const said = sorted.length ? `p50 ${percentile(sorted, 0.5).toFixed(1)} ms, p99 ${percentile(sorted, 0.99).toFixed(1)} ms, most ${sorted.at(-1).toFixed(1)} ms` : "none";
    console.log(`${`${link}, ${way}`.padEnd(32)} ${said} (${sorted.length} of ${presses}${lost ? `, ${lost} not heard within ${GIVEN_UP / 1000} s` : ""})`);
  }
  await end();
}
await helper.close();
robot.kill();
await lab.end();
