// What the reader has chosen, and its form in the address of the page.
import type { Tables, Values } from "./tables";

export interface Algebra {
  constants: number[]; // of [e1, e2], [e2, e3], [e3, e1], each by e1, e2, e3
  squares: number[]; // H = sum of squares[i] x_i^2 / 2 + linear[i] x_i
  linear: number[];
}

export interface Choice {
  system: string;
  schemes: [string, string];
  step: number;
  rate: number; // steps a second
  values: Values;
  x0: number[];
  algebra: Algebra;
  turn: [number, number];
}

export const TYPED = "algebra";
export const MIN_STEP = 0.01, MAX_STEP = 2, MIN_RATE = 1, MAX_RATE = 100000;
export const FIRST_TURN: [number, number] = [-0.65, 0.42];
export const FIRST_ALGEBRA: Algebra = { constants: [0, 0, 1, 1, 0, 0, 0, 1, 0], squares: [1, 0.6, 0.4], linear: [0, 0, 0] };

export const schemesOf = (tables: Tables, system: string) =>
  Object.keys((tables.systems[system] ?? tables.systems.rigid_body).schemes);

export function firstChoice(tables: Tables, name = "rigid_body", algebra = FIRST_ALGEBRA): Choice {
  const system = tables.systems[name];
  return {
    system: name,
    schemes: schemesOf(tables, name).includes("rk4") ? ["splitting4", "rk4"] : ["isospectral2", "isospectral4"],
    step: system?.step ?? 1.5,
    rate: 60,
    values: Object.fromEntries((system?.sliders ?? []).map((slider) => [slider.name, slider.value])),
    x0: system ? [...system.x0] : [0.05, 1, 0.05],
    algebra: structuredClone(algebra),
    turn: [...FIRST_TURN],
  };
}

// The number that a text is; NaN if it is none.
export const numberIn = (text: string) => (text.trim() ? Number(text) : NaN);

const list = (numbers: number[]) => numbers.map(String).join(",");

// Only what differs from the first choice.
export function written(tables: Tables, choice: Choice): string {
  const first = firstChoice(tables, choice.system), found = new URLSearchParams();
  const put = (name: string, value: string, usual: string) => value !== usual && found.set(name, value);
  put("system", choice.system, "rigid_body");
  put("a", choice.schemes[0], first.schemes[0]);
  put("b", choice.schemes[1], first.schemes[1]);
  put("h", String(choice.step), String(first.step));
  put("rate", String(choice.rate), String(first.rate));
  for (const [name, value] of Object.entries(choice.values)) put(`p.${name}`, String(value), String(first.values[name]));
  put("x", list(choice.x0), list(first.x0));
  put("turn", list(choice.turn), list(first.turn));
  if (choice.system === TYPED) {
    put("c", list(choice.algebra.constants), list(FIRST_ALGEBRA.constants));
    put("squares", list(choice.algebra.squares), list(FIRST_ALGEBRA.squares));
    put("linear", list(choice.algebra.linear), list(FIRST_ALGEBRA.linear));
  }
  return found.toString();
}

// A choice from an address; what cannot be read is as at first, and is added to `refused`.
export function read(tables: Tables, text: string, refused: string[] = []): Choice {
  const given = new URLSearchParams(text);
  const known = (label: string, names: string[], usual: string) => {
    const value = given.get(label) ?? usual;
    if (names.includes(value)) return value;
    refused.push(`${label}=${value}`);
    return usual;
  };
  const choice = firstChoice(tables, known("system", [...Object.keys(tables.systems), TYPED], "rigid_body"));
  const numbers = (label: string, usual: number[], low = -Infinity, high = Infinity) => {
    const values = given.get(label)?.split(",").map(numberIn) ?? usual;
    if (values.length === usual.length && values.every((x) => Number.isFinite(x) && x >= low && x <= high)) return values;
    refused.push(`${label}=${given.get(label)}`);
    return usual;
  };
  const number = (label: string, usual: number, low: number, high: number) => numbers(label, [usual], low, high)[0];
  for (const [k, label] of ["a", "b"].entries())
    choice.schemes[k] = known(label, schemesOf(tables, choice.system), choice.schemes[k]);
  choice.step = number("h", choice.step, MIN_STEP, MAX_STEP);
  choice.rate = number("rate", choice.rate, MIN_RATE, MAX_RATE);
  for (const slider of tables.systems[choice.system]?.sliders ?? [])
    choice.values[slider.name] = number(`p.${slider.name}`, slider.value, slider.low, slider.high);
  choice.x0 = numbers("x", choice.x0);
  choice.turn = numbers("turn", choice.turn) as [number, number];
  const { algebra } = choice;
  algebra.constants = numbers("c", algebra.constants);
  algebra.squares = numbers("squares", algebra.squares);
  algebra.linear = numbers("linear", algebra.linear);
  return choice;
}
