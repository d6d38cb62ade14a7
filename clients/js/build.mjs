// One file of ESM for pages, workers and Node, and one with its insides for the tests.
import { build } from "esbuild";

const options = { bundle: true, format: "esm", platform: "neutral", target: "es2022", sourcemap: true };
await build({ ...options, entryPoints: ["src/index.ts"], outfile: "dist/mom-client.js", minify: true });
await build({ ...options, entryPoints: ["test/internals.ts"], outfile: "dist/test/internals.js" });
