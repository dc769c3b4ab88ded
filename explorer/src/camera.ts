// Vectors and rotations of three dimensions, and the direction from which a scene is seen.
export type Vector = [number, number, number];
export type Matrix = number[]; // nine entries, row after row

export const dot = (a: ArrayLike<number>, b: ArrayLike<number>) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a: ArrayLike<number>, b: ArrayLike<number>): Vector => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0],
];
export const scaled = (a: ArrayLike<number>, s: number): Vector => [a[0] * s, a[1] * s, a[2] * s];
export const plus = (a: ArrayLike<number>, b: ArrayLike<number>): Vector => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const length = (a: ArrayLike<number>) => Math.hypot(a[0], a[1], a[2]);
export const apply = (m: Matrix, a: ArrayLike<number>): Vector => [
  m[0] * a[0] + m[1] * a[1] + m[2] * a[2], m[3] * a[0] + m[4] * a[1] + m[5] * a[2], m[6] * a[0] + m[7] * a[1] + m[8] * a[2],
];
export const transposed = (m: Matrix): Matrix => [m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]];
export function product(a: Matrix, b: Matrix): Matrix {
  const columns = transposed(b);
  return [0, 1, 2].flatMap((i) => [0, 1, 2].map((j) => dot(a.slice(3 * i, 3 * i + 3), columns.slice(3 * j, 3 * j + 3))));
}

// The rotation by the angle |w| about w.
export function rotation(w: ArrayLike<number>): Matrix {
  const angle = length(w);
  if (!(angle > 0)) return [1, 0, 0, 0, 1, 0, 0, 0, 1];
  const [x, y, z] = scaled(w, 1 / angle), s = Math.sin(angle), c = 1 - Math.cos(angle);
  return [
    1 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y,
    c * x * y + s * z, 1 - c * (x * x + z * z), c * y * z - s * x,
    c * x * z - s * y, c * y * z + s * x, 1 - c * (x * x + y * y),
  ];
}

// The shortest rotation from the direction of a to that of b.
export function between(a: ArrayLike<number>, b: ArrayLike<number>): Matrix {
  const axis = cross(a, b), sine = length(axis), angle = Math.atan2(sine, dot(a, b));
  if (sine > 0) return rotation(scaled(axis, angle / sine));
  if (angle === 0) return rotation([0, 0, 0]);
  const normal = cross(a, Math.abs(a[0]) < 0.9 * length(a) ? [1, 0, 0] : [0, 1, 0]);
  return rotation(scaled(normal, Math.PI / length(normal)));
}

// The first block of a group element, which is the rotation of a body; null if no group element is computed.
export function firstBlock(group: ArrayLike<number>): Matrix | null {
  const rows = Math.sqrt(group.length), axes = [0, 1, 2];
  return rows ? axes.flatMap((i) => axes.map((j) => group[i * rows + j])) : null;
}

// The largest entry of R^T R - 1.
export function rotationError(matrix: Matrix): number {
  return Math.max(...product(transposed(matrix), matrix).map((x, k) => Math.abs(x - (k % 4 === 0 ? 1 : 0))));
}

export const clamp = (x: number, low: number, high: number) => Math.min(high, Math.max(low, x));

// Right, up and toward the reader, of coordinates whose third axis points up.
export function camera([yaw, pitch]: [number, number]): Matrix {
  const [s, c, u, v] = [Math.sin(yaw), Math.cos(yaw), Math.sin(pitch), Math.cos(pitch)];
  return [c, s, 0, -u * s, u * c, v, s * v, -c * v, u];
}
