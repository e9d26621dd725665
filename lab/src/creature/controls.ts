/** Controls of the builder: sliders with their number beside them, and lists, that tell of each change. */
import { type Child, h, select, unique } from "../dom.js";

export interface Slide {
  readonly label: string;
  readonly value: number;
  readonly low: number;
  readonly high: number;
  readonly step: number;
  readonly unit?: string;
  /** Told while it is drawn (`final` false) and when it is let go. */
  readonly set: (value: number, final: boolean) => void;
}

/** A slider and its number: what is typed may lie beyond the slider's ends. */
export function slider({ label, value, low, high, step, unit, set }: Slide): HTMLElement {
  const id = unique("slide");
  const range = h("input", { type: "range", min: Math.min(low, value), max: Math.max(high, value), step, value: String(value), "aria-label": label, tabIndex: 0 });
  const number = h("input", { type: "number", id, step, value: String(shown(value)) });
  const take = (text: string, final: boolean): void => {
    const entered = Number(text);
    if (text.trim() === "" || !Number.isFinite(entered)) return;
    range.value = number.value = String(entered);
    set(entered, final);
  };
  range.addEventListener("input", () => take(range.value, false));
  range.addEventListener("change", () => take(range.value, true));
  number.addEventListener("change", () => take(number.value, true));
  return h("div", { class: "slide" }, h("label", { for: id }, label, unit !== undefined && h("span", { class: "soft" }, ` ${unit}`)), range, number);
}

/** A list to choose from, with its label beside it. */
export function choice(label: string, options: readonly (string | readonly [string, string])[], chosen: string, set: (value: string) => void): HTMLElement {
  const list = select(options, chosen);
  list.id = unique("choice");
  list.addEventListener("change", () => set(list.value));
  return h("div", { class: "choice" }, h("label", { for: list.id }, label), list);
}

/** A box to be ticked. */
export function tick(label: string, checked: boolean, set: (value: boolean) => void): HTMLElement {
  const box = h("input", { type: "checkbox", checked });
  box.addEventListener("change", () => set(box.checked));
  return h("label", { class: "check" }, box, label);
}

/** A part of the inspector that can be folded away; whether it is open is remembered while the page is. */
export function panel(title: string, memory: Map<string, boolean>, open: boolean, ...children: Child[]): HTMLElement {
  const details = h("details", { class: "panel", open: memory.get(title) ?? open }, h("summary", {}, title), h("div", { class: "inside" }, ...children));
  details.addEventListener("toggle", () => memory.set(title, details.open));
  return details;
}

const shown = (value: number): number => Number(value.toPrecision(6));
