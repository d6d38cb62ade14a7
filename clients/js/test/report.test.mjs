// What a program reports of its own errors to a hub, if it is told to (M56).
import assert from "node:assert/strict";
import { execFile } from "node:child_process";
import { createServer } from "node:http";
import { dirname, join } from "node:path";
import test from "node:test";
import { promisify } from "node:util";
import { WebSocket } from "ws";
import { program, startLab } from "./lab.mjs";

let instances = 0;
/** The client as another program has it, which has reported nothing yet. */
const fresh = () => import(`../dist/mom-client.js?${++instances}`);

/** What operators read. */
async function logs({ port }) {
  const env = { ...process.env, MOM_HUB: `bin://127.0.0.1:${port}`, MOM_USER: "carol", MOM_PASSWORD: "carol" };
  const { stdout } = await promisify(execFile)(join(dirname(program), "mom"), ["logs", "--json"], { env });
  return stdout.split("\n").filter(Boolean).map((line) => JSON.parse(line));
}

test("a client that cannot connect reports why if it is told to, and not the password", async (t) => {
  const lab = await startLab({ config: `\n[tls]\ncertificate = "hub.crt"\nkey = "hub.key"\nself-signed = true\nhosts = ["127.0.0.1"]\n` });
  t.after(() => lab.stop());
  const { connect } = await fresh();
  const secret = { user: "alice", password: "secret-of-alice", webSocket: WebSocket, connectWithin: 1 };
  // Nobody vouches for its certificate.
  const address = `wss://127.0.0.1:${lab.port}`;
  await assert.rejects(connect(address, secret), { kind: "connection" });
  // What the hub refuses it knows.
  await assert.rejects(connect(`ws://127.0.0.1:${lab.port}`, { ...secret, report: { program: "refused" } }), { code: "bad-login" });
  assert.deepEqual(await logs(lab), []);
  await assert.rejects(connect(address, { ...secret, report: { program: "survey", version: "1.2" } }), { kind: "connection" });
  let found = [];
  for (let tries = 0; !found.length && tries < 20; tries++) found = await logs(lab);
  assert.equal(found.length, 1);
  const [{ text, level, code, program, version, from }] = found;
  assert.match(text, /self-signed certificate/);
  assert.deepEqual([level, code, program, version, from], ["error", "disconnected", "survey", "1.2", "127.0.0.1"]);
  assert.ok(!JSON.stringify(found).includes("secret"));
});

test("a report is cut to what the hub takes, whatever is in it", async (t) => {
  const lab = await startLab();
  t.after(() => lab.stop());
  const { report } = await fresh();
  const address = `mom://127.0.0.1:${lab.port}`;
  for (const letter of ["x", "\u0000", "😀", '"', "\ud800"]) {
    assert.equal(await report(address, { text: letter.repeat(10_000), code: letter.repeat(100), program: "mine", level: "warn" }), true, JSON.stringify(letter));
  }
  const found = await logs(lab);
  assert.deepEqual(found.map(({ program, level }) => [program, level]), Array(5).fill(["mine", "warn"]));
  assert.match(found[0].text, /^x{3000,}$/);
});

test("reports are few, the same is said once, and nothing of them fails", async (t) => {
  const heard = [];
  let status = 204;
  const server = createServer((asked, answer) => {
    heard.push([asked.method, asked.url]);
    asked.resume().on("end", () => answer.writeHead(status, { "retry-after": "60", location: "/elsewhere" }).end());
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  t.after(() => server.close());
  const address = `http://127.0.0.1:${server.address().port}`;
  let { report } = await fresh();
  const said = [];
  for (const text of ["1", "1", "2", "3", "4", "5", "6"]) said.push(await report(address, { text }));
  assert.deepEqual(said, [true, false, true, true, true, true, false]);
  assert.deepEqual(heard, Array(5).fill(["POST", "/log"]));
  // A hub that takes none, one that has had enough, and one that sends it elsewhere.
  for (const [answer, next] of [[404, true], [429, false], [307, true]]) {
    ({ report } = await fresh());
    status = answer;
    assert.equal(await report(address, { text: "1" }), false);
    status = 204;
    assert.equal(await report(address, { text: "2" }), next, `${answer}`);
  }
  ({ report } = await fresh());
  for (const wrong of ["", "no address", "bin://127.0.0.1", "http://127.0.0.1:9"]) assert.equal(await report(wrong, { text: wrong || "none" }), false, wrong);
  for (const wrong of [undefined, null, {}, { text: " " }, { text: 7 }]) assert.equal(await report(address, wrong), false);
});
