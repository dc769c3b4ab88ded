// The same run as a script for Python, and as a table of numbers.
import { firstBlock } from "./camera";
import type { Kernels, Points } from "./kernels";
import { type Plan, startedRun, valuesOf } from "./track";

const MAX_ROWS = 20000;

export const python = (x: number) => (Number.isInteger(x) && Math.abs(x) < 1e16 ? `${x}.0` : String(x).replace("e+", "e"));

export interface Script {
  system: string; // Python code
  schemes: string[];
  attitude: boolean;
  x0: string; // Python code
  step: number;
  steps: number;
}

export function pythonScript({ system, schemes, attitude, x0, step, steps }: Script): string {
  const h = python(step);
  return `import coadjoint as co

system = ${system}
x0 = ${x0}
for method in (
${schemes.map((scheme) => `    ${scheme},`).join("\n")}
):
    sol = co.integrate(system, x0, t_span=(0.0, ${steps} * ${h}), step=${h}, method=method${attitude ? ', attitude="coadjoint"' : ""})
    print(method, sol.x[-1].tolist(), sol.drift())
`;
}

const ROTATION = [1, 2, 3].flatMap((i) => [1, 2, 3].map((j) => `R${i}${j}`));

// Both runs again from the start, with at most some thousands of their states, or mean eastward speeds of a flow on a
// sphere, and rotations where they have attitudes.
export function csv(kernels: Kernels, plans: Plan[], coordinates: string[], attitude: boolean, steps: number): string {
  const every = Math.max(1, Math.ceil((steps * plans.length) / MAX_ROWS));
  const quoted = (text: string) => (/[",]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  const header = ["scheme", "step", "t", ...coordinates, ...plans[0].invariants, ...(attitude ? ROTATION : [])];
  const rows = [header.map(quoted).join(",")];
  for (const plan of plans) {
    const size = plan.x0.length, run = startedRun(kernels, plan);
    const add = (step: number, points: Points, k: number) => {
      const rotation = attitude ? firstBlock(points.group(k))! : [];
      const x = points.x.subarray(k * size, (k + 1) * size);
      const numbers = [...(plan.planet?.zonal(x) ?? x), ...valuesOf(plan, points, k), ...rotation];
      rows.push([quoted(plan.title), step, step * plan.step, ...numbers].join(","));
    };
    for (let done = 0; done < steps && !run.failure; ) {
      const first = done, piece = Math.min(every, steps - done), points = run.advance(piece, plan.step);
      done += piece;
      if (first === 0) add(0, points, 0);
      if (!run.failure) add(done, points, points.count - 1);
    }
    run.free();
  }
  return rows.join("\n") + "\n";
}

export function download(name: string, text: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
  link.download = name;
  link.click();
  URL.revokeObjectURL(link.href);
}
