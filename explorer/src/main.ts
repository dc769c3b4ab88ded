// The page: loads the kernels and the tables, draws a frame after the other, and keeps the choice in the address.
import { App } from "./app";
import { attitudeOf, drawBody } from "./body";
import { camera, clamp, rotationError } from "./camera";
import { element } from "./controls";
import { csv, download, pythonScript } from "./exports";
import { Kernels } from "./kernels";
import { buildPanel } from "./panel";
import { drawPlanet } from "./map";
import { drawErrors, drawSection } from "./plots";
import { drawScene, picked } from "./scene";
import { FIRST_TURN, firstChoice, read, written } from "./state";
import { checked, type Tables } from "./tables";
import { applyTheme, colors, toggleTheme } from "./theme";

const TURN_OF_KEY = 0.08, TURN_OF_PIXEL = 0.008, CLICK_PIXELS = 4;
const FPS_FRAMES = 60;

const message = document.getElementById("message")!;
const at = (id: string) => document.getElementById(id)!;

interface Card {
  title: HTMLElement;
  hint: HTMLElement;
  scene: HTMLCanvasElement;
  body: HTMLCanvasElement;
  readout: HTMLElement;
}

function card(name: string): Card & { figure: HTMLElement } {
  const title = element("b"), readout = element("p", { className: "readout" });
  const scene = element("canvas", { className: "scene", tabIndex: 0 }), body = element("canvas", { className: "body" });
  scene.setAttribute("role", "img");
  body.setAttribute("aria-hidden", "true");
  const hint = element("span", { className: "hint" }), caption = element("figcaption", {}, title, hint);
  return { title, hint, scene, body, readout, figure: element("figure", { className: `card ${name}` }, caption, scene, body, readout) };
}

const power = (error: number) => (error === 0 ? "0" : Number.isFinite(error) ? error.toExponential(1) : "not a number");

class Page {
  private readonly cards = ["a", "b"].map(card);
  private readonly energy = this.plot("Energy error |H − H₀|, largest so far");
  private readonly casimirs = this.plot("Casimir error |C − C₀|, largest so far");
  private readonly section = this.plot("");
  private palette = colors();
  private last = 0;
  private shown = false;
  private readonly times: number[] = [];
  private pending = 0;

  constructor(readonly app: App) {
    at("scenes").append(...this.cards.map(({ figure }) => figure));
    at("plots").append(...[this.energy, this.casimirs, this.section].map(({ figure }) => figure));
    for (const [k, { scene }] of this.cards.entries()) this.listen(scene, k);
    at("theme").addEventListener("click", () => {
      toggleTheme();
      this.palette = colors();
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      applyTheme();
      this.palette = colors();
    });
    addEventListener("hashchange", () => {
      const text = location.hash.slice(1);
      if (text === written(app.tables, app.choice)) return;
      this.open(text);
    });
    addEventListener("keydown", (event) => {
      const typing = (event.target as HTMLElement).closest("input, select, button, summary, a");
      if (event.key !== " " || typing) return;
      event.preventDefault();
      at("play").click();
    });
    this.open(location.hash.slice(1));
    requestAnimationFrame((time) => this.frame(time));
  }

  // The choice of an address, and what of it is not taken.
  private open(text: string): void {
    const { app } = this, refused: string[] = [];
    app.choice = read(app.tables, text, refused);
    this.rebuild();
    if (refused.length && !app.problem) this.refuse(`The address has values that are not taken: ${refused.join(", ")}.`);
  }

  private refuse(reason: string): void {
    message.textContent = reason;
  }

  // What an algebra that is not run would copy or store; its reason is shown instead.
  private whenValid(action: () => void): void {
    if (this.app.problem) this.refuse(`${this.app.problem} Nothing is copied.`);
    else action();
  }

  private plot(text: string): { figure: HTMLElement; canvas: HTMLCanvasElement; caption: HTMLElement } {
    const canvas = element("canvas", { className: "plot" }), caption = element("figcaption", {}, text);
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", text);
    return { canvas, caption, figure: element("figure", { className: "card" }, caption, canvas) };
  }

  // The settings of another system.
  rebuild(): void {
    this.app.restart();
    at("controls").replaceChildren(...buildPanel(this.app, {
      changed: (restart) => {
        if (restart) this.app.restart();
        this.changed();
      },
      rebuilt: () => this.rebuild(),
      copyScript: () => this.whenValid(() => this.copy(this.script(), "The script is in the clipboard.")),
      download: () => this.whenValid(() => this.save()),
      copyLink: () => this.whenValid(() => {
        this.store();
        this.copy(location.href, "The link is in the clipboard.");
      }),
      refused: (reason) => this.refuse(reason),
    }));
    this.changed();
  }

  private changed(): void {
    const { app } = this, { view } = app;
    message.textContent = app.problem;
    for (const [k, { title, hint, scene, body }] of this.cards.entries()) {
      title.textContent = app.title(app.choice.schemes[k]);
      title.className = k ? "b-text" : "a-text";
      const seen = view.kind === "planet" ? "vorticity, and the mean eastward speed by latitude" : "orbit";
      const click = view.click === undefined ? "" : " A click sets the initial state.";
      scene.setAttribute("aria-label", `${app.title(app.choice.schemes[k])}: the ${seen}. Arrow keys turn it.${click}`);
      hint.textContent = view.click === undefined ? "drag to turn" : "drag to turn · click to start";
      body.hidden = !view.body && view.kind !== "planet";
      body.classList.toggle("profile", view.kind === "planet");
      body.width = body.height = 0;
    }
    const relative = view.kind === "planet" ? ", of its size" : "";
    this.energy.caption.textContent = `Energy error |H − H₀|${relative}, largest so far`;
    this.casimirs.caption.textContent = `Casimir error |C − C₀|${relative}, largest so far`;
    this.casimirs.figure.hidden = !app.hasCasimirs;
    this.section.figure.hidden = !view.section;
    this.section.caption.textContent = view.section ? `Poincaré section: ${view.section.name}` : "";
    this.section.canvas.setAttribute("aria-label", this.section.caption.textContent);
    clearTimeout(this.pending);
    this.pending = setTimeout(() => this.store(), 150) as unknown as number;
  }

  private store(): void {
    if (this.app.problem) return;
    const text = written(this.app.tables, this.app.choice);
    history.replaceState(null, "", text ? `#${text}` : location.pathname + location.search);
  }

  script(): string {
    const { app } = this, { choice } = app;
    return pythonScript({
      system: app.systemCode(), schemes: choice.schemes.map((name) => app.schemeCode(name)),
      attitude: app.hasAttitudes, x0: app.start, step: choice.step,
      steps: Math.max(1, app.steps),
    });
  }

  data(): string {
    const { app } = this;
    return csv(app.kernels, app.plans(), app.columns, app.hasAttitudes, Math.max(1, app.steps));
  }

  private save(): void {
    download(`${this.app.choice.system}.csv`, this.data());
    message.textContent = "Both runs are downloaded.";
  }

  private copy(text: string, done: string): void {
    const shown = () => {
      message.textContent = "";
      const area = element("textarea", { value: text, readOnly: true, rows: 12, cols: 60 });
      area.setAttribute("aria-label", "Text to copy");
      message.append(area);
      area.select();
    };
    if (!navigator.clipboard) return shown();
    navigator.clipboard.writeText(text).then(() => (message.textContent = done), shown);
  }

  private listen(canvas: HTMLCanvasElement, number: number): void {
    let from: [number, number] | null = null, moved = 0;
    const { app } = this;
    const turn = (across: number, up: number) => {
      const [yaw, pitch] = app.choice.turn;
      app.choice.turn = [Number((yaw + across).toFixed(3)), Number(clamp(pitch + up, -1.5, 1.5).toFixed(3))];
      this.changed();
    };
    canvas.addEventListener("pointerdown", (event) => {
      from = [event.clientX, event.clientY];
      moved = 0;
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!from) return;
      const across = event.clientX - from[0], up = event.clientY - from[1];
      moved += Math.abs(across) + Math.abs(up);
      if (moved < CLICK_PIXELS) return;
      from = [event.clientX, event.clientY];
      turn(-across * TURN_OF_PIXEL, up * TURN_OF_PIXEL);
    });
    canvas.addEventListener("pointerup", (event) => {
      if (from && moved < CLICK_PIXELS) this.click(canvas, number, event.offsetX, event.offsetY);
      from = null;
    });
    canvas.addEventListener("pointercancel", () => (from = null));
    canvas.addEventListener("keydown", (event) => {
      const turns: Record<string, [number, number]> = {
        ArrowLeft: [TURN_OF_KEY, 0], ArrowRight: [-TURN_OF_KEY, 0], ArrowUp: [0, -TURN_OF_KEY], ArrowDown: [0, TURN_OF_KEY],
      };
      const by = turns[event.key];
      if (by) turn(...by);
      else if (event.key === "Home") {
        app.choice.turn = [...FIRST_TURN];
        this.changed();
      } else return;
      event.preventDefault();
    });
  }

  // The initial state of the first momentum, under the pointer.
  private click(canvas: HTMLCanvasElement, number: number, x: number, y: number): void {
    const { app } = this, { view } = app;
    if (view.click === undefined || !app.shapes[number]) return;
    const point = picked(canvas, camera(app.choice.turn), view, x, y);
    if (!point) return;
    const radius = app.shapes[number].radius(view.click);
    view.balls![view.click].forEach((i, k) => (app.choice.x0[i] = Number((radius * point[k]).toPrecision(6))));
    this.rebuild();
  }

  private frame(time: number): void {
    requestAnimationFrame((next) => this.frame(next));
    const seconds = Math.min(0.1, (time - this.last) / 1000 || 0);
    this.times.push(time);
    if (this.times.length > FPS_FRAMES) this.times.shift();
    this.last = time;
    this.app.advance(seconds);
    this.draw();
    if (!this.shown) performance.mark("first picture");
    this.shown = true;
  }

  get framesPerSecond(): number {
    const { times } = this;
    return (1000 * (times.length - 1)) / (times[times.length - 1] - times[0]);
  }

  // Without runs nothing is shown of those before.
  private clear(): void {
    const canvases = this.cards.flatMap(({ scene, body }) => [scene, body]);
    for (const canvas of [...canvases, this.energy.canvas, this.casimirs.canvas, this.section.canvas])
      canvas.getContext("2d")!.clearRect(0, 0, canvas.width, canvas.height);
    for (const { readout } of this.cards) readout.textContent = "";
  }

  private draw(): void {
    const { app, palette } = this, matrix = camera(app.choice.turn);
    for (const [k, track] of app.tracks.entries()) {
      const { scene, body, readout } = this.cards[k], color = k ? palette.b : palette.a;
      if (app.view.kind === "planet") drawPlanet(scene, body, matrix, track, palette);
      else drawScene(scene, matrix, track, app.shapes[k], app.view, app.axes, color, palette, app.orbit);
      if (app.view.body) {
        const attitude = track.rotation && attitudeOf(app.view, track.rotation, app.choice.x0);
        drawBody(body, matrix, app.view, attitude, track.x, app.choice.values, color, palette);
      }
      const casimirs = app.hasCasimirs ? ` · Casimirs ${power(track.casimirs.now)}` : "";
      const turned = track.rotation ? ` · rotation ${power(rotationError(track.rotation))}` : "";
      const text = track.failure || `Step ${track.step} · errors: energy ${power(track.energy.now)}${casimirs}${turned}`;
      if (readout.textContent !== text) readout.textContent = text;
    }
    if (!app.tracks.length) return this.clear();
    drawErrors(this.energy.canvas, app.tracks.map((track) => track.energy), palette);
    if (app.hasCasimirs) drawErrors(this.casimirs.canvas, app.tracks.map((track) => track.casimirs), palette);
    const { section } = app.view;
    if (section) drawSection(this.section.canvas, app.tracks, section.labels, palette);
  }
}

async function fetched(name: string): Promise<Response> {
  const answer = await fetch(new URL(name, document.baseURI));
  if (!answer.ok) throw new Error(`${name} is not loaded: ${answer.status}`);
  return answer;
}

async function main(): Promise<void> {
  applyTheme();
  const [kernels, tables] = await Promise.all([
    fetched("kernels.wasm").then((answer) => Kernels.load(answer)),
    fetched("tables.json").then(async (answer) => checked((await answer.json()) as Tables)),
  ]);
  const page = new Page(new App(kernels, tables, firstChoice(tables)));
  Object.assign(window, { explorer: page }); // for tests
}

main().catch((error: unknown) => (message.textContent = `The explorer does not start: ${error instanceof Error ? error.message : error}`));
