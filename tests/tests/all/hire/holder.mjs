// An agent that holds the token as its task says: what every agent of the kit does alike, in JavaScript.
import { Refused, serve } from "../../../../clients/js/dist/agent.js";
import { DriveError } from "../../../../clients/js/dist/drive.js";
import { connect } from "../../../../clients/js/dist/mom-client.js";

const holder = {
  verb: "hold",
  token: "/robot/token",
  read(content) {
    if (typeof content.what !== "string") throw new Refused("bad-content", "say `what`");
    return content.what;
  },
  words: (what) => `hold ${what}`,
  meet(task) {
    if (task.what === "nothing") throw new Refused("try-later", "there is nothing to hold");
    return "/robot/token";
  },
  async work(task) {
    if (task.what === "badly") throw new DriveError("my hands are full");
    if (task.what === "crashes") throw new TypeError("it crashes, as it is to");
    if (task.what === "unsayable") {
      const nested = [];
      nested.push(nested);
      return { text: "I held it", how: nested, often: 2n ** 80n };
    }
    if (task.what === "cancels itself") throw new DOMException("it ends itself", "AbortError");
    if (task.what === "once") return { text: "I held it once", times: 1 };
    if (task.what === "the arm") {
      const arm = await task.drive("/robot/arm");
      const end = await arm.carryOut("home; wait 60000");
      if (!end.finished) throw new DriveError(end.text);
    }
    if (task.what !== "deaf") await new Promise((_, reject) => task.signal.addEventListener("abort", () => reject(task.signal.reason)));
    else await new Promise(() => undefined);
  },
};

const client = await connect(process.env.MOM_HUB, { user: "servo", password: "servo" });
const ends = new AbortController();
process.on("SIGTERM", () => ends.abort());
console.log("ready");
await serve(client, "/servo", holder, { signal: ends.signal });
await client.close();
