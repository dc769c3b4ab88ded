// A splitting, a vector field and the invariants for an algebra of dimension 3 that is typed in: x' = J(x) grad H(x), with
// H = sum of squares x^2 / 2 + linear x, one part for each coordinate, as `parts="coordinates"` of the library.
import type { Fields } from "./kernels";
import { python } from "./exports";
import type { Algebra } from "./state";
import type { Tables } from "./tables";

const PAIRS = [[0, 1], [1, 2], [2, 0]];
const SCALE = 0, ROTATE = 1, PLANE = 2, SHEAR = 3, SERIES = 5;
const TAYLOR_DEGREE = 20;
const UNIT_ROUNDOFF = 2 ** -53, JACOBI_UNITS = 64;
const TINY = 1e-12; // of the largest structure constant, in the search for Casimirs

type Cube = number[][][]; // constants[i][j][k] of [e_i, e_j]

export function cube(algebra: Algebra): Cube {
  const c: Cube = [0, 1, 2].map(() => [0, 1, 2].map(() => [0, 0, 0]));
  PAIRS.forEach(([i, j], pair) => {
    for (let k = 0; k < 3; ++k) {
      c[i][j][k] = algebra.constants[3 * pair + k];
      c[j][i][k] = -algebra.constants[3 * pair + k] || 0;
    }
  });
  return c;
}

// Whether [[e1, e2], e3] + [[e2, e3], e1] + [[e3, e1], e2] vanishes, up to rounding.
export function satisfiesJacobi(c: Cube): boolean {
  for (let l = 0; l < 3; ++l) {
    let sum = 0, size = 0;
    for (const [i, j, m] of [[0, 1, 2], [1, 2, 0], [2, 0, 1]])
      for (let k = 0; k < 3; ++k) {
        sum += c[i][j][k] * c[k][m][l];
        size += Math.abs(c[i][j][k] * c[k][m][l]);
      }
    if (Math.abs(sum) > JACOBI_UNITS * UNIT_ROUNDOFF * size) return false;
  }
  return true;
}

interface Block {
  kind: number;
  coordinates: number[];
  constants: number[];
  tail: number[]; // row starts and columns of a series
  degree: number;
}

type Entry = [number, number, number]; // row, column, value

function sourcesOf(entries: Entry[]): Block[] {
  return entries.map(([row, column, value]) => ({ kind: SHEAR, coordinates: [row, column], constants: [value], tail: [], degree: 0 }));
}

function planeOf([i, j]: number[], matrix: number[][]): Block {
  const [a, b, c, d] = [matrix[i][i], matrix[i][j], matrix[j][i], matrix[j][j]];
  const rotates = a === 0 && d === 0 && b === -c;
  if (rotates) return { kind: ROTATE, coordinates: c < 0 ? [j, i] : [i, j], constants: [Math.abs(c)], tail: [], degree: 0 };
  return { kind: PLANE, coordinates: [i, j], constants: [(a + d) / 2, (a - d) / 2, b, c], tail: [], degree: 0 };
}

// All three coordinates: a finite sum if no coordinate returns to itself, else the series in substeps.
function seriesOf(entries: Entry[]): Block {
  const reach = (depth: number, from: number): number =>
    depth > 3 ? 4 : Math.max(depth, ...entries.filter(([, column]) => column === from).map(([row]) => reach(depth + 1, row)));
  const depth = Math.max(...[0, 1, 2].map((k) => reach(0, k)));
  const inColumn = (k: number) => entries.filter(([, column]) => column === k);
  const norms = [0, 1, 2].map((k) => inColumn(k).reduce((sum, [, , value]) => sum + Math.abs(value), 0));
  const starts = [0, 1, 2, 3].map((row) => entries.filter(([r]) => r < row).length);
  return {
    kind: SERIES, coordinates: [0, 1, 2], constants: [depth <= 3 ? 0 : Math.max(...norms), ...entries.map(([, , value]) => value)],
    tail: [...starts, ...entries.map(([, column]) => column)], degree: depth <= 3 ? depth : TAYLOR_DEGREE,
  };
}

// The blocks of a generator: connected sets of coordinates.
function blocksOf(matrix: number[][]): Block[] {
  const set = [0, 1, 2];
  for (let pass = 0; pass < 3; ++pass)
    for (let i = 0; i < 3; ++i)
      for (let j = 0; j < 3; ++j) if (matrix[i][j] !== 0) set[i] = set[j] = Math.min(set[i], set[j]);
  const found: Block[] = [];
  for (const label of [0, 1, 2]) {
    const members = [0, 1, 2].filter((k) => set[k] === label);
    const inRow = (i: number) => members.filter((j) => matrix[i][j] !== 0).map((j): Entry => [i, j, matrix[i][j]]);
    const entries = members.flatMap(inRow);
    if (!entries.length) continue;
    const sheared = !entries.some(([row]) => entries.some(([, column]) => column === row));
    if (sheared) found.push(...sourcesOf(entries));
    else if (members.length === 1)
      found.push({ kind: SCALE, coordinates: members, constants: [matrix[label][label]], tail: [], degree: 0 });
    else if (members.length === 2) found.push(planeOf(members, matrix));
    else found.push(seriesOf(entries));
  }
  return found;
}

// Blocks that share a run, in the order of the library: shears, and blocks of one kind with equal constants.
function runsOf(blocks: Block[]): Block[][] {
  const groups: Block[][] = [];
  for (const block of blocks) {
    const group = groups.find(
      ([first]) =>
        first.kind === block.kind && block.kind !== SERIES &&
        (block.kind === SHEAR || String(first.constants) === String(block.constants)),
    );
    if (group) group.push(block);
    else groups.push([block]);
  }
  return groups.sort((a, b) => a[0].kind - b[0].kind || a.length - b.length);
}

function actionOf(path: string, generators: number[][][]): Fields {
  const fields: Record<string, number[]> = {};
  for (const name of ["run", "kind", "angles", "repeat", "angle", "position", "constant", "width", "entries", "degree", "indices", "constants"])
    fields[name] = [];
  fields.run.push(0);
  for (const matrix of generators) {
    for (const group of runsOf(blocksOf(matrix))) {
      const [first] = group;
      fields.kind.push(first.kind);
      fields.angles.push(1);
      fields.repeat.push(group.length);
      fields.angle.push(0);
      fields.position.push(fields.indices.length);
      fields.constant.push(fields.constants.length);
      fields.width.push(first.coordinates.length);
      fields.entries.push(first.kind === SERIES ? first.constants.length - 1 : 0);
      fields.degree.push(first.degree);
      for (const block of group) fields.indices.push(...block.coordinates, ...block.tail);
      for (const block of first.kind === SHEAR ? group : [first]) fields.constants.push(...block.constants);
    }
    fields.run.push(fields.kind.length);
  }
  return { [`${path}size`]: 3, ...Object.fromEntries(Object.entries(fields).map(([name, values]) => [path + name, values])) };
}

interface Row {
  target: number;
  offset: number;
  entries: Array<[number, number]>; // column and weight
}

// Linear terms, each a list of rows.
function termsOf(path: string, terms: Row[][]): Fields {
  const rows = terms.flat(), entries = rows.flatMap((row) => row.entries);
  const counted = (lengths: number[]) => lengths.reduce((sums, size) => [...sums, sums[sums.length - 1] + size], [0]);
  return {
    [`${path}size`]: terms.length,
    [`${path}kind`]: terms.map(() => 0),
    [`${path}row`]: counted(terms.map((term) => term.length)),
    [`${path}target`]: rows.map((row) => row.target),
    [`${path}offset`]: rows.map((row) => row.offset),
    [`${path}entry`]: counted(rows.map((row) => row.entries.length)),
    [`${path}column`]: entries.map(([column]) => column),
    [`${path}weight`]: entries.map(([, weight]) => weight),
    [`${path}monomial`]: new Array(terms.length + 1).fill(0),
    ...Object.fromEntries(["coefficient", "factor_row", "exponent"].map((name) => [path + name, []])),
    [`${path}factor`]: [0],
  };
}

const energyRows = ({ squares, linear }: Algebra): Row[] =>
  [0, 1, 2].map((i) => ({ target: i, offset: linear[i], entries: squares[i] ? [[i, squares[i]]] : [] }));

const used = (rows: Row[]) => rows.filter((row) => row.offset !== 0 || row.entries.length);

function watchOf(path: string, algebra: Algebra): Fields {
  const terms = [used(energyRows(algebra)), ...casimirs(cube(algebra)).map((casimir) => used(casimir.rows))];
  return {
    [`${path}size`]: terms.length,
    ...termsOf(`${path}terms.`, terms),
    [`${path}addresses`]: terms.map(() => 0),
    [`${path}first`]: [...terms.map((_, k) => k), terms.length],
    [`${path}constant`]: terms.map(() => 0),
    [`${path}period`]: terms.map(() => 0),
    [`${path}longest`]: Math.max(...terms.map((term) => term.length)),
  };
}

function fieldOf(path: string, algebra: Algebra): Fields {
  const c = cube(algebra), entries: Array<[number, number, number, number]> = [];
  for (const [i, j] of [[0, 1], [0, 2], [1, 2]])
    for (let k = 0; k < 3; ++k) if (c[i][j][k] !== 0) entries.push([i, j, k, c[i][j][k]], [j, i, k, -c[i][j][k]]);
  entries.sort((a, b) => a[0] - b[0]);
  return {
    [`${path}size`]: 3,
    [`${path}sign`]: 1,
    [`${path}first`]: [0, 1, 2, 3].map((row) => entries.filter(([i]) => i < row).length),
    [`${path}column`]: entries.map(([, j]) => j),
    [`${path}state`]: entries.map(([, , k]) => k),
    [`${path}constant`]: entries.map(([, , , value]) => value),
    [`${path}nonlinear`]: 0,
    [`${path}structure`]: [],
    ...termsOf(`${path}terms.`, [energyRows(algebra)]),
    [`${path}addresses`]: [0],
    [`${path}longest`]: 3,
  };
}

export interface Casimir {
  name: string;
  rows: Row[];
}

// The one-dimensional kernel of a matrix with few columns, scaled to a leading one; null if there is none.
function kernel(rows: number[][], size: number): number[] | null {
  const left = rows.map((row) => [...row]), pivots: number[] = [];
  for (let column = 0, at = 0; column < size; ++column) {
    let best = at;
    for (let row = at; row < left.length; ++row) if (Math.abs(left[row][column]) > Math.abs(left[best]?.[column] ?? 0)) best = row;
    if (!left[best] || Math.abs(left[best][column]) <= TINY) continue;
    [left[at], left[best]] = [left[best], left[at]];
    for (let row = 0; row < left.length; ++row) {
      if (row === at) continue;
      const ratio = left[row][column] / left[at][column];
      for (let k = column; k < size; ++k) left[row][k] -= ratio * left[at][k];
    }
    pivots.push(column);
    ++at;
  }
  const free = Array.from({ length: size }, (_, k) => k).filter((k) => !pivots.includes(k));
  if (!free.length) return null;
  const vector = new Array<number>(size).fill(0);
  vector[free[0]] = 1;
  pivots.forEach((column, row) => (vector[column] = -left[row][free[0]] / left[row][column]));
  const lead = vector.find((x) => Math.abs(x) > TINY)!;
  return vector.map((x) => (Math.abs(x) > TINY ? x / lead : 0));
}

const SQUARES = [[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]];

// A linear or a quadratic Casimir, if there is one.
export function casimirs(c: Cube): Casimir[] {
  const linear = kernel([0, 1, 2].flatMap((i) => [0, 1, 2].map((k) => [0, 1, 2].map((j) => c[i][j][k]))), 3);
  if (linear) return [{ name: "C1", rows: linear.map((x, i) => ({ target: i, offset: x, entries: [] })) }];
  const equations: number[][] = [];
  for (let i = 0; i < 3; ++i)
    for (const [p, q] of SQUARES)
      equations.push(SQUARES.map(([a, b]) => {
        const product = (j: number, other: number) => [0, 1, 2].reduce(
          (sum, k) => sum + (Math.min(k, other) === p && Math.max(k, other) === q ? c[i][j][k] : 0), 0);
        return product(a, b) + product(b, a);
      }));
  const found = kernel(equations, 6);
  if (!found) return [];
  const rows: Row[] = [0, 1, 2].map((target) => ({ target, offset: 0, entries: [] }));
  SQUARES.forEach(([a, b], k) => {
    if (!found[k]) return;
    rows[a].entries.push([b, a === b ? 2 * found[k] : found[k]]);
    if (a !== b) rows[b].entries.push([a, found[k]]);
  });
  for (const row of rows) row.entries.sort((one, other) => one[0] - other[0]);
  return [{ name: "C2", rows }];
}

export function typedCode(algebra: Algebra): string {
  const c = cube(algebra), entry = (i: number, j: number, k: number) => `(${i}, ${j}, ${k}, ${python(c[i][j][k])})`;
  const brackets = PAIRS.flatMap(([i, j]) => [0, 1, 2].filter((k) => c[i][j][k]).map((k) => entry(i, j, k)));
  const numbers = (values: number[]) => `[${values.map(python).join(", ")}]`;
  return `co.LiePoissonSystem(
    co.LieAlgebra([${brackets.join(", ")}], dim=3),
    co.Quadratic(${numbers(algebra.squares)}, linear=${numbers(algebra.linear)}),
)`;
}

export const invariantsOf = (algebra: Algebra) => ["energy", ...casimirs(cube(algebra)).map((casimir) => casimir.name)];

// The tables of a scheme: what does not depend on the system is that of a system of the same dimension.
export function typedFields(tables: Tables, algebra: Algebra, name: string, h: number): Fields {
  const model = tables.systems.fluid_triad.schemes[name], fields: Fields = {};
  for (const [path, value] of Object.entries(model.fields))
    fields[path] = typeof value === "number" || Array.isArray(value) ? value : tables.arrays[value[""]];
  Object.assign(fields, watchOf("watch.", algebra));
  if (model.loop === "runge_kutta_advance") return Object.assign(fields, fieldOf("tables.field.", algebra));
  if (model.loop === "stepping_advance")
    return Object.assign(fields, fieldOf("tables.tables.field.", algebra), watchOf("tables.tables.restored.", algebra));
  const c = cube(algebra), parts = used(energyRows(algebra)), rows = tables.rows[name][parts.length - 1];
  if (!rows) throw new Error("the energy is zero");
  const zeros = parts.map(() => 0);
  return Object.assign(fields, {
    "tables.only": parts.map((_, k) => k),
    "tables.bent": zeros,
    "tables.frequency": zeros,
    "tables.part": rows.part,
    "tables.tau": rows.tau.map((coefficient) => coefficient * h),
    "tables.moment": rows.moment,
    "tables.section": rows.section,
    "tables.share": [0, ...parts.map((_, k) => k + 1)],
    ...termsOf("tables.terms.", parts.map((row) => [{ ...row, target: 0 }])),
    "tables.addresses": zeros,
    ...actionOf("tables.state.", parts.map(({ target }) => [0, 1, 2].map((j) => [0, 1, 2].map((l) => c[j][target][l])))),
    "tables.called": parts.map(() => -1),
    "tables.properties": zeros,
    "tables.step": h,
  });
}
