// Each file of the build beside itself, compressed: the hub sends it as it is.
import { readFileSync, readdirSync, statSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { gzipSync } from "node:zlib";

const FIRST = 130 * 1024;

function files(folder) {
  return readdirSync(folder).flatMap((name) => {
    const path = join(folder, name);
    return statSync(path).isDirectory() ? files(path) : [path];
  });
}

let first = 0;
const html = readFileSync("dist/index.html", "utf8");
for (const path of files("dist").filter((path) => !path.endsWith(".gz"))) {
  const packed = gzipSync(readFileSync(path), { level: 9 });
  writeFileSync(`${path}.gz`, packed);
  // What the page names, and the worker that it starts at once.
  const name = path.slice("dist/".length);
  if (name === "index.html" || html.includes(name) || name.startsWith("assets/hub-worker")) first += packed.length;
}
console.log(`first load: ${(first / 1024).toFixed(1)} KiB compressed`);
if (first > FIRST) {
  console.error(`the first load may have ${FIRST / 1024} KiB: load what is not seen at once by import()`);
  process.exit(1);
}
