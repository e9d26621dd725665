/** Worlds: which there are, a new one of a template, and up to four of them side by side, live. */
import { state, words } from "../api.js";
import { action, line } from "../command.js";
import { type Child, append, field, fill, h, icon, select } from "../dom.js";
import { type View, address, empty, failure, go, heading, loading } from "../shell.js";
import { type WorldEntry, askHost } from "../world.js";
import { pane } from "./world_pane.js";

const MOST_PANES = 4;
const REFRESH = 3000; // ms
const SHOWN = 50; // of a page of the list

export function open(view: View): void {
  if (view.params.length === 0) {
    list(view);
  } else {
    watch(view, view.params.slice(0, MOST_PANES));
  }
}

function watch({ root, signal }: View, names: readonly string[]): void {
  const [first = ""] = names;
  const beside = select([["", "Beside it …"]], "", { "aria-label": "Watch another world beside it" });
  beside.addEventListener("change", () => go("worlds", ...names, beside.value));
  void askHost({ list: true }).then(({ worlds }) => {
    beside.append(...worlds.filter(({ world }) => !names.includes(world)).map(({ world }) => h("option", { value: world }, world)));
    beside.hidden = beside.options.length < 2 || names.length >= MOST_PANES;
  }, () => (beside.hidden = true));
  append(root, [
    heading(names.length === 1 ? first : "Side by side", undefined,
      h("a", { class: "button", href: "#/worlds" }, icon("back", 18), "All worlds"), beside),
    h("div", { class: `panes of-${names.length}` }, ...names.map((name) =>
      pane(name, signal, names.length === 1 ? undefined : () => go("worlds", ...names.filter((each) => each !== name))))),
  ]);
}

function list({ root, signal }: View): void {
  const chosen = new Set<string>();
  const body = h("div");
  const together = h("button", { disabled: true, onclick: () => go("worlds", ...chosen) }, icon("split", 18), "Watch side by side");
  const starts = [0];
  const search = h("input", { type: "search", placeholder: "Find a world on this page", "aria-label": "Find a world on this page" });
  const create = creation(signal);
  append(root, [
    heading("Worlds", "Each is a deterministic world of this lab: watched live, recorded as it runs.", together,
      h("button", { class: "primary", onclick: () => { create.hidden = !create.hidden; create.querySelector("input")?.focus(); } }, icon("plus", 18), "New world")),
    create, h("div", { class: "bar" }, h("div", { class: "searching" }, icon("search", 18), search)), body,
  ]);
  const turn = (to: number | undefined): void => {
    if (to === undefined) {
      starts.pop();
    } else {
      starts.push(to);
    }
    void draw();
  };
  let worlds: readonly WorldEntry[] = [];
  let next: number | null | undefined;
  let shown = "";
  const render = (): void => {
    const wanted = worlds.filter(({ world }) => world.toLowerCase().includes(search.value.toLowerCase()));
    const looks = JSON.stringify([wanted, next, starts, search.value]);
    if (looks === shown) {
      return;
    }
    shown = looks;
    const focused = document.activeElement instanceof HTMLElement ? document.activeElement.dataset["key"] : undefined;
    fill(body, worlds.length === 0
      ? empty("No worlds yet", "Create one from a template, and drop a creature into it.")
      : [table(wanted, chosen, () => (together.disabled = chosen.size < 2 || chosen.size > MOST_PANES), draw), pager(starts, next, turn)]);
    if (focused !== undefined) {
      [...body.querySelectorAll<HTMLElement>("[data-key]")].find(({ dataset }) => dataset["key"] === focused)?.focus();
    }
  };
  const draw = async (): Promise<void> => {
    try {
      const start = starts.at(-1) ?? 0;
      const page = await askHost(start === 0 ? { list: true } : { list: true, start });
      ({ worlds, next } = page);
      if (!signal.aborted) {
        render();
      }
    } catch (error) {
      if (!signal.aborted) {
        shown = "";
        fill(body, failure(error, () => void draw()), h("p", { class: "hint" }, "The list is asked for again every few seconds."));
      }
    }
  };
  search.addEventListener("input", render);
  fill(body, loading("worlds"));
  void draw();
  const timer = setInterval(() => document.hidden || void draw(), REFRESH);
  signal.addEventListener("abort", () => clearInterval(timer));
}

function pager(starts: readonly number[], next: number | null | undefined, turn: (to: number | undefined) => void): Child {
  return (starts.length > 1 || (next !== undefined && next !== null)) && h("div", { class: "bar pager" },
    h("button", { disabled: starts.length < 2, onclick: () => turn(undefined) }, "Before"),
    h("button", { disabled: next === undefined || next === null, onclick: () => turn(next ?? 0) }, "Further"));
}

function table(worlds: readonly WorldEntry[], chosen: Set<string>, changed: () => void, again: () => Promise<void>): Child {
  const rows = worlds.slice(0, SHOWN).map((entry) => {
    const { world, backend, frame, clients } = entry;
    const box = h("input", { type: "checkbox", checked: chosen.has(world), "aria-label": `Watch ${world} beside others`, data: { key: `box ${world}` } });
    box.addEventListener("change", () => {
      if (box.checked) {
        chosen.add(world);
      } else {
        chosen.delete(world);
      }
      changed();
    });
    return h("tr", {},
      h("td", {}, box),
      h("td", { class: "name" }, h("a", { href: address("worlds", world), data: { key: `link ${world}` } }, world)),
      h("td", {}, condition(entry)),
      h("td", { class: "wide" }, backend),
      h("td", { class: "number wide" }, frame === null ? "–" : frame.toLocaleString("en")),
      h("td", { class: "number wide" }, clients),
      h("td", { class: "number" }, closing(world, again)));
  });
  return [
    h("div", { class: "table" }, h("table", {},
      h("thead", {}, h("tr", {}, h("th", {}, h("span", { class: "unseen" }, "Chosen")), h("th", {}, "World"), h("th", {}, "State"), h("th", { class: "wide" }, "Engine"),
        h("th", { class: "number wide" }, "Frame"), h("th", { class: "number wide" }, "Clients"), h("th", {}, h("span", { class: "unseen" }, "Actions")))),
      h("tbody", {}, ...rows))),
    worlds.length > SHOWN && h("p", { class: "hint" }, `${(worlds.length - SHOWN).toLocaleString("en")} more: type a part of the name.`),
  ];
}

function closing(world: string, again: () => Promise<void>): HTMLElement {
  const button = action({
    label: `Close ${world}`, icon: "trash", look: "ghost", bare: true,
    command: () => ({ message: { type: "auth", close: world } }),
    run: async () => {
      if (!confirm(`Close ${world} for good? Its recording stays.`)) {
        return false;
      }
      await askHost({ close: world });
      await again();
      return true;
    },
  });
  button.dataset["key"] = `close ${world}`;
  return button;
}

function condition({ frame, mode, fault, asleep, ratio }: WorldEntry): HTMLElement {
  if (fault !== null) {
    return h("span", { class: "badge bad" }, `stopped: ${fault.replaceAll("_", " ")}`);
  }
  if (frame === null) {
    return h("span", { class: "badge" }, "not begun");
  }
  if (asleep === true) {
    return h("span", { class: "badge" }, "asleep");
  }
  if (ratio !== undefined && ratio !== null) {
    return h("span", { class: "badge warn" }, `slow: ${Math.round(ratio * 100)} %`);
  }
  return h("span", { class: "badge good" }, mode);
}

function creation(signal: AbortSignal): HTMLElement {
  const name = h("input", { type: "text", maxlength: 128, required: true, placeholder: "arena", autocomplete: "off", spellcheck: "false" });
  const template = select(["default"]);
  const seed = h("input", { type: "number", min: 0, step: 1, placeholder: "that of the template" });
  const problem = h("p", { class: "bad", role: "alert" });
  void state().then(({ templates = ["default"] }) => {
    if (!signal.aborted) {
      fill(template, ...templates.map((each) => h("option", { value: each }, each)));
    }
  }, (error: unknown) => (problem.textContent = words(error)));
  const asked = (): { world: string; template: string; seed?: number } =>
    ({ world: name.value.trim(), template: template.value, ...(seed.value === "" ? {} : { seed: Number(seed.value) }) });
  let port = 14000;
  void state().then((known) => (port = known.port ?? port), () => undefined); // the form has said it
  const button = action({
    label: "Create and watch", look: "primary",
    command: () => line("nmes", "worlds", `127.0.0.1:${port}`, "--create", asked().world || "NAME", "--template", asked().template, ...(seed.value === "" ? [] : ["--seed", seed.value])),
    run: async () => {
      problem.textContent = "";
      if (!form.reportValidity()) {
        return false;
      }
      try {
        await askHost({ create: asked() });
        go("worlds", asked().world);
        return true;
      } catch (error) {
        problem.textContent = words(error);
        return false;
      }
    },
  });
  const form = h("form", { class: "card stack", hidden: true, onsubmit: (event: Event) => event.preventDefault(), onkeydown: (event: KeyboardEvent) => {
    if (event.key === "Enter" && event.target instanceof HTMLInputElement) {
      event.preventDefault();
      button.click();
    }
  } },
    h("h2", {}, "A new world"),
    h("div", { class: "form" }, field("Name", name), field("Template", template), field("Seed", seed), button), problem);
  return form;
}
