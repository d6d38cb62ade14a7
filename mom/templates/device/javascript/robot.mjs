// A robot on two wheels: what it can do, how it stands still, where it is. The kit does the rest.
import { readFileSync } from "node:fs";
import { connect, Key } from "mom-client";
import { device, DeviceError, number, runs, sleep, verb } from "mom-client/device";
import { motors as find } from "./driver.mjs";

const motors = find();
const robot = device("newbot", {
  does: "A robot on two wheels",
  verbs: {
    drive: verb.relative("Drives straight on", { way: number({ unit: "mm", min: -2000, max: 2000 }) }, ({ way }, signal) => motors.drive(way, signal)),
    turn: verb.relative("Turns on the spot", { angle: number({ unit: "degrees", min: -360, max: 360 }) }, ({ angle }, signal) => motors.turn(angle, signal)),
    jog: verb.velocity(
      "Drives on for 300 ms",
      { speed: number({ unit: "mm/s", min: -300, max: 300 }), rate: number({ unit: "degrees/s", min: -90, max: 90 }) },
      async ({ speed, rate }, signal) => {
        motors.setSpeed(speed, rate);
        await sleep(300, signal);
      },
    ),
  },
  halt: () => motors.brake(),
  keepAlive: () => motors.keepAlive(),
  position: () => motors.pose(),
  report: () => ({ battery: motors.battery() }),
  estop: () => motors.estop(),
  plan() {
    if (motors.battery() < 5) throw new DeviceError("battery", "the battery is empty: charge it");
  },
  state: { x: number({ unit: "mm" }), y: number({ unit: "mm" }), heading: number({ unit: "degrees" }), battery: number({ unit: "%" }) },
  stopsWithin: 500,
});

const key = await Key.fromPem(readFileSync("newbot.key", "utf8"));
// Started again, it takes the place of its earlier start: nothing else may be called so.
const client = await connect(process.env.MOM_HUB ?? "mom://127.0.0.1:7666", { user: "newbot", key, heartbeat: 500, installation: "newbot" });
runs(await client.obey("/newbot/robot", robot));
console.log("newbot is ready");
