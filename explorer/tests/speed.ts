// Steps a second of every scheme, printed: `npm run speed`.
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { Kernels } from "../src/kernels";
import { checked, fieldsOf, type Tables } from "../src/tables";

const BUILT = join(process.cwd(), "../build/explorer");
const kernels = await Kernels.load(readFileSync(join(BUILT, "public/kernels.wasm")));
const tables = checked(JSON.parse(readFileSync(join(BUILT, "public/tables.json"), "utf-8")) as Tables);
const MEASURED = 400, WARM = 1500; // milliseconds; the machine code is improved while a loop runs
for (const [name, system] of Object.entries(tables.systems)) {
  const found: string[] = [], values = Object.fromEntries(system.sliders.map((slider) => [slider.name, slider.value]));
  for (const [label, scheme] of Object.entries(system.schemes)) {
    const fields = fieldsOf(tables, system, scheme, values, system.step);
    const run = kernels.run(scheme.loop, fields, system.x0.length, system.invariants.length);
    run.begin(system.x0);
    const steps = (milliseconds: number) => {
      const start = performance.now();
      for (let count = 1000; ; count += 1000) {
        run.advance(1000, system.step);
        const passed = performance.now() - start;
        if (passed > milliseconds) return count / passed;
      }
    };
    if (system === tables.systems.rigid_body) steps(WARM);
    found.push(`${label} ${Math.round(steps(MEASURED))}`);
    run.free();
  }
  console.log(`${name}: ${found.join(", ")} thousand steps a second`);
}
