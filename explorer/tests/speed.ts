// Steps a second of every scheme, printed: `npm run speed`.
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { Kernels } from "../src/kernels";
import { App } from "../src/app";
import { firstChoice } from "../src/state";
import { checked, type Tables } from "../src/tables";
import { startedRun } from "../src/track";

const BUILT = join(process.cwd(), "../build/explorer");
const kernels = await Kernels.load(readFileSync(join(BUILT, "public/kernels.wasm")));
const tables = checked(JSON.parse(readFileSync(join(BUILT, "public/tables.json"), "utf-8")) as Tables);
const MEASURED = 400, WARM = 1500; // milliseconds; the machine code is improved while a loop runs
for (const [name, system] of Object.entries(tables.systems)) {
  const found: string[] = [], piece = name === "planet" ? 10 : 1000;
  for (const label of Object.keys(system.schemes)) {
    const [plan] = new App(kernels, tables, { ...firstChoice(tables, name), schemes: [label, label] }).plans();
    const run = startedRun(kernels, plan);
    const steps = (milliseconds: number) => {
      const start = performance.now();
      for (let count = piece; ; count += piece) {
        run.advance(piece, system.step);
        const passed = performance.now() - start;
        if (passed > milliseconds) return count / passed;
      }
    };
    if (system === tables.systems.rigid_body) steps(WARM);
    found.push(`${label} ${Number(steps(MEASURED).toPrecision(2))}`);
    run.free();
  }
  console.log(`${name}: ${found.join(", ")} thousand steps a second`);
}
