// A flow on a rotating sphere as matrices: the tables of the kernels for any parameters, states from modes of their
// relative vorticity, and what the page shows of a state. The numbers are those of `sphere_qg` of the library, whose
// matrices are described in `systems/matrices/spherical_modes.py`. Entry (i, i + m) of a matrix is on its diagonal m;
// tables of tridiagonal matrices on diagonals have its coefficient at [i, m].
import type { Fields, Kernels } from "./kernels";

interface Tridiagonal {
  main: Float64Array;
  beside: Float64Array; // beside[i, m] couples the entries (i - 1, i - 1 + m) and (i, i + m)
}

export const LATITUDES = 48, LONGITUDES = 96; // of the map
const POWERS = [2, 3, 4];

// Minus the Laplacian, with the eigenvalues l(l + 1).
function laplacian(N: number): Tridiagonal {
  const main = new Float64Array(N * N).fill(1), beside = new Float64Array(N * N);
  for (let i = 0; i < N; ++i)
    for (let m = 0; i + m < N; ++m) {
      main[i * N + m] = (N - 1) * (2 * i + 1 + m) - 2 * i * (i + m);
      beside[i * N + m] = -Math.sqrt(i * (N - i) * ((i + m) * (N - i - m)));
    }
  return { main, beside };
}

// The product with the squared sine of the latitude times `lamb`.
function screening(N: number, lamb: number, of: Tridiagonal): Tridiagonal {
  const main = new Float64Array(N * N), beside = new Float64Array(N * N), M = N * N - 1;
  const x = (i: number, m: number) => (i >= 0 && i + m < N ? (N - 1 - 2 * i - m) / Math.sqrt(M) : 0);
  for (let i = 0; i < N; ++i)
    for (let m = 0; i + m < N; ++m) {
      const here = x(i, m), middle = (x(i - 1, m) + here) / 2, at = i * N + m;
      main[at] = lamb * (here * here * (1 - 1 / M) + (of.main[at] * here * here) / M);
      beside[at] = (lamb * of.beside[at] * middle * middle) / M;
    }
  return { main, beside };
}

// The factors of minus the inverse on each diagonal: below the diagonal of L, then inverse pivots. The first number marks
// a map that ignores the trace.
function factors(N: number, { main, beside }: Tridiagonal): Float64Array {
  const found = new Float64Array(2 * N * N);
  for (let m = 0; m < N; ++m) {
    let pivot = main[m];
    found[N * N + m] = -1 / pivot;
    for (let i = 1; i + m < N; ++i) {
      const at = i * N + m, below = beside[at] / pivot;
      found[at] = below;
      pivot = main[at] - below * beside[at];
      const singular = m === 0 && i === N - 1 && Math.abs(pivot) <= 1e-10 * Math.abs(main[at]);
      found[N * N + at] = singular ? 0 : -1 / pivot;
    }
  }
  found[0] = 1;
  return found;
}

// Real and imaginary parts side by side, row after row.
export type State = Float64Array;

export class Planet {
  readonly scale: number; // S, of W = i S sum of c_lm T_lm
  readonly size: number;
  private readonly screening: Tridiagonal;
  private readonly inverse: Float64Array; // of the operator of q
  private readonly unscreened: Float64Array; // of the Laplacian
  private readonly planetary: Float64Array; // the imaginary parts of the diagonal at rest
  private readonly harmonics: Float64Array[] = []; // of each m, T_lm as [l - m, i]
  private readonly latitudes = Array.from({ length: LATITUDES }, (_, row) => Math.PI * (0.5 - (row + 0.5) / LATITUDES));
  private readonly legendre: Float64Array[] = []; // of each m, Y_lm at longitude 0 as [row, l - m]
  private readonly slopes: Float64Array; // eastward speed of the stream functions Y_l0, as [row, l]

  constructor(readonly N: number, lamb: number, rotation: number) {
    this.scale = Math.sqrt((N * (N * N - 1)) / (16 * Math.PI));
    this.size = 2 * N * N;
    const L = laplacian(N), screen = screening(N, lamb, L);
    this.screening = screen;
    this.unscreened = factors(N, L);
    this.inverse = factors(N, { main: L.main.map((x, k) => x + screen.main[k]), beside: L.beside.map((x, k) => x + screen.beside[k]) });
    this.planetary = Float64Array.from({ length: N }, (_, i) => 2 * rotation * ((N - 1) / 2 - i));
    for (let m = 0; m < N; ++m) {
      this.harmonics.push(harmonicsOf(N, m));
      this.legendre.push(legendreOf(N, m, this.latitudes));
    }
    this.slopes = new Float64Array(LATITUDES * N);
    this.latitudes.forEach((latitude, row) => {
      const mu = Math.sin(latitude), Y = this.legendre[0];
      for (let l = 1; l < N; ++l) {
        const before = Y[row * N + l - 1] / Math.sqrt((2 * l - 1) / (2 * l + 1));
        this.slopes[row * N + l] = (-l * (before - mu * Y[row * N + l])) / Math.cos(latitude);
      }
    });
  }

  // The fields of the tables of a scheme: those of the export, with the numbers of these parameters.
  fields(kernels: Kernels, fields: Fields): Fields {
    const { N, size } = this, minus = this.solved(this.atRest(), this.inverse).map((x) => -x);
    const whole = Array.from(fields["tables.tables.whole"] as number[]);
    whole[0] = N;
    for (let k = 0; k < 3; ++k) whole[6 + k] = (kernels.wasm.product_address as (number: number) => number)(k);
    return {
      ...fields, "tables.tables.whole": whole, "tables.tables.field.size": size, "tables.tables.field.first": new Float64Array(size + 1),
      "tables.tables.coefficients": [...(fields["tables.tables.coefficients"] as number[]), ...minus, ...this.inverse],
    };
  }

  // The state of a relative vorticity, from its modes: rows l, m, real and imaginary part.
  state(modes: number[][]): State {
    const { N } = this, W = new Float64Array(this.size);
    for (const [l, m, re, im] of modes)
      for (let i = 0; i + m < N; ++i) {
        const entry = this.scale * this.entry(l, m, i), at = 2 * (i * N + i + m);
        W[at] -= entry * im;
        W[at + 1] += entry * re;
      }
    const screened = this.screened(this.solved(mirrored(N, W), this.unscreened)), rest = this.atRest();
    return W.map((x, k) => x - screened[k] + rest[k]);
  }

  // T_lm at the entry (i, i + m).
  private entry(l: number, m: number, i: number): number {
    const n = this.N - m, half = n - (n >> 1), upper = i < half;
    const value = this.harmonics[m][(l - m) * half + (upper ? i : n - 1 - i)];
    return upper || (l - m) % 2 === 0 ? value : -value;
  }

  private atRest(): State {
    const { N } = this, W = new Float64Array(this.size);
    for (let i = 0; i < N; ++i) W[2 * (i * N + i) + 1] = this.planetary[i];
    return W;
  }

  private moving(W: ArrayLike<number>): State {
    const rest = this.atRest();
    return rest.map((x, k) => W[k] - x);
  }

  // The stream function of a vorticity, by the factors of an operator.
  private solved(W: State, table: Float64Array): State {
    const { N } = this, P = W.slice();
    centre(N, P);
    for (let i = 1; i < N; ++i)
      for (let m = 0; i + m < N; ++m)
        for (let part = 0; part < 2; ++part)
          P[2 * (i * N + i + m) + part] -= table[i * N + m] * P[2 * ((i - 1) * N + i - 1 + m) + part];
    for (let i = N - 1; i >= 0; --i)
      for (let m = 0; i + m < N; ++m)
        for (let part = 0; part < 2; ++part) {
          const at = 2 * (i * N + i + m) + part;
          P[at] *= table[N * N + i * N + m];
          if (i + m + 1 < N) P[at] -= table[(i + 1) * N + m] * P[at + 2 * N + 2];
        }
    centre(N, P);
    return mirrored(N, P);
  }

  // lamb mu^2 psi, of the mean of psi for which that of the product is zero.
  private screened(P: State): State {
    const { N } = this, one = new Float64Array(this.size);
    for (let i = 0; i < N; ++i) one[2 * (i * N + i) + 1] = 1;
    const of = product(N, this.screening, P), ofOne = product(N, this.screening, one);
    const mean = trace(N, ofOne) ? trace(N, of) / trace(N, ofOne) : 0;
    return of.map((x, k) => x - mean * ofOne[k]);
  }

  // The energy of the motion, and traces of powers of the Hermitian matrix -i W.
  readonly invariants = ["energy", ...POWERS.map((k) => `tr W^${k}`)];

  values(W: ArrayLike<number>): number[] {
    const { N } = this, V = this.moving(W), P = this.solved(V, this.inverse);
    let energy = 0;
    for (let k = 0; k < this.size; ++k) energy -= (0.5 * P[k] * V[k]) / this.scale ** 2;
    // The square of H, of which entries below the diagonal are conjugate.
    const traces = [0, 0, 0];
    for (let i = 0; i < N; ++i)
      for (let j = i; j < N; ++j) {
        let re = 0, im = 0;
        // H_ik = (b, -a) for W_ik = a + ib, and H_kj is conjugate to H_jk.
        for (let k = 0; k < N; ++k) {
          const a = 2 * (i * N + k), b = 2 * (j * N + k);
          re += W[a + 1] * W[b + 1] + W[a] * W[b];
          im += W[a + 1] * W[b] - W[a] * W[b + 1];
        }
        const twice = i === j ? 1 : 2, at = 2 * (i * N + j);
        if (i === j) traces[0] += re;
        traces[1] += twice * (re * W[at + 1] - im * W[at]);
        traces[2] += twice * (re * re + im * im);
      }
    return [energy, ...traces];
  }

  // The sizes by which errors of these are divided: of a matrix whose eigenvalues are equal but for their signs.
  units(values: ArrayLike<number>): number[] {
    return [Math.abs(values[0]), ...POWERS.map((k) => this.N * (values[1] / this.N) ** (k / 2))];
  }

  // Coefficients of order m of a field, by degrees from m on, from its matrix.
  private modes(W: State, m: number): Float64Array {
    const { N } = this, n = N - m, found = new Float64Array(2 * n), half = n - (n >> 1), V = this.harmonics[m];
    for (let i = 0; i < n; ++i) {
      const at = 2 * (i * N + i + m), re = W[at + 1] / this.scale, im = -W[at] / this.scale;
      const column = i < half ? i : n - 1 - i;
      for (let k = 0; k < n; ++k) {
        const entry = i >= half && k % 2 ? -V[k * half + column] : V[k * half + column];
        found[2 * k] += entry * re;
        found[2 * k + 1] += entry * im;
      }
    }
    return found;
  }

  // The relative vorticity, row after row from north to south.
  vorticity(W: ArrayLike<number>, values: Float64Array<ArrayBuffer> = new Float64Array(LATITUDES * LONGITUDES)): Float64Array<ArrayBuffer> {
    const { N } = this, V = this.moving(W), screened = this.screened(this.solved(V, this.inverse));
    const relative = V.map((x, k) => x + screened[k]);
    values.fill(0);
    for (let m = 0; m < Math.min(N, LONGITUDES / 2); ++m) {
      const c = this.modes(relative, m), Y = this.legendre[m], n = N - m, twice = m ? 2 : 1;
      for (let row = 0; row < LATITUDES; ++row) {
        let re = 0, im = 0;
        for (let k = 0; k < n; ++k) {
          re += Y[row * n + k] * c[2 * k];
          im += Y[row * n + k] * c[2 * k + 1];
        }
        const cosine = Math.cos((2 * Math.PI * m) / LONGITUDES), sine = Math.sin((2 * Math.PI * m) / LONGITUDES);
        for (let column = 0, x = twice * re, y = twice * im; column < LONGITUDES; ++column) {
          values[row * LONGITUDES + column] += x;
          [x, y] = [x * cosine - y * sine, x * sine + y * cosine];
        }
      }
    }
    return values;
  }

  // The mean eastward speed at the latitudes of the map.
  zonal(W: ArrayLike<number>): number[] {
    const { N } = this, c = this.modes(this.solved(this.moving(W), this.inverse), 0);
    return this.latitudes.map((_, row) => {
      let speed = 0;
      for (let l = 1; l < N; ++l) speed += this.slopes[row * N + l] * c[2 * l];
      return speed;
    });
  }

  readonly names = this.latitudes.map((latitude) => `u at ${((180 * latitude) / Math.PI).toFixed(3)}`);
}

// The trace of a skew-Hermitian matrix over i.
function trace(N: number, W: State): number {
  let sum = 0;
  for (let i = 0; i < N; ++i) sum += W[2 * (i * N + i) + 1];
  return sum;
}

function centre(N: number, W: State): void {
  const mean = trace(N, W) / N;
  for (let i = 0; i < N; ++i) W[2 * (i * N + i) + 1] -= mean;
}

// Set the entries below the diagonal of a skew-Hermitian matrix.
function mirrored(N: number, W: State): State {
  for (let i = 0; i < N; ++i)
    for (let j = i + 1; j < N; ++j) {
      W[2 * (j * N + i)] = -W[2 * (i * N + j)];
      W[2 * (j * N + i) + 1] = W[2 * (i * N + j) + 1];
    }
  return W;
}

function product(N: number, { main, beside }: Tridiagonal, P: State): State {
  const found = new Float64Array(P.length);
  for (let i = 0; i < N; ++i)
    for (let m = 0; i + m < N; ++m)
      for (let part = 0; part < 2; ++part) {
        const at = 2 * (i * N + i + m) + part;
        let value = main[i * N + m] * P[at];
        if (i > 0) value += beside[i * N + m] * P[at - 2 * N - 2];
        if (i + m + 1 < N) value += beside[(i + 1) * N + m] * P[at + 2 * N + 2];
        found[at] = value;
      }
  return mirrored(N, found);
}

// T_lm at the entries (i, i + m) up to the middle, as [l - m, i]; the parity is that of l - m. The position along the
// diagonal times T_lm is a sum of its neighbours in l, a recurrence that is stable from either end up to its peak.
function harmonicsOf(N: number, m: number): Float64Array {
  const n = N - m, half = n - (n >> 1), V = new Float64Array(n * half);
  const beside = Array.from({ length: n - 1 }, (_, k) => {
    const l = m + 1 + k;
    return Math.sqrt(((l * l - m * m) * (N * N - l * l)) / (4 * l * l - 1)) / 2;
  });
  const peak = beside.indexOf(Math.max(...beside)), last = n - 1;
  for (let i = 0; i < half; ++i) {
    const position = (n - 1) / 2 - i, up = [1], down = [1];
    for (let k = 0; k <= peak && k < last; ++k) up.push((position * up[k] - (k ? beside[k - 1] * up[k - 1] : 0)) / beside[k]);
    for (let k = 0; k < last - peak; ++k)
      down.push((position * down[k] - (k ? beside[last - k] * down[k - 1] : 0)) / beside[last - 1 - k]);
    if (n > 1) {
      const [a, b] = [down[last - peak], down[last - peak - 1]];
      const factor = (up[peak] * a + up[peak + 1] * b) / (a * a + b * b);
      for (let k = peak + 2; k < n; ++k) up.push(factor * down[last - k]);
    }
    const length = ((m % 2) ? -1 : 1) / Math.sqrt(up.reduce((sum, x) => sum + x * x, 0));
    up.forEach((x, k) => (V[k * half + i] = x * length));
  }
  return V;
}

// Orthonormal harmonics Y_lm at longitude 0, as [row, l - m], in the phase of Condon and Shortley.
function legendreOf(N: number, m: number, latitudes: number[]): Float64Array {
  const n = N - m, found = new Float64Array(latitudes.length * n);
  latitudes.forEach((latitude, row) => {
    const mu = Math.sin(latitude);
    let value = Math.sqrt(1 / (4 * Math.PI)), before = 0;
    for (let k = 1; k <= m; ++k) value *= -Math.cos(latitude) * Math.sqrt((2 * k + 1) / (2 * k));
    for (let l = m; l < N; ++l) {
      found[row * n + l - m] = value;
      const next = l + 1, a = Math.sqrt((4 * next * next - 1) / (next * next - m * m));
      const b = Math.sqrt((l * l - m * m) / (4 * l * l - 1) || 0);
      [value, before] = [a * (mu * value - b * before), value];
    }
  });
  return found;
}
