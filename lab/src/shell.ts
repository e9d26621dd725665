/** What is around every page: header, navigation, the dock with commands, notices; and which page an address shows. */
import { state, words } from "./api.js";
import { dock } from "./command.js";
import { type Child, type Icon, fill, h, icon } from "./dom.js";
import { theme, toggleTheme } from "./theme.js";

/** What a page is given when it is opened. */
export interface View {
  /** Where it shows itself; empty. */
  readonly root: HTMLElement;
  /** What stands behind its name in the address, such as the name of a world. */
  readonly params: readonly string[];
  readonly query: URLSearchParams;
  /** Aborted when the page is left: listeners, sockets and timers end with it. */
  readonly signal: AbortSignal;
}

/** A page: `open` fills the view. */
export interface Page {
  open(view: View): void | Promise<void>;
}

/** A page's place in the navigation, and where it is loaded from. */
export interface Place {
  readonly name: string;
  readonly title: string;
  readonly icon: Icon;
  readonly load: () => Promise<Page>;
}

const main = h("main", { id: "main", tabIndex: -1 });
const live = h("div", { class: "unseen", role: "status", "aria-live": "polite", id: "live" });
const notices = h("div", { class: "notices", id: "notices" });
let leaving: AbortController | undefined;

/** Shows the shell, and from then on the page that the address names. */
export function start(places: readonly Place[]): void {
  const links = new Map(places.map((place) => [place.name, link(place)]));
  const menu = h("button", { class: "ghost square menu", "aria-label": "Menu", "aria-expanded": "false", "aria-controls": "nav" }, icon("menu"));
  const nav = h("nav", { id: "nav", "aria-label": "Pages" }, h("ul", {}, ...[...links.values()].map((each) => h("li", {}, each))));
  const unfold = (open: boolean): void => {
    nav.classList.toggle("open", open);
    menu.setAttribute("aria-expanded", String(open));
  };
  menu.addEventListener("click", () => unfold(!nav.classList.contains("open")));
  nav.addEventListener("click", () => unfold(false));
  addEventListener("keydown", (event) => {
    if (event.key === "Escape") {
      unfold(false);
    }
  });
  document.body.append(
    h("a", { class: "skip", href: "#main", onclick: (event: Event) => { event.preventDefault(); main.focus(); } }, "Skip to the page"),
    h("header", {}, menu, brand(), h("span", { class: "grow" }), themeButton()),
    nav, main, dock(), notices, live,
  );
  const route = (): void => void show(places, links);
  addEventListener("hashchange", route);
  route();
}

async function show(places: readonly Place[], links: ReadonlyMap<string, HTMLElement>): Promise<void> {
  leaving?.abort();
  const { signal } = (leaving = new AbortController());
  const [path = "", search = ""] = location.hash.replace(/^#\/?/, "").split("?", 2) as [string?, string?];
  const [name = "", ...params] = path.split("/").filter((each) => each !== "").map(decoded);
  const place = places.find((each) => each.name === name) ?? (name === "" ? places[0] : undefined);
  for (const [each, element] of links) {
    if (each === place?.name) {
      element.setAttribute("aria-current", "page");
    } else {
      element.removeAttribute("aria-current");
    }
  }
  document.title = place === undefined ? "NMES lab" : `${params[0] === undefined ? "" : `${params[0]} · `}${place.title} · NMES lab`;
  const root = h("div", { class: "page", data: { page: place?.name ?? "none" } });
  fill(main, root);
  scrollTo(0, 0);
  if (place === undefined) {
    fill(root, empty("There is no such page", `Nothing is at ${location.hash}.`, h("a", { class: "button", href: "#/" }, "To the worlds")));
    return;
  }
  announce(place.title);
  const late = setTimeout(() => fill(root, loading(place.title)), 150);
  try {
    const [page] = await Promise.all([place.load(), state().catch(() => undefined)]); // command lines name the folder
    clearTimeout(late);
    if (!signal.aborted) {
      fill(root);
      await page.open({ root, params, query: new URLSearchParams(search), signal });
    }
  } catch (error) {
    clearTimeout(late);
    if (!signal.aborted) {
      fill(root, failure(error, () => void show(places, links)));
    }
  }
}

function decoded(text: string): string {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}

function link({ name, title, icon: drawing }: Place): HTMLElement {
  return h("a", { href: `#/${name}` }, icon(drawing), h("span", {}, title));
}

function brand(): HTMLElement {
  return h("a", { class: "brand", href: "#/" }, h("img", { src: "icon.svg", alt: "", width: 26, height: 26 }), h("span", {}, "NMES ", h("b", {}, "lab")));
}

function themeButton(): HTMLElement {
  const button = h("button", { class: "ghost square" });
  const draw = (): void => {
    button.setAttribute("aria-label", theme() === "dark" ? "Light theme" : "Dark theme");
    button.title = button.getAttribute("aria-label") ?? "";
    fill(button, icon(theme() === "dark" ? "sun" : "moon"));
  };
  button.addEventListener("click", toggleTheme);
  addEventListener("nmes-theme", draw);
  draw();
  return button;
}

/** Tells something to those who listen to a screen. */
export function announce(text: string): void {
  live.textContent = text;
}

/** Shows a passing notice; of errors until it is closed. */
export function notify(text: string, kind: "good" | "bad" | "plain" = "plain"): void {
  const close = h("button", { class: "ghost square small", "aria-label": "Close this notice" }, icon("close", 16));
  const notice = h("div", { class: `notice ${kind}`, role: kind === "bad" ? "alert" : "status" }, h("span", {}, text), close);
  close.addEventListener("click", () => notice.remove());
  notices.append(notice);
  while (notices.children.length > 4) {
    notices.firstElementChild?.remove();
  }
  if (kind !== "bad") {
    setTimeout(() => notice.remove(), 5000);
  }
}

/** Goes to a page: `go("worlds", "main")`. */
export function go(...parts: readonly string[]): void {
  location.hash = address(...parts);
}

/** The address of a page. */
export function address(...parts: readonly string[]): string {
  return `#/${parts.map(encodeURIComponent).join("/")}`;
}

/** The heading of a page, with what can be done beside it. */
export function heading(title: Child, lead?: string, ...actions: Child[]): HTMLElement {
  return h("div", { class: "heading" }, h("div", {}, h("h1", {}, title), lead !== undefined && h("p", { class: "lead" }, lead)), h("div", { class: "actions" }, ...actions));
}

/** What stands where there is nothing yet, and what to do about that. */
export function empty(title: string, text: string, ...actions: Child[]): HTMLElement {
  return h("div", { class: "empty" }, h("h2", {}, title), h("p", {}, text), actions.length > 0 && h("div", { class: "actions" }, ...actions));
}

/** What stands where something is being loaded. */
export function loading(what: string): HTMLElement {
  return h("div", { class: "loading", role: "status" }, h("span", { class: "spinner", "aria-hidden": "true" }), `Loading ${what.toLowerCase()} …`);
}

/** What stands where something went wrong. */
export function failure(error: unknown, again?: () => void): HTMLElement {
  return h("div", { class: "failure", role: "alert" }, icon("warning", 24), h("div", {}, h("h2", {}, "That did not work"), h("p", {}, words(error))),
    again !== undefined && h("button", { onclick: again }, "Try again"));
}

/** Fills an element with what a promise brings; until then it says that it loads, and if that fails what went wrong. */
export async function load<T>(element: HTMLElement, what: string, ask: () => Promise<T>, render: (value: T) => Child, signal: AbortSignal): Promise<void> {
  const late = setTimeout(() => fill(element, loading(what)), 150);
  try {
    const value = await ask();
    if (!signal.aborted) {
      fill(element, render(value));
    }
  } catch (error) {
    if (!signal.aborted) {
      fill(element, failure(error, () => void load(element, what, ask, render, signal)));
    }
  } finally {
    clearTimeout(late);
  }
}

/** Does something that a person asked for, and shows why where it fails. */
export async function attempt(work: () => Promise<unknown> | unknown): Promise<boolean> {
  try {
    await work();
    return true;
  } catch (error) {
    notify(words(error), "bad");
    return false;
  }
}
