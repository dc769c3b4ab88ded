// The kernels in WebAssembly against runs of the library, bit for bit.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { Kernels } from "../src/kernels";
import { checked, evaluate, fieldsOf, type Tables, type Values } from "../src/tables";

const BUILT = join(process.cwd(), "../build/explorer");

interface Expected {
  system: string;
  scheme: string;
  values: Values;
  step: number;
  x0: number[];
  steps: number;
  save_every: number;
  x: number[][];
  invariants: number[][];
}

const kernels = await Kernels.load(readFileSync(join(BUILT, "public/kernels.wasm")));
const tables = checked(JSON.parse(readFileSync(join(BUILT, "public/tables.json"), "utf-8")) as Tables);
const runs = JSON.parse(readFileSync(join(BUILT, "runs.json"), "utf-8")) as Expected[];

// The states and invariants at the saved steps, computed in pieces of this many steps.
function computed(run: Expected, piece: number): { x: number[][]; invariants: number[][]; failure: string } {
  const system = tables.systems[run.system];
  const scheme = system.schemes[run.scheme];
  const fields = fieldsOf(tables, system, scheme, run.values, run.step);
  const size = run.x0.length, count = system.invariants.length;
  const one = kernels.run(scheme.loop, fields, size, count);
  one.begin(run.x0);
  const x: number[][] = [], invariants: number[][] = [];
  for (let done = 0; done < run.steps; done += piece) {
    const points = one.advance(Math.min(piece, run.steps - done), run.step);
    for (let k = 0; k < points.count; ++k) {
      x.push(Array.from(points.x.subarray(k * size, (k + 1) * size)));
      invariants.push(Array.from(points.values.subarray(k * count, (k + 1) * count)));
    }
  }
  one.free();
  const saved = (rows: number[][]) => rows.filter((_, k) => k % run.save_every === 0);
  return { x: saved(x), invariants: saved(invariants), failure: one.failure };
}

for (const run of runs)
  test(`${run.system}, ${run.scheme}, step ${run.step}`, () => {
    for (const piece of [run.steps, 7]) {
      const found = computed(run, piece);
      assert.equal(found.failure, "");
      assert.deepEqual(found.x, run.x);
      assert.deepEqual(found.invariants, run.invariants);
    }
  });

test("formulas in reverse Polish notation", () => {
  assert.equal(evaluate("0.5 I1 /", { I1: 4 }), 0.125);
  assert.equal(evaluate("2 a - 3 *", { a: 5 }), -9);
});
