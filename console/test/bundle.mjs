// Makes one module of src loadable by Node: TypeScript and runes, as the page gets them, and what it loads later in the same file.
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";
import { svelte } from "@sveltejs/vite-plugin-svelte";
import { build } from "vite";

const root = dirname(dirname(fileURLToPath(import.meta.url)));

/** Bundles files of `src` and imports what they export. */
export async function load(...files) {
  const folder = mkdtempSync(join(tmpdir(), "mom-console-"));
  const entry = join(folder, "entry.js");
  writeFileSync(entry, files.map((file) => `export * from ${JSON.stringify(join(root, "src", file))};\n`).join(""));
  try {
    await build({
      root,
      configFile: false,
      logLevel: "error",
      plugins: [svelte({ configFile: join(root, "svelte.config.js") })],
      resolve: { alias: { "mom-client/drive": join(root, "../clients/js/src/drive/index.ts"), "mom-client": join(root, "../clients/js/src/index.ts") } },
      build: { outDir: folder, emptyOutDir: false, minify: false, target: "es2022", lib: { entry, formats: ["es"], fileName: () => "bundle.mjs" }, rollupOptions: { output: { codeSplitting: false } } },
    });
    return await import(pathToFileURL(join(folder, "bundle.mjs")).href);
  } finally {
    rmSync(folder, { recursive: true, force: true });
  }
}
