// The same run as a script for Python, and as a table of numbers.
import type { Kernels } from "./kernels";
import type { Plan } from "./track";

const MAX_ROWS = 20000;

export const python = (x: number) => (Number.isInteger(x) && Math.abs(x) < 1e16 ? `${x}.0` : String(x).replace("e+", "e"));

export interface Script {
  system: string; // Python code
  schemes: string[];
  attitude: boolean;
  x0: number[];
  step: number;
  steps: number;
}

export function pythonScript({ system, schemes, attitude, x0, step, steps }: Script): string {
  const h = python(step);
  return `import coadjoint as co

system = ${system}
x0 = [${x0.map(python).join(", ")}]
for method in (
${schemes.map((scheme) => `    ${scheme},`).join("\n")}
):
    sol = co.integrate(system, x0, t_span=(0.0, ${steps} * ${h}), step=${h}, method=method${attitude ? ', attitude="coadjoint"' : ""})
    print(method, sol.x[-1].tolist(), sol.drift())
`;
}

// Both runs again from the start, with at most some thousands of their states.
export function csv(kernels: Kernels, plans: Plan[], coordinates: string[], steps: number): string {
  const every = Math.max(1, Math.ceil((steps * plans.length) / MAX_ROWS));
  const quoted = (text: string) => (/[",]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  const rows = [["scheme", "step", "t", ...coordinates, ...plans[0].invariants].map(quoted).join(",")];
  for (const plan of plans) {
    const size = plan.x0.length, count = plan.invariants.length;
    const run = kernels.run(plan.loop, plan.fields, size, count);
    run.begin(plan.x0);
    const add = (step: number, x: Float64Array, values: Float64Array) =>
      rows.push([quoted(plan.title), step, step * plan.step, ...x, ...values].join(","));
    const row = (numbers: Float64Array, width: number, k: number) => numbers.subarray(k * width, (k + 1) * width);
    for (let done = 0; done < steps && !run.failure; ) {
      const first = done, piece = Math.min(every, steps - done), points = run.advance(piece, plan.step);
      done += piece;
      if (first === 0) add(0, row(points.x, size, 0), row(points.values, count, 0));
      if (!run.failure) add(done, row(points.x, size, points.count - 1), row(points.values, count, points.count - 1));
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
