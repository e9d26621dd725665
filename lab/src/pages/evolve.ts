/** Evolve and learn: a run is begun here, paused, gone on with, and looked at; its champions are watched. */
import { get, part, post, state } from "../api.js";
import { action, done, line } from "../command.js";
import type { Genome } from "../creature/genome.js";
import { field, fill, h, select } from "../dom.js";
import { genomes, type Named, type RunItem, runs, type TaskItem, tasks } from "../names.js";
import { drawn, RunView } from "../runs/run.js";
import { address, empty, heading, load, type View } from "../shell.js";

/** The algorithms, each with what it is for. */
const EVOLVE: readonly (readonly [string, string])[] = [
  ["ga", "ga: bodies and brains, by tournaments"],
  ["afpo", "afpo: the same, with room for the young"],
  ["map-elites", "map-elites: the best of every kind"],
  ["nsga2", "nsga2: several objectives"],
  ["random", "random: what others must be better than"],
  ["cma", "cma: the brain alone, by covariances"],
  ["es", "es: the brain alone, by slopes"],
  ["cma-me", "cma-me: brains, the best of every kind"],
  ["neat", "neat: a network that grows"],
];
const LEARN: readonly (readonly [string, string])[] = [["ppo", "ppo: proximal policy optimisation"], ["reinforce", "reinforce: plain policy gradients"]];
const OF_BRAINS = new Set(["cma", "es", "cma-me", "neat"]);
const ARCHIVES = new Set(["map-elites", "cma-me"]);
const MEASURES = [{ expression: "legs", low: 0, high: 10, cells: 10 }, { expression: "mass", low: 0, high: 50, cells: 10 }];
const OBJECTIVES = ["distance", "-energy"];
const RANDOM = "";

export async function open(view: View): Promise<void> {
  const [name] = view.params;
  if (name !== undefined) {
    await new RunView(name, view).open();
    return;
  }
  const list = h("div", {});
  const form = h("div", { class: "card" });
  fill(view.root, heading("Evolve and learn", "Bodies and brains that nobody designed, in runs that anyone can repeat."), form, h("h2", {}, "Runs"), list);
  await Promise.all([
    load(form, "what there is to choose", async () => Promise.all([genomes(view.signal), tasks(view.signal), state(), runs()]), ([known, all, { folder = "lab" }, existing]) =>
      new Form(known, all, folder, existing.map((run) => run.name), view.query).element, view.signal),
    load(list, "runs", () => runs("", view.signal), (items) => listed(items), view.signal),
  ]);
}

function listed(items: readonly RunItem[]): HTMLElement {
  if (items.length === 0) return empty("No runs yet", "Begin one above: a small budget takes less than a minute.");
  return h("div", { class: "table" }, h("table", {},
    h("thead", {}, h("tr", {}, ...["Name", "Task", "Algorithm", "State"].map((title) => h("th", { scope: "col" }, title)))),
    h("tbody", {}, ...items.map((run) => h("tr", {},
      h("td", { class: "name" }, h("a", { href: address("evolve", run.name) }, run.name)),
      h("td", {}, String(run.details?.["task"] ?? "")), h("td", {}, String(run.details?.["algorithm"] ?? "")),
      h("td", {}, run.job === null || run.job === undefined ? "" : h("span", { class: "badge good" }, "running")))))));
}

/** What a run is begun with. */
class Form {
  readonly element = h("form", { class: "stack" });
  readonly #start: HTMLSelectElement;
  readonly #task: HTMLSelectElement;
  readonly #algorithm = h("select", {});
  readonly #budget = h("input", { type: "number", min: 1, max: 1_000_000_000, value: "200", required: true });
  readonly #seed = h("input", { type: "number", min: 0, value: "1", required: true });
  readonly #name = h("input", { type: "text", maxlength: 100, required: true, pattern: "[A-Za-z0-9_][A-Za-z0-9_.\\-]*" });
  readonly #command = h("code", { class: "as-command" });
  readonly #about = h("p", { class: "soft" });
  readonly #amount = h("span", {}, "Budget, in candidates");
  readonly #picture = h("div", {});
  #kind: "evolve" | "learn" = "evolve";
  #named = false; // by a person: then it stays

  constructor(known: readonly Named[], private readonly all: readonly TaskItem[], private readonly folder: string, private readonly existing: readonly string[], query: URLSearchParams) {
    const asked = query.get("genome") ?? RANDOM;
    const options = known.map(({ name, ships }) => [name, ships ? `${name} (ships)` : name] as const);
    this.#start = select([[RANDOM, "random creatures"], ...options], asked);
    this.#task = select(all.filter((task) => (task.roles ?? []).length === 0).map((task) => task.name), query.get("task") ?? "walk");
    const kinds = (["evolve", "learn"] as const).map((kind) => h("button", { type: "button", "aria-pressed": String(kind === this.#kind) }, kind === "evolve" ? "Evolve" : "Learn"));
    kinds.forEach((button, i) => button.addEventListener("click", () => {
      this.#kind = i === 0 ? "evolve" : "learn";
      for (const each of kinds) each.setAttribute("aria-pressed", String(each === button));
      this.#budget.value = this.#kind === "evolve" ? "200" : "100000";
      this.#update();
    }));
    const budget = field("", this.#budget);
    fill(budget.querySelector("label") as HTMLElement, this.#amount);
    const begin = action({ label: "Start", icon: "play", look: "primary", run: () => this.#begin() });
    fill(this.element,
      h("div", { class: "run-head" }, h("div", { class: "choices", role: "group", "aria-label": "What is done" }, ...kinds), this.#picture),
      h("div", { class: "form" }, field("Begin with", this.#start), field("Task", this.#task), field("Algorithm", this.#algorithm), budget, field("Seed", this.#seed), field("Name of the run", this.#name)),
      this.#about, this.#command, h("div", { class: "actions" }, begin));
    this.element.addEventListener("submit", (event) => {
      event.preventDefault();
      begin.click();
    });
    this.element.addEventListener("input", (event) => {
      if (event.target === this.#name) this.#named = true;
      this.#update();
    });
    this.#update();
  }

  #update(): void {
    const learning = this.#kind === "learn";
    const random = this.#start.value === RANDOM;
    const fitting = learning ? LEARN : EVOLVE.filter(([name]) => !(random && OF_BRAINS.has(name)));
    const chosen = fitting.some(([name]) => name === this.#algorithm.value) ? this.#algorithm.value : (fitting[0]?.[0] ?? "");
    if (fitting.length !== this.#algorithm.options.length || this.#algorithm.value !== chosen || this.#algorithm.options[0]?.value !== fitting[0]?.[0]) {
      fill(this.#algorithm, ...fitting.map(([value, text]) => h("option", { value, selected: value === chosen }, text)));
    }
    if (learning && random && this.#start.options.length > 1) this.#start.selectedIndex = 1;
    this.#amount.textContent = learning ? "Steps to learn from" : "Budget, in candidates";
    if (!this.#named) this.#name.value = this.#free(`${this.#task.value}-${chosen}-${this.#seed.value}`);
    const task = this.all.find((each) => each.name === this.#task.value);
    fill(this.#about, task?.description ?? "");
    this.#command.textContent = this.#line();
    void this.#draw();
  }

  async #draw(): Promise<void> {
    const name = this.#start.value;
    fill(this.#picture);
    if (name === RANDOM) return;
    const genome = await get<Genome>(`/genomes/${part(name)}`);
    const drawing = await drawn(genome, 64);
    if (this.#start.value === name && drawing !== undefined) fill(this.#picture, drawing);
  }

  #free(name: string): string {
    let free = name;
    for (let number = 2; this.existing.includes(free); number += 1) free = `${name}-${number}`;
    return free;
  }

  /** The command line that does the same. */
  #line(): string {
    const start = this.#start.value === RANDOM ? "random" : this.#start.value;
    const from = this.#start.selectedOptions[0]?.text.endsWith("(ships)") || start === "random" ? start : `${this.folder}/genomes/${start}.json`;
    const algorithm = this.#algorithm.value;
    const archive = ARCHIVES.has(algorithm) ? MEASURES.flatMap((each) => ["--measure", `${each.expression} from ${each.low} to ${each.high} in ${each.cells}`]) : [];
    const objectives = algorithm === "nsga2" ? OBJECTIVES.flatMap((each) => ["--objective", each]) : [];
    return line("nmes", this.#kind, from, "--task", this.#task.value, "--algorithm", algorithm, this.#kind === "evolve" ? "--budget" : "--steps", this.#budget.value,
      "--seed", this.#seed.value, ...archive, ...objectives, "-o", `${this.folder}/runs/${this.#name.value}`);
  }

  async #begin(): Promise<void> {
    if (!this.element.reportValidity()) return;
    const [task, algorithm, name] = [this.#task.value, this.#algorithm.value, this.#name.value];
    const [amount, seed] = [Number(this.#budget.value), Number(this.#seed.value)];
    const start = this.#start.value;
    const settings = this.#kind === "learn"
      ? { genome: start, task, algorithm, steps: amount, seed }
      : {
          task, algorithm, budget: amount, seed, starts: start === RANDOM ? [] : [start],
          ...(ARCHIVES.has(algorithm) ? { measures: MEASURES } : {}),
          ...(algorithm === "nsga2" ? { objectives: OBJECTIVES } : {}),
        };
    const job = await post<{ id: number; command: string }>("/runs", { kind: this.#kind, name, settings });
    done(job.command);
    location.hash = `${address("evolve", name)}?job=${job.id}`;
  }
}
