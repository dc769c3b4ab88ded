// The tables that the library exports for the page, and their entries for other values of the sliders.
import type { Fields } from "./kernels";

export interface Slider {
  name: string;
  label: string;
  low: number;
  high: number;
  value: number;
  step: number;
}

// An entry that depends on the sliders: its index, a source and a factor.
type Move = [number, number, number];

export interface Scheme {
  code: string;
  loop: string;
  fields: Record<string, number | number[] | { "": number }>;
  moves: Record<string, Move[]>;
}

export interface View {
  kind: "sphere" | "path" | "cylinder" | "planet";
  balls?: number[][];
  axes?: number[];
  labels?: string[];
  body?: "inertia" | "top" | "arrows" | "vorticity";
  click?: number;
  centered?: boolean; // a path around the origin, whose scale changes in steps
  section?: Section;
}

export interface Section {
  level: number;
  across: number;
  up: number;
  labels: [string, string];
  name: string;
}

export interface System {
  title: string;
  text: string;
  code: string;
  sliders: Slider[];
  sources: string[];
  x0: number[];
  coordinates: string[];
  invariants: string[];
  view: View;
  step: number;
  schemes: Record<string, Scheme>;
  start?: string; // code of the initial state of a flow on a sphere
  modes?: number[][]; // of its relative vorticity: l, m, real and imaginary part
}

export interface Tables {
  version: number;
  library: string;
  interface: string;
  schemes: Array<{ name: string; code: string; title: string }>;
  rows: Record<string, Array<Record<"part" | "tau" | "moment" | "section", number[]>>>; // of one to three parts
  arrays: number[][];
  systems: Record<string, System>;
}

export const VERSION = 3;

export type Values = Record<string, number>;

export function checked(tables: Tables): Tables {
  if (tables.version !== VERSION) throw new Error(`the tables have version ${tables.version}; this page reads ${VERSION}`);
  return tables;
}

// A formula in reverse Polish notation, operation by operation, as the script that exports the tables computes it.
export function evaluate(source: string, values: Values): number {
  const stack: number[] = [];
  for (const token of source.split(" ")) {
    if ("+-*/".includes(token)) {
      const second = stack.pop()!, first = stack.pop()!;
      stack.push(token === "+" ? first + second : token === "-" ? first - second : token === "*" ? first * second : first / second);
    } else stack.push(token in values ? values[token] : Number(token));
  }
  return stack[0];
}

// The fields of the tables of a scheme for these values of the sliders and this step.
export function fieldsOf(tables: Tables, system: System, scheme: Scheme, values: Values, h: number): Fields {
  const sources = system.sources.map((source) => evaluate(source, values));
  const fields: Fields = {};
  for (const [path, value] of Object.entries(scheme.fields))
    fields[path] = typeof value === "number" ? value : Array.isArray(value) ? value : tables.arrays[value[""]];
  for (const [path, moves] of Object.entries(scheme.moves)) {
    const numbers = Array.from(fields[path] as number[]);
    for (const [index, source, factor] of moves) numbers[index] = factor * sources[source];
    fields[path] = numbers;
  }
  if (scheme.loop === "flow_advance") {
    fields["tables.tau"] = Array.from(fields["tables.tau"] as number[], (coefficient) => coefficient * h);
    fields["tables.step"] = h;
  }
  return fields;
}
