// A peer of a dialogue (tests/src/dialogue/program.rs): it sends the parcels that stand in its input, in the JSON form, and writes those
// that come, through this client's bare connection.
import { createInterface } from "node:readline";
import { WebSocket } from "ws";
import { Double, Time, connectRaw } from "../dist/mom-client.js";
import { jsonForm } from "./jsonform.mjs";

const { read, write } = jsonForm({ Double, Time });

try {
  const connection = await connectRaw(process.argv[2], {
    webSocket: WebSocket,
    exact: true,
    stamps: false,
    onParcel: (parcel) => process.stdout.write(`${write(parcel)}\n`),
    // All that was written before leaves first.
    onEnd: () => process.stdout.write("", () => process.exit(0)),
  });
  process.stdout.write("\n");
  const lines = createInterface({ input: process.stdin, crlfDelay: Infinity });
  lines.on("line", (line) => line && connection.sendParcel(read(line)));
  lines.on("close", () => connection.close());
} catch (error) {
  process.stderr.write(`${error.message}\n`);
  process.exit(1);
}
