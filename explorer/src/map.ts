// The vorticity of a planet as it is seen, and the mean eastward speed by latitude beside it.
import { paint } from "./body";
import { clamp, type Matrix } from "./camera";
import { LATITUDES, LONGITUDES } from "./planet";
import { frameOf } from "./scene";
import type { Colors } from "./theme";
import type { Track } from "./track";

const PIXELS = 200; // of the edge of the drawn square
const MIDDLE = 0.34, RADIUS = 0.42; // of the disc: from the left, and of the smaller edge

interface Drawn {
  vorticity: Float64Array<ArrayBuffer>;
  fastest: number; // speed of the widest profile so far, of the axis
  count: number; // states so far
  disc: HTMLCanvasElement;
  pixels: ImageData;
}
const drawn = new WeakMap<Track, Drawn>();

function drawnOf(track: Track): Drawn {
  let found = drawn.get(track);
  if (!found) {
    const disc = document.createElement("canvas");
    disc.width = disc.height = PIXELS;
    const vorticity = new Float64Array(LATITUDES * LONGITUDES), pixels = disc.getContext("2d")!.createImageData(PIXELS, PIXELS);
    found = { vorticity, fastest: 0, count: 0, disc, pixels };
    drawn.set(track, found);
  }
  return found;
}

export function drawPlanet(
  canvas: HTMLCanvasElement, profile: HTMLCanvasElement, matrix: Matrix, track: Track, colors: Colors,
): void {
  const planet = track.plan.planet!, found = drawnOf(track), { data } = found.pixels;
  if (found.count !== track.count) planet.vorticity(track.x, found.vorticity);
  found.count = track.count;
  const { vorticity } = found, limit = 2.5 * Math.sqrt(vorticity.reduce((sum, x) => sum + x * x, 0) / vorticity.length) || 1;
  for (let row = 0; row < PIXELS; ++row)
    for (let column = 0; column < PIXELS; ++column) {
      const at = 4 * (row * PIXELS + column);
      const right = (2 * (column + 0.5)) / PIXELS - 1, up = 1 - (2 * (row + 0.5)) / PIXELS, rest = 1 - right * right - up * up;
      data[at + 3] = 0;
      if (rest < 0) continue;
      const front = Math.sqrt(rest);
      const [x, y, z] = [0, 1, 2].map((k) => right * matrix[k] + up * matrix[3 + k] + front * matrix[6 + k]);
      const south = clamp((0.5 - Math.asin(clamp(z, -1, 1)) / Math.PI) * LATITUDES - 0.5, 0, LATITUDES - 1);
      const east = (Math.atan2(y, x) / (2 * Math.PI) + 1) * LONGITUDES;
      const line = Math.min(LATITUDES - 2, Math.floor(south)), place = Math.floor(east), down = south - line, along = east - place;
      const left = line * LONGITUDES + (place % LONGITUDES), next = line * LONGITUDES + ((place + 1) % LONGITUDES);
      const upper = vorticity[left] * (1 - along) + vorticity[next] * along;
      const lower = vorticity[left + LONGITUDES] * (1 - along) + vorticity[next + LONGITUDES] * along;
      paint(data, at, (upper * (1 - down) + lower * down) / limit);
    }
  found.disc.getContext("2d")!.putImageData(found.pixels, 0, 0);
  const { context, middle, height, radius } = frameOf(canvas, matrix, RADIUS, MIDDLE);
  context.imageSmoothingEnabled = true;
  context.drawImage(found.disc, middle - radius, height / 2 - radius, 2 * radius, 2 * radius);
  drawProfile(profile, planet.zonal(track.x), found, colors);
}

function drawProfile(canvas: HTMLCanvasElement, speeds: number[], found: Drawn, colors: Colors): void {
  const { context, width, height } = frameOf(canvas, [], 1), bottom = 16;
  found.fastest = Math.max(found.fastest, ...speeds.map(Math.abs));
  const limit = 2 ** Math.ceil(Math.log2(found.fastest || 1)), across = (u: number) => width * (0.5 + (0.46 * u) / limit);
  const down = (row: number) => ((row + 0.5) / LATITUDES) * (height - bottom);
  context.strokeStyle = colors.line;
  context.lineWidth = 1;
  context.beginPath();
  for (const degrees of [-60, -30, 0, 30, 60]) {
    const y = (0.5 - degrees / 180) * (height - bottom);
    context.moveTo(0, y);
    context.lineTo(width, y);
  }
  context.moveTo(across(0), 0);
  context.lineTo(across(0), height - bottom);
  context.stroke();
  context.strokeStyle = colors.text;
  context.lineWidth = 1.7;
  context.beginPath();
  speeds.forEach((u, row) => (row ? context.lineTo(across(u), down(row)) : context.moveTo(across(u), down(row))));
  context.stroke();
  context.fillStyle = colors.muted;
  context.font = "11px system-ui, sans-serif";
  context.textAlign = "center";
  context.textBaseline = "bottom";
  context.fillText(`eastward, ±${limit}`, width / 2, height);
}
