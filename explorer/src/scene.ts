// The orbit of a run: on the sphere of every momentum, on a cylinder, or as a path in three coordinates.
import { apply, type Matrix, type Vector, length } from "./camera";
import { drawOrbit } from "./orbit";
import type { View } from "./tables";
import type { Colors } from "./theme";
import { type Track, TRAIL } from "./track";

const SCALE = 1.25; // ratio of the scales of a centered path
const FLAT = 0.55; // heights on the cylinder, drawn smaller

type Context = CanvasRenderingContext2D;

// From coordinates of a scene to pixels: x and y on the canvas, and the depth toward the reader.
export interface Frame {
  context: Context;
  width: number;
  height: number;
  middle: number; // of the scene, in pixels from the left
  radius: number; // pixels of one unit
  matrix: Matrix;
}

// In pixels: a part of the smaller edge, or what is left beside the middle.
const radiusOf = ({ clientWidth, clientHeight }: HTMLCanvasElement, part: number, middle: number) =>
  Math.min(part * Math.min(clientWidth, clientHeight), 0.95 * middle * clientWidth);

export function frameOf(canvas: HTMLCanvasElement, matrix: Matrix, part: number, middle = 0.5): Frame {
  const ratio = Math.min(2, devicePixelRatio || 1);
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d")!;
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height, middle: middle * width, radius: radiusOf(canvas, part, middle), matrix };
}

export function seen(frame: Frame, point: ArrayLike<number>): Vector {
  const [x, y, z] = apply(frame.matrix, point);
  return [frame.middle + frame.radius * x, frame.height / 2 - frame.radius * y, z];
}

// What a scene shows of a state: points in units of the scene, one for each ball.
export class Shape {
  readonly balls: number[][];
  private readonly radii: number[];
  private readonly middle: number[];

  constructor(private readonly view: View, x0: ArrayLike<number>, trail?: Iterable<Float64Array>) {
    this.balls = view.balls ?? [view.axes!];
    const of = (ball: number[], x: ArrayLike<number>) => ball.map((i) => x[i]);
    this.middle = [0, 0, 0];
    if (view.kind === "sphere") this.radii = this.balls.map((ball) => length(of(ball, x0)) || 1);
    else if (view.kind === "cylinder") this.radii = [Math.hypot(...of(view.axes!.slice(0, 2), x0)) * 1.6 || 1];
    else {
      const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
      for (const x of trail ?? [])
        this.balls[0].forEach((i, k) => {
          low[k] = Math.min(low[k], x[i]);
          high[k] = Math.max(high[k], x[i]);
        });
      const found = Number.isFinite(low[0]);
      if (view.centered) {
        const most = Math.max(1e-9, ...(found ? [...low, ...high] : of(this.balls[0], x0)).map(Math.abs));
        this.radii = [SCALE ** Math.ceil(Math.log(most * 1.1) / Math.log(SCALE))];
      } else {
        this.middle = found ? low.map((x, k) => (x + high[k]) / 2) : of(this.balls[0], x0);
        this.radii = [found ? Math.max(1e-9, ...low.map((x, k) => (high[k] - x) / 2)) * 1.3 : 1];
      }
    }
  }

  // Of the state that begins at `from`.
  point(ball: number, x: ArrayLike<number>, into: Vector, from = 0): Vector {
    const coordinates = this.balls[ball], scale = 1 / this.radii[ball];
    for (let k = 0; k < 3; ++k) into[k] = (x[from + coordinates[k]] - this.middle[k]) * scale;
    if (this.view.kind === "cylinder") into[2] *= FLAT;
    return into;
  }

  // The radius of a ball in units of its coordinates.
  radius(ball: number): number {
    return this.radii[ball];
  }
}

function curve(frame: Frame, points: Vector[], front: boolean): void {
  frame.context.beginPath();
  let drawing = false;
  for (const point of points) {
    const [x, y, z] = seen(frame, point);
    if (z >= 0 !== front) {
      drawing = false;
      continue;
    }
    if (drawing) frame.context.lineTo(x, y);
    else frame.context.moveTo(x, y);
    drawing = true;
  }
  frame.context.stroke();
}

const circle = (at: (angle: number) => Vector) => Array.from({ length: 73 }, (_, k) => at((k * Math.PI) / 36));
const GRID: Vector[][] = [
  ...[-60, -30, 0, 30, 60].map((degrees) => {
    const u = (degrees * Math.PI) / 180;
    return circle((t) => [Math.cos(u) * Math.cos(t), Math.cos(u) * Math.sin(t), Math.sin(u)]);
  }),
  ...[0, 30, 60, 90, 120, 150].map((degrees) => {
    const v = (degrees * Math.PI) / 180;
    return circle((t) => [Math.cos(t) * Math.cos(v), Math.cos(t) * Math.sin(v), Math.sin(t)]);
  }),
];
const TUBE: Vector[][] = [
  ...[-1.4, -0.7, 0, 0.7, 1.4].map((z) => circle((t) => [Math.cos(t) / 1.6, Math.sin(t) / 1.6, z / 1.6])),
  ...[0, 45, 90, 135, 180, 225, 270, 315].map((degrees) => {
    const v = (degrees * Math.PI) / 180;
    return Array.from({ length: 9 }, (_, k): Vector => [Math.cos(v) / 1.6, Math.sin(v) / 1.6, ((k - 4) * 0.35) / 1.6]);
  }),
];

function grid(frame: Frame, view: View, colors: Colors, front: boolean): void {
  const { context } = frame;
  context.lineWidth = 1;
  context.strokeStyle = colors.line;
  context.globalAlpha = front ? 0.55 : 0.25;
  if (view.kind === "sphere") for (const line of GRID) curve(frame, line, front);
  if (view.kind === "cylinder") for (const line of TUBE) curve(frame, line, front);
  context.globalAlpha = 1;
}

function ball(frame: Frame, colors: Colors): void {
  const { context, middle, height, radius } = frame;
  const shade = context.createRadialGradient(middle - radius * 0.35, height / 2 - radius * 0.4, radius * 0.1, middle, height / 2, radius);
  const [light, edge] = colors.dark
    ? ["rgba(150,175,200,0.26)", "rgba(60,75,95,0.34)"]
    : ["rgba(255,255,255,0.55)", "rgba(140,160,180,0.28)"];
  shade.addColorStop(0, light);
  shade.addColorStop(1, edge);
  context.fillStyle = shade;
  context.beginPath();
  context.arc(middle, height / 2, radius, 0, 2 * Math.PI);
  context.fill();
  context.strokeStyle = colors.line;
  context.stroke();
}

function axes(frame: Frame, view: View, names: string[], colors: Colors): void {
  const { context } = frame;
  const reach = view.kind === "sphere" ? 1.13 : 1.05;
  context.font = "13px system-ui, sans-serif";
  context.textAlign = "center";
  context.textBaseline = "middle";
  for (let k = 0; k < 3; ++k) {
    const tip: Vector = [0, 0, 0];
    tip[k] = reach;
    const [x, y, z] = seen(frame, tip);
    const [x0, y0] = seen(frame, tip.map((c) => c * (view.kind === "sphere" ? 0.9 : 0)));
    context.globalAlpha = z < -0.05 ? 0.45 : 1;
    context.strokeStyle = colors.muted;
    context.beginPath();
    context.moveTo(x0, y0);
    context.lineTo(x, y);
    context.stroke();
    context.fillStyle = colors.text;
    context.fillText(names[k], x + (x - frame.middle) * 0.06, y + (y - frame.height / 2) * 0.06);
  }
  context.globalAlpha = 1;
}

const AGES = 4;
const BALL = 0.41; // radius of the sphere, of the smaller edge

// Beside a body the scene is left of the middle.
const middleOf = (view: View) => (view.body ? 0.39 : 0.5);

// The pixels of the trail of a ball, from the oldest state on: x, y and whether it is in front, one after the other.
const projected = new Float32Array(3 * (TRAIL + 1));

function project(frame: Frame, track: Track, shape: Shape, number: number): number {
  const scratch: Vector = [0, 0, 0], kept = Math.min(track.count, track.capacity), size = track.x.length;
  const m = frame.matrix, middle = frame.middle, height = frame.height / 2;
  for (let k = 0; k < kept; ++k) {
    shape.point(number, track.trail, scratch, ((track.count - kept + k) % track.capacity) * size);
    const [x, y, z] = scratch;
    projected[3 * k] = middle + frame.radius * (m[0] * x + m[1] * y + m[2] * z);
    projected[3 * k + 1] = height - frame.radius * (m[3] * x + m[4] * y + m[5] * z);
    projected[3 * k + 2] = m[6] * x + m[7] * y + m[8] * z >= 0 ? 1 : 0;
  }
  return kept;
}

// The trail of one ball, older parts fainter; in front of the middle of the scene or behind it.
function trail(frame: Frame, track: Track, shape: Shape, number: number, color: string, front: boolean): void {
  const { context } = frame, kept = project(frame, track, shape, number), side = front ? 1 : 0;
  context.strokeStyle = color;
  context.lineWidth = front ? 1.7 : 1.2;
  context.lineJoin = "round";
  for (let age = 0; age < AGES; ++age) {
    const first = Math.floor((age * kept) / AGES), last = Math.floor(((age + 1) * kept) / AGES);
    context.globalAlpha = (front ? 1 : 0.4) * (0.25 + (0.75 * (age + 1)) / AGES);
    context.beginPath();
    let drawing = false;
    for (let k = Math.max(1, first); k < last; ++k) {
      const inside = projected[3 * k + 2] === side;
      if (inside) {
        if (!drawing) context.moveTo(projected[3 * k - 3], projected[3 * k - 2]);
        context.lineTo(projected[3 * k], projected[3 * k + 1]);
      }
      drawing = inside;
    }
    context.stroke();
  }
  context.globalAlpha = 1;
}

export const hue = (color: string, number: number, count: number) =>
  count > 2 ? `hsl(${Math.round((360 * number) / count)} 65% 50%)` : number ? "#d98b1f" : color;

export function drawScene(
  canvas: HTMLCanvasElement, matrix: Matrix, track: Track, shape: Shape, view: View, names: string[], color: string,
  colors: Colors, orbit: Vector[],
): void {
  const frame = frameOf(canvas, matrix, view.kind === "sphere" ? BALL : 0.47, middleOf(view));
  const { context } = frame, count = shape.balls.length, scratch: Vector = [0, 0, 0];
  grid(frame, view, colors, false);
  drawOrbit(frame, orbit, colors, false);
  for (let k = 0; k < count; ++k) trail(frame, track, shape, k, hue(color, k, count), false);
  if (view.kind === "sphere") ball(frame, colors);
  grid(frame, view, colors, true);
  drawOrbit(frame, orbit, colors, true);
  axes(frame, view, names, colors);
  for (let k = 0; k < count; ++k) trail(frame, track, shape, k, hue(color, k, count), true);
  for (let k = 0; k < count; ++k) {
    const [x, y, z] = seen(frame, shape.point(k, track.x, scratch));
    context.globalAlpha = z >= 0 ? 1 : 0.5;
    context.fillStyle = hue(color, k, count);
    context.strokeStyle = colors.panel;
    context.lineWidth = 1.5;
    context.beginPath();
    context.arc(x, y, count > 2 ? 4.5 : 6, 0, 2 * Math.PI);
    context.fill();
    context.stroke();
  }
  context.globalAlpha = 1;
}

// The point of the sphere under a pixel, on the side of the reader, or null.
export function picked(canvas: HTMLCanvasElement, matrix: Matrix, view: View, x: number, y: number): Vector | null {
  const middle = middleOf(view), radius = radiusOf(canvas, BALL, middle);
  const right = (x - canvas.clientWidth * middle) / radius, up = (canvas.clientHeight / 2 - y) / radius;
  const rest = 1 - right * right - up * up;
  if (rest < 0) return null;
  const front = [right, up, Math.sqrt(rest)];
  return [0, 1, 2].map((k) => front[0] * matrix[k] + front[1] * matrix[3 + k] + front[2] * matrix[6 + k]) as Vector;
}
