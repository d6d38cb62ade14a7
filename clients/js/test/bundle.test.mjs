import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { existsSync, readFileSync } from "node:fs";
import test from "node:test";
import { gzipSync } from "node:zlib";

const here = (path) => new URL(path, import.meta.url);

test("the bundle has 27 KiB gzipped at most", () => {
  const bytes = gzipSync(readFileSync(here("../dist/mom-client.js")), { level: 9 }).length;
  assert.ok(bytes <= 27 * 1024, `${bytes} bytes: find out what it is by \`npx esbuild src/index.ts --bundle --minify --format=esm --analyze\``);
});

for (const [who, name, most, others = []] of [["devices need", "device", 15], ["those need who drive one", "drive", 7], ["agents need", "agent", 4, ["./drive.js"]]]) {
  test(`what ${who} beside it has ${most} KiB gzipped at most, and imports ${["the client", ...others].join(" and ")} only`, () => {
    const text = readFileSync(here(`../dist/${name}.js`), "utf8");
    const bytes = gzipSync(text, { level: 9 }).length;
    assert.ok(bytes <= most * 1024, `${bytes} bytes`);
    const imported = new Set([...text.matchAll(/\bfrom *"([^"]*)"/g)].map(([, from]) => from));
    assert.deepEqual([...imported].filter((from) => from !== "./mom-client.js"), others);
    assert.ok(existsSync(here(`../dist/types/${name}/index.d.ts`)));
  });
}

test("the bundle imports nothing, and its types are there", () => {
  const text = readFileSync(here("../dist/mom-client.js"), "utf8");
  assert.doesNotMatch(text, /\bimport\b[^.]*from|\brequire\(/);
  assert.ok(existsSync(here("../dist/types/index.d.ts")));
});

test("a program in TypeScript can rely on the types", () => {
  execFileSync("npx", ["tsc", "--project", "test"], { cwd: here("..").pathname, stdio: ["ignore", "inherit", "ignore"] });
});

test("the lock file names no registry", () => {
  assert.doesNotMatch(readFileSync(here("../package-lock.json"), "utf8"), /"resolved"|https?:\/\/(?!opencollective|github|www\.patreon|tidelift|paulmillr)[^"]*\.tgz/);
});

test("what is packed is what is needed", () => {
  const [{ files }] = JSON.parse(execFileSync("npm", ["pack", "--dry-run", "--json", "--ignore-scripts"], { cwd: here("..").pathname, stdio: ["ignore", "pipe", "ignore"] }));
  const names = files.map((file) => file.path).filter((path) => !path.startsWith("dist/types/"));
  assert.deepEqual(names.sort(), ["README.md", "dist/agent.js", "dist/agent.js.map", "dist/device.js", "dist/device.js.map", "dist/drive.js", "dist/drive.js.map", "dist/mom-client.js", "dist/mom-client.js.map", "package.json"]);
});
