// The level set of a Casimir in three dimensions, which contains the coadjoint orbit, as its lines in planes of the axes.
import type { Casimir } from "./algebra";
import type { Vector } from "./camera";
import { type Frame, seen } from "./scene";
import type { Colors } from "./theme";

const PLANES = 9, CELLS = 28;

function valueOf(casimir: Casimir, x: ArrayLike<number>): number {
  return casimir.rows.reduce(
    (sum, { target, offset, entries }) =>
      sum + x[target] * (offset + 0.5 * entries.reduce((inner, [column, weight]) => inner + weight * x[column], 0)), 0);
}

// Pairs of ends of short lines within the cube of half edge `radius`, in units of it.
export function orbitLines(casimir: Casimir, x0: ArrayLike<number>, radius: number): Vector[] {
  const level = valueOf(casimir, x0), lines: Vector[] = [];
  const coordinate = (k: number, count: number) => (2 * k) / count - 1;
  for (let normal = 0; normal < 3; ++normal)
    for (let plane = 0; plane < PLANES; ++plane) {
      const point = (i: number, j: number): Vector => {
        const x: Vector = [0, 0, 0];
        x[normal] = coordinate(plane, PLANES - 1);
        x[(normal + 1) % 3] = coordinate(i, CELLS);
        x[(normal + 2) % 3] = coordinate(j, CELLS);
        return x;
      };
      const height = (x: Vector) => valueOf(casimir, x.map((c) => c * radius)) - level;
      const points = Array.from({ length: CELLS + 1 }, (_, i) => Array.from({ length: CELLS + 1 }, (_, j) => point(i, j)));
      const heights = points.map((row) => row.map(height));
      for (let i = 0; i < CELLS; ++i)
        for (let j = 0; j < CELLS; ++j) {
          const corners = [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]], ends: Vector[] = [];
          for (let k = 0; k < 4; ++k) {
            const [a, b] = [corners[k], corners[(k + 1) % 4]], from = heights[a[0]][a[1]], to = heights[b[0]][b[1]];
            if (from < 0 === to < 0) continue;
            const part = from / (from - to), p = points[a[0]][a[1]], q = points[b[0]][b[1]];
            ends.push(p.map((c, n) => c + part * (q[n] - c)) as Vector);
          }
          for (let k = 0; k + 1 < ends.length; k += 2) lines.push(ends[k], ends[k + 1]);
        }
    }
  return lines;
}

export function drawOrbit(frame: Frame, lines: Vector[], colors: Colors, front: boolean): void {
  const { context } = frame;
  context.strokeStyle = colors.line;
  context.lineWidth = 1;
  context.globalAlpha = front ? 0.6 : 0.28;
  context.beginPath();
  for (let k = 0; k < lines.length; k += 2) {
    const [x0, y0, z0] = seen(frame, lines[k]), [x1, y1, z1] = seen(frame, lines[k + 1]);
    if (z0 + z1 >= 0 !== front) continue;
    context.moveTo(x0, y0);
    context.lineTo(x1, y1);
  }
  context.stroke();
  context.globalAlpha = 1;
}
