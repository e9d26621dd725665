/** Where candidates of a run are drawn: in which cell of an archive, and how far back among the ancestors. */

const SHOWN = 60; // of an ancestry; the nearest

export interface Measure {
  readonly expression: string;
  readonly low: number;
  readonly high: number;
  readonly cells: number;
}

export interface Elite {
  readonly index: number;
  readonly score: number | null;
  readonly measures: readonly number[];
}

/** The cell of a measure in which a value is; what is outside of its range is in the cell at its end. */
export function cellOf(measure: Measure, value: number): number {
  const place = Math.floor(((value - measure.low) / (measure.high - measure.low)) * measure.cells);
  return Math.min(Math.max(place, 0), measure.cells - 1);
}

export interface Relative {
  readonly index: number;
  readonly score: number | null;
  readonly operator: string;
  readonly parents: readonly number[];
}

/** How many steps back each ancestor of a candidate is, the nearest first, at most as many as are drawn. */
export function ancestry(known: ReadonlyMap<number, Relative>, of: number): Map<number, number> {
  const steps = new Map<number, number>(known.has(of) ? [[of, 0]] : []);
  for (const [index, step] of steps) {
    for (const parent of known.get(index)?.parents ?? []) {
      if (known.has(parent) && !steps.has(parent) && steps.size < SHOWN) steps.set(parent, step + 1);
    }
  }
  return steps;
}
