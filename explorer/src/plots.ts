// Errors of invariants on logarithmic axes, and the Poincaré section.
import { Errors, type Track } from "./track";
import type { Colors } from "./theme";
import { frameOf } from "./scene";

type Context = CanvasRenderingContext2D;
const LEFT = 46, BOTTOM = 30, TOP = 8, RIGHT = 10;
const LOWEST = -17; // decade drawn for errors of zero

interface Axes {
  context: Context;
  across: (value: number) => number;
  up: (value: number) => number;
}

const SUPERSCRIPTS = "⁰¹²³⁴⁵⁶⁷⁸⁹";
const power = (n: number) => "10" + String(n).replace("-", "⁻").replace(/\d/g, (digit) => SUPERSCRIPTS[Number(digit)]);

function prepared(canvas: HTMLCanvasElement): { context: Context; width: number; height: number } {
  const { context, width, height } = frameOf(canvas, [], 1);
  context.font = "12px system-ui, sans-serif";
  context.lineWidth = 1;
  return { context, width, height };
}

function logAxes(canvas: HTMLCanvasElement, low: [number, number], high: [number, number], colors: Colors): Axes {
  const { context, width, height } = prepared(canvas);
  const across = (value: number) => LEFT + ((value - low[0]) / (high[0] - low[0])) * (width - LEFT - RIGHT);
  const up = (value: number) => height - BOTTOM - ((value - low[1]) / (high[1] - low[1])) * (height - BOTTOM - TOP);
  context.strokeStyle = colors.line;
  context.fillStyle = colors.muted;
  context.globalAlpha = 1;
  const rows = Math.max(1, Math.ceil((high[1] - low[1]) / 5));
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (let k = Math.ceil(low[1]); k <= high[1]; k += rows) {
    line(context, LEFT, up(k), width - RIGHT, up(k));
    context.fillText(power(k), LEFT - 6, up(k));
  }
  context.textAlign = "center";
  context.textBaseline = "top";
  for (let k = Math.ceil(low[0]); k <= high[0]; ++k) {
    line(context, across(k), TOP, across(k), height - BOTTOM);
    context.fillText(power(k), across(k), height - BOTTOM + 4);
  }
  context.textAlign = "right";
  context.fillText("steps", width - RIGHT, height - 13);
  return { context, across, up };
}

function line(context: Context, x0: number, y0: number, x1: number, y1: number): void {
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.stroke();
}

const decade = (error: number) => (error > 0 ? Math.max(LOWEST, Math.log10(error)) : LOWEST);

// The largest error until each step, of both runs.
export function drawErrors(canvas: HTMLCanvasElement, errors: Errors[], colors: Colors): void {
  let low = 0, high = -Infinity, last = 1;
  for (const one of errors) {
    last = Math.max(last, one.last);
    for (let bin = 0; bin <= one.last; ++bin) {
      const error = one.largest[bin];
      if (!Number.isFinite(error)) continue;
      low = Math.min(low, decade(error));
      high = Math.max(high, decade(error));
    }
  }
  if (!Number.isFinite(high)) [low, high] = [LOWEST, 0];
  const top = Math.max(Math.ceil(high + 0.3), Math.floor(low) + 4);
  const end = Math.max(2, Math.log10(Errors.step(last)) * 1.02);
  const axes = logAxes(canvas, [0, Math.floor(low - 0.3)], [end, top], colors);
  errors.forEach((one, number) => {
    const { context } = axes;
    context.strokeStyle = number ? colors.b : colors.a;
    context.lineWidth = 2;
    context.setLineDash(number ? [6, 3] : []);
    context.beginPath();
    let drawing = false;
    for (let bin = 0; bin <= one.last; ++bin) {
      const error = one.largest[bin];
      if (Number.isNaN(error)) continue;
      const x = axes.across(Math.log10(Errors.step(bin))), y = axes.up(Math.min(decade(error), top));
      if (drawing) context.lineTo(x, y);
      else context.moveTo(x, y);
      drawing = true;
    }
    context.stroke();
    context.setLineDash([]);
  });
}

// The points of the section, one run beside the other.
export function drawSection(canvas: HTMLCanvasElement, tracks: Track[], labels: [string, string], colors: Colors): void {
  const { context, width, height } = prepared(canvas);
  let low = [Infinity, Infinity], high = [-Infinity, -Infinity];
  for (const track of tracks)
    track.crossings.forEach((value, k) => {
      low[k % 2] = Math.min(low[k % 2], value);
      high[k % 2] = Math.max(high[k % 2], value);
    });
  if (!Number.isFinite(low[0])) [low, high] = [[-1, -1], [1, 1]];
  const margin = low.map((x, k) => Math.max(1e-6, 0.08 * (high[k] - x)));
  const across = (x: number) => LEFT + ((x - low[0] + margin[0]) / (high[0] - low[0] + 2 * margin[0])) * (width - LEFT - RIGHT);
  const up = (y: number) => height - BOTTOM - ((y - low[1] + margin[1]) / (high[1] - low[1] + 2 * margin[1])) * (height - BOTTOM - TOP);
  context.strokeStyle = colors.line;
  context.strokeRect(LEFT, TOP, width - LEFT - RIGHT, height - BOTTOM - TOP);
  context.fillStyle = colors.muted;
  context.textBaseline = "middle";
  for (const part of [0.1, 0.9]) {
    const x = low[0] + part * (high[0] - low[0]), y = low[1] + part * (high[1] - low[1]);
    context.textAlign = "center";
    context.fillText(x.toPrecision(2), across(x), height - BOTTOM + 12);
    context.textAlign = "right";
    context.fillText(y.toPrecision(2), LEFT - 5, up(y));
  }
  context.fillText(labels[1], LEFT - 8, (height - BOTTOM) / 2);
  context.textAlign = "center";
  context.fillText(labels[0], (LEFT + width) / 2, height - BOTTOM + 14);
  tracks.forEach((track, number) => {
    context.fillStyle = number ? colors.b : colors.a;
    for (let k = 0; k < track.crossings.length; k += 2)
      context.fillRect(across(track.crossings[k]) - 1.5, up(track.crossings[k + 1]) - 1.5, 3, 3);
  });
}
