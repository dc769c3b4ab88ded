// The two runs of a choice, and everything that the page shows of the system.
import { casimirs, cube, invariantsOf, satisfiesJacobi, typedCode, typedFields } from "./algebra";
import type { Vector } from "./camera";
import { python } from "./exports";
import type { Kernels } from "./kernels";
import { orbitLines } from "./orbit";
import { Planet } from "./planet";
import { Shape } from "./scene";
import { type Choice, firstChoice, schemesOf } from "./state";
import { fieldsOf, type System, type Tables, type View } from "./tables";
import { type Plan, Track } from "./track";

const MAX_STEPS_OF_FRAME = 2000;
const FRAME_BUDGET = 9; // milliseconds for the steps of a frame
const MAX_PIECES = 20; // of the steps of a frame, between which the time is compared with the budget
const TYPED_VIEW: View = { kind: "path", axes: [0, 1, 2], labels: ["x₁", "x₂", "x₃"], centered: true };

const SUBSCRIPTS = "₀₁₂₃₄₅₆₇₈₉";
export const subscripted = (name: string) => name.replace("gamma", "γ").replace(/\d/g, (digit) => SUBSCRIPTS[Number(digit)]);

export class App {
  tracks: Track[] = [];
  shapes: Shape[] = [];
  playing = true;
  problem = "";
  private owed = 0;
  private surface: { radius: number; lines: Vector[] } = { radius: 0, lines: [] };

  constructor(readonly kernels: Kernels, readonly tables: Tables, public choice: Choice) {
    this.restart();
  }

  get system(): System | undefined {
    return this.tables.systems[this.choice.system];
  }

  get view(): View {
    return this.system?.view ?? TYPED_VIEW;
  }

  get coordinates(): string[] {
    return this.system?.coordinates ?? ["x1", "x2", "x3"];
  }

  // Names at the ends of the axes.
  get axes(): string[] {
    const { view } = this;
    if (view.labels) return view.labels;
    return view.balls!.length > 1 ? ["x", "y", "z"] : view.balls![0].map((i) => subscripted(this.coordinates[i]));
  }

  select(name: string): void {
    const next = firstChoice(this.tables, name, this.choice.algebra);
    const { schemes, rate, turn } = this.choice, known = schemesOf(this.tables, name);
    this.choice = { ...next, schemes: schemes.every((scheme) => known.includes(scheme)) ? schemes : next.schemes, rate, turn };
    this.restart();
  }

  schemeCode(name: string): string {
    if (this.system) return this.system.schemes[name].code;
    const { code } = this.tables.schemes.find((scheme) => scheme.name === name)!;
    return code.startsWith("co.Splitting(") ? `${code.slice(0, -1)}, parts="coordinates")` : code;
  }

  systemCode(): string {
    if (!this.system) return typedCode(this.choice.algebra);
    return this.system.code.replace(/\{(\w+)\}/g, (_, name) => python(this.choice.values[name]));
  }

  title(name: string): string {
    return this.tables.schemes.find((scheme) => scheme.name === name)!.title;
  }

  plans(): Plan[] {
    const { choice, system, tables } = this, planet = this.planetOf();
    const x0 = planet?.state(system!.modes!) ?? choice.x0;
    return choice.schemes.map((name) => {
      const fields = system
        ? fieldsOf(tables, system, system.schemes[name], choice.values, choice.step)
        : typedFields(tables, choice.algebra, name, choice.step);
      return {
        title: this.title(name),
        loop: (system ?? tables.systems.rigid_body).schemes[name].loop,
        fields: planet?.fields(this.kernels, fields) ?? fields,
        invariants: planet?.invariants ?? system?.invariants ?? invariantsOf(choice.algebra),
        step: choice.step,
        x0,
        section: this.view.section,
        planet,
      };
    });
  }

  private planetOf(): Planet | undefined {
    const { N, lamb, rotation } = this.choice.values;
    return this.view.kind === "planet" ? new Planet(N, lamb, rotation) : undefined;
  }

  // Names of the columns of the downloaded data.
  get columns(): string[] {
    return this.tracks[0]?.plan.planet?.names ?? this.coordinates;
  }

  // Python code of the initial state.
  get start(): string {
    return this.system?.start ?? `[${this.choice.x0.map(python).join(", ")}]`;
  }

  get hasCasimirs(): boolean {
    return this.system ? this.system.invariants.length !== 1 : casimirs(cube(this.choice.algebra)).length > 0;
  }

  get hasAttitudes(): boolean {
    return this.tracks.some((track) => track.rotation !== null);
  }

  // Begin both runs again.
  restart(): void {
    for (const track of this.tracks) track.free();
    this.tracks = [];
    this.owed = 0;
    this.surface = { radius: 0, lines: [] };
    this.problem = "";
    const { algebra, x0 } = this.choice;
    if (!this.system) {
      if (!satisfiesJacobi(cube(algebra)))
        this.problem = "These brackets violate the Jacobi identity: [[e₁,e₂],e₃] + [[e₂,e₃],e₁] + [[e₃,e₁],e₂] is not zero.";
      else if ([...algebra.squares, ...algebra.linear].every((x) => x === 0)) this.problem = "H is zero: give it a coefficient.";
      if (this.problem) return;
    }
    const { view } = this, balls = (view.balls ?? [0]).length;
    this.tracks = this.plans().map((plan) => new Track(this.kernels, plan, balls));
    this.shapes = view.kind === "planet" ? [] : this.tracks.map(() => new Shape(view, x0));
  }

  // Take the steps of one frame; fewer if they take too long.
  advance(seconds: number): void {
    if (!this.playing || !this.tracks.length) return;
    this.owed = Math.min(this.owed + seconds * this.choice.rate, MAX_STEPS_OF_FRAME);
    const steps = Math.floor(this.owed);
    this.owed -= steps;
    this.take(steps);
  }

  take(steps: number): void {
    const start = performance.now(), pieces = Math.min(MAX_PIECES, Math.ceil(steps / (this.view.kind === "planet" ? 1 : 20)));
    let left = steps;
    for (let piece = 0; piece < pieces && left > 0; ++piece) {
      const taken = Math.ceil(left / (pieces - piece));
      for (const track of this.tracks) track.advance(taken);
      left -= taken;
      if (performance.now() - start > FRAME_BUDGET) break;
    }
    if (this.view.kind === "path" && this.tracks.length) {
      const both = this.tracks.flatMap((track) => (track.failure ? [] : [...track.states()]));
      this.shapes = this.tracks.map(() => new Shape(this.view, this.choice.x0, both));
    }
  }

  // Lines of the level set of the Casimir of a typed algebra; it is computed again if the scale changes.
  get orbit(): Vector[] {
    const radius = this.shapes[0]?.radius(0) ?? 0;
    if (this.system || radius === this.surface.radius) return this.surface.lines;
    const [casimir] = casimirs(cube(this.choice.algebra));
    this.surface = { radius, lines: casimir ? orbitLines(casimir, this.choice.x0, radius) : [] };
    return this.surface.lines;
  }

  get steps(): number {
    return Math.max(0, ...this.tracks.map((track) => track.step));
  }
}
