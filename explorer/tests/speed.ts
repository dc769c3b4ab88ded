// Steps a second of every scheme, printed: `npm run speed`.
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { Kernels } from "../src/kernels";
import { checked, fieldsOf, type Tables } from "../src/tables";

const BUILT = join(process.cwd(), "../build/explorer");
const kernels = await Kernels.load(readFileSync(join(BUILT, "public/kernels.wasm")));
const tables = checked(JSON.parse(readFileSync(join(BUILT, "public/tables.json"), "utf-8")) as Tables);
for (const [name, system] of Object.entries(tables.systems)) {
  const found: string[] = [];
  for (const [label, scheme] of Object.entries(system.schemes)) {
    const values = Object.fromEntries(system.sliders.map((slider) => [slider.name, slider.value]));
    const run = kernels.run(scheme.loop, fieldsOf(tables, system, scheme, values, system.step), system.x0.length, system.invariants.length);
    run.begin(system.x0);
    let steps = 0;
    const start = performance.now();
    while (performance.now() - start < 300) steps += 1000, run.advance(1000, system.step);
    found.push(`${label} ${Math.round(steps / (performance.now() - start))}`);
    run.free();
  }
  console.log(`${name}: ${found.join(", ")} thousand steps a second`);
}
