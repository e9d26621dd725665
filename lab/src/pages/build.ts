/** Build: a creature from parts, with the pointer or the keyboard, judged as it grows, and put into a world at once. */
import { get, part, post, put, state, words } from "../api.js";
import { action, done } from "../command.js";
import { cubesOf, Impossible, jointsOf } from "../creature/anatomy.js";
import { Bench, type Spot } from "../creature/bench.js";
import { add, fresh, type Stamp, STAMPS } from "../creature/creature.js";
import type { Cube, Genome, Joint, Shape, Vector } from "../creature/genome.js";
import { graphPanels } from "../creature/graph_panels.js";
import { History } from "../creature/history.js";
import { brainPanel, jointPanel, partPanel, partsPanel, problemsPanel, sensesPanel, type Shop } from "../creature/panels.js";
import { field, fill, h, select } from "../dom.js";
import { genomes } from "../names.js";
import { release, worldName } from "../play.js";
import { announce, attempt, go, heading, notify, type View } from "../shell.js";

interface Checked {
  readonly problems: readonly { path: string; message: string }[];
  readonly body: {
    readonly cubes: readonly { id: string; size: Vector; mass: number; position: Vector; quaternion: readonly number[]; color: readonly number[] | null; shape: Shape; later: boolean }[];
    readonly joints: readonly { id: string; a: number; b: number; kind: Joint["type"]; anchor: Vector; axis: Vector | null }[];
  } | null;
}

const LONGEST = 200; // bytes of the name of a file
const SOON = 250; // ms after the last change that it is checked
const DRAFT = "nmes-draft"; // under which the browser keeps what was not saved
const HINTS: Record<Stamp, string> = {
  leg: "hangs down from a side, or goes on from the end of another",
  segment: "goes on from a face, as a tail or a snake does",
  block: "is fixed, as a head or a horn is",
  wheel: "rolls, with a motor of its own",
  ball: "is fixed and round",
};

/** Opens the page: with a genome of that name, or a candidate of a run, or what was built last. */
export async function open({ root, params, query, signal }: View): Promise<void> {
  const genome = await beginning(params[0], query);
  if (signal.aborted) return; // what is made with such a signal never ends
  const workshop = new Workshop(genome, signal);
  fill(root, workshop.element);
  workshop.refresh();
}

async function beginning(name: string | undefined, query: URLSearchParams): Promise<Genome> {
  const [run, candidate] = [query.get("run"), query.get("candidate")];
  if (run !== null && candidate !== null) return get<Genome>(`/runs/${part(run)}/candidates/${part(candidate)}/genome`);
  if (name !== undefined) return get<Genome>(`/genomes/${part(name)}`);
  const draft = sessionStorage.getItem(DRAFT);
  return draft === null ? fresh("mine") : (JSON.parse(draft) as Genome);
}

class Workshop implements Shop {
  readonly memory = new Map<string, boolean>();
  readonly element: HTMLElement;
  chosen: string | undefined;
  mirror = true;
  stamp: Stamp = "leg";
  #adding = true; // a click adds what the stamp says, else it chooses
  readonly #history: History<Genome>;
  readonly #bench: Bench;
  readonly #inspector = h("div", { class: "inspector" });
  readonly #verdict = h("div", { class: "verdicts" });
  readonly #name = h("input", { type: "text", maxlength: 100, spellcheck: "false" });
  readonly #undo: HTMLButtonElement;
  readonly #redo: HTMLButtonElement;
  #checked: Checked | undefined;
  #timer = 0;
  #asked = 0;

  constructor(genome: Genome, private readonly signal: AbortSignal) {
    this.#history = new History(genome);
    this.#bench = new Bench({ press: (spot) => this.#press(spot), foresee: (spot) => this.#foresee(spot), leave: () => this.choose(undefined) }, signal);
    this.#undo = action({ label: "Undo", icon: "undo", bare: true, run: () => this.#turn(() => this.#history.undo()) });
    this.#redo = action({ label: "Redo", icon: "redo", bare: true, run: () => this.#turn(() => this.#history.redo()) });
    this.#name.addEventListener("change", () => {
      const name = this.#name.value.trim();
      if (name !== "") this.commit({ ...this.genome, name });
    });
    addEventListener("keydown", (event) => this.#key(event), { signal });
    signal.addEventListener("abort", () => clearTimeout(this.#timer));
    this.element = h("div", { class: "build" },
      heading("Build", "Click a face to add a part there. Drag to look around it.", ...this.#actions()),
      h("div", { class: "tools" }, this.#stamps(), this.#mirrors(), h("span", { class: "grow" }), this.#undo, this.#redo,
        action({ label: "Show all of it", icon: "search", bare: true, run: () => this.#bench.frame() })),
      h("div", { class: "columns" }, h("div", { class: "stack" }, this.#bench.element, this.#verdict), this.#inspector));
  }

  get genome(): Genome {
    return this.#history.now;
  }

  commit(genome: Genome, step?: string): void {
    this.#history.commit(genome, step);
    this.#changed(step !== undefined);
  }

  choose(id: string | undefined): void {
    this.chosen = id;
    this.#draw();
    this.#inspect();
    if (id !== undefined) announce(`${id} is chosen.`);
  }

  /** Shows all of it anew. */
  refresh(): void {
    this.#changed(false);
  }

  #changed(drawing: boolean): void {
    sessionStorage.setItem(DRAFT, JSON.stringify(this.genome));
    this.#name.value = this.genome.name;
    this.#undo.disabled = !this.#history.canUndo;
    this.#redo.disabled = !this.#history.canRedo;
    if (this.genome.body.graph === undefined && !cubesOf(this.genome).some((cube) => cube.id === this.chosen)) this.chosen = undefined;
    this.#draw();
    if (!drawing) this.#inspect(); // while a slider is drawn it must stay where it is
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => void this.#check(), SOON);
  }

  #turn(step: () => void): void {
    step();
    this.#changed(false);
  }

  #draw(): void {
    if (this.genome.body.graph === undefined) {
      this.#bench.show(cubesOf(this.genome), jointsOf(this.genome), this.chosen, new Set(this.genome.later ?? []));
      return;
    }
    const body = this.#checked?.body;
    if (body === undefined || body === null) return;
    const cubes = body.cubes.map(({ quaternion, color, ...cube }): Cube => ({ ...cube, rotation: quaternion, ...(color === null ? {} : { color }) }));
    const joints = body.joints.map((each): Joint => ({
      id: each.id, type: each.kind, anchor: each.anchor, cube1: body.cubes[each.a]?.id ?? "", cube2: body.cubes[each.b]?.id ?? "", ...(each.axis === null ? {} : { axis: each.axis }),
    }));
    this.#bench.show(cubes, joints, this.chosen, new Set(body.cubes.filter((cube) => cube.later).map((cube) => cube.id)));
  }

  #inspect(): void {
    const focused = this.#inspector.querySelector(":focus");
    const place = focused === null ? -1 : [...this.#inspector.querySelectorAll("button, input, select, summary")].indexOf(focused);
    const name = field("Name", this.#name);
    if (this.genome.body.graph !== undefined) fill(this.#inspector, name, ...graphPanels(this), brainPanel(this));
    else {
      const own = this.chosen;
      fill(this.#inspector, name, partsPanel(this), own !== undefined && partPanel(this, own), own !== undefined && jointPanel(this, own), sensesPanel(this), brainPanel(this));
    }
    // Whoever works with the keyboard stays where they were.
    ([...this.#inspector.querySelectorAll("button, input, select, summary")][place] as HTMLElement | undefined)?.focus();
  }

  async #check(): Promise<void> {
    const asked = (this.#asked += 1);
    fill(this.#verdict, problemsPanel(this, undefined));
    try {
      const checked = await post<Checked>("/genomes/check", this.genome);
      if (asked !== this.#asked || this.signal.aborted) return;
      this.#checked = checked;
      fill(this.#verdict, problemsPanel(this, checked.problems));
      if (this.genome.body.graph !== undefined) this.#draw();
    } catch (error) {
      if (asked === this.#asked && !this.signal.aborted) fill(this.#verdict, h("div", { class: "verdict bad", role: "status" }, words(error)));
    }
  }

  #press(spot: Spot): void {
    if (this.genome.body.graph !== undefined || !this.#adding) {
      this.choose(spot.id);
      return;
    }
    void attempt(() => {
      const { genome } = add(this.genome, spot.id, spot.face, spot.at, this.stamp, this.mirror);
      this.commit(genome);
      announce(`A ${this.stamp} was added.`);
    });
  }

  #foresee(spot: Spot): readonly Cube[] {
    if (this.genome.body.graph !== undefined || !this.#adding) return [];
    try {
      const before = cubesOf(this.genome);
      const after = cubesOf(add(this.genome, spot.id, spot.face, spot.at, this.stamp, this.mirror).genome);
      // Where the body would be lifted, the ghost is shown where the body is now.
      const lift = (after[0]?.position[1] ?? 0) - (before[0]?.position[1] ?? 0);
      return after.slice(before.length).map((cube) => ({ ...cube, position: [cube.position[0], cube.position[1] - lift, cube.position[2]] }));
    } catch (error) {
      if (error instanceof Impossible) return [];
      throw error;
    }
  }

  #key(event: KeyboardEvent): void {
    const typing = event.target instanceof HTMLInputElement || event.target instanceof HTMLSelectElement;
    if (typing || !(event.ctrlKey || event.metaKey)) return;
    const key = event.key.toLowerCase();
    if (key !== "z" && key !== "y") return;
    event.preventDefault();
    this.#turn(() => (key === "y" || event.shiftKey ? this.#history.redo() : this.#history.undo()));
  }

  #stamps(): HTMLElement {
    const tools = ["choose", ...STAMPS] as const;
    const buttons = tools.map((tool) => h("button", {
      class: "small", "aria-pressed": String(tool === this.stamp),
      title: tool === "choose" ? "A click chooses a part, to change it" : `A click adds a ${tool}, which ${HINTS[tool]}`,
    }, tool === "choose" ? "Choose" : tool));
    buttons.forEach((button, i) => button.addEventListener("click", () => {
      const tool = tools[i] ?? "choose";
      this.#adding = tool !== "choose";
      if (tool !== "choose") this.stamp = tool;
      for (const each of buttons) each.setAttribute("aria-pressed", String(each === button));
      this.#inspect();
    }));
    return h("div", { class: "row", role: "group", "aria-label": "What a click does" }, buttons[0], h("span", { class: "soft" }, "or add a"), ...buttons.slice(1));
  }

  #mirrors(): HTMLElement {
    const button = h("button", { class: "small", "aria-pressed": "true", title: "What is done on one side is done on the other" }, "Mirror");
    button.addEventListener("click", () => {
      this.mirror = !this.mirror;
      button.setAttribute("aria-pressed", String(this.mirror));
      this.#inspect();
    });
    return button;
  }

  #actions(): HTMLElement[] {
    const opening = h("button", {}, "Open");
    opening.addEventListener("click", () => void attempt(() => this.#choose()));
    return [
      action({ label: "New", icon: "plus", run: () => { this.chosen = undefined; this.commit(fresh("mine")); this.#bench.frame(); } }),
      opening,
      action({ label: "Save", icon: "download", run: () => this.#save() }),
      action({ label: "Evolve this", icon: "evolve", run: async () => { await this.#save(); location.hash = `#/evolve?genome=${encodeURIComponent(this.#file())}`; } }),
      action({ label: "Drop into a world", icon: "worlds", look: "primary", run: () => this.#drop() }),
    ];
  }

  /** The name of its file: letters and digits of any script, and what the lab's folder takes of other characters. */
  #file(): string {
    const name = this.genome.name.normalize("NFC").replace(/[^\p{L}\p{N}_.-]+/gu, "-").replace(/^[.-]+/, "");
    const bytes = new TextEncoder();
    let short = ""; // file systems count bytes
    for (const letter of [...name].slice(0, 100)) {
      if (bytes.encode(short + letter).length > LONGEST) break;
      short += letter;
    }
    return short || "creature";
  }

  async #save(): Promise<void> {
    const { hash, command } = await put<{ hash: string; command: string }>(`/genomes/${part(this.#file())}`, this.genome);
    done(command);
    notify(`Saved as ${this.#file()}, ${hash.slice(0, 12)} …`, "good");
  }

  async #drop(): Promise<void> {
    const world = worldName("try", this.genome.name);
    await release({ world, name: "it", genome: this.genome });
    go("worlds", world);
  }

  async #choose(): Promise<void> {
    const [known, { folder = "" }] = await Promise.all([genomes(this.signal), state()]);
    const list = select(known.map(({ name, ships }) => [name, ships ? `${name} (ships with NMES)` : name] as const));
    const file = h("input", { type: "file", accept: ".json,application/json" });
    const dialog = h("dialog", { class: "card", "aria-label": "Open a creature" });
    const close = (genome?: Genome): void => {
      dialog.close();
      dialog.remove();
      if (genome === undefined) return;
      this.chosen = undefined;
      this.#checked = undefined;
      this.commit(genome);
      if (genome.body.graph === undefined) this.#bench.frame();
    };
    file.addEventListener("change", () => void attempt(async () => {
      const chosen = file.files?.[0];
      if (chosen === undefined) return;
      const document = JSON.parse(await chosen.text()) as Genome;
      const { problems } = await post<Checked>("/genomes/check", document);
      const first = problems[0];
      if (first !== undefined) throw new Error(`${chosen.name} is no good genome: ${first.path}: ${first.message}`);
      close(document);
    }));
    dialog.addEventListener("close", () => dialog.remove());
    fill(dialog, h("h2", {}, "Open a creature"), field("Of the lab", list, `Those that ship, and those in ${folder}/genomes`), field("Or a file", file),
      h("div", { class: "actions" }, action({ label: "Cancel", run: () => close() }),
        action({ label: "Open it", look: "primary", run: async () => close(await get<Genome>(`/genomes/${part(list.value)}`)) })));
    this.element.append(dialog);
    dialog.showModal();
  }
}
