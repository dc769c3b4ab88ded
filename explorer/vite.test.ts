import { defineConfig } from "vite";

// The unit tests as modules for Node.
export default defineConfig({
  build: {
    ssr: true,
    outDir: "../build/explorer/tests",
    emptyOutDir: true,
    rollupOptions: { input: ["tests/reader.test.ts", "tests/fused.test.ts", "tests/page.test.ts", "tests/speed.ts"], output: { entryFileNames: "[name].mjs" } },
  },
});
