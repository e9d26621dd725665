/** Evolve and learn: a run is begun here, paused, gone on with, and looked at; its champions are watched. */
import { get, part, post, put, state, words } from "../api.js";
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
  ["islands", "islands: several populations, the better ones go on"],
  ["map-elites", "map-elites: the best of every kind"],
  ["nsga2", "nsga2: several objectives"],
  ["random", "random: what others must be better than"],
  ["cma", "cma: the brain alone, by covariances"],
  ["es", "es: the brain alone, by slopes"],
  ["cma-me", "cma-me: brains, the best of every kind"],
  ["neat", "neat: a network that grows"],
];
const CLONE = "clone";
const LEARN: readonly (readonly [string, string])[] = [["ppo", "ppo: proximal policy optimisation"], ["reinforce", "reinforce: plain policy gradients"], [CLONE, "clone: what was done in recordings"]];
const OF_BRAINS = new Set(["cma", "es", "cma-me", "neat"]);
const ARCHIVES = new Set(["map-elites", "cma-me"]);
const MEASURES = [{ expression: "legs", low: 0, high: 10, cells: 10 }, { expression: "mass", low: 0, high: 50, cells: 10 }];
const OBJECTIVES = ["distance", "-energy"];
const [PUPIL, LESSON] = ["eel", "swim"]; // on which learning shows soonest
const RANDOM = "";
const LOOK = 2000; // ms between two looks for recordings to learn from, which is how often the lab looks itself
const SAME = "="; // which no name is: what the run has that another is begun like

export async function open(view: View): Promise<void> {
  const [name] = view.params;
  if (name !== undefined) {
    await new RunView(name, view).open();
    return;
  }
  const list = h("div", {});
  const form = h("div", { class: "card" });
  fill(view.root, heading("Evolve and learn", "Bodies and brains that nobody designed, in runs that anyone can repeat."), form, h("h2", {}, "Runs"), list);
  const another = view.query.get("like");
  const like = async (): Promise<Like | undefined> => (another === null ? undefined : { name: another, ...await get<Pick<Like, "kind" | "settings">>(`/runs/${part(another)}`) });
  let asked: ReturnType<typeof runs> | undefined; // once, for the list and for names that are free, unless it fails
  const newest = (): ReturnType<typeof runs> => (asked ??= runs("", view.signal).catch((error: unknown) => {
    asked = undefined;
    throw error;
  }));
  await Promise.all([
    load(form, "what there is to choose", async () => Promise.all([genomes(view.signal), tasks(view.signal), state(), newest(), like()]), ([known, all, { folder = "lab" }, existing, found]) =>
      new Form(known, all, folder, existing.map((run) => run.name), view, found).element, view.signal),
    load(list, "runs", newest, (items) => listed(items), view.signal),
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

/** A run that another is begun like. */
interface Like {
  readonly name: string;
  readonly kind: "evolve" | "learn";
  readonly settings: Settings;
}

interface Settings {
  readonly task: { readonly name: string };
  readonly algorithm: string;
  readonly seed: number;
  readonly options?: object;
  readonly budget?: number;
  readonly starts?: readonly { readonly name: string }[];
  readonly genome?: object;
  readonly recordings?: readonly string[];
  readonly steps?: number;
  readonly every?: number;
  readonly reward?: string;
}

/** Settings of a run of learning, as the lab takes them. */
interface Lesson extends Pick<Settings, "algorithm" | "seed" | "options" | "steps" | "every" | "reward" | "recordings"> {
  readonly genome?: string;
  readonly task?: string | object;
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
  readonly #recordings = h("select", { multiple: true, size: 6, required: true });
  readonly #lessons = field("Recordings to learn from", this.#recordings, "Of episodes of one creature on one task, such as scores leave. Several with Ctrl or Shift.");
  readonly #options = h("textarea", { rows: 4, spellcheck: "false", class: "mono" });
  readonly #creature: readonly HTMLElement[]; // who begins, and on what: recordings say it themselves
  #kind: "evolve" | "learn" = "evolve";
  #cloning = false; // whether recordings to learn from are shown
  #asking = false; // for recordings
  #fitted: string | undefined; // the algorithm whose options are shown
  #named = false; // by a person: then it stays

  constructor(known: readonly Named[], private readonly all: readonly TaskItem[], private readonly folder: string, private readonly existing: readonly string[], private readonly view: View, private readonly like?: Like) {
    const { query, signal } = view;
    const asked = query.get("genome") ?? RANDOM;
    const options = known.map(({ name, ships }) => [name, ships ? `${name} (ships)` : name] as const);
    const same = like !== undefined && (like.kind === "learn" || (like.settings.starts ?? []).length > 0);
    this.#start = select([...(same ? [[SAME, `as in ${like.name}`] as const] : []), [RANDOM, "random creatures"], ...options], same ? SAME : asked);
    const alone = all.filter((task) => (task.roles ?? []).length === 0).map((task) => [task.name, task.name] as const);
    this.#task = select([...(like === undefined ? [] : [[SAME, `${like.settings.task.name}, as in ${like.name}`] as const]), ...alone],
      like === undefined ? query.get("task") ?? "walk" : SAME);
    this.#creature = [field("Begin with", this.#start), field("Task", this.#task)];
    this.#kind = like?.kind ?? "evolve";
    if (like !== undefined) {
      this.#budget.value = String(like.settings.budget ?? like.settings.steps ?? 1);
      this.#seed.value = String(like.settings.seed + 1);
      fill(this.#algorithm, h("option", { value: like.settings.algorithm, selected: true }, like.settings.algorithm));
      this.#options.value = JSON.stringify(like.settings.options ?? {}, null, 1);
    }
    const kinds = (["evolve", "learn"] as const).map((kind) => h("button", { type: "button", "aria-pressed": String(kind === this.#kind) }, kind === "evolve" ? "Evolve" : "Learn"));
    kinds.forEach((button, i) => button.addEventListener("click", () => {
      this.#kind = i === 0 ? "evolve" : "learn";
      for (const each of kinds) each.setAttribute("aria-pressed", String(each === button));
      this.#budget.value = this.#kind === "evolve" ? "200" : "100000";
      if (this.#kind === "learn" && this.#start.value === RANDOM) this.#easy();
      this.#update();
    }));
    const budget = field("", this.#budget);
    fill(budget.querySelector("label") as HTMLElement, this.#amount);
    const begin = action({ label: "Start", icon: "play", look: "primary", run: () => this.#begin() });
    fill(this.element,
      h("div", { class: "run-head" }, like === undefined && h("div", { class: "choices", role: "group", "aria-label": "What is done" }, ...kinds), this.#picture),
      h("div", { class: "form" }, ...this.#creature, field("Algorithm", this.#algorithm), budget, field("Seed", this.#seed), field("Name of the run", this.#name)),
      this.#lessons,
      like !== undefined && field("Options of the algorithm, as JSON", this.#options, "Those of another algorithm are other ones: {} takes its defaults."),
      this.#about, this.#command, h("div", { class: "actions" }, begin));
    this.element.addEventListener("submit", (event) => {
      event.preventDefault();
      begin.click();
    });
    this.element.addEventListener("input", (event) => {
      if (event.target === this.#name) this.#named = true;
      this.#update();
    });
    const timer = setInterval(() => {
      if (this.#cloning && !document.hidden) void this.#offer();
    }, LOOK);
    signal.addEventListener("abort", () => clearInterval(timer));
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
    const cloning = chosen === CLONE;
    for (const each of this.#creature) each.hidden = cloning;
    this.#lessons.hidden = this.#recordings.disabled = !cloning;
    this.#picture.hidden = cloning;
    if (cloning && !this.#cloning) void this.#offer();
    this.#cloning = cloning;
    if (this.like !== undefined && chosen !== this.#fitted) this.#options.value = JSON.stringify(chosen === this.like.settings.algorithm ? this.like.settings.options ?? {} : {}, null, 1);
    this.#fitted = chosen;
    this.#amount.textContent = learning ? "Steps to learn from" : "Budget, in candidates";
    if (!this.#named) this.#name.value = this.#free(`${cloning ? "recordings" : this.#taskName()}-${chosen}-${this.#seed.value}`);
    const task = this.all.find((each) => each.name === this.#taskName());
    fill(this.#about, cloning ? "A network learns to do what the creature did in them, whoever drove it." : task?.description ?? "");
    this.#command.textContent = this.#line();
    void this.#draw();
  }

  /** Offers recordings to learn from: those that came since the last look, above the others. */
  async #offer(): Promise<void> {
    if (this.#asking) return;
    this.#asking = true;
    try {
      const { items } = await get<{ items: readonly { name: string }[] }>("/recordings", {}, this.view.signal); // the newest alone
      const before = this.like?.settings.recordings ?? [];
      const offered = new Set([...this.#recordings.options].map((option) => option.value));
      const paths = new Set([...before, ...items.map(({ name }) => this.#path(name))].filter((path) => !offered.has(path)));
      if (paths.size > 0) {
        this.#recordings.prepend(...[...paths].map((path) => h("option", { value: path, selected: before.includes(path) }, this.#called(path))));
        this.#update();
      }
    } catch {
      // The next look asks again.
    } finally {
      this.#asking = false;
    }
  }

  /** The path of a recording of the lab, as settings of runs have it. */
  #path(name: string): string {
    return `${this.folder}/recordings/${name}.mcap`.replace(/^\.\//, "");
  }

  /** The name of a recording of the lab by its path; of one from elsewhere, which the lab will refuse, the path. */
  #called(path: string): string {
    const name = path.replace(/^.*\//, "").replace(/\.mcap$/, "");
    return path === this.#path(name) ? name : path;
  }

  /** The paths of the recordings that are chosen. */
  #chosen(): string[] {
    return [...this.#recordings.selectedOptions].map((option) => option.value);
  }

  /** Chooses a creature that learns something in a minute, on its task. */
  #easy(): void {
    const has = (choice: HTMLSelectElement, name: string): boolean => [...choice.options].some((option) => option.value === name);
    if (!has(this.#start, PUPIL) || !has(this.#task, LESSON)) return;
    this.#start.value = PUPIL;
    this.#task.value = LESSON;
  }

  #taskName(): string {
    return this.#task.value === SAME ? this.like?.settings.task.name ?? "" : this.#task.value;
  }

  /** The name of a genome that is a run's, once it is kept. */
  #kept(): string {
    return this.#start.value === SAME ? `${this.like?.name ?? ""}-start` : this.#start.value;
  }

  async #draw(): Promise<void> {
    const name = this.#start.value;
    fill(this.#picture);
    if (name === RANDOM || name === SAME) return;
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
    if (this.like !== undefined && this.#kind === "evolve") return line("nmes", "evolve", "--settings", `${this.folder}/settings/${this.#name.value}.json`, "-o", `${this.folder}/runs/${this.#name.value}`);
    const start = this.#start.value === RANDOM ? "random" : this.#kept();
    const from = this.#start.selectedOptions[0]?.text.endsWith("(ships)") || start === "random" ? start : `${this.folder}/genomes/${start}.json`;
    const algorithm = this.#algorithm.value;
    const given = this.like === undefined ? [] : this.#like();
    if (algorithm === CLONE) {
      return line("nmes", "learn", ...this.#chosen(), "--algorithm", CLONE, "--steps", this.#budget.value,
        "--seed", this.#seed.value, ...given, "-o", `${this.folder}/runs/${this.#name.value}`);
    }
    const archive = ARCHIVES.has(algorithm) ? MEASURES.flatMap((each) => ["--measure", `${each.expression} from ${each.low} to ${each.high} in ${each.cells}`]) : [];
    const task = this.#taskName();
    const own = this.all.some((each) => each.name === task && !each.ships);
    const source = this.#task.value === SAME ? `${this.folder}/settings/${this.#name.value}.json` : own ? `${this.folder}/tasks/${task}.json` : task;
    const objectives = algorithm === "nsga2" ? OBJECTIVES.flatMap((each) => ["--objective", each]) : [];
    return line("nmes", this.#kind, from, "--task", source, "--algorithm", algorithm, this.#kind === "evolve" ? "--budget" : "--steps", this.#budget.value,
      "--seed", this.#seed.value, ...given, ...archive, ...objectives, "-o", `${this.folder}/runs/${this.#name.value}`);
  }

  /** What a run of learning that is like another has of it, in the command line. */
  #like(): string[] {
    let lesson: Lesson;
    try {
      lesson = this.#lesson();
    } catch {
      return []; // who begins it is told what is wrong with the options
    }
    const { every, reward, options = {} } = lesson;
    return [...(every === undefined ? [] : ["--every", String(every)]), ...(reward === undefined ? [] : ["--reward", reward]),
      ...Object.entries(options).flatMap(([name, value]) => ["--set", `${name}=${JSON.stringify(value)}`])];
  }

  async #begin(): Promise<void> {
    if (!this.element.reportValidity()) return;
    const name = this.#name.value;
    const settings = this.#kind === "learn" ? this.#lesson() : this.#search();
    if ("genome" in settings && this.#start.value === SAME) await put(`/genomes/${part(this.#kept())}`, this.like?.settings.genome);
    const job = await post<{ id: number; command: string }>("/runs", { kind: this.#kind, name, settings });
    done(job.command);
    location.hash = `${address("evolve", name)}?job=${job.id}`;
  }

  /** Settings of evolution. */
  #search(): object {
    const [start, task, algorithm] = [this.#start.value, this.#task.value, this.#algorithm.value];
    const before = this.like?.kind === "evolve" ? this.like.settings : undefined;
    const same = before !== undefined && algorithm === before.algorithm;
    return {
      ...(same ? before : {}),
      ...(before === undefined ? {} : { options: this.#given() }),
      task: task === SAME ? before?.task : task, algorithm, budget: Number(this.#budget.value), seed: Number(this.#seed.value),
      starts: start === SAME ? before?.starts : start === RANDOM ? [] : [start],
      ...(ARCHIVES.has(algorithm) && !same ? { measures: MEASURES } : {}),
      ...(algorithm === "nsga2" && !same ? { objectives: OBJECTIVES } : {}),
    };
  }

  /** Settings of learning; the genome of a run that it is to be like is kept among the genomes. */
  #lesson(): Lesson {
    const before = this.like?.kind === "learn" ? this.like.settings : undefined;
    const amounts = { algorithm: this.#algorithm.value, steps: Number(this.#budget.value), seed: Number(this.#seed.value), ...(before === undefined ? {} : { options: this.#given(), ...(before.every === undefined ? {} : { every: before.every }) }) };
    if (this.#algorithm.value === CLONE) return { recordings: this.#chosen().map((path) => this.#called(path)), ...amounts };
    const same = before !== undefined && this.#algorithm.value === before.algorithm;
    return {
      genome: this.#kept(), task: this.#task.value === SAME ? before?.task ?? "" : this.#task.value, ...amounts,
      ...(same && before.reward !== undefined ? { reward: before.reward } : {}),
    };
  }

  #given(): object {
    try {
      return JSON.parse(this.#options.value) as object;
    } catch (error) {
      throw new Error(`options: this is no JSON: ${words(error)}`);
    }
  }
}
