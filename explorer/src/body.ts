// The body in space, spins as arrows, and the vorticity of a fluid.
import { apply, between, length, type Matrix, plus, product, scaled, type Vector, dot } from "./camera";
import { type Frame, frameOf, hue, seen } from "./scene";
import type { Values, View } from "./tables";
import type { Colors } from "./theme";

const UP: Vector = [0, 0, 1];

// The attitude for the drawing, from the body to space, where the vertical of a top or the angular momentum at the start
// of a free body points up: the axes of both frames agree at first.
export function attitudeOf(view: View, rotation: Matrix, x0: ArrayLike<number>): Matrix {
  const first = view.body === "top" ? 3 : 0;
  return product(between([x0[first], x0[first + 1], x0[first + 2]], UP), rotation);
}

export function inertiaOf(values: Values): Vector {
  return [values.I1, values.I2, values.I3];
}

// Half the edges of a uniform box with these moments, the longest of length one.
export function box(inertia: Vector): Vector {
  const total = inertia[0] + inertia[1] + inertia[2];
  const edges = inertia.map((moment) => Math.sqrt(Math.max(0.02, total / 2 - moment))) as Vector;
  return scaled(edges, 1 / Math.max(...edges));
}

const FACES = [
  [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1],
] as const;

function face(normal: readonly number[], half: Vector): Vector[] {
  const k = normal.findIndex((x) => x !== 0), [i, j] = [(k + 1) % 3, (k + 2) % 3];
  return [[1, 1], [-1, 1], [-1, -1], [1, -1]].map(([a, b]) => {
    const corner: Vector = [0, 0, 0];
    corner[k] = normal[k] * half[k];
    corner[i] = a * half[i];
    corner[j] = b * half[j];
    return corner;
  });
}

// A spot in the middle of a face, which tells it from the opposite one.
function mark(context: CanvasRenderingContext2D, corners: Vector[]): void {
  const [x, y] = [0, 1].map((k) => (corners[0][k] + corners[2][k]) / 2);
  context.globalAlpha = 0.85;
  context.fillStyle = "#fff";
  context.beginPath();
  context.arc(x, y, 3, 0, 2 * Math.PI);
  context.fill();
}

function solid(frame: Frame, attitude: Matrix, half: Vector, middle: Vector, color: string, colors: Colors): void {
  const { context } = frame;
  const light: Vector = [0.35, 0.5, 0.79];
  for (const [number, normal] of FACES.entries()) {
    const outward = apply(frame.matrix, apply(attitude, normal));
    if (outward[2] <= 0) continue;
    const corners = face(normal, half).map((corner) => seen(frame, apply(attitude, plus(corner, middle))));
    context.beginPath();
    corners.forEach(([x, y], k) => (k ? context.lineTo(x, y) : context.moveTo(x, y)));
    context.closePath();
    context.fillStyle = [color, "#d98b1f", "#8fa1b3"][number >> 1];
    context.globalAlpha = 1;
    context.fill();
    const shade = dot(outward, light) - 0.55;
    context.fillStyle = shade > 0 ? "#fff" : "#000";
    context.globalAlpha = Math.abs(shade) * 0.55;
    context.fill();
    if (number % 2 === 0) mark(context, corners);
    context.globalAlpha = 1;
    context.strokeStyle = colors.panel;
    context.stroke();
  }
}

function arrow(frame: Frame, from: Vector, to: Vector, color: string, width: number): void {
  const { context } = frame;
  const [x0, y0] = seen(frame, from), [x1, y1] = seen(frame, to);
  const along = Math.hypot(x1 - x0, y1 - y0) || 1, u = (x1 - x0) / along, v = (y1 - y0) / along, head = Math.min(9, along / 2);
  context.strokeStyle = context.fillStyle = color;
  context.lineWidth = width;
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1 - u * head * 0.7, y1 - v * head * 0.7);
  context.stroke();
  context.beginPath();
  context.moveTo(x1, y1);
  context.lineTo(x1 - head * (u - 0.45 * v), y1 - head * (v + 0.45 * u));
  context.lineTo(x1 - head * (u + 0.45 * v), y1 - head * (v - 0.45 * u));
  context.fill();
}

export function drawBody(
  canvas: HTMLCanvasElement, camera: Matrix, view: View, attitude: Matrix | null, x: ArrayLike<number>, values: Values,
  color: string, colors: Colors,
): void {
  if (view.body === "vorticity") return drawVorticity(canvas, x, triadOf(values));
  if (view.body === "arrows") return drawArrows(canvas, camera, view, x, color, colors);
  if (!attitude) return;
  const frame = frameOf(canvas, camera, view.body === "top" ? 0.26 : 0.3), half = box(inertiaOf(values));
  if (view.body === "inertia") {
    arrow(frame, [0, 0, -1.5], [0, 0, 1.5], colors.muted, 1);
    solid(frame, attitude, half, [0, 0, 0], color, colors);
    return;
  }
  const lever: Vector = [values.l1, values.l2, values.l3], reach = length(lever) || 1;
  const middle = scaled(lever, 1.1 / reach);
  arrow(frame, [0, 0, -1.6], [0, 0, 1.6], colors.muted, 1);
  arrow(frame, [0, 0, 0], apply(attitude, middle), colors.text, 2);
  solid(frame, attitude, scaled(half, 0.5), middle, color, colors);
}

function drawArrows(
  canvas: HTMLCanvasElement, camera: Matrix, view: View, x: ArrayLike<number>, color: string, colors: Colors,
): void {
  const frame = frameOf(canvas, camera, 0.42), count = view.balls!.length, size = count > 2 ? 0.42 : 0.7;
  const order = view.balls!.map((ball, k) => {
    const at: Vector = [(1.6 * k) / (count - 1) - 0.8, 0, 0];
    return { at, ball, k, depth: apply(camera, at)[2] };
  });
  for (const { at, ball, k } of order.sort((a, b) => a.depth - b.depth)) {
    const spin = scaled(ball.map((i) => x[i]), size);
    arrow(frame, plus(at, scaled(spin, -0.6)), plus(at, spin), hue(color, k, count), 2.5);
    const [u, v] = seen(frame, at);
    frame.context.fillStyle = colors.muted;
    frame.context.beginPath();
    frame.context.arc(u, v, 2, 0, 2 * Math.PI);
    frame.context.fill();
  }
}

// Set a pixel to the color of a value between -1 and 1.
export function paint(data: Uint8ClampedArray, at: number, value: number): void {
  const far = Math.min(1, Math.abs(value)), [r, g, b] = value > 0 ? [200, 60, 50] : [40, 100, 190];
  data[at] = 246 + (r - 246) * far;
  data[at + 1] = 246 + (g - 246) * far;
  data[at + 2] = 246 + (b - 246) * far;
  data[at + 3] = 255;
}

const triadOf = ({ kx, ky }: Values) => [[1, 0], [kx, ky], [1 + kx, ky]];

const CELLS = 44;
let image: ImageData | null = null;

// The sum of waves on a square of two periods of the first.
function drawVorticity(canvas: HTMLCanvasElement, x: ArrayLike<number>, waves: number[][]): void {
  if (canvas.width !== CELLS) canvas.width = canvas.height = CELLS;
  const context = canvas.getContext("2d")!;
  image ??= context.createImageData(CELLS, CELLS);
  const most = Array.from(x).reduce((sum, amplitude) => sum + Math.abs(amplitude), 0) || 1;
  for (let row = 0; row < CELLS; ++row)
    for (let column = 0; column < CELLS; ++column) {
      const u = (column / CELLS) * 4 * Math.PI, v = (row / CELLS) * 4 * Math.PI;
      let value = 0;
      for (const [k, wave] of waves.entries()) {
        const phase = wave[0] * u + wave[1] * v;
        value += x[k] * Math.cos(phase);
      }
      paint(image.data, 4 * (row * CELLS + column), (value / most) * 1.3);
    }
  context.putImageData(image, 0, 0);
}

