/** A table of Q-learning: what each action is worth in each state, and which is best. */
import { get, part } from "../api.js";
import { append, field, fill, h, icon, select, svg } from "../dom.js";
import { type View, heading, load } from "../shell.js";

/** A document as `schemas/q_table.json` has it. */
interface Table {
  readonly title: string;
  readonly dimensions: readonly Dimension[];
  readonly actions: readonly { readonly name: string; readonly arrow?: readonly [number, number] }[];
  readonly values: readonly (readonly number[])[];
  readonly visits: readonly (readonly number[])[];
  readonly figures: { readonly [name: string]: number };
  readonly digest: string;
}

interface Dimension {
  readonly name: string;
  readonly unit: string;
  readonly edges: readonly number[];
}

const KEYS: { readonly [key: string]: readonly [number, number] } = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

export function showTable({ root, signal }: View, name: string): void {
  const body = h("div", { class: "stack" });
  append(root, [heading(name, "A table of Q-learning: what each action is worth in each state.", h("a", { class: "button", href: "#/brain" }, icon("back", 18), "All brains")), body]);
  void load(body, "the table", () => get<Table>(`/tables/${part(name)}`, {}, signal), (table) => new Shown(table).element, signal);
}

/** The first two dimensions are a map; what all others are is chosen. */
class Shown {
  readonly element: HTMLElement;
  readonly #map = h("div", { class: "states", role: "group", "aria-label": "States: arrow keys go from one to the next" });
  readonly #about = h("div", { class: "card stack", "aria-live": "polite" });
  readonly #others: HTMLSelectElement[];
  readonly #columns: number;
  readonly #rows: number;
  readonly #strides: readonly number[];
  #at: readonly [number, number];

  constructor(private readonly table: Table) {
    const { dimensions } = table;
    const counts = dimensions.map(({ edges }) => edges.length + 1);
    this.#strides = counts.map((_, place) => counts.slice(place + 1).reduce((all, count) => all * count, 1));
    this.#columns = counts[0] ?? 1;
    this.#rows = counts[1] ?? 1;
    this.#at = [this.#columns >> 1, this.#rows >> 1];
    this.#others = dimensions.slice(2).map((dimension, place) => {
      const count = counts[place + 2] ?? 1;
      const choice = select(Array.from({ length: count }, (_, range) => [String(range), between(dimension, range)] as const), String(count >> 1));
      choice.addEventListener("change", () => this.#draw());
      return choice;
    });
    this.#map.style.setProperty("--columns", String(this.#columns));
    this.#map.addEventListener("keydown", (event) => this.#move(event));
    const [across, down] = dimensions;
    this.element = h("div", { class: "columns" },
      h("div", { class: "card stack" }, h("h2", {}, table.title),
        this.#others.length > 0 && h("div", { class: "form" }, ...this.#others.map((choice, place) => field(dimensions[place + 2]?.name ?? "", choice))),
        this.#map,
        h("p", { class: "hint" }, `From left to right: ${across?.name ?? ""}${down === undefined ? "" : `; from top to bottom: ${down.name}`}. The stronger the colour, the more the best action is worth; it is what the arrow shows. Pale and dotted is what it was never in.`)),
      h("div", { class: "stack" }, this.#about,
        h("div", { class: "card stack" }, h("h2", {}, "What is known of it"), h("ul", { class: "list" },
          ...Object.entries(table.figures).map(([name, value]) => h("li", {}, h("span", {}, name), h("span", { class: "number mono" }, value.toLocaleString("en")))),
          h("li", {}, h("span", {}, "digest"), h("code", { class: "breaks" }, table.digest))))));
    this.#draw();
  }

  #state(column: number, row: number): number {
    return [column, ...(this.table.dimensions.length > 1 ? [row] : []), ...this.#others.map(({ value }) => Number(value))]
      .reduce((sum, range, place) => sum + range * (this.#strides[place] ?? 1), 0);
  }

  #draw(): void {
    const { values, visits, actions, dimensions } = this.table;
    const bests = values.map((row) => Math.max(...row));
    const [low, high] = [Math.min(...bests), Math.max(...bests)];
    const cells = Array.from({ length: this.#columns * this.#rows }, (_, place) => {
      const [column, row] = [place % this.#columns, Math.floor(place / this.#columns)];
      const state = this.#state(column, row);
      const best = bests[state] ?? 0;
      const action = actions[(values[state] ?? []).indexOf(best)];
      const seen = (visits[state] ?? []).reduce((sum, count) => sum + count, 0);
      const where = dimensions.slice(0, 2).map((dimension, axis) => `${dimension.name} ${between(dimension, axis === 0 ? column : row)}`).join(", ");
      const cell = h("button", {
        type: "button", class: seen === 0 ? "state never" : "state", tabIndex: -1, title: where,
        "aria-label": `${where}: ${seen === 0 ? "never seen" : `best is to ${action?.name ?? ""}, worth ${best.toFixed(2)}`}`,
        onclick: () => this.#choose(column, row),
      }, seen === 0 ? "" : action?.arrow === undefined ? action?.name ?? "" : arrow(action.arrow));
      cell.style.setProperty("--worth", high > low ? String((best - low) / (high - low)) : "0");
      return cell;
    });
    fill(this.#map, ...cells);
    this.#choose(...this.#at);
  }

  #choose(column: number, row: number): void {
    this.#at = [column, row];
    [...this.#map.children].forEach((cell, place) => {
      const chosen = place === row * this.#columns + column;
      cell.setAttribute("aria-pressed", String(chosen));
      (cell as HTMLElement).tabIndex = chosen ? 0 : -1;
    });
    const { actions, dimensions } = this.table;
    const state = this.#state(column, row);
    const values = this.table.values[state] ?? [];
    const visits = this.table.visits[state] ?? [];
    const best = values.indexOf(Math.max(...values));
    const ranges = [column, row, ...this.#others.map(({ value }) => Number(value))];
    fill(this.#about, h("h2", {}, `State ${state.toLocaleString("en")}`),
      h("ul", { class: "list" }, ...dimensions.map((dimension, place) => h("li", {}, h("span", {}, dimension.name), h("span", { class: "number" }, between(dimension, ranges[place] ?? 0))))),
      h("div", { class: "table" }, h("table", {},
        h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "Action"), h("th", { scope: "col", class: "number" }, "Worth"), h("th", { scope: "col", class: "number" }, "Learned from"))),
        h("tbody", {}, ...actions.map(({ name }, action) => h("tr", {}, h("td", {}, name, action === best && visits.some((count) => count > 0) && h("span", { class: "badge good" }, "best")),
          h("td", { class: "number mono" }, (values[action] ?? 0).toFixed(3)), h("td", { class: "number mono" }, (visits[action] ?? 0).toLocaleString("en"))))))));
  }

  #move(event: KeyboardEvent): void {
    const step = KEYS[event.key];
    if (step === undefined) return;
    event.preventDefault();
    const clamp = (value: number, most: number): number => Math.min(Math.max(value, 0), most - 1);
    const [column, row] = [clamp(this.#at[0] + step[0], this.#columns), clamp(this.#at[1] + step[1], this.#rows)];
    this.#choose(column, row);
    (this.#map.children[row * this.#columns + column] as HTMLElement | undefined)?.focus();
  }
}

/** A range of a dimension, in words. */
function between({ edges, unit }: Dimension, range: number): string {
  const [from, to] = [edges[range - 1], edges[range]];
  if (from === undefined) return to === undefined ? "any" : `under ${to} ${unit}`;
  return to === undefined ? `over ${from} ${unit}` : `${from} to ${to} ${unit}`;
}

function arrow([x, y]: readonly [number, number]): SVGElement {
  const picture = svg("svg", { viewBox: "-12 -12 24 24", "aria-hidden": "true", class: "arrow" });
  picture.append(svg("path", { d: "M-8 0H7M1 -6L7 0L1 6", transform: `rotate(${(Math.atan2(y, x) * 180) / Math.PI})` }));
  return picture;
}
