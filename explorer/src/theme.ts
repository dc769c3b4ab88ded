// Light or dark, as the site stores it, and the colors that drawings read from the style sheet.
export interface Colors {
  a: string;
  b: string;
  text: string;
  muted: string;
  line: string;
  panel: string;
  dark: boolean;
}

export function applyTheme(): void {
  const stored = localStorage.getItem("theme") ?? localStorage.getItem("mode");
  const dark = stored === "dark" || (stored !== "light" && matchMedia("(prefers-color-scheme: dark)").matches);
  document.documentElement.dataset.theme = dark ? "dark" : "light";
}

export function toggleTheme(): void {
  const theme = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
  localStorage.setItem("theme", theme);
  localStorage.setItem("mode", theme);
  applyTheme();
}

export function colors(): Colors {
  const style = getComputedStyle(document.documentElement);
  const of = (name: string) => style.getPropertyValue(name).trim();
  return {
    a: of("--a"), b: of("--b"), text: of("--text"), muted: of("--muted"), line: of("--line"), panel: of("--panel"),
    dark: document.documentElement.dataset.theme === "dark",
  };
}
