import { createHash } from "node:crypto";
import { fileURLToPath } from "node:url";
import { svelte } from "@sveltejs/vite-plugin-svelte";
import { defineConfig, type Plugin } from "vite";

/** Writes `build.json` with a name of this build, which the page compares with that of the hub after an upgrade. */
function stamp(): Plugin {
  return {
    name: "stamp",
    generateBundle(_options, bundle) {
      const hash = createHash("sha256");
      for (const name of Object.keys(bundle).sort()) hash.update(name);
      this.emitFile({ type: "asset", fileName: "build.json", source: JSON.stringify({ build: hash.digest("hex").slice(0, 16) }) });
    },
  };
}

/** A hub to try the page with while it is changed: `MOM_HUB=http://127.0.0.1:7666 npm run dev`. */
const hub = process.env["MOM_HUB"] ?? "http://127.0.0.1:7666";
const proxy = Object.fromEntries(["/mom", "/tunnel", "/api", "/log"].map((path) => [path, { target: hub, ws: path === "/mom", headers: { origin: hub } }]));

const client = (entry: string): string => fileURLToPath(new URL(`../clients/js/src/${entry}`, import.meta.url));

export default defineConfig({
  // Pages of others load these files from wherever the hub is.
  base: "./",
  server: { proxy },
  preview: { proxy },
  plugins: [svelte(), stamp()],
  resolve: { alias: { "mom-client/drive": client("drive/index.ts"), "mom-client": client("index.ts") } },
  worker: { format: "es", rollupOptions: { output: { entryFileNames: "assets/hub-worker-[hash].js" } } },
  build: {
    target: "es2022",
    // What is made of light-dark() for older browsers works in our own page only, not in pages of others.
    cssTarget: ["chrome123", "firefox120", "safari17.5"],
    outDir: "dist",
    // No `data:` URLs, which the policy does not let in.
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    sourcemap: false,
    rollupOptions: {
      // Pages of others use what panels.js exports.
      preserveEntrySignatures: "exports-only",
      input: { index: "index.html", panels: "src/panels.ts" },
      output: {
        // Pages of others name this one.
        entryFileNames: (chunk) => (chunk.name === "panels" ? "panels.js" : "assets/[name]-[hash].js"),
      },
    },
  },
});
