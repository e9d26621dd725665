/** A creature as a small drawing: its boxes seen from above and ahead, the nearest painted last. No canvas, no graphics driver. */

import { svg } from "../dom.js";
import { type Cube, edges, type Vector } from "./genome.js";
import { plus, quaternion, turn } from "./vectors.js";

export type Drawn = Pick<Cube, "id" | "size" | "position" | "rotation" | "color" | "shape">;

const PALETTE: readonly Vector[] = [[0.36, 0.55, 0.75], [0.85, 0.62, 0.31], [0.45, 0.65, 0.45], [0.72, 0.42, 0.42], [0.58, 0.49, 0.7]];
const LIGHT: Vector = [0.35, 0.85, 0.4];
const ACROSS: Vector = [0.82, 0, -0.57]; // what is to the right in the picture
const UP: Vector = [-0.24, 0.91, -0.34];
const NEARER: Vector = [0.52, 0.41, 0.75];
const ROUND = 14; // points of a circle

interface Patch {
  readonly points: readonly (readonly [number, number])[];
  readonly depth: number;
  readonly fill: string;
}

/** Draws a body into a square of so many pixels; `label` is what is read out, and none where text stands beside it. */
export function portrait(cubes: readonly Drawn[], size: number, label?: string): SVGElement {
  const patches = cubes.flatMap((cube, i) => patchesOf(cube, color(cube, i))).sort((a, b) => a.depth - b.depth);
  const points = patches.flatMap((patch) => patch.points);
  const [left, right] = extent(points.map(([x]) => x));
  const [bottom, top] = extent(points.map(([, y]) => y));
  const scale = (size * 0.9) / Math.max(right - left, top - bottom, 1e-9);
  const place = ([x, y]: readonly [number, number]): string =>
    `${(size / 2 + (x - (left + right) / 2) * scale).toFixed(1)},${(size / 2 - (y - (bottom + top) / 2) * scale).toFixed(1)}`;
  const drawing = svg("svg", { viewBox: `0 0 ${size} ${size}`, width: size, height: size, class: "portrait" });
  if (label === undefined) drawing.setAttribute("aria-hidden", "true");
  else {
    drawing.setAttribute("role", "img");
    drawing.setAttribute("aria-label", label);
  }
  drawing.append(...patches.map((patch) => svg("polygon", { points: patch.points.map(place).join(" "), fill: patch.fill, stroke: patch.fill, "stroke-width": 0.6, "stroke-linejoin": "round" })));
  return drawing;
}

/** The colour of a part: its own, or one of a few in turn. */
export function color(cube: Pick<Cube, "color">, index: number): readonly number[] {
  return cube.color ?? (PALETTE[index % PALETTE.length] as Vector);
}

function patchesOf(cube: Drawn, own: readonly number[]): Patch[] {
  const half = edges(cube).map((edge) => edge / 2) as unknown as Vector;
  const q = quaternion(cube.rotation);
  const world = (point: Vector): Vector => plus(cube.position, turn(q, point));
  if (cube.shape !== undefined && cube.shape !== "box") {
    const points = roundPoints(cube.shape, half).map((point) => flat(world(point)));
    return [{ points: hull(points), depth: dot(cube.position, NEARER), fill: shade(own, 0.85) }];
  }
  const patches: Patch[] = [];
  for (const axis of [0, 1, 2] as const) {
    for (const sign of [-1, 1]) {
      const normal = turn(q, [0, 1, 2].map((i) => (i === axis ? sign : 0)) as unknown as Vector);
      if (dot(normal, NEARER) <= 0) continue;
      const [b, c] = [(axis + 1) % 3, (axis + 2) % 3];
      const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([s = 0, t = 0]) =>
        world([0, 1, 2].map((i) => (half[i] ?? 0) * (i === axis ? sign : i === b ? s : i === c ? t : 0)) as unknown as Vector),
      );
      const middle = world([0, 1, 2].map((i) => (i === axis ? sign * (half[i] ?? 0) : 0)) as unknown as Vector);
      patches.push({ points: corners.map(flat), depth: dot(middle, NEARER), fill: shade(own, 0.55 + 0.45 * Math.max(0, dot(normal, LIGHT))) });
    }
  }
  return patches;
}

function roundPoints(shape: string, half: Vector): Vector[] {
  const along = half[0] === half[2] ? 1 : half[1] === half[2] ? 0 : 2;
  const radius = half[(along + 1) % 3] as number;
  const reach = shape === "sphere" ? 0 : shape === "capsule" ? (half[along] as number) - radius : (half[along] as number);
  const turns = Array.from({ length: ROUND }, (_, i) => (2 * Math.PI * i) / ROUND);
  const lifts = shape === "cylinder" ? [0] : turns.map((angle) => angle / 2 - Math.PI / 2);
  return [-1, 1].flatMap((end) => lifts.flatMap((lift) => turns.map((angle) => {
    const point: [number, number, number] = [0, 0, 0];
    point[along] = end * reach + radius * Math.sin(lift);
    point[(along + 1) % 3] = radius * Math.cos(lift) * Math.cos(angle);
    point[(along + 2) % 3] = radius * Math.cos(lift) * Math.sin(angle);
    return point;
  })));
}

/** The convex hull of points of the plane, by Andrew's monotone chain. */
function hull(points: readonly (readonly [number, number])[]): (readonly [number, number])[] {
  const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  const chain = (list: readonly (readonly [number, number])[]): (readonly [number, number])[] => {
    const kept: (readonly [number, number])[] = [];
    for (const point of list) {
      while (kept.length > 1 && turnsRight(kept.at(-2)!, kept.at(-1)!, point)) kept.pop();
      kept.push(point);
    }
    return kept.slice(0, -1);
  };
  return [...chain(sorted), ...chain(sorted.reverse())];
}

function turnsRight(a: readonly [number, number], b: readonly [number, number], c: readonly [number, number]): boolean {
  return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) <= 0;
}

const flat = (point: Vector): readonly [number, number] => [dot(point, ACROSS), dot(point, UP)];

const dot = (a: Vector, b: Vector): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

function extent(values: readonly number[]): [number, number] {
  return values.length === 0 ? [0, 1] : [Math.min(...values), Math.max(...values)];
}

function shade([r = 0, g = 0, b = 0]: readonly number[], light: number): string {
  return `rgb(${[r, g, b].map((value) => Math.round(Math.min(1, value * light + (light - 0.55) * 0.12) * 255)).join(" ")})`;
}
