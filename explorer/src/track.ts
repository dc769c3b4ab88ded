// One of the two runs side by side: its last states, its errors and its section.
import { firstBlock, type Matrix } from "./camera";
import type { Fields, Kernels, Points, Run } from "./kernels";
import type { Planet } from "./planet";
import type { Section } from "./tables";

export const TRAIL = 2400; // coordinates triples kept, for all balls together
const BINS_PER_DECADE = 40, DECADES = 9;
const MAX_SECTION = 4000;
const BISECTIONS = 40;

export interface Plan {
  title: string;
  loop: string;
  fields: Fields;
  invariants: string[];
  step: number;
  x0: ArrayLike<number>;
  section?: Section;
  planet?: Planet; // of matrices, whose invariants the page computes
}

// The largest error until each of some steps, which are evenly spaced on a logarithmic axis.
export class Errors {
  readonly largest = new Float64Array(BINS_PER_DECADE * DECADES).fill(NaN);
  now = 0;
  most = 0;
  last = -1;

  add(step: number, error: number): void {
    this.now = error;
    if (error > this.most || Number.isNaN(error)) this.most = error;
    const bin = Math.min(this.largest.length - 1, Math.floor(Math.log10(Math.max(step, 1)) * BINS_PER_DECADE));
    this.largest[bin] = this.most;
    this.last = Math.max(this.last, bin);
  }

  static step(bin: number): number {
    return 10 ** (bin / BINS_PER_DECADE);
  }
}

// A run of a plan from its initial state.
export function startedRun(kernels: Kernels, plan: Plan): Run {
  const run = kernels.run(plan.loop, plan.fields, plan.x0.length, plan.planet ? 0 : plan.invariants.length);
  run.begin(plan.x0);
  return run;
}

// The invariants at a point.
export function valuesOf({ planet, invariants: { length }, x0 }: Plan, points: Points, k: number): number[] {
  if (planet) return planet.values(points.x.subarray(k * x0.length, (k + 1) * x0.length));
  return Array.from(points.values.subarray(k * length, (k + 1) * length));
}

export class Track {
  readonly energy = new Errors();
  readonly casimirs = new Errors();
  readonly trail: Float64Array; // a ring of whole states
  readonly capacity: number;
  readonly crossings: number[] = [];
  count = 0; // states so far
  x: Float64Array;
  rotation: Matrix | null = null; // of the last group element, its first block
  failure = "";
  private readonly run: Run;
  private readonly first: number[];
  private readonly units: number[]; // of errors of the invariants
  private readonly recent: Float64Array[] = [];

  constructor(kernels: Kernels, readonly plan: Plan, balls: number) {
    const size = plan.x0.length;
    this.run = startedRun(kernels, plan);
    this.capacity = plan.planet ? 1 : Math.floor(TRAIL / Math.max(1, balls));
    this.trail = new Float64Array(this.capacity * size);
    const start = this.run.advance(1, plan.step);
    this.first = valuesOf(plan, start, 0);
    this.units = plan.planet?.units(this.first) ?? this.first.map(() => 1);
    this.x = start.x.slice(0, size);
    this.add(start);
  }

  get step(): number {
    return Math.max(0, this.count - 1);
  }

  free(): void {
    this.run.free();
  }

  advance(steps: number): void {
    if (this.failure || steps < 1) return;
    this.add(this.run.advance(steps, this.plan.step));
    this.failure = this.run.failure;
  }

  private add(points: Points): void {
    const size = this.x.length, { section } = this.plan;
    for (let k = 0; k < points.count; ++k) {
      const next = points.x.subarray(k * size, (k + 1) * size);
      if (section) this.cross(section, next);
      this.x = next;
      this.trail.set(next, (this.count % this.capacity) * size);
      if (this.count) {
        const errors = valuesOf(this.plan, points, k).map((value, i) => Math.abs(value - this.first[i]) / this.units[i]);
        this.energy.add(this.count, errors[0]);
        this.casimirs.add(this.count, Math.max(0, ...errors.slice(1)));
      }
      ++this.count;
    }
    if (this.x.length) this.x = this.x.slice();
    if (points.count) this.rotation = firstBlock(points.group(points.count - 1));
  }

  // A point of the section where a coordinate rises through zero: on the cubic through four states, between the middle two.
  private cross(section: Section, next: Float64Array): void {
    const { recent } = this;
    recent.push(next);
    if (recent.length < 4) return;
    if (recent.length > 4) recent.shift();
    if (!(recent[1][section.level] < 0 && recent[2][section.level] >= 0)) return;
    const at = (i: number, s: number) =>
      (-s * (s - 1) * (s - 2) * recent[0][i] + 3 * (s + 1) * (s - 1) * (s - 2) * recent[1][i] -
        3 * (s + 1) * s * (s - 2) * recent[2][i] + (s + 1) * s * (s - 1) * recent[3][i]) / 6;
    let low = 0, high = 1;
    for (let k = 0; k < BISECTIONS; ++k) {
      const middle = (low + high) / 2;
      if (at(section.level, middle) < 0) low = middle;
      else high = middle;
    }
    this.crossings.push(at(section.across, low), at(section.up, low));
    if (this.crossings.length > 2 * MAX_SECTION) this.crossings.splice(0, 2);
  }

  // The states that are kept, from the oldest on.
  *states(): Generator<Float64Array> {
    const size = this.x.length, kept = Math.min(this.count, this.capacity);
    for (let k = this.count - kept; k < this.count; ++k) {
      const at = (k % this.capacity) * size;
      yield this.trail.subarray(at, at + size);
    }
  }
}
