// The kernels in WebAssembly against runs of the library, bit for bit.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { Kernels } from "../src/kernels";
import { casimirs, cube, invariantsOf, satisfiesJacobi, typedFields } from "../src/algebra";
import { Planet } from "../src/planet";
import type { Algebra } from "../src/state";
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
  attitudes: number[][]; // after the start
}

interface Typed {
  name: string;
  algebra: Algebra;
  scheme: string;
  step: number;
  x0: number[];
  exact: boolean;
  x: number[][];
  energy: number[];
  casimirs: number;
}

interface OnSphere {
  scheme: string;
  values: Values;
  step: number;
  steps: number;
  x: number[][]; // first and last
  invariants: number[][];
  vorticity: number[]; // of the last state
  zonal: number[];
}

const ROUND_OFF = 1e-12; // where the order of operations is another one

const kernels = await Kernels.load(readFileSync(join(BUILT, "public/kernels.wasm")));
const tables = checked(JSON.parse(readFileSync(join(BUILT, "public/tables.json"), "utf-8")) as Tables);
const { runs, algebras, planets } = JSON.parse(readFileSync(join(BUILT, "runs.json"), "utf-8")) as {
  runs: Expected[];
  algebras: Typed[];
  planets: OnSphere[];
};

// The states and invariants at the saved steps, computed in pieces of this many steps, and the group elements after each
// piece.
function computed(run: Expected, piece: number): Pick<Expected, "x" | "invariants" | "attitudes"> & { failure: string } {
  const system = tables.systems[run.system];
  const scheme = system.schemes[run.scheme];
  const fields = fieldsOf(tables, system, scheme, run.values, run.step);
  const size = run.x0.length, count = system.invariants.length;
  const one = kernels.run(scheme.loop, fields, size, count);
  one.begin(run.x0);
  const x: number[][] = [], invariants: number[][] = [], attitudes: number[][] = [];
  for (let done = 0; done < run.steps; done += piece) {
    const points = one.advance(Math.min(piece, run.steps - done), run.step);
    const group = Array.from(points.group(points.count - 1));
    if (group.length) attitudes.push(group);
    for (let k = 0; k < points.count; ++k) {
      x.push(Array.from(points.x.subarray(k * size, (k + 1) * size)));
      invariants.push(Array.from(points.values.subarray(k * count, (k + 1) * count)));
    }
  }
  one.free();
  const saved = (rows: number[][]) => rows.filter((_, k) => k % run.save_every === 0);
  return { x: saved(x), invariants: saved(invariants), attitudes, failure: one.failure };
}

for (const run of runs)
  test(`${run.system}, ${run.scheme}, step ${run.step}`, () => {
    for (const piece of [run.save_every, run.steps, 7]) {
      const found = computed(run, piece);
      assert.equal(found.failure, "");
      if (piece === run.save_every) assert.deepEqual(found.attitudes, run.attitudes);
      else assert.deepEqual(found.attitudes.at(-1), run.attitudes.at(-1));
      assert.deepEqual(found.x, run.x);
      assert.deepEqual(found.invariants, run.invariants);
    }
  });

for (const [number, typed] of algebras.entries())
  test(`${typed.name}, ${typed.scheme}, energy ${number % 3}`, () => {
    const names = invariantsOf(typed.algebra), { loop } = tables.systems.rigid_body.schemes[typed.scheme];
    const run = kernels.run(loop, typedFields(tables, typed.algebra, typed.scheme, typed.step), 3, names.length);
    run.begin(typed.x0);
    const points = run.advance(typed.x.length - 1, typed.step);
    run.free();
    const x = typed.x.map((_, k) => Array.from(points.x.subarray(3 * k, 3 * k + 3)));
    const energy = typed.x.map((_, k) => points.values[names.length * k]);
    assert.equal(casimirs(cube(typed.algebra)).length, typed.casimirs);
    if (typed.exact) {
      assert.deepEqual(x, typed.x);
      assert.deepEqual(energy, typed.energy);
    } else {
      const size = Math.max(...typed.x.flat().map(Math.abs));
      x.flat().forEach((value, k) => assert.ok(Math.abs(value - typed.x.flat()[k]) <= ROUND_OFF * size));
    }
  });

// Products of matrices add in another order than those of the library.
const MATRIX_ROUND_OFF = 1e-10;

for (const { scheme, values, step, steps, x, invariants, vorticity, zonal } of planets)
  test(`a planet of N = ${values.N}, ${scheme}, lamb = ${values.lamb}`, () => {
    const { planet: system } = tables.systems, planet = new Planet(values.N, values.lamb, values.rotation);
    const close = (found: ArrayLike<number>, wanted: number[], what: string, units?: number[]) => {
      const size = Math.max(...wanted.map(Math.abs));
      assert.equal(found.length, wanted.length);
      wanted.forEach((value, k) => {
        const error = Math.abs(found[k] - value) / (units?.[k] ?? size);
        assert.ok(error <= MATRIX_ROUND_OFF, `${what} ${k}: ${found[k]}, not ${value}`);
      });
    };
    const first = planet.state(system.modes!);
    close(first, x[0], "first state");
    const run = kernels.run(system.schemes[scheme].loop, planet.fields(kernels, fieldsOf(tables, system, system.schemes[scheme], values, step)), planet.size, 0);
    run.begin(first);
    const points = run.advance(steps, step);
    run.free();
    assert.equal(run.failure, "");
    const last = points.x.subarray(steps * planet.size, (steps + 1) * planet.size);
    close(last, x[1], "last state");
    const units = planet.units(invariants[0]), found = planet.values(last);
    close(planet.values(first), invariants[0], "first invariant", units);
    close(found, invariants[1], "last invariant", units);
    found.slice(1).forEach((value, k) => assert.ok(Math.abs(value - invariants[0][k + 1]) < 1e-13 * units[k + 1]));
    close(planet.vorticity(last), vorticity, "vorticity");
    close(planet.zonal(last), zonal, "speed");
    assert.ok(Math.max(...x[1].map((value, k) => Math.abs(value - x[0][k]))) > 1e-3 * Math.max(...x[0].map(Math.abs)));
  });

test("Jacobi identity", () => {
  for (const { algebra } of algebras) assert.ok(satisfiesJacobi(cube(algebra)));
  assert.ok(!satisfiesJacobi(cube({ constants: [1, 0, 0, 0, 1, 0, 1, 0, 1], squares: [1, 1, 1], linear: [0, 0, 0] })));
});

test("formulas in reverse Polish notation", () => {
  assert.equal(evaluate("0.5 I1 /", { I1: 4 }), 0.125);
  assert.equal(evaluate("2 a - 3 *", { a: 5 }), -9);
});
