/** What runs come to, as pictures: curves over uPlot, the archive as a heat map, who comes from whom as a tree. */

import uPlot from "uplot";

import { h, svg } from "../dom.js";
import { color, onTheme } from "../theme.js";
import { ancestry, cellOf, type Elite, type Measure, type Relative } from "./places.js";

export interface Line {
  readonly name: string;
  readonly values: readonly (number | null)[];
  /** The name of a colour of the style sheet. */
  readonly color: string;
  readonly width?: number;
}

/** A curve that is drawn anew as its numbers come. */
export class Curve {
  readonly element = h("div", { class: "curve" }, h("p", { class: "soft" }, "Nothing has a score yet. The first come within seconds."));
  #plot: uPlot | undefined;
  #last: { x: string; xs: readonly number[]; lines: readonly Line[] } = { x: "", xs: [], lines: [] };

  constructor(private readonly label: string, signal: AbortSignal) {
    this.element.setAttribute("role", "img");
    const watch = new ResizeObserver(() => this.#plot?.setSize(this.#size()));
    watch.observe(this.element);
    signal.addEventListener("abort", () => {
      watch.disconnect();
      this.#plot?.destroy();
    });
    onTheme(() => this.#draw(true), signal);
  }

  /** Shows lines over the same places of the x axis, which is named. */
  show(x: string, xs: readonly number[], lines: readonly Line[]): void {
    const alike = lines.map((line) => line.name).join() === this.#last.lines.map((line) => line.name).join();
    this.#last = { x, xs, lines };
    this.#draw(!alike);
  }

  #draw(anew: boolean): void {
    const { x, xs, lines } = this.#last;
    const newest = lines.map((line) => `${line.name} ${worded(line.values.findLast((value) => value !== null) ?? null)}`);
    this.element.setAttribute("aria-label", `${this.label}: ${newest.join(", ") || "nothing yet"}`);
    if (!this.element.isConnected || xs.length === 0) return;
    const data = [xs, ...lines.map((line) => line.values)] as uPlot.AlignedData;
    if (!anew && this.#plot !== undefined) {
      this.#plot.setData(data);
      return;
    }
    this.#plot?.destroy();
    this.element.replaceChildren();
    const axis = { stroke: color("soft"), grid: { stroke: color("line"), width: 1 }, ticks: { stroke: color("line"), width: 1 } };
    this.#plot = new uPlot(
      {
        ...this.#size(),
        scales: { x: { time: false } },
        axes: [{ ...axis, label: x, labelSize: 20, size: 34 }, { ...axis, size: 52 }],
        cursor: { points: { size: 7 } },
        series: [
          { label: x, value: (plot: uPlot, value: number | null) => worded(value ?? plot.data[0].at(-1)) },
          ...lines.map((line) => ({
            label: line.name,
            stroke: color(line.color),
            width: line.width ?? 2,
            points: { show: xs.length < 3 },
            // Where no pointer is, the newest.
            value: (plot: uPlot, value: number | null, series: number, at: number | null) =>
              worded(at === null ? (plot.data[series] as (number | null)[]).findLast((each) => each !== null) : value),
          })),
        ],
      },
      data,
      this.element,
    );
  }

  #size(): { width: number; height: number } {
    return { width: Math.max(200, this.element.clientWidth), height: 240 };
  }
}

/** A number as people read it. */
export function worded(value: number | null | undefined): string {
  if (value === null || value === undefined) return "none";
  return Math.abs(value) >= 1000 ? Math.round(value).toLocaleString("en") : String(Number(value.toPrecision(3)));
}

/**
 * Draws an archive as a grid of its first two measures; of several elites in one cell of these the best is shown.
 *
 * @param portrait Brings the drawing of a candidate, or nothing.
 * @param pick Is told the candidate of a cell that was chosen.
 */
export function heatMap(
  measures: readonly Measure[],
  elites: readonly Elite[],
  portrait: (index: number) => Promise<Node | undefined>,
  pick: (index: number) => void,
): HTMLElement {
  const [across, up] = [measures[0], measures[1]] as [Measure, Measure | undefined];
  const rows = up?.cells ?? 1;
  const best = new Map<string, Elite>();
  for (const elite of elites) {
    const key = `${cellOf(across, elite.measures[0] ?? 0)} ${up === undefined ? 0 : cellOf(up, elite.measures[1] ?? 0)}`;
    const before = best.get(key);
    if (before === undefined || (elite.score ?? -Infinity) > (before.score ?? -Infinity)) best.set(key, elite);
  }
  const scores = [...best.values()].flatMap((elite) => (elite.score === null ? [] : [elite.score]));
  const [low, high] = [Math.min(...scores), Math.max(...scores)];
  const grid = h("div", { class: "cells", role: "grid", "aria-label": `${best.size} of ${across.cells * rows} cells are occupied` });
  grid.style.setProperty("grid-template-columns", `repeat(${across.cells}, minmax(0, 1fr))`);
  for (let row = rows - 1; row >= 0; row -= 1) {
    const line = h("div", { role: "row", class: "row" });
    for (let column = 0; column < across.cells; column += 1) {
      const elite = best.get(`${column} ${row}`);
      line.append(h("div", { role: "gridcell" }, elite === undefined ? h("span", { class: "cell" }) : cell(elite)));
    }
    grid.append(line);
  }

  function cell(elite: Elite): HTMLElement {
    const share = elite.score === null || high === low ? 1 : (elite.score - low) / (high - low);
    const told = [across, ...(up === undefined ? [] : [up])].map((measure, i) => `${measure.expression} ${worded(elite.measures[i])}`);
    const button = h("button", {
      class: "cell full",
      title: `Candidate ${elite.index}: score ${worded(elite.score)}, ${told.join(", ")}`,
      "aria-label": `Candidate ${elite.index}: score ${worded(elite.score)}, ${told.join(", ")}`,
      onclick: () => pick(elite.index),
    });
    button.style.setProperty("--share", String(share));
    if (across.cells <= 16) void portrait(elite.index).then((drawing) => drawing !== undefined && button.append(drawing));
    return button;
  }

  const ends = (measure: Measure): HTMLElement =>
    h("span", { class: "ends" }, h("span", {}, worded(measure.low)), h("b", {}, measure.expression), h("span", {}, worded(measure.high)));
  return h("figure", { class: "heat" },
    up !== undefined && h("div", { class: "upward" }, ends(up)), grid, h("div", { class: "across" }, ends(across)),
    h("figcaption", {}, `The brighter, the better: from ${worded(low)} to ${worded(high)}.`));
}

const WIDE = 130; // px from one generation of ancestors to the next
const HIGH = 34;

/** Draws who a candidate comes from: it on the right, each ancestor as far to the left as it is steps away. */
export function lineage(candidates: readonly Relative[], of: number, pick: (index: number) => void): HTMLElement {
  const known = new Map(candidates.map((each) => [each.index, each]));
  const steps = ancestry(known, of);
  const columns = new Map<number, number[]>();
  for (const [index, step] of steps) columns.set(step, [...(columns.get(step) ?? []), index]);
  const farthest = Math.max(0, ...columns.keys());
  const tallest = Math.max(1, ...[...columns.values()].map((column) => column.length));
  const [width, height] = [(farthest + 1) * WIDE + 20, tallest * HIGH + 20];
  const places = new Map<number, readonly [number, number]>();
  for (const [step, column] of columns) {
    column.sort((a, b) => a - b).forEach((index, i) => {
      places.set(index, [10 + (farthest - step) * WIDE, height / 2 + (i - (column.length - 1) / 2) * HIGH]);
    });
  }
  const picture = svg("svg", { viewBox: `0 0 ${width} ${height}`, width, height, role: "group", "aria-label": `The ancestors of candidate ${of}` });
  for (const [index, [x, y]] of places) {
    for (const parent of known.get(index)?.parents ?? []) {
      const from = places.get(parent);
      if (from === undefined) continue;
      const [ax, ay] = [from[0] + 96, from[1]];
      picture.append(svg("path", { d: `M${ax} ${ay} C${ax + 20} ${ay} ${x - 20} ${y} ${x} ${y}`, class: "link" }));
    }
  }
  for (const [index, [x, y]] of places) picture.append(person(known.get(index) as Relative, x, y, index === of, pick));
  return h("div", { class: "lineage", tabIndex: 0, role: "region", "aria-label": "Lineage" }, picture);
}

function person(each: Relative, x: number, y: number, chosen: boolean, pick: (index: number) => void): SVGElement {
  const label = `${each.index} · ${worded(each.score)}, by ${each.operator}`; // begins with what is seen
  const group = svg("g", { class: chosen ? "person chosen" : "person", tabindex: 0, role: "button", "aria-label": label, transform: `translate(${x} ${y})` },
    svg("title", {}, label),
    svg("rect", { x: 0, y: -12, width: 96, height: 24, rx: 6 }),
    svg("text", { x: 8, y: 4 }, `${each.index} · ${worded(each.score)}`));
  group.addEventListener("click", () => pick(each.index));
  group.addEventListener("keydown", (event) => {
    if ((event as KeyboardEvent).key === "Enter" || (event as KeyboardEvent).key === " ") {
      event.preventDefault();
      pick(each.index);
    }
  });
  return group;
}
