/** Dark or light: what the system says, unless the person said something else. Loaded first, so that nothing flashes. */
export type Theme = "light" | "dark";

const KEY = "nmes-theme";
const dark = matchMedia("(prefers-color-scheme: dark)");

/** The theme that is shown. */
export function theme(): Theme {
  const chosen = localStorage.getItem(KEY);
  return chosen === "light" || chosen === "dark" ? chosen : dark.matches ? "dark" : "light";
}

/** Shows the other theme, and keeps it. */
export function toggleTheme(): void {
  localStorage.setItem(KEY, theme() === "dark" ? "light" : "dark");
  apply();
}

/** Has a function called when the theme changes, until the signal. */
export function onTheme(listener: () => void, signal: AbortSignal): void {
  addEventListener("nmes-theme", listener, { signal });
}

/** A colour of the style sheet, as it is in the theme that is shown. */
export function color(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

function apply(): void {
  document.documentElement.dataset["theme"] = theme();
  dispatchEvent(new Event("nmes-theme"));
}

dark.addEventListener("change", apply);
apply();
