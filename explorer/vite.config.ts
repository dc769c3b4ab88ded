import { defineConfig } from "vite";

// Beside the pages of the site, in a folder of its own; the kernels and the tables are copied from where `make explorer`
// builds them.
export default defineConfig({
  base: "./",
  publicDir: "../build/explorer/public",
  build: { outDir: "../build/explorer/site", emptyOutDir: true, target: "es2022", modulePreload: false },
});
