// Files of ESM for pages, workers and Node: the client, and what devices, who drives them, and agents need beside it; and one with their insides for the tests.
import { build } from "esbuild";

const options = { bundle: true, format: "esm", platform: "neutral", target: "es2022", sourcemap: true };
/** What the others share with the client is there once: classes of two copies would not be the same. */
const client = {
  name: "client",
  setup: ({ onResolve }) => {
    onResolve({ filter: /^\.\.\/index\.js$/ }, () => ({ path: "./mom-client.js", external: true }));
    onResolve({ filter: /^\.\.\/drive\/index\.js$/ }, () => ({ path: "./drive.js", external: true }));
  },
};
await build({ ...options, entryPoints: ["src/index.ts"], outfile: "dist/mom-client.js", minify: true });
await build({ ...options, entryPoints: ["src/device/index.ts"], outfile: "dist/device.js", minify: true, plugins: [client] });
await build({ ...options, entryPoints: ["src/drive/index.ts"], outfile: "dist/drive.js", minify: true, plugins: [client] });
await build({ ...options, entryPoints: ["src/agent/index.ts"], outfile: "dist/agent.js", minify: true, plugins: [client] });
await build({ ...options, entryPoints: ["test/internals.ts"], outfile: "dist/test/internals.js" });
