/** One run, as it goes on: its curve, its best, its archive, who comes from whom; and the champion in a world. */
import { ApiError, get, kept, part, post, put, words } from "../api.js";
import { action, done, line } from "../command.js";
import type { Genome } from "../creature/genome.js";
import { portrait } from "../creature/portrait.js";
import { type Child, fill, h } from "../dom.js";
import type { Job } from "../jobs.js";
import { isRun } from "../names.js";
import { stage, watch, worldName } from "../play.js";
import { address, announce, failure, heading, loading, notify, type View } from "../shell.js";
import { Curve, heatMap, lineage, worded } from "./charts.js";
import type { Measure, Relative } from "./places.js";

interface Candidate extends Relative {
  readonly measures: readonly number[];
}

/** A run, as the lab tells of it. */
interface Run {
  readonly kind: "evolve" | "learn";
  readonly state: "running" | "paused" | "finished";
  readonly job: number | null;
  readonly settings: { readonly task: { readonly name: string } | string; readonly algorithm: string; readonly budget?: number; readonly steps?: number; readonly seed: number; readonly measures?: readonly Measure[] };
  readonly told?: number;
  readonly best: { readonly index?: number; readonly leg?: number; readonly score: number } | null;
  readonly curve?: readonly { begin: number; end: number; quartiles: readonly [number, number, number] | null; best: number | null }[];
  readonly archive?: readonly Candidate[];
  readonly lineage?: readonly Candidate[];
  readonly top?: readonly { index: number; score: number; operator: string }[];
  readonly legs?: readonly { steps: number; score: number | null; return: number | null }[];
  readonly digest: string;
}

const OFTEN = 1000; // ms between looks at a run that goes on
const SELDOM = 5000; // of one that does not

export class RunView {
  readonly #curve: Curve;
  readonly #head = h("div", { class: "run-head" });
  readonly #bar = h("span", {});
  readonly #best = h("div", { class: "card" });
  readonly #archive = h("div", { class: "card" });
  readonly #family = h("div", { class: "card" });
  readonly #stage = h("div", { class: "card" });
  readonly #said = h("pre", { class: "said", tabIndex: 0, hidden: true });
  readonly #portraits = new Map<number | "best", Promise<SVGElement | undefined>>();
  #shown = ""; // the digest of what is drawn
  #watching: AbortController | undefined;
  #staged: Promise<void> = Promise.resolve(); // the last candidate that was put into the world, or could not be
  #chosen: number | "best" = "best";
  #timer = 0;
  #job: string | null;

  constructor(private readonly name: string, private readonly view: View) {
    this.#curve = new Curve("Scores", view.signal);
    this.#job = view.query.get("job");
    view.signal.addEventListener("abort", () => clearTimeout(this.#timer));
  }

  async open(): Promise<void> {
    const progress = h("div", { class: "progress", role: "progressbar", "aria-label": "Progress" }, this.#bar);
    fill(this.view.root, heading(this.name, undefined, h("a", { class: "button", href: "#/evolve" }, "All runs")), this.#head, progress, this.#said,
      h("div", { class: "run-columns" },
        h("div", { class: "stack" }, this.#stage, h("div", { class: "card" }, h("h2", {}, "Scores"), this.#curve.element), this.#archive, this.#family),
        h("div", { class: "stack" }, this.#best)));
    for (const card of [this.#archive, this.#family, this.#stage]) card.hidden = true;
    fill(this.#best, loading("the run"));
    await this.#look();
  }

  async #look(): Promise<void> {
    clearTimeout(this.#timer);
    let running = true;
    try {
      // A run that has just been started has no folder yet; what its command says tells whether it will.
      if (this.#shown === "" && this.#job !== null && !(await isRun(this.name))) {
        running = await this.#tell(this.#job);
        if (running || !this.#said.hidden) return;
      }
      const run = await get<Run>(`/runs/${part(this.name)}`);
      if (this.view.signal.aborted) return;
      running = run.state === "running";
      this.#show(run);
      if (this.#job !== null && !running) await this.#tell(this.#job);
    } catch (error) {
      if (this.view.signal.aborted) return;
      if (this.#said.hidden) {
        fill(this.#best, failure(error, () => void this.#look()));
        this.#shown = ""; // what is there when it answers again is drawn anew
      }
    } finally {
      if (!this.view.signal.aborted) this.#timer = setTimeout(() => void this.#look(), running ? OFTEN : SELDOM);
    }
  }

  /** Shows what the command of this run says where it failed; returns whether it goes on. */
  async #tell(id: string): Promise<boolean> {
    const job = await this.#begun(id);
    if (job === undefined) return false;
    // One that was paused also ends with 1, but prints how far it came, or says that it did not begin.
    const paused = job.status === 1 && (job.result !== null || job.lines.at(-1) === "Aborted!");
    const failed = job.state === "ended" && job.status !== 0 && !paused;
    this.#said.hidden = !failed;
    if (failed) {
      this.#said.textContent = [job.command, ...job.lines].join("\n");
      if (this.#shown === "") fill(this.#best, h("p", { class: "bad" }, "The command failed; what it said stands above."));
    }
    return job.state === "running";
  }

  /** Returns a command of this run; undefined where the lab, begun anew meanwhile, has none or another by that number. */
  async #begun(id: string): Promise<Job | undefined> {
    try {
      const job = await get<Job>(`/jobs/${part(id)}`);
      if (job.about === `run ${this.name}`) return job;
    } catch (error) {
      if (!(error instanceof ApiError && error.status === 404)) throw error;
    }
    this.#job = null;
    return undefined;
  }

  #show(run: Run): void {
    const learning = run.kind === "learn";
    const total = (learning ? run.settings.steps : run.settings.budget) ?? 1;
    const done = learning ? (run.legs?.at(-1)?.steps ?? 0) : (run.told ?? 0);
    const task = typeof run.settings.task === "string" ? run.settings.task : run.settings.task.name;
    const percent = Math.min(100, (100 * done) / total); // a run of learning ends its last leg, beyond what was asked for
    this.#bar.style.setProperty("width", `${percent}%`);
    this.#bar.parentElement?.setAttribute("aria-valuenow", String(Math.round(percent)));
    const key = `${run.state} ${run.digest}`;
    if (key === this.#shown) return;
    const before = this.#shown.split(" ")[0];
    if (before !== "" && before !== run.state) announce(`The run is ${run.state}.`);
    this.#shown = key;
    this.#portraits.delete("best");
    const asked = `${done > total ? "at least " : ""}${total.toLocaleString("en")}`;
    fill(this.#head, badge(run.state), h("span", {}, `${done.toLocaleString("en")} of ${asked} ${learning ? "steps" : "candidates"}`),
      h("span", { class: "soft" }, `${task} · ${run.settings.algorithm} · seed ${run.settings.seed}`), h("span", { class: "grow" }), this.#steering(run));
    this.#draw(run);
    this.#champion(run, learning);
    this.#kinds(run);
    this.#relatives(run);
  }

  #steering(run: Run): Child {
    const path = kept("runs", this.name);
    const like = h("a", { class: "button", href: `#/evolve?like=${encodeURIComponent(this.name)}` }, "Begin another like it");
    const steer = async (what: "pause" | "resume", more: { budget?: number } = {}): Promise<void> => {
      const job = await post<{ id: number }>(`/runs/${part(this.name)}/${what}`, more);
      if (what === "resume") this.#job = String(job.id);
      await this.#look();
    };
    if (run.state === "running") return action({ label: "Pause", icon: "pause", run: () => steer("pause") });
    const resume = run.state === "paused" && action({ label: "Resume", icon: "play", look: "primary", command: () => line("nmes", run.kind, "resume", path), run: () => steer("resume") });
    if (run.kind === "learn") return [resume, like];
    const budget = h("input", { type: "number", class: "few", min: Math.max(run.told ?? 1, 1), max: 1_000_000_000, value: String(2 * (run.settings.budget ?? 1)), "aria-label": "Another budget, in candidates" });
    const more = action({
      label: "Go on to", icon: "play", command: () => line("nmes", "evolve", "resume", path, "--budget", budget.value),
      run: () => steer("resume", { budget: Number(budget.value) }),
    });
    return [resume, more, budget, like];
  }

  #draw(run: Run): void {
    if (run.legs !== undefined) {
      this.#curve.show("steps", run.legs.map((leg) => leg.steps), [
        { name: "score", values: filled(run.legs.map((leg) => leg.score)), color: "series-1", width: 3 },
        { name: "return", values: run.legs.map((leg) => leg.return), color: "series-2" },
      ]);
      return;
    }
    const points = run.curve ?? [];
    const quartile = (i: 0 | 1 | 2): (number | null)[] => points.map((point) => point.quartiles?.[i] ?? null);
    this.#curve.show("candidates", points.map((point) => point.end), [
      { name: "best", values: points.map((point) => point.best), color: "series-1", width: 3 },
      { name: "better half", values: quartile(2), color: "series-3" },
      { name: "middle", values: quartile(1), color: "series-2" },
    ]);
  }

  #champion(run: Run, learning: boolean): void {
    const best = run.best;
    if (best === null) {
      fill(this.#best, h("h2", {}, "Best"), h("p", { class: "soft" }, "No candidate has a score yet."));
      return;
    }
    const picture = h("div", {});
    void this.#portrait("best", 120).then((drawing) => drawing !== undefined && fill(picture, drawing));
    const which = learning ? `after leg ${best.leg}` : `candidate ${best.index}`;
    fill(this.#best, h("h2", {}, "Best"),
      h("div", { class: "best" }, picture, h("div", {}, h("div", { class: "score" }, worded(best.score)), h("div", { class: "soft" }, which))),
      h("div", { class: "actions" },
        action({ label: "Watch it", icon: "play", look: "primary", run: () => this.#watch("best") }),
        ...this.#keeping("best")),
      ...(run.top !== undefined && run.top.length > 1 ? [h("h3", {}, "Others that did well"), this.#others(run.top)] : []));
  }

  #keeping(candidate: number | "best"): HTMLElement[] {
    const file = `${this.name}-${candidate}`;
    return [
      action({
        label: "Save as a genome", icon: "download",
        run: async () => {
          const { command } = await put<{ command: string }>(`/genomes/${part(file)}`, { ...(await this.#genome(candidate)), name: file });
          done(command);
          notify(`Saved as ${file}`, "good");
        },
      }),
      h("a", { class: "button", href: `#/build?run=${encodeURIComponent(this.name)}&candidate=${candidate}` }, "Open in Build"),
    ];
  }

  #others(top: NonNullable<Run["top"]>): HTMLElement {
    return h("div", { class: "top" }, ...top.slice(1, 7).map(({ index, score }) => {
      const button = h("button", { onclick: () => void this.#watch(index), title: `Watch candidate ${index}` });
      void this.#portrait(index, 80).then((drawing) => fill(button, drawing ?? null, h("span", {}, `${index} · ${worded(score)}`)));
      return button;
    }));
  }

  #kinds(run: Run): void {
    const measures = run.settings.measures ?? [];
    this.#archive.hidden = measures.length === 0 || (run.archive ?? []).length === 0;
    if (this.#archive.hidden) return;
    fill(this.#archive, h("h2", {}, "Archive"), h("p", { class: "soft" }, "The best creature of every kind. Click one to watch it."),
      heatMap(measures, run.archive ?? [], (index) => this.#portrait(index, 48), (index) => void this.#watch(index)));
  }

  #relatives(run: Run): void {
    const index = run.best?.index;
    this.#family.hidden = index === undefined || (run.lineage ?? []).length < 2;
    if (index === undefined || this.#family.hidden) return;
    fill(this.#family, h("h2", {}, "Lineage of the best"), h("p", { class: "soft" }, "From its ancestors on the left. Click one to watch it."), lineage(run.lineage ?? [], index, (each) => void this.#watch(each)));
  }

  /** Shows a candidate live. The world is made anew for each, so that one is staged after the other. */
  #watch(candidate: number | "best"): Promise<void> {
    this.#watching?.abort();
    this.#watching = new AbortController();
    const signal = AbortSignal.any([this.view.signal, this.#watching.signal]);
    this.#chosen = candidate;
    this.#stage.hidden = false;
    fill(this.#stage, h("h2", {}, live(candidate)), loading("the world"));
    this.#staged = this.#staged.then(() => this.#put(candidate, signal));
    return this.#staged;
  }

  async #put(candidate: number | "best", signal: AbortSignal): Promise<void> {
    if (signal.aborted) return;
    const world = worldName("run", this.name);
    try {
      const { creature, task, seed } = await stage(world, this.name, candidate);
      if (signal.aborted) return;
      fill(this.#stage, h("h2", {}, live(candidate)), h("p", { class: "soft" }, `In the world of ${task}, as seed ${seed} draws it.`), watch(world, creature, signal),
        h("div", { class: "actions" }, action({ label: "From the start", icon: "reset", run: () => this.#watch(this.#chosen) }), h("a", { class: "button", href: address("worlds", world) }, "Open its world"),
          ...(candidate === "best" ? [] : this.#keeping(candidate))));
      this.#stage.scrollIntoView({ block: "nearest", behavior: "smooth" });
    } catch (error) {
      if (signal.aborted) return;
      fill(this.#stage, h("h2", {}, live(candidate)), failure(error, () => void this.#watch(candidate)));
      announce(words(error));
    }
  }

  #genome(candidate: number | "best"): Promise<Genome> {
    return get<Genome>(`/runs/${part(this.name)}/candidates/${candidate}/genome`);
  }

  #portrait(candidate: number | "best", size: number): Promise<SVGElement | undefined> {
    const known = this.#portraits.get(candidate) ?? this.#genome(candidate).then((genome) => drawn(genome, size));
    this.#portraits.set(candidate, known);
    return known.then((drawing) => {
      const copy = drawing?.cloneNode(true) as SVGElement | undefined;
      for (const edge of ["width", "height"]) copy?.setAttribute(edge, String(size));
      return copy;
    });
  }
}

function live(candidate: number | "best"): string {
  return candidate === "best" ? "The best, live" : `Candidate ${candidate}, live`;
}

/** A portrait of a genome: of one that grows, as the lab says that it has grown. */
export async function drawn(genome: Pick<Genome, "body">, size: number): Promise<SVGElement | undefined> {
  type Cubes = Parameters<typeof portrait>[0];
  if (genome.body.cubes !== undefined) return portrait(genome.body.cubes, size);
  const { body } = await post<{ body: { cubes: readonly (Cubes[number] & { quaternion: readonly number[]; color: readonly number[] | null })[] } | null }>("/genomes/check", genome);
  return body === null ? undefined : portrait(body.cubes.map(({ quaternion, color, ...cube }) => ({ ...cube, rotation: quaternion, ...(color === null ? {} : { color }) }) as Cubes[number]), size);
}

/** A line without gaps: between two scores the last one stands. */
function filled(values: readonly (number | null)[]): (number | null)[] {
  let last: number | null = null;
  return values.map((value) => (last = value ?? last));
}

function badge(text: Run["state"]): HTMLElement {
  return h("span", { class: `badge ${text === "paused" ? "warn" : "good"}` }, text);
}
