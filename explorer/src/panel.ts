// The settings of the page.
import { type App, subscripted } from "./app";
import { button, choice, element, numbers, slider } from "./controls";
import { MAX_RATE, MAX_STEP, MIN_RATE, MIN_STEP, schemesOf, TYPED } from "./state";

export interface Actions {
  changed: (restart: boolean) => void;
  rebuilt: () => void;
  copyScript: () => void;
  download: () => void;
  copyLink: () => void;
  refused: (reason: string) => void;
}

// Structure constants of [e1, e2], [e2, e3] and [e3, e1], and a step at which both schemes run for long.
const EXAMPLES: Record<string, { constants: number[]; step: number }> = {
  "so(3), the sphere": { constants: [0, 0, 1, 1, 0, 0, 0, 1, 0], step: 1.5 },
  "se(2), the plane": { constants: [0, 0, 1, 0, 0, 0, 0, 1, 0], step: 1 },
  "sl(2), hyperboloids": { constants: [0, 2, 0, 1, 0, 0, 0, 0, 2], step: 0.2 },
  Heisenberg: { constants: [0, 0, 1, 0, 0, 0, 0, 0, 0], step: 1.5 },
};
const MANY = 9; // coordinates beyond which their fields are folded

function group(title: string, ...children: Node[]): HTMLFieldSetElement {
  return element("fieldset", {}, element("legend", {}, title), ...children);
}

function schemes(app: App, actions: Actions): Node[] {
  const options = schemesOf(app.tables, app.choice.system).map((name): [string, string] => [name, app.title(name)]);
  return ["Left scheme", "Right scheme"].map((label, k) =>
    choice(label, options, app.choice.schemes[k], (name) => {
      app.choice.schemes[k] = name;
      actions.changed(true);
    }, k ? "b-text" : "a-text"),
  );
}

function parameters(app: App, actions: Actions): Node[] {
  const sliders = app.system?.sliders ?? [];
  if (!sliders.length) return [];
  const made = sliders.map((one) =>
    slider({ ...one, value: app.choice.values[one.name] }, (value) => {
      app.choice.values[one.name] = value;
      actions.changed(true);
    }),
  );
  return [group("Parameters", ...made)];
}

function typed(app: App, actions: Actions): Node[] {
  if (app.choice.system !== TYPED) return [];
  const { algebra } = app.choice;
  const fields = (labels: string[], values: number[], store: (values: number[]) => void) =>
    numbers(labels, values, (next) => {
      store(next);
      actions.rebuilt();
    }, actions.refused);
  const brackets = ["[e₁, e₂]", "[e₂, e₃]", "[e₃, e₁]"].map((name, pair) =>
    element("label", {}, `${name} in e₁, e₂, e₃`,
      fields([1, 2, 3].map((k) => `${name}, e${k}`), algebra.constants.slice(3 * pair, 3 * pair + 3), (values) => {
        algebra.constants.splice(3 * pair, 3, ...values);
      })),
  );
  const names = Object.keys(EXAMPLES).map((name): [string, string] => [name, name]);
  const examples = choice("Example", [["", "choose…"], ...names], "", (name) => {
    if (!(name in EXAMPLES)) return;
    algebra.constants = [...EXAMPLES[name].constants];
    app.choice.step = EXAMPLES[name].step;
    actions.rebuilt();
  });
  const energy = [
    element("p", { className: "about" }, "H = Σ aᵢ xᵢ²/2 + bᵢ xᵢ"),
    element("label", {}, "a", fields(["a1", "a2", "a3"], algebra.squares, (values) => (algebra.squares = values))),
    element("label", {}, "b", fields(["b1", "b2", "b3"], algebra.linear, (values) => (algebra.linear = values))),
  ];
  return [group("Structure constants", examples, ...brackets), group("Energy", ...energy)];
}

function start(app: App, actions: Actions): Node[] {
  if (!app.coordinates.length) return [];
  const fields = numbers(app.coordinates, app.choice.x0, (values) => {
    app.choice.x0 = values;
    actions.rebuilt();
  }, actions.refused, app.coordinates.map(subscripted));
  const about = app.view.kind === "sphere" ? "Click on the sphere, or type:" : "Type:";
  if (app.choice.x0.length <= MANY) return [group("Initial state", element("p", { className: "about" }, about), fields)];
  return [element("details", {}, element("summary", {}, "Initial state"), element("p", { className: "about" }, about), fields)];
}

export function buildPanel(app: App, actions: Actions): Node[] {
  const systems: Array<[string, string]> = [
    ...Object.entries(app.tables.systems).map(([name, { title }]): [string, string] => [name, title]),
    [TYPED, "Your own algebra"],
  ];
  const play = button(app.playing ? "Pause" : "Play", () => {
    app.playing = !app.playing;
    play.textContent = app.playing ? "Pause" : "Play";
  }, "main");
  play.id = "play";
  const once = button("One step", () => {
    app.playing = false;
    play.textContent = "Play";
    app.take(1);
  });
  const again = button("Restart", () => actions.changed(true));
  const text = app.system?.text ?? "x′ = J(x) ∇H(x) on the dual of your own Lie algebra; the splitting is built in the page.";
  return [
    group("System",
      element("div", {}, choice("System", systems, app.choice.system, (name) => {
        app.select(name);
        actions.rebuilt();
      }, "", false)),
      element("p", { className: "about" }, text)),
    element("div", { className: "row" }, play, once, again),
    group("Schemes", ...schemes(app, actions)),
    group("Time",
      slider({ label: "step h", low: MIN_STEP, high: MAX_STEP, step: 0, value: app.choice.step, logarithmic: true }, (value) => {
        app.choice.step = value;
        actions.changed(true);
      }),
      slider({ label: "steps a second", low: MIN_RATE, high: MAX_RATE, step: 0, value: app.choice.rate, logarithmic: true }, (value) => {
        app.choice.rate = Math.round(value);
        actions.changed(false);
      })),
    ...parameters(app, actions),
    ...typed(app, actions),
    ...start(app, actions),
    element("div", { className: "row" },
      button("Copy as Python", actions.copyScript), button("Download data", actions.download), button("Copy link", actions.copyLink)),
  ];
}
