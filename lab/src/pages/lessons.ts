/** Lessons: their list, and one with its steps on the left and its world on the right. */
import type { Command } from "nmes-client";
import { get, part, post, words } from "../api.js";
import { done } from "../command.js";
import type { Genome, Vector } from "../creature/genome.js";
import { h, fill, icon } from "../dom.js";
import { ended, type Job } from "../jobs.js";
import { type Evolved, type Lab, type Lesson, LESSONS, type Step } from "../lessons/lessons.js";
import { isRun, runs } from "../names.js";
import { provide, release, watch } from "../play.js";
import { address, announce, empty, heading, type View } from "../shell.js";
import { Visit } from "../world.js";

const DONE = "nmes-lessons"; // under which the browser keeps which lessons were done
const PATIENCE = 30_000; // ms that a step waits for a world that does not tick

export async function open(view: View): Promise<void> {
  const [id] = view.params;
  const lesson = LESSONS.find((each) => each.id === id);
  if (id === undefined) list(view);
  else if (lesson === undefined) fill(view.root, empty("There is no such lesson", `Nothing is called ${id}.`, h("a", { class: "button", href: "#/lessons" }, "All lessons")));
  else await new Class(lesson, view).open();
}

function list({ root }: View): void {
  const finished = new Set(completed());
  const minutes = LESSONS.reduce((total, lesson) => total + lesson.minutes, 0);
  fill(root, heading("Lessons", `Five short ones, ${minutes} minutes together. Each ends with something that moves.`),
    h("ol", { class: "cards lessons" }, ...LESSONS.map((lesson, i) => h("li", { class: "card" },
      h("div", { class: "run-head" }, h("span", { class: "badge" }, `${lesson.minutes} minutes`), finished.has(lesson.id) && h("span", { class: "badge good" }, icon("check", 14), "done")),
      h("h2", {}, `${i + 1}. ${lesson.title}`), h("p", { class: "soft" }, lesson.about),
      h("a", { class: "button", href: address("lessons", lesson.id) }, finished.has(lesson.id) ? "Once more" : "Begin")))));
}

function completed(): string[] {
  return (localStorage.getItem(DONE) ?? "").split(" ").filter((id) => id !== "");
}

/** One lesson, as it is done. */
class Class implements Lab {
  readonly kept = new Map<string, unknown>();
  readonly #world: string;
  readonly #visit: Visit;
  readonly #stage = h("div", { class: "beside" });
  readonly #outcomes: HTMLElement[] = [];
  readonly #buttons: HTMLButtonElement[] = [];
  readonly #after = h("div", {});
  #watching: AbortController | undefined;
  #told: HTMLElement | undefined;
  #busy = false;

  constructor(private readonly lesson: Lesson, private readonly view: View) {
    this.#world = `lesson-${lesson.id}`;
    this.#visit = new Visit(this.#world, view.signal);
  }

  async open(): Promise<void> {
    const place = LESSONS.indexOf(this.lesson);
    const steps = this.lesson.steps.map((step, i) => this.#step(step, i));
    fill(this.view.root, heading(`${place + 1}. ${this.lesson.title}`, this.lesson.about, h("a", { class: "button", href: "#/lessons" }, "All lessons")),
      h("div", { class: "lesson" }, h("div", { class: "stack" }, h("ol", { class: "steps" }, ...steps), this.#after), this.#stage));
    await provide(this.#world);
    await this.clear();
    this.#show(undefined);
  }

  #step(step: Step, i: number): HTMLElement {
    const outcome = h("p", { class: "outcome", role: "status" });
    const button = h("button", { class: i === 0 ? "primary" : "" }, icon("play", 18), step.button);
    button.addEventListener("click", () => void this.#run(step, i));
    this.#outcomes.push(outcome);
    this.#buttons.push(button);
    return h("li", { class: "card" }, h("p", {}, step.say), step.guess !== undefined && h("p", { class: "guess" }, "Guess first: ", step.guess), button, outcome);
  }

  async #run(step: Step, i: number): Promise<void> {
    const [button, outcome] = [this.#buttons[i], this.#outcomes[i]];
    if (this.#busy || button === undefined || outcome === undefined) return;
    this.#busy = true;
    for (const each of this.#buttons) each.setAttribute("aria-disabled", "true");
    this.#told = outcome;
    fill(outcome, h("span", { class: "spinner", "aria-hidden": "true" }), " …");
    try {
      const came = await step.run(this);
      if (this.view.signal.aborted) return;
      outcome.className = "outcome good";
      fill(outcome, icon("check", 18), h("span", {}, came));
      button.classList.remove("primary");
      this.#buttons[i + 1]?.classList.add("primary");
      announce(came);
      if (this.#outcomes.every((each) => each.classList.contains("good"))) this.#finish();
    } catch (error) {
      if (this.view.signal.aborted) return;
      outcome.className = "outcome bad";
      fill(outcome, icon("warning", 18), h("span", {}, words(error)));
    } finally {
      this.#busy = false;
      for (const each of this.#buttons) each.removeAttribute("aria-disabled");
    }
  }

  #finish(): void {
    localStorage.setItem(DONE, [...new Set([...completed(), this.lesson.id])].join(" "));
    const next = LESSONS[LESSONS.indexOf(this.lesson) + 1];
    fill(this.#after, h("div", { class: "card finished" }, h("h2", {}, "Done"), h("p", {}, this.lesson.more),
      h("div", { class: "actions" }, next !== undefined && h("a", { class: "button primary", href: address("lessons", next.id) }, `Next: ${next.title}`),
        h("a", { class: "button", href: address(this.lesson.page) }, "Try it yourself"))));
  }

  #show(creature: string | undefined): void {
    this.view.signal.throwIfAborted();
    this.#watching?.abort();
    this.#watching = new AbortController();
    fill(this.#stage, watch(this.#world, creature, AbortSignal.any([this.view.signal, this.#watching.signal])));
  }

  // -- what steps can do --------------------------------------------------------------------------------------------

  async send(command: Command): Promise<unknown> {
    this.view.signal.throwIfAborted();
    const reply = await this.#visit.request(command);
    done({ world: this.#world, message: command });
    return reply;
  }

  async clear(): Promise<void> {
    await this.send({ type: "reset" });
    await this.#visit.request({ type: "resume" });
  }

  async release(genome: Genome, more: { readonly asleep?: boolean; readonly target?: Vector } = {}): Promise<void> {
    this.view.signal.throwIfAborted();
    await release({ world: this.#world, name: "it", genome, ...more });
    this.#show("it");
  }

  async position(cube: string): Promise<Vector> {
    this.view.signal.throwIfAborted();
    const { position } = await this.#visit.request({ type: "get_cube_state", cube_name: cube });
    return position as unknown as Vector;
  }

  async wait(seconds: number): Promise<void> {
    let now = await this.#time();
    const until = now + seconds;
    for (let since = performance.now(); until - now > 1e-6; ) { // in a world that is behind the clock, waits longer
      await new Promise((resolve) => setTimeout(resolve, Math.max(20, (until - now) * 1000)));
      const before = now;
      now = await this.#time();
      if (now < before) throw new Error("The world was reset meanwhile. Do it once more.");
      if (now > before) since = performance.now();
      else if (performance.now() - since > PATIENCE) throw new Error("The world stands still. Let it run, and do it once more.");
    }
  }

  /** The time of the lesson's world, s. */
  async #time(): Promise<number> {
    this.view.signal.throwIfAborted();
    const { t } = await this.#visit.request({ type: "get_world_state", cubes: [] });
    this.view.signal.throwIfAborted();
    return t;
  }

  genome(name: string): Promise<Genome> {
    return get<Genome>(`/genomes/${part(name)}`);
  }

  tell(text: string): void {
    if (this.#told !== undefined) fill(this.#told, h("span", { class: "spinner", "aria-hidden": "true" }), ` ${text}`);
  }

  async evolve(genome: Genome, budget: number): Promise<Evolved> {
    const before = (await runs("lesson-")).length;
    const name = `lesson-${before + 1}`;
    const settings = { task: "walk", algorithm: "ga", budget, seed: before + 1, starts: [genome] };
    const job = await post<Job>("/runs", { kind: "evolve", name, settings });
    done(job.command);
    const about = (): Promise<Told> => get<Told>(`/runs/${part(name)}`);
    const look = async (): Promise<void> => {
      if (!(await isRun(name))) return;
      const { told, best } = await about();
      this.tell(`${told} of ${budget} children${best === null ? "" : `, the best with ${best.score.toFixed(2)} m`}`);
    };
    const over = await ended(job, this.view.signal, () => void look());
    if (over.status !== 0) throw new Error(`The run failed: ${over.lines.join(" ")}`);
    const { best, curve, lineage } = await about();
    if (best === null) throw new Error("No candidate has a score.");
    const champion = await get<Genome>(`/runs/${part(name)}/candidates/best/genome`);
    const first = lineage.find((each) => each.index === 0)?.score ?? curve[0]?.quartiles?.[1] ?? 0;
    return { first, best: best.score, champion };
  }
}

interface Told {
  readonly told: number;
  readonly best: { readonly score: number } | null;
  readonly curve: readonly { readonly quartiles: readonly [number, number, number] | null }[];
  readonly lineage: readonly { readonly index: number; readonly score: number | null }[];
}
