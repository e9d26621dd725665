/** Elements in a line of code. Text only ever becomes a text node: what a stranger named cannot become markup. */

export type Child = Node | string | number | null | undefined | false | readonly Child[];

/** Attributes, properties (`value`, `checked`, ...) and listeners (`onclick`) of an element. */
export interface Attributes {
  class?: string;
  style?: Record<string, string>;
  data?: Record<string, string>;
  [name: string]: unknown;
}

const PROPERTIES = new Set(["value", "checked", "disabled", "selected", "hidden", "indeterminate", "htmlFor", "open", "tabIndex"]);

/** Makes an element. */
export function h<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Attributes = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  set(element, attributes);
  append(element, children);
  return element;
}

/** Makes an element of SVG. */
export function svg(tag: string, attributes: Record<string, string | number> = {}, ...children: Child[]): SVGElement {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) {
    element.setAttribute(name, String(value));
  }
  append(element, children);
  return element;
}

/** Replaces all that is in an element. */
export function fill(element: Element, ...children: Child[]): void {
  element.replaceChildren();
  append(element, children);
}

/** Adds to what is in an element. */
export function append(element: Element, children: readonly Child[]): void {
  for (const child of children) {
    if (Array.isArray(child)) {
      append(element, child as readonly Child[]);
    } else if (child instanceof Node || typeof child === "string") {
      element.append(child);
    } else if (typeof child === "number") {
      element.append(String(child));
    }
  }
}

function set(element: HTMLElement, attributes: Attributes): void {
  for (const [name, value] of Object.entries(attributes)) {
    if (value === undefined || value === null || value === false) {
      continue;
    }
    if (name === "style") {
      for (const [property, text] of Object.entries(value as Record<string, string>)) {
        element.style.setProperty(property, text);
      }
    } else if (name === "data") {
      Object.assign(element.dataset, value);
    } else if (name.startsWith("on") && typeof value === "function") {
      element.addEventListener(name.slice(2), value as EventListener);
    } else if (PROPERTIES.has(name)) {
      (element as unknown as Record<string, unknown>)[name] = value;
    } else {
      element.setAttribute(name, value === true ? "" : String(value));
    }
  }
}

let last = 0;

/** A name for an element that another refers to, such as its label. */
export function unique(prefix: string): string {
  return `${prefix}-${++last}`;
}

/** A labelled control: `control` gets the label's name. */
export function field(label: string, control: HTMLElement, hint?: string): HTMLElement {
  control.id ||= unique("field");
  const note = hint === undefined ? undefined : h("span", { class: "hint", id: unique("hint") }, hint);
  if (note !== undefined) {
    control.setAttribute("aria-describedby", note.id);
  }
  return h("div", { class: "field" }, h("label", { for: control.id }, label), control, note);
}

/** A list to choose from. */
export function select(options: readonly (string | readonly [string, string])[], chosen?: string, attributes: Attributes = {}): HTMLSelectElement {
  const list = h("select", attributes);
  for (const option of options) {
    const [value, text] = typeof option === "string" ? [option, option] : option;
    list.append(h("option", { value, selected: value === chosen }, text));
  }
  return list;
}

const PATHS: Record<string, string> = {
  worlds: "M12 2.8 20 7.4v9.2l-8 4.6-8-4.6V7.4zM4 7.4l8 4.6 8-4.6M12 12v9.2",
  build: "M3 21l6.5-6.5M8 9.5l6.5 6.5M13.5 4.5l6 6-5 5-6-6z",
  evolve: "M4 20V10M10 20V4M16 20v-7M22 20H2",
  recordings: "M12 21a9 9 0 1 0 0-18 9 9 0 0 0 0 18zM10 8.5v7l5.5-3.5z",
  brain: "M6 6.5a2 2 0 1 0 0-.01M6 17.5a2 2 0 1 0 0-.01M18 12a2 2 0 1 0 0-.01M7.8 7.3 16.2 11M7.8 16.7 16.2 13M6 8.5v7",
  leaderboard: "M7 4h10v6a5 5 0 0 1-10 0zM7 6H3.5v1.5A3.5 3.5 0 0 0 7 11M17 6h3.5v1.5A3.5 3.5 0 0 1 17 11M12 15v3M8 21h8M9.5 18h5v3",
  lessons: "M3 5.5 12 3l9 2.5v13L12 21l-9-2.5zM12 3v18",
  play: "M7 4.5v15l12-7.5z",
  pause: "M8 5v14M16 5v14",
  step: "M6 5v14l9-7zM18 5v14",
  plus: "M12 5v14M5 12h14",
  copy: "M9 9h11v11H9zM5 15H4V4h11v1",
  check: "M4.5 12.5 10 18 20 6.5",
  close: "M6 6l12 12M18 6 6 18",
  menu: "M4 6.5h16M4 12h16M4 17.5h16",
  sun: "M12 16.5a4.5 4.5 0 1 0 0-9 4.5 4.5 0 0 0 0 9zM12 2v2.5M12 19.5V22M2 12h2.5M19.5 12H22M4.9 4.9l1.8 1.8M17.3 17.3l1.8 1.8M4.9 19.1l1.8-1.8M17.3 6.7l1.8-1.8",
  moon: "M20 14.5A8.5 8.5 0 0 1 9.5 4a8.5 8.5 0 1 0 10.5 10.5z",
  follow: "M12 15a3 3 0 1 0 0-6 3 3 0 0 0 0 6zM12 2v4M12 18v4M2 12h4M18 12h4",
  download: "M12 4v11M7 10.5l5 5 5-5M4 20h16",
  fork: "M6 3v6a6 6 0 0 0 6 6h6M6 9v12M15 11.5l3.5 3.5-3.5 3.5",
  search: "M10.5 17a6.5 6.5 0 1 0 0-13 6.5 6.5 0 0 0 0 13zM15.5 15.5 21 21",
  warning: "M12 3.5 22 20.5H2zM12 10v5M12 17.8v.2",
  back: "M14.5 5l-7 7 7 7",
  terminal: "M4 6l6 6-6 6M12 18h8",
  split: "M3 4h18v16H3zM12 4v16",
  trash: "M4 7h16M9 7V4h6v3M6 7l1 13h10l1-13",
  undo: "M8 5 4 9l4 4M4 9h10a6 6 0 0 1 0 12h-3",
  redo: "M16 5l4 4-4 4M20 9H10a6 6 0 0 0 0 12h3",
  reset: "M4 12a8 8 0 1 0 2.5-5.8M4 4v4.5h4.5",
};

export type Icon = keyof typeof PATHS;

/** A drawing of 20 by 20 pixels, of which readers of screens are told nothing. */
export function icon(name: Icon, size = 20): SVGElement {
  const drawing = svg("svg", { viewBox: "0 0 24 24", width: size, height: size, "aria-hidden": "true", class: "icon" });
  drawing.append(svg("path", { d: PATHS[name] ?? "" }));
  return drawing;
}
