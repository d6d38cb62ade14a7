// The demonstration lab's broker, on a port of its own.
import { spawn } from "node:child_process";
import { existsSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { createInterface } from "node:readline";
import { fileURLToPath } from "node:url";
import { WebSocket } from "ws";

const project = fileURLToPath(new URL("../../..", import.meta.url));
export const program = process.env.MOM_BROKER ?? join(project, "target/debug/mom-broker");

/** Starts a broker whose configuration is the lab's, changed; `users` are added to the users file. */
export async function startLab({ config = "", users = "", args = [] } = {}) {
  if (!existsSync(program)) throw new Error(`${program} is missing: build it by \`cargo build -p mom-broker\`, or name one in MOM_BROKER`);
  const folder = mkdtempSync(join(tmpdir(), "mom-js-"));
  const lab = readFileSync(join(project, "config/lab.toml"), "utf8").replace(/^#:schema.*$/m, "");
  writeFileSync(join(folder, "lab.toml"), lab + config);
  writeFileSync(join(folder, "lab-users.toml"), readFileSync(join(project, "config/lab-users.toml"), "utf8").replace(/^#:schema.*$/m, "") + users);
  const child = spawn(program, ["--config", join(folder, "lab.toml"), "--listen", "127.0.0.1:0", ...args], {
    stdio: ["ignore", "pipe", process.env.MOM_LOG ? "inherit" : "ignore"],
    env: { ...process.env, XDG_STATE_HOME: folder, STATE_DIRECTORY: "" },
  });
  const ended = new Promise((resolve) => child.once("exit", resolve));
  const port = await new Promise((resolve, reject) => {
    ended.then((status) => reject(new Error(`the broker ended with ${status} before it listened`)));
    createInterface(child.stdout).on("line", (line) => {
      const found = /listening at .*?:\/\/127\.0\.0\.1:(\d+)/.exec(line);
      if (found) resolve(Number(found[1]));
    });
  });
  const stop = async () => {
    child.kill();
    await ended;
    rmSync(folder, { recursive: true, force: true });
  };
  const signal = (name) => child.kill(name);
  return { port, stop, signal, folder, [Symbol.asyncDispose]: stop };
}

/** What logs a user of the lab in, where every password is the user's name. */
export const as = (user, more = {}) => ({ user, password: user, webSocket: WebSocket, ...more });

/** The first event that fits. */
export async function until(events, fits) {
  for (;;) {
    const { done, value } = await events.next();
    if (done) throw new Error("the events ended");
    if (fits(value)) return value;
  }
}
