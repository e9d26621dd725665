// Builds the pages of the lab into nmes/lab/pages/: one bundle, cut so that each page is loaded when it is opened.
import { build } from "esbuild";
import { copyFile, mkdir, readFile, readdir, rm, writeFile } from "node:fs/promises";
import { basename, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = fileURLToPath(new URL(".", import.meta.url));
const out = process.argv[2] ?? join(here, "../nmes/lab/pages");

await mkdir(out, { recursive: true });
for (const name of await readdir(out)) {
  await rm(join(out, name), { recursive: true });
}
const result = await build({
  absWorkingDir: here,
  entryPoints: { main: "src/main.ts", theme: "src/theme.ts", style: "src/styles/style.css" },
  outdir: out,
  bundle: true,
  splitting: true,
  format: "esm",
  target: ["es2022"],
  minify: true,
  metafile: true,
  legalComments: "linked",
  entryNames: "[name]-[hash]",
  chunkNames: "[name]-[hash]",
  alias: { "nmes-client": join(here, "../clients/typescript/src/index.ts") },
  logLevel: "warning",
});
let page = await readFile(join(here, "src/index.html"), "utf8");
let bytes = 0;
for (const [file, { entryPoint, bytes: size }] of Object.entries(result.metafile.outputs)) {
  bytes += size;
  if (entryPoint !== undefined) {
    page = page.replace(`%${basename(entryPoint)}%`, basename(file));
  }
}
await writeFile(join(out, "index.html"), page);
await copyFile(join(here, "src/icon.svg"), join(out, "icon.svg"));
console.log(`${out}: ${Math.round(bytes / 1000)} kB`);
