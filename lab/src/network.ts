/**
 * Brains as networks to be drawn: units in columns, links with weights, and what each unit does with what is sensed; and
 * waves as formulas. What a document leaves out is as the schemas say.
 */

export interface Unit {
  readonly label: string;
  readonly column: number;
}

export interface Wire {
  readonly from: number;
  readonly to: number;
  readonly weight: number;
}

/** What a world tells of a brain that it runs. */
export interface Mind {
  readonly units: readonly number[];
  readonly controls: readonly number[];
}

export interface Network {
  readonly units: readonly Unit[];
  readonly wires: readonly Wire[];
  /** What the units do, of what the sensors read and, of a brain with a memory, what the world tells of it. */
  readonly activate: (sensed: readonly number[], mind: Mind) => number[];
  /** Whether that depends on the past, which only the world knows. */
  readonly remembers: boolean;
}

type Json = { readonly [name: string]: unknown };

const ACTIVATIONS: Record<string, (x: number) => number> = {
  tanh: Math.tanh, sigmoid: (x) => 1 / (1 + Math.exp(-x)), sin: Math.sin, cos: Math.cos, gauss: (x) => Math.exp(-x * x),
  step: (x) => (x >= 0 ? 1 : 0), relu: (x) => Math.max(x, 0), abs: Math.abs, identity: (x) => x,
};

/**
 * Returns the network of a brain's document, of any kind that is one.
 *
 * @param sensors The names of the body's sensors, in the order in which they are read.
 * @param outputs Those of its motors and voices.
 */
export function network(brain: Json, sensors: readonly string[], outputs: readonly string[]): Network | undefined {
  switch (brain["kind"]) {
    case "mlp": return layered(brain, sensors, outputs);
    case "ctrnn": return recurrent(brain, sensors, outputs);
    case "graph": return free(brain, sensors);
    case "cpg": return coupled(brain, sensors, outputs);
    default: return undefined;
  }
}

/** Which sensors each entry of a list means: its name, or wildcards. */
function meant(entries: readonly string[] | undefined, names: readonly string[]): { label: string; places: number[] }[] {
  if (entries === undefined) {
    return names.map((label, place) => ({ label, places: [place] }));
  }
  const taken = names.map((name) => {
    const exact = entries.indexOf(name);
    return exact >= 0 ? exact : entries.findIndex((entry) => fits(entry, name));
  });
  return entries.map((label, entry) => ({ label, places: taken.flatMap((owner, place) => (owner === entry ? [place] : [])) }));
}

/** Whether a name fits a pattern, as brains have it: * stands for any characters, also none, and ? for any one. */
function fits(entry: string, name: string): boolean {
  const [pattern, text] = [[...entry], [...name]];
  let [star, from, at] = [-1, 0, 0];
  for (let i = 0; i < text.length; ) {
    if (pattern[at] === "*") {
      [star, from] = [at++, i];
    } else if (pattern[at] === "?" || pattern[at] === text[i]) {
      at++;
      i++;
    } else if (star >= 0) { // the last * takes one more; what those before it took may stay
      from++;
      [at, i] = [star + 1, from];
    } else {
      return false;
    }
  }
  return pattern.slice(at).every((each) => each === "*");
}

function layered(brain: Json, sensors: readonly string[], outputs: readonly string[]): Network {
  const inputs = meant(brain["inputs"] as string[] | undefined, sensors);
  const driven = (brain["outputs"] as string[] | undefined) ?? outputs;
  const layers = brain["layers"] as { weights: number[][]; biases?: number[]; activation?: string }[];
  const units: Unit[] = inputs.map(({ label }) => ({ label, column: 0 }));
  const wires: Wire[] = [];
  let before = 0;
  layers.forEach(({ weights }, layer) => {
    const start = units.length;
    weights.forEach((row, unit) => {
      units.push({ label: layer === layers.length - 1 ? driven[unit] ?? "" : "", column: layer + 1 });
      row.forEach((weight, from) => wires.push({ from: before + from, to: start + unit, weight }));
    });
    before = start;
  });
  return {
    units, wires, remembers: false,
    activate: (sensed) => {
      let values = inputs.map(({ places }) => summed(sensed, places));
      const all = [...values];
      for (const { weights, biases = [], activation = "tanh" } of layers) {
        const act = ACTIVATIONS[activation] ?? Math.tanh;
        values = weights.map((row, unit) => act(row.reduce((total, weight, from) => total + weight * (values[from] ?? 0), biases[unit] ?? 0)));
        all.push(...values);
      }
      return all;
    },
  };
}

function recurrent(brain: Json, sensors: readonly string[], outputs: readonly string[]): Network {
  const inputs = meant(brain["inputs"] as string[] | undefined, sensors);
  const driven = (brain["outputs"] as string[] | undefined) ?? outputs;
  const weights = brain["weights"] as number[][];
  const units: Unit[] = [...inputs.map(({ label }) => ({ label, column: 0 })), ...weights.map((_, unit) => ({ label: driven[unit] ?? "", column: unit < driven.length ? 2 : 1 }))];
  const wires = [
    ...((brain["input_weights"] as number[][] | undefined) ?? []).flatMap((row, to) => row.map((weight, from) => ({ from, to: inputs.length + to, weight }))),
    ...weights.flatMap((row, to) => row.map((weight, from) => ({ from: inputs.length + from, to: inputs.length + to, weight }))),
  ];
  return {
    units, wires, remembers: true,
    activate: (sensed, mind) => [...inputs.map(({ places }) => summed(sensed, places)), ...mind.units],
  };
}

/** What an entry of a list reads: all that it means, together. */
function summed(sensed: readonly number[], places: readonly number[]): number {
  return places.reduce((total, place) => total + (sensed[place] ?? 0), 0);
}

interface Link { readonly from?: string; readonly sensor?: string; readonly to: string; readonly weight?: number }
interface Node { readonly id: string; readonly motor?: string; readonly activation?: string; readonly bias?: number }

function free(brain: Json, sensors: readonly string[]): Network {
  const nodes = brain["nodes"] as readonly Node[];
  const links = (brain["links"] as readonly Link[] | undefined) ?? [];
  const sensed = [...new Set(links.flatMap(({ sensor }) => (sensor === undefined ? [] : [sensor])))];
  const place = new Map(nodes.map(({ id }, index) => [id, sensed.length + index]));
  const wires = links.map(({ from, sensor, to, weight = 1 }) => ({
    from: sensor !== undefined ? sensed.indexOf(sensor) : place.get(from ?? "") ?? 0, to: place.get(to) ?? 0, weight,
  }));
  const { order, loops } = sorted(sensed.length + nodes.length, wires);
  const depth = Array.from({ length: sensed.length + nodes.length }, () => 0);
  for (const unit of order) {
    for (const { from, to } of wires) {
      if (from === unit && from !== to) {
        depth[to] = Math.max(depth[to] ?? 0, (depth[unit] ?? 0) + 1);
      }
    }
  }
  const last = Math.max(1, ...depth) + (nodes.some(({ motor }, index) => motor === undefined && depth[sensed.length + index] === Math.max(...depth)) ? 1 : 0);
  const units = [...sensed.map((label) => ({ label, column: 0 })), ...nodes.map(({ id, motor }, index) =>
    ({ label: motor ?? id, column: motor !== undefined ? last : Math.max(depth[sensed.length + index] ?? 1, 1) }))];
  const reads = sensed.map((entry) => sensors.flatMap((name, index) => (name === entry || fits(entry, name) ? [index] : [])));
  return {
    units, wires, remembers: loops,
    activate: (values, mind) => {
      const all = units.map((_, unit) => summed(values, reads[unit] ?? []));
      if (loops) {
        return [...all.slice(0, sensed.length), ...mind.units];
      }
      for (const unit of order) {
        const node = nodes[unit - sensed.length];
        if (node !== undefined) {
          const total = wires.reduce((sum, { from, to, weight }) => (to === unit ? sum + weight * (all[from] ?? 0) : sum), node.bias ?? 0);
          all[unit] = (ACTIVATIONS[node.activation ?? "tanh"] ?? Math.tanh)(total);
        }
      }
      return all;
    },
  };
}

/** The units in the order in which values flow; those in loops are left out. */
function sorted(count: number, wires: readonly Wire[]): { order: number[]; loops: boolean } {
  const waits = Array.from({ length: count }, () => 0);
  wires.forEach(({ to }) => (waits[to] = (waits[to] ?? 0) + 1));
  const order = waits.flatMap((wait, unit) => (wait === 0 ? [unit] : []));
  for (let next = 0; next < order.length; next++) {
    for (const { from, to } of wires) {
      if (from === order[next] && (waits[to] = (waits[to] ?? 0) - 1) === 0) {
        order.push(to);
      }
    }
  }
  return { order, loops: order.length < count };
}

/** Oscillators, and what pulls at their phases. */
function coupled(brain: Json, sensors: readonly string[], outputs: readonly string[]): Network {
  const oscillators = brain["oscillators"] as { motor: string }[];
  const feedback = (brain["feedback"] as { sensor: string; motor: string; rate?: number; offset?: number }[] | undefined) ?? [];
  const links = (brain["links"] as { from: string; to: string; weight?: number }[] | undefined) ?? [];
  const sensed = [...new Set(feedback.map(({ sensor }) => sensor))].filter((entry) => sensors.some((name) => name === entry || fits(entry, name)));
  const reads = sensed.map((entry) => sensors.flatMap((name, index) => (name === entry || fits(entry, name) ? [index] : [])));
  const driven = oscillators.map(({ motor }) => outputs.findIndex((name) => name === motor || fits(motor, name)));
  const place = (motor: string): number => sensed.length + oscillators.findIndex((each) => each.motor === motor || fits(each.motor, motor));
  return {
    units: [...sensed.map((label) => ({ label, column: 0 })), ...oscillators.map(({ motor }) => ({ label: motor, column: 1 }))],
    wires: [
      ...feedback.map(({ sensor, motor, rate, offset }) => ({ from: sensed.indexOf(sensor), to: place(motor), weight: rate ?? offset ?? 0 })),
      ...links.map(({ from, to, weight = 4 }) => ({ from: place(from), to: place(to), weight })),
    ].filter(({ from, to }) => from >= 0 && to >= sensed.length),
    remembers: true,
    activate: (values, mind) => [
      ...reads.map((places) => summed(values, places)),
      ...driven.map((motor) => mind.controls[motor] ?? 0),
    ],
  };
}

interface Wave { readonly motor: string; readonly frequency?: number; readonly amplitude?: number; readonly phase?: number; readonly step?: number; readonly offset?: number }

/** Returns what a brain without a network does, in words. */
export function described(brain: Json): string {
  const waves = brain["oscillators"];
  if (!Array.isArray(waves)) {
    return "It is no network that can be drawn.";
  }
  const several = (waves as readonly Wave[]).some(({ step = 0 }) => step !== 0);
  return (waves as readonly Wave[]).map(({ motor, frequency = 1, amplitude = 0.5, phase = 0, step = 0, offset = 0 }) =>
    `${motor}: ${offset} + ${amplitude} sin(2π ${frequency} t + ${phase}${step === 0 ? "" : ` - ${step} n`})`).join("; ")
    + (several ? "; n is 0 for the first motor of a wave, 1 for the next" : "");
}
