/** The brain of a creature in a world: its network with weights, what it senses, and what its units do meanwhile. */
import { get, kept, post, socketUrl, words } from "../api.js";
import { action, done, line } from "../command.js";
import { Link } from "../connection.js";
import { append, field, fill, h, icon, svg } from "../dom.js";
import { type Job, ended } from "../jobs.js";
import { type Mind, type Network, described, network } from "../network.js";
import type { Scene } from "../poses.js";
import { type View, address, empty, go, heading, load } from "../shell.js";
import { Visit, allWorlds } from "../world.js";
import { showTable } from "./table.js";

const LOOK = 100; // ms between two looks at the sensors
const WIDTH = 760;
const MOST_UNITS = 400; // that are drawn
const MOST_WIRES = 4000;

interface Checked {
  readonly body: { readonly sensors: readonly { readonly id: string; readonly type: string }[]; readonly outputs: readonly string[] } | null;
}

/** What a world tells of the brain of one of its creatures. */
interface Told extends Mind {
  /** Whether the world runs it. */
  readonly own: boolean;
}

export function open(view: View): void {
  const [world, creature] = view.params;
  if (world !== undefined && creature !== undefined) {
    show(view, world, creature);
  } else if (world !== undefined) {
    showTable(view, world); // of one part: a table, which is of no world
  } else {
    choose(view);
  }
}

/** All creatures of all worlds that run. */
function choose({ root, signal }: View): void {
  const body = h("div", { class: "stack" });
  const tables = h("section", { class: "card stack" });
  append(root, [heading("Brain", "What a creature senses, and what its network makes of it while it lives."), body, tables]);
  void load(tables, "tables", () => get<{ items: readonly { name: string }[] }>("/tables", {}, signal), ({ items }) => taught(items.map(({ name }) => name), signal), signal);
  void load(body, "worlds", () => allWorlds(50), (worlds) => {
    const awake = worlds.filter(({ frame }) => frame !== null);
    const cards = h("div", { class: "cards" });
    const none = empty("Nobody lives yet", "Drop a creature into a world; then its brain can be watched here.", h("a", { class: "button primary", href: "#/worlds" }, "To the worlds"));
    for (const { world } of awake.slice(0, 20)) {
      const card = h("section", { class: "card stack", hidden: true });
      cards.append(card);
      const link = new Link(socketUrl("/ws/poses", { world }), {
        message: (message) => {
          if (message["type"] !== "scene") return;
          const names = ((message as { creatures?: Scene["creatures"] }).creatures ?? []).slice(0, 50);
          card.hidden = names.length === 0;
          none.hidden ||= names.length > 0;
          fill(card, h("h2", {}, world), h("ul", { class: "list" }, ...names.map(({ name, genome }) =>
            h("li", {}, h("a", { href: address("brain", world, name) }, name), h("span", { class: "soft" }, genome ?? "")))));
        },
      }, signal);
      card.append(link.banner);
    }
    return [none, cards];
  }, signal);
}

/** The tables of Q-learning that there are, and a cube that learns another. */
function taught(names: readonly string[], signal: AbortSignal): HTMLElement[] {
  let free = 1;
  while (names.includes(`cube-${free}`)) free += 1;
  const episodes = h("input", { type: "number", min: 1, max: 100_000, value: "1200", required: true });
  const seed = h("input", { type: "number", min: 0, max: 1_000_000_000, value: String(free), required: true });
  const note = h("p", { class: "hint", role: "status" });
  const teach = action({
    label: "Teach a cube", icon: "play", look: "primary",
    command: () => line("nmes", "learn", "cube", "-o", kept("tables", `cube-${free}.json`), "--episodes", episodes.value, "--seed", seed.value),
    run: async () => {
      note.textContent = "It learns, which takes a quarter of a minute or so …";
      const asked = { name: `cube-${free}`, episodes: Number(episodes.value), seed: Number(seed.value) };
      const job = await ended(await post<Job>("/tables", asked), signal);
      note.textContent = "";
      if (job.status !== 0) throw new Error(job.lines.at(-1) ?? "it could not be taught");
      go("brain", asked.name);
    },
  });
  return [
    h("h2", {}, "Tables of Q-learning"),
    h("p", { class: "soft" }, "A cube learns to be pushed to a target; what it has learned is a table: what each push is worth in each state."),
    h("ul", { class: "list" }, ...names.map((name) => h("li", {}, h("a", { href: address("brain", name) }, name)))),
    h("div", { class: "form" }, field("Episodes to learn from", episodes), field("Seed of the cube", seed)),
    h("div", { class: "actions" }, teach), note,
  ];
}

function show({ root, signal }: View, world: string, creature: string): void {
  const visit = new Visit(world, signal);
  const body = h("div", { class: "stack" });
  append(root, [heading(creature, `A creature in ${world}.`, h("a", { class: "button", href: address("worlds", world) }, icon("worlds", 18), "Watch it")), body]);
  void load(body, "the brain", async () => {
    const message = { type: "get_genome", creature } as const;
    const { genome } = await visit.request(message);
    done({ world, message });
    const { body: found } = await post<Checked>("/genomes/check", genome);
    return { genome, found };
  }, ({ genome, found }) => {
    const brain = genome["brain"] as { readonly [name: string]: unknown } | undefined;
    const sensors = found?.sensors ?? [];
    const names = sensors.map(({ id }) => id);
    const drawn = brain === undefined ? undefined : network(brain, names, found?.outputs ?? []);
    const outputs = found?.outputs ?? [];
    const bars = sensors.length === 0 ? undefined : new Bars(names);
    const driven = outputs.length === 0 ? undefined : new Bars(outputs);
    const picture = drawn === undefined ? undefined : new Picture(drawn);
    const note = h("p", { class: "hint", role: "status" });
    const whose = h("p", { class: "hint" });
    let sensed: readonly number[] = [];
    let mind: Told = { own: true, units: [], controls: [] };
    if (bars !== undefined) {
      void sense(visit, creature, signal, (values) => {
        sensed = values;
        bars.show(values);
        picture?.show(sensed, mind);
      }, (text) => (note.textContent = text));
    }
    const link = new Link(socketUrl("/ws/poses", { world, mind: creature }), {
      message: (message) => {
        if (message["type"] !== "mind") return;
        mind = message as unknown as Told;
        whose.textContent = mind.own || brain === undefined ? "" : "Its brain is run by somebody else: what its units do only they know.";
        driven?.show(mind.controls);
        picture?.show(sensed, mind);
      },
    }, signal);
    return h("div", { class: "stack" }, link.banner, h("div", { class: "columns" },
      h("div", { class: "card stack" }, h("h2", {}, brain === undefined ? "It has no brain" : `A brain of kind ${String(brain["kind"])}`),
        picture?.element ?? h("p", { class: "soft" }, brain === undefined ? "Whoever runs it drives its motors by messages." : described(brain)),
        picture !== undefined && h("p", { class: "hint" }, "Lines are weights: ", h("span", { class: "plus" }, "positive"), " and ", h("span", { class: "minus" }, "negative"), ", the thicker the larger. ",
          drawn?.remembers === true ? "Units are filled by what they do, which depends on their past: the world tells it."
            : "Units are filled by what they do, which this page computes of what is sensed now."), whose),
      h("div", { class: "stack" },
        h("div", { class: "card stack" }, h("h2", {}, "What it senses"), note, bars?.element ?? h("p", { class: "soft" }, "It has no sensors.")),
        h("div", { class: "card stack" }, h("h2", {}, "What its motors are told"), driven?.element ?? h("p", { class: "soft" }, "It has no motors.")))));
  }, signal);
}

/** Reads the sensors again and again, while the page is looked at. */
async function sense(visit: Visit, creature: string, signal: AbortSignal, show: (values: readonly number[]) => void, told: (text: string) => void): Promise<void> {
  while (!signal.aborted) {
    try {
      if (!document.hidden) {
        show((await visit.request({ type: "sense", creature })).values);
        told("");
      }
      await new Promise((resolve) => setTimeout(resolve, LOOK));
    } catch (error) {
      told(`${words(error)}. Trying again …`);
      await new Promise((resolve) => setTimeout(resolve, 20 * LOOK));
    }
  }
}

/** A bar a sensor. */
class Bars {
  readonly element: HTMLElement;
  private readonly rows: { bar: HTMLElement; number: HTMLElement }[];

  constructor(names: readonly string[]) {
    this.rows = names.slice(0, MOST_UNITS).map(() => ({ bar: h("i"), number: h("span", { class: "number mono" }) }));
    this.element = h("ul", { class: "bars" }, ...this.rows.map(({ bar, number }, place) =>
      h("li", {}, h("span", { class: "breaks" }, names[place] ?? ""), h("span", { class: "bar-track" }, bar), number)));
  }

  show(values: readonly number[]): void {
    this.rows.forEach(({ bar, number }, place) => {
      const value = values[place] ?? 0;
      const part = Math.tanh(value);
      bar.style.left = `${50 + Math.min(part, 0) * 50}%`;
      bar.style.width = `${Math.abs(part) * 50}%`;
      number.textContent = value.toFixed(2);
    });
  }
}

/** A network, drawn: a column of units for each step that values take. */
class Picture {
  readonly element: SVGElement;
  private readonly dots: SVGElement[];

  constructor(private readonly network: Network) {
    const units = network.units.slice(0, MOST_UNITS);
    const columns = Math.max(...units.map(({ column }) => column)) + 1;
    const counts = Array.from({ length: columns }, (_, column) => units.filter((unit) => unit.column === column).length);
    const height = Math.max(140, Math.max(...counts) * 30 + 20);
    const seen = Array.from({ length: columns }, () => 0);
    const places = units.map(({ column }) => {
      const row = seen[column] ?? 0;
      seen[column] = row + 1;
      return [150 + (columns === 1 ? 0.5 : column / (columns - 1)) * (WIDTH - 300), ((row + 0.5) / (counts[column] ?? 1)) * height] as const;
    });
    const strongest = Math.max(...network.wires.map(({ weight }) => Math.abs(weight)), 1e-9);
    const lines = network.wires.slice(0, MOST_WIRES).flatMap(({ from, to, weight }) => {
      const [start, end] = [places[from], places[to]];
      if (start === undefined || end === undefined) {
        return [];
      }
      const [x1, y1] = start;
      const [x2, y2] = end;
      const bend = x2 > x1 ? `M${x1} ${y1}C${(x1 + x2) / 2} ${y1} ${(x1 + x2) / 2} ${y2} ${x2} ${y2}`
        : from === to ? `M${x1} ${y1}c26 -34 40 18 0 4` : `M${x1} ${y1}Q${(x1 + x2) / 2 + 60} ${(y1 + y2) / 2} ${x2} ${y2}`;
      const line = svg("path", { d: bend, class: weight < 0 ? "wire minus" : "wire plus", "stroke-width": 0.5 + (3.5 * Math.abs(weight)) / strongest });
      line.append(svg("title", {}, weight.toPrecision(3)));
      return [line];
    });
    this.dots = places.map(([cx, cy]) => svg("circle", { cx, cy, r: 8, class: "unit" }));
    const labels = units.map(({ label, column }, place) => {
      const [x, y] = places[place] ?? [0, 0];
      const short = label.length > 20 ? `${label.slice(0, 19)}…` : label;
      return column === 0 && columns > 1 ? svg("text", { x: x - 14, y: y + 4, "text-anchor": "end" }, short)
        : column === columns - 1 ? svg("text", { x: x + 14, y: y + 4 }, short) : svg("text", { x, y: y - 13, "text-anchor": "middle" }, short);
    });
    this.element = svg("svg", { viewBox: `0 0 ${WIDTH} ${height}`, class: "network", role: "img", "aria-label": `A network of ${network.units.length} units and ${network.wires.length} weights` }, ...lines, ...places.map(([cx, cy]) => svg("circle", { cx, cy, r: 8, class: "under" })), ...this.dots, ...labels);
  }

  show(sensed: readonly number[], mind: Mind): void {
    this.network.activate(sensed, mind).forEach((value, unit) => {
      const dot = this.dots[unit];
      if (dot !== undefined) {
        dot.style.setProperty("fill", value < 0 ? "var(--series-2)" : "var(--series-1)");
        dot.style.setProperty("fill-opacity", Math.min(Math.abs(value), 1).toFixed(2));
      }
    });
  }
}

