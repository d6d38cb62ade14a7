// A device that tells its parent when it hears of a stop: a process of its own, as a robot is. Arguments: the hub's host, the channel.
import { createRequire } from "node:module";
import { connect } from "../../clients/js/dist/mom-client.js";

const { WebSocket } = createRequire(new URL("../../clients/js/package.json", import.meta.url))("ws");
const [, , host, path] = process.argv;
const robot = await connect(`ws://${host}`, { user: "carol", password: "carol", nickname: "bench", webSocket: WebSocket });
const channel = await robot.channel(path, { device: true });
process.once("disconnect", () => process.exit());
process.send({ heard: "ready" });
for await (const event of channel.events()) {
  if (event.type !== "message" || (event.name !== "stop" && event.name !== "unstop")) continue;
  process.send({ heard: event.name, at: performance.timeOrigin + performance.now(), stop: event.stop });
  void channel.send("state", { stopped: event.name === "stop", stop: event.stop });
}
