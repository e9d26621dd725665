/** Recordings: those of the lab, and one or two of them played side by side. */
import { get, words } from "../api.js";
import { type Child, append, fill, h, icon } from "../dom.js";
import { type View, address, empty, failure, go, heading, loading } from "../shell.js";
import { Pair } from "./pair.js";
import { Player } from "./player.js";

const TYPED = 200; // ms after the last key before the list is asked for

interface Item {
  readonly name: string;
  /** When it was last written, s since 1970. */
  readonly time: number;
  readonly size: number;
  /** null until it was read. */
  readonly details: {
    readonly world?: string; readonly backend?: string; readonly frames?: number | null; readonly tick_rate?: number;
    readonly creature?: string | null; readonly task?: string | null; readonly error?: string;
  } | null;
}

interface Page {
  readonly items: readonly Item[];
  readonly next: string | null;
  readonly count?: number;
}

export function open(view: View): void {
  if (view.params.length === 0) {
    list(view);
  } else {
    play(view, view.params.slice(0, 2));
  }
}

function play({ root, signal }: View, names: readonly string[]): void {
  const [first = "", second] = names;
  const back = h("a", { class: "button", href: "#/recordings" }, icon("back", 18), "All recordings");
  if (second !== undefined) {
    append(root, [heading("Two recordings", "On one time line, and where they part.", back), new Pair([first, second], signal).element]);
    return;
  }
  append(root, [heading(first, undefined, back, beside(first, signal)), h("div", { class: "panes of-1" }, new Player(first, signal).element)]);
}

function beside(name: string, signal: AbortSignal): HTMLElement {
  const choice = h("select", { "aria-label": "Play another recording beside it" }, h("option", { value: "" }, "Beside it …"));
  void get<Page>("/recordings", {}, signal).then(({ items }) => {
    choice.append(...items.filter((item) => item.name !== name).slice(0, 100).map((item) => h("option", { value: item.name }, item.name)));
    choice.hidden = choice.options.length < 2;
  }, () => (choice.hidden = true));
  choice.addEventListener("change", () => go("recordings", name, choice.value));
  return choice;
}

function list({ root, query, signal }: View): void {
  const search = h("input", { type: "search", value: query.get("name") ?? "", placeholder: "Find a recording by a part of its name", "aria-label": "Find a recording by a part of its name" });
  const body = h("div");
  const count = h("p", { class: "hint" });
  const chosen = new Set<string>();
  const compare = h("button", { disabled: true, onclick: () => go("recordings", ...chosen) }, icon("split", 18), "Play side by side");
  const changed = (): void => void (compare.disabled = chosen.size !== 2);
  let asked = 0;
  const draw = async (): Promise<void> => {
    const mine = ++asked;
    try {
      const page = await get<Page>("/recordings", { name: search.value }, signal);
      if (mine === asked) {
        show(page);
      }
    } catch (error) {
      if (!signal.aborted && mine === asked) {
        fill(body, failure(error, () => void draw()));
      }
    }
  };
  const show = (page: Page): void => {
    count.textContent = page.count === undefined ? "" : `${page.count.toLocaleString("en")} in all, the newest first`;
    if (page.items.length === 0) {
      fill(body, search.value === ""
        ? empty("No recordings yet", "Each world leaves one as it runs, and each evaluation that is recorded.", h("a", { class: "button", href: "#/worlds" }, "To the worlds"))
        : empty("Nothing is called so", `No recording has “${search.value}” in its name.`));
      return;
    }
    const rows = h("tbody", {}, ...page.items.map((item) => row(item, chosen, changed)));
    const more = h("button", {}, "More");
    let next = page.next;
    more.hidden = next === null;
    more.addEventListener("click", () => {
      more.disabled = true;
      get<Page>("/recordings", { name: search.value, after: next ?? undefined }, signal).then((further) => {
        rows.append(...further.items.map((item) => row(item, chosen, changed)));
        next = further.next;
        more.hidden = next === null;
      }, (error: unknown) => signal.aborted || (count.textContent = words(error))).finally(() => (more.disabled = false));
    });
    fill(body, h("div", { class: "table" }, h("table", {},
      h("thead", {}, h("tr", {}, h("th", {}, h("span", { class: "unseen" }, "Chosen")), h("th", {}, "Recording"), h("th", { class: "wide" }, "Of"), h("th", { class: "number" }, "Length"),
        h("th", { class: "number wide" }, "Size"), h("th", { class: "number wide" }, "Written"))), rows)), h("div", { class: "bar pager" }, more));
  };
  let waiting = 0;
  search.addEventListener("input", () => {
    clearTimeout(waiting);
    waiting = setTimeout(() => void draw(), TYPED);
  });
  append(root, [
    heading("Recordings", "What happened in each world, tick by tick: play it, check it, go on from it.", compare),
    h("div", { class: "bar" }, h("div", { class: "searching" }, icon("search", 18), search), count), body,
  ]);
  fill(body, loading("recordings"));
  void draw();
}

function row({ name, time, size, details }: Item, chosen: Set<string>, changed: () => void): HTMLElement {
  const box = h("input", { type: "checkbox", checked: chosen.has(name), "aria-label": `Play ${name} beside another` });
  box.addEventListener("change", () => {
    if (box.checked) {
      chosen.add(name);
    } else {
      chosen.delete(name);
    }
    changed();
  });
  const of: Child = details === null ? "" : details.error !== undefined ? h("span", { class: "bad" }, details.error)
    : `${details.creature ?? ""}${(details.creature ?? "") === "" ? "" : " on "}${details.task ?? details.world ?? ""}`;
  const frames = details?.frames;
  return h("tr", {}, h("td", {}, box),
    h("td", { class: "name" }, h("a", { href: address("recordings", name) }, name)),
    h("td", { class: "wide" }, of),
    h("td", { class: "number" }, frames === null || frames === undefined ? "" : seconds(frames / (details?.tick_rate ?? 60))),
    h("td", { class: "number wide" }, bytes(size)),
    h("td", { class: "number wide" }, h("time", { datetime: new Date(time * 1000).toISOString() }, new Date(time * 1000).toLocaleString([], { dateStyle: "medium", timeStyle: "short" }))));
}

function bytes(size: number): string {
  return size < 1e6 ? `${Math.max(Math.round(size / 1e3), 1)} kB` : `${(size / 1e6).toFixed(1)} MB`;
}

function seconds(value: number): string {
  return value < 120 ? `${value.toFixed(1)} s` : `${Math.floor(value / 60)} min ${Math.round(value % 60)} s`;
}

