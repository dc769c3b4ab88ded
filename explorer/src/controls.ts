// Elements of the settings: sliders, lists and fields, each with its label.
import { numberIn } from "./state";

const LARGEST = 1e6; // of the numbers in fields

export function element<K extends keyof HTMLElementTagNameMap>(
  name: K, properties: Partial<HTMLElementTagNameMap[K]> = {}, ...children: Array<Node | string>
): HTMLElementTagNameMap[K] {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

export interface Range {
  label: string;
  low: number;
  high: number;
  step: number;
  value: number;
  logarithmic?: boolean;
  digits?: number;
}

// A decimal number as it is written: multiples of a step would carry rounding.
const clean = (x: number) => Number(x.toPrecision(12));

export function slider(range: Range, changed: (value: number) => void): HTMLLabelElement {
  const log = range.logarithmic;
  const shown = (value: number) => String(log ? Number(value.toPrecision(range.digits ?? 2)) : clean(value));
  const input = element("input", { type: "range" });
  input.min = String(log ? Math.log10(range.low) : 0);
  input.max = String(log ? Math.log10(range.high) : Math.round((range.high - range.low) / range.step));
  input.step = log ? "any" : "1";
  input.value = String(log ? Math.log10(range.value) : Math.round((range.value - range.low) / range.step));
  if (log) input.step = "0.01";
  const number = element("span", { className: "number" }, shown(range.value));
  const describe = (value: number) => input.setAttribute("aria-valuetext", shown(value));
  describe(range.value);
  input.addEventListener("input", () => {
    const at = Number(input.value);
    const value = log ? Number((10 ** at).toPrecision(range.digits ?? 2)) : clean(range.low + at * range.step);
    number.textContent = shown(value);
    describe(value);
    changed(Math.min(range.high, Math.max(range.low, value)));
  });
  return element("label", { className: "slider" }, range.label, number, input);
}

export function choice(
  label: string, options: Array<[string, string]>, value: string, changed: (value: string) => void, className = "", named = true,
): HTMLLabelElement {
  const list = element("select", {}, ...options.map(([name, title]) => element("option", { value: name }, title)));
  list.value = value;
  list.addEventListener("change", () => changed(list.value));
  list.setAttribute("aria-label", label);
  return element("label", { className }, named ? label : "", list);
}

export function button(label: string, pressed: () => void, className = ""): HTMLButtonElement {
  const made = element("button", { type: "button", className }, label);
  made.addEventListener("click", pressed);
  return made;
}

// Fields of numbers that are read when one of them is left, or by Enter; with names above them if given. What is no number
// is marked and refused with a reason, and the run keeps the value before.
export function numbers(
  labels: string[], values: number[], changed: (values: number[]) => void, refused: (reason: string) => void,
  names: string[] = [],
): HTMLDivElement {
  const inputs = labels.map((label, k) => {
    const input = element("input", { type: "text", inputMode: "decimal", value: String(Number(values[k].toPrecision(6))) });
    input.setAttribute("aria-label", label);
    input.title = label;
    input.addEventListener("change", () => {
      const value = numberIn(input.value), valid = Math.abs(value) < LARGEST;
      input.setAttribute("aria-invalid", String(!valid));
      if (!valid) return refused(`${label} is “${input.value}”; type a number between −10⁶ and 10⁶. The runs keep ${values[k]}.`);
      changed(values.map((old, i) => (i === k ? value : old)));
    });
    return names.length ? element("div", {}, element("span", { className: "name", ariaHidden: "true" }, names[k]), input) : input;
  });
  return element("div", { className: "numbers" }, ...inputs);
}
