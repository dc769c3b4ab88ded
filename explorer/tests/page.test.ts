// The page without a browser: the choice and its address, both runs, their data and errors, and what drawings show.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { casimirs, cube } from "../src/algebra";
import { App } from "../src/app";
import { attitudeOf, box, inertiaOf } from "../src/body";
import { apply, camera, dot, firstBlock, length, type Matrix, product, rotation, transposed, type Vector } from "../src/camera";
import { csv, pythonScript } from "../src/exports";
import { Kernels } from "../src/kernels";
import { orbitLines } from "../src/orbit";
import { drawErrors } from "../src/plots";
import { picked, Shape } from "../src/scene";
import { type Choice, firstChoice, read, schemesOf, TYPED, written } from "../src/state";
import { checked, type Tables } from "../src/tables";
import type { Colors } from "../src/theme";
import { Errors } from "../src/track";

const BUILT = join(process.cwd(), "../build/explorer");
const kernels = await Kernels.load(readFileSync(join(BUILT, "public/kernels.wasm")));
const tables = checked(JSON.parse(readFileSync(join(BUILT, "public/tables.json"), "utf-8")) as Tables);
const NAMES = [...Object.keys(tables.systems), TYPED];
const FRAME = 1 / 60;

const app = (name: string, changes: Partial<Choice> = {}) =>
  new App(kernels, tables, { ...firstChoice(tables, name), ...changes });

test("an address contains all of a choice", () => {
  for (const name of NAMES) {
    const choice = firstChoice(tables, name);
    assert.equal(written(tables, choice), name === "rigid_body" ? "" : `system=${name}`);
    choice.schemes = schemesOf(tables, name).slice(-2).reverse() as [string, string];
    Object.assign(choice, { step: 0.07, rate: 300, turn: [0.3, -0.2] });
    choice.x0 = choice.x0.map((x, k) => x + 0.125 * (k + 1));
    for (const slider of tables.systems[name]?.sliders ?? []) choice.values[slider.name] = slider.high;
    if (name === TYPED) choice.algebra = { constants: [0, 2, 0, 1, 0, 0, 0, 0, 2], squares: [0.5, 0, 1], linear: [0, 0.25, -1] };
    assert.deepEqual(read(tables, written(tables, choice)), choice);
  }
});

test("the first schemes have one order, and the splitting keeps the energy better from a hundred steps on", () => {
  for (const name of NAMES.filter((one) => one !== "planet")) {
    const one = app(name);
    assert.deepEqual(one.choice.schemes, ["splitting4", "rk4"]);
    for (const code of one.choice.schemes.map((scheme) => one.schemeCode(scheme))) assert.match(code, /order=4|ExplicitRungeKutta\(\)/);
    for (const steps of [100, 1000]) {
      while (one.steps < steps) one.take(10);
      const [first, second] = one.tracks.map((track) => track.energy.most);
      assert.ok(first < second, `${name}: after ${steps} steps ${first} and ${second}`);
    }
  }
});

test("what cannot be read in an address is as at first, and named", () => {
  const wrong = [
    "system=none", "h=-3", "h=", "h=1e9", "h=0.001", "rate=0", "rate=1e9", "a=euler", "p.I1=x", "p.I1=0.5", "p.I1=1.7", "turn=1", "turn=1,y",
    "x=1,2", "x=1,,2", "x=1,2,NaN",
  ];
  for (const text of [...wrong, "x=abc", "x=1,2,abc"]) {
    const refused: string[] = [];
    assert.deepEqual(read(tables, text, refused), firstChoice(tables), text);
    assert.deepEqual(refused, [text]);
  }
  const taken: string[] = [];
  read(tables, "system=heavy_top&h=0.1&a=taylor&x=1,2,3,0,0,1&turn=0.1,0.2", taken);
  assert.deepEqual(taken, []);
});

test("a run takes as many steps a second as chosen, and one after the other", () => {
  for (const rate of [60, 240]) {
    const one = app("rigid_body", { rate });
    for (let frame = 0; frame < 60; ++frame) one.advance(FRAME);
    assert.ok(Math.abs(one.steps - rate) <= 1, `${one.steps} steps`);
    one.playing = false;
    one.advance(1);
    assert.ok(Math.abs(one.steps - rate) <= 1);
    one.take(1);
    assert.ok(one.tracks.every((track) => track.step === one.steps));
    one.restart();
    assert.equal(one.steps, one.tracks[0].step);
    assert.ok(one.steps <= 1);
  }
});

test("another system keeps schemes, rate and direction of view", () => {
  const one = app("rigid_body", { schemes: ["gauss", "taylor"], rate: 30, turn: [1, 1], step: 0.4 });
  one.select("heavy_top");
  const expected = { ...firstChoice(tables, "heavy_top"), schemes: ["gauss", "taylor"], rate: 30, turn: [1, 1] };
  assert.deepEqual(one.choice, expected);
  assert.equal(one.tracks[0].x.length, 6);
  one.select("planet");
  assert.deepEqual([one.choice.schemes, one.tracks[0].x.length], [["isospectral2", "isospectral4"], 2 * 32 ** 2]);
});

test("a flow on a sphere keeps the traces, and its data are invariants and speeds", () => {
  const one = app("planet", { values: { N: 16, lamb: 100, rotation: 20 } });
  while (one.steps < 200) one.take(Math.min(5, 200 - one.steps));
  for (const track of one.tracks) {
    assert.ok(track.casimirs.most < 1e-13 && track.energy.most < 1e-3, `${track.casimirs.most}, ${track.energy.most}`);
    assert.ok(track.energy.most > 0);
  }
  assert.ok(one.tracks[1].energy.most < one.tracks[0].energy.most / 20);
  const text = csv(one.kernels, one.plans(), one.columns, one.hasAttitudes, one.steps).trim().split("\n");
  const header = text[0].split(","), last = text.at(-1)!.split('"').at(-1)!.split(",").slice(1).map(Number);
  assert.deepEqual([text.length, header.length, header.at(-4)], [403, 3 + 48 + 4, "energy"]);
  const { planet } = one.tracks[1].plan;
  assert.deepEqual(last.slice(2), [...planet!.zonal(one.tracks[1].x), ...planet!.values(one.tracks[1].x)]);
});

// Rows of numbers of each scheme.
function dataOf(one: App): Record<string, number[][]> {
  const text = csv(one.kernels, one.plans(), one.coordinates, one.hasAttitudes, one.steps);
  const found: Record<string, number[][]> = {};
  for (const line of text.trim().split("\n").slice(1)) {
    const quoted = line.startsWith('"') ? line.indexOf('"', 1) + 1 : line.indexOf(",");
    (found[line.slice(0, quoted).replaceAll('"', "")] ??= []).push(line.slice(quoted + 1).split(",").map(Number));
  }
  return found;
}

test("data of long runs are evenly thinned, and end with the last state", () => {
  const one = app("heavy_top", { schemes: ["splitting4", "rk4"] }), steps = 24000;
  while (one.steps < steps) one.take(Math.min(400, steps - one.steps));
  const found = dataOf(one);
  assert.deepEqual(Object.keys(found), ["Splitting, order 4", "Runge-Kutta, order 4"]);
  for (const [k, rows] of Object.values(found).entries()) {
    const { step } = one.choice, every = rows[1][0], { x, rotation } = one.tracks[k];
    assert.ok(rows.length <= 10001 && rows.length > 5000);
    rows.forEach(([number, t], row) => assert.ok(number === Math.min(row * every, steps) && t === number * step));
    assert.deepEqual(rows.at(-1)!.slice(2, 8), Array.from(x));
    assert.deepEqual(rows.at(-1)!.slice(-9), rotation);
  }
});

test("data of a run that fails end before the step that failed", () => {
  const one = app("heavy_top", { step: 2, x0: [9, 9, 9, 0.6, 0, 0.8] });
  while (one.steps < 300) one.take(10);
  const { failure } = one.tracks[1], failed = Number(failure.match(/Step (\d+)/)![1]);
  assert.match(failure, /overflowed.*smaller/);
  const rows = dataOf(one)["Runge-Kutta, order 4"];
  assert.ok(rows.length === failed && rows.flat().every(Number.isFinite));
});

test("errors are the largest distances from the start", () => {
  const one = app("heavy_top"), steps = 500;
  while (one.steps < steps) one.take(1);
  for (const [k, rows] of Object.values(dataOf(one)).entries()) {
    const track = one.tracks[k], first = rows[0].slice(8, 11);
    const energies = rows.map((row) => Math.abs(row[8] - first[0]));
    const others = rows.map((row) => Math.max(...[1, 2].map((i) => Math.abs(row[8 + i] - first[i]))));
    for (const [errors, expected] of [[track.energy, energies], [track.casimirs, others]] as Array<[Errors, number[]]>) {
      assert.equal(errors.most, Math.max(...expected));
      assert.equal(errors.now, expected.at(-1));
      for (let bin = 0; bin <= errors.last; ++bin) {
        if (Number.isNaN(errors.largest[bin])) continue;
        const until = expected.filter((_, step) => step && Math.log10(step) < Math.log10(Errors.step(bin + 1)) - 1e-9);
        assert.equal(errors.largest[bin], Math.max(...until));
      }
    }
  }
});

test("an error that is not a number stays the largest", () => {
  const errors = new Errors();
  for (const error of [1e-3, NaN, 1]) errors.add(errors.last < 0 ? 1 : 100, error);
  assert.ok(Number.isNaN(errors.most));
});

test("the trail contains the last states in order", () => {
  const one = app("spin_chain");
  for (let k = 0; k < 100; ++k) one.take(7);
  const [track] = one.tracks, states = [...track.states()].map((state) => Array.from(state));
  const [rows] = Object.values(dataOf(one));
  assert.equal(states.length, track.capacity);
  assert.deepEqual(states, rows.slice(-states.length).map((row) => row.slice(2, 26)));
});

test("the body turns so that its angular momentum, or the vertical of a top, points up", () => {
  for (const [name, first] of [["rigid_body", 0], ["heavy_top", 3]] as Array<[string, number]>) {
    const one = app(name, { schemes: ["splitting4", "taylor"], step: 0.1 });
    const { x0 } = one.choice;
    for (const steps of [1, 40, 300]) {
      one.take(steps);
      for (const { rotation, x } of one.tracks) {
        const attitude = attitudeOf(one.view, rotation!, x0), up = apply(attitude, x.slice(first, first + 3));
        assert.ok(Math.abs(up[2] / length(x0.slice(first, first + 3)) - 1) < 1e-9, `${name}: ${up}`);
        const error = product(transposed(attitude), attitude).map((entry, k) => entry - (k % 4 ? 0 : 1));
        assert.ok(Math.max(...error.map(Math.abs)) < 1e-9);
      }
    }
  }
});

test("the box that is drawn has the moments of inertia", () => {
  const values = { I1: 1.2, I2: 1.7, I3: 2.4 }, squares = box(inertiaOf(values)).map((edge) => edge * edge);
  const moments = [0, 1, 2].map((k) => squares[(k + 1) % 3] + squares[(k + 2) % 3]);
  Object.values(values).forEach((moment, k) => assert.ok(Math.abs(moments[k] / moments[0] - moment / values.I1) < 1e-12));
});

// Labels and ends of lines that are drawn on a canvas of 400 by 300 pixels.
function drawn(draw: (canvas: HTMLCanvasElement) => void): { labels: Array<[string, number, number]>; ends: Vector[] } {
  const labels: Array<[string, number, number]> = [], ends: Vector[] = [];
  const context = {
    fillText: (text: string, x: number, y: number) => labels.push([text, x, y]),
    lineTo: (x: number, y: number) => ends.push([x, y, 0]),
  };
  const others = () => undefined;
  Object.assign(globalThis, { devicePixelRatio: 1 });
  const recorder = new Proxy(context, { get: (target, name) => Reflect.get(target, name) ?? others, set: () => true });
  draw({ clientWidth: 400, clientHeight: 300, getContext: () => recorder } as unknown as HTMLCanvasElement);
  return { labels, ends };
}

test("errors are drawn at their places between powers of ten", () => {
  const errors = new Errors();
  for (let step = 1; step <= 1000; ++step) errors.add(step, 1e-9 * step ** 2);
  const { labels, ends } = drawn((canvas) => drawErrors(canvas, [errors], {} as Colors));
  const at = (text: string, index: 1 | 2, k: number) => labels.filter(([label]) => label === text).at(k)![index];
  const [x, y] = ends.at(-1)!, rows = at("10⁻⁴", 2, 0), lower = at("10⁻⁶", 2, 0), columns = at("10³", 1, -1), left = at("10²", 1, -1);
  assert.ok(Math.abs(y - (rows - (lower - rows) / 2)) < 1e-9, `${y} of 10⁻³, beside ${rows} and ${lower}`);
  assert.ok(Math.abs(x - columns) < 1e-9 && left < columns, `${x} of 1000 steps, beside ${columns}`);
});

test("the first block of a group element, and rotations", () => {
  const rows = Array.from({ length: 36 }, (_, k) => k);
  assert.deepEqual(firstBlock(rows), [0, 1, 2, 6, 7, 8, 12, 13, 14]);
  assert.equal(firstBlock([]), null);
  assert.deepEqual(apply(rotation([0, 0, Math.PI / 2]), [1, 0, 0]).map((x) => Math.round(x * 1e9) / 1e9), [0, 1, 0]);
  const turned: Matrix = camera([0.7, -0.4]), right = turned.slice(0, 3), up = turned.slice(3, 6);
  assert.ok(Math.abs(dot(right, up)) < 1e-12 && right[2] === 0 && up[2] > 0);
});

test("a pixel of the sphere is the point that is drawn there", () => {
  const one = app("rigid_body"), canvas = { clientWidth: 500, clientHeight: 420 } as HTMLCanvasElement;
  const matrix = camera([-0.65, 0.42]);
  for (const [x, y] of [[195, 210], [150, 120], [260, 300]]) {
    const point = picked(canvas, matrix, one.view, x, y)!, seen = apply(matrix, point), radius = 0.41 * 420;
    assert.ok(Math.abs(length(point) - 1) < 1e-12 && seen[2] > 0);
    assert.ok(Math.hypot(0.39 * 500 + radius * seen[0] - x, 210 - radius * seen[1] - y) < 1e-9);
  }
  assert.equal(picked(canvas, matrix, one.view, 490, 10), null);
});

test("shapes place spheres, cylinders and paths in the scene", () => {
  const scratch: Vector = [0, 0, 0];
  const spins = app("spin_pair"), { x0 } = spins.choice;
  for (const ball of [0, 1]) {
    const at = [...new Shape(spins.view, x0).point(ball, x0, scratch)], part = x0.slice(3 * ball, 3 * ball + 3);
    at.forEach((c, k) => assert.ok(Math.abs(c - part[k] / length(part)) < 1e-12));
  }
  const light = app("maxwell_bloch");
  new Shape(light.view, light.choice.x0).point(0, light.choice.x0, scratch);
  assert.ok(Math.abs(Math.hypot(scratch[0], scratch[1]) - 1 / 1.6) < 1e-12 && scratch[2] > 0);
  const ring = app("toda_ring");
  ring.take(400);
  for (const track of ring.tracks)
    for (const state of track.states()) {
      const at = ring.shapes[0].point(0, state, scratch);
      assert.ok(Math.max(...at.map(Math.abs)) <= 1 / 1.3 + 1e-12);
    }
});

test("lines of an orbit lie on the level set of the Casimir", () => {
  for (const constants of [[0, 0, 1, 1, 0, 0, 0, 1, 0], [0, 2, 0, 1, 0, 0, 0, 0, 2], [0, 0, 1, 0, 0, 0, 0, 1, 0]]) {
    const [casimir] = casimirs(cube({ constants, squares: [1, 0.6, 0.4], linear: [0, 0, 0] })), x0 = [0.5, 1, 0.3], radius = 2;
    const value = (x: number[]) =>
      casimir.rows.reduce((sum, row) => sum + x[row.target] * (row.offset + row.entries.reduce((s, [j, w]) => s + 0.5 * w * x[j], 0)), 0);
    const lines = orbitLines(casimir, x0, radius);
    assert.ok(lines.length > 100 && lines.length % 2 === 0);
    for (const end of lines) {
      assert.ok(Math.max(...end.map(Math.abs)) <= 1 + 1e-12);
      assert.ok(Math.abs(value(end.map((c) => c * radius)) - value(x0)) < 0.06, `${constants}: ${end}`);
    }
  }
});

test("wrong algebras are refused", () => {
  const algebra = { constants: [1, 0, 0, 0, 1, 0, 1, 0, 1], squares: [1, 1, 1], linear: [0, 0, 0] };
  assert.match(app(TYPED, { algebra }).problem, /Jacobi/);
  assert.match(app(TYPED, { algebra: { ...algebra, constants: [0, 0, 1, 1, 0, 0, 0, 1, 0], squares: [0, 0, 0] } }).problem, /H is zero/);
});

test("a script contains what was chosen", () => {
  const text = pythonScript({ system: "co.s()", schemes: ["A()", "B()"], attitude: true, x0: "[1.0, 0.5]", step: 2, steps: 7 });
  assert.match(text, /system = co\.s\(\)\nx0 = \[1\.0, 0\.5\]/);
  assert.match(text, / {4}A\(\),\n {4}B\(\),/);
  assert.match(text, /t_span=\(0\.0, 7 \* 2\.0\), step=2\.0, method=method, attitude="coadjoint"/);
});
