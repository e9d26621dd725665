/**
 * Brains for a body that is being built: how one of each kind begins, and how one goes along when the body changes.
 *
 * Oscillators, and networks that know motors by their names, lose what is gone and get something for what is new. A
 * network in layers has a size that follows from the body: it stays as it is, the check says where it does not fit, and
 * whoever builds makes it anew.
 */

import { depthOf, hangsBy } from "./anatomy.js";
import { type Brain, type Cube, edges, fits, type Genome, type Joint, type SensorEntry } from "./genome.js";
import { round } from "./vectors.js";

export const KINDS = ["none", "sine", "cpg", "graph", "ctrnn", "mlp"] as const;
export type Kind = (typeof KINDS)[number];

interface Oscillator {
  readonly motor: string;
  readonly frequency?: number;
  readonly amplitude?: number;
  readonly phase?: number;
  readonly offset?: number;
}

interface Node {
  readonly id: string;
  readonly motor?: string;
  readonly activation?: string;
  readonly bias?: number;
}

interface Link {
  readonly from?: string;
  readonly sensor?: string;
  readonly to: string;
  readonly weight?: number;
}

const FREQUENCY = 2.5; // Hz of new oscillators: about what legs as long as a forearm swing at
const AMPLITUDE = 0.4;
const LEAN = 0.6; // how far new legs swing about a place before the hip: without it they push back as much as forth
const BEHIND = 0.9; // rad that each link of a spine runs behind the one before
const HIDDEN = 8;

/** The joints that have motors, in the order of the body. */
export function motorsOf(genome: Genome): readonly Joint[] {
  return (genome.body.joints ?? []).filter((joint) => joint.motor !== undefined);
}

/** The kinds that can be made for a body: one that grows has as many motors as there will be, which wildcards name. */
export function kindsFor(genome: Genome): readonly Kind[] {
  return genome.body.graph === undefined ? KINDS : ["none", "sine", "cpg"];
}

/** Gives a creature a new brain of a kind, for the body that it has. */
export function withBrain(genome: Genome, kind: Kind): Genome {
  const { brain: _, ...rest } = genome;
  if (genome.body.graph !== undefined && kind !== "none") {
    const oscillators = [{ motor: "*", frequency: FREQUENCY, amplitude: AMPLITUDE, step: -BEHIND }];
    return { ...(rest as Genome), brain: kind === "cpg" ? { kind, oscillators, chains: [{ motors: "*", lag: BEHIND }] } : { kind: "sine", oscillators } };
  }
  const motors = motorsOf(genome);
  if (kind === "none" || motors.length === 0) return rest as Genome;
  return { ...(rest as Genome), brain: BEGINNINGS[kind](genome, motors) };
}

/** Lets a brain go along with its body. */
export function follow(genome: Genome): Genome {
  const brain = genome.brain;
  if (brain === undefined || genome.body.graph !== undefined) return genome;
  const outputs = outputNames(genome);
  const followed =
    brain.kind === "sine" || brain.kind === "cpg" ? followWaves(genome, brain, outputs)
    : brain.kind === "graph" ? followNodes(genome, brain, outputs)
    : brain;
  if (followed !== undefined) return { ...genome, brain: followed };
  const { brain: _, ...rest } = genome;
  return rest as Genome;
}

/** The names of all that a body senses: those of the inputs of its brain, in their order. */
export function sensorNames(genome: Genome): string[] {
  const cubes = (genome.body.cubes ?? []).map((cube) => cube.id);
  const joints = genome.body.joints ?? [];
  return entries(genome).flatMap((entry) => {
    if (entry.joint !== undefined) {
      const able = joints.filter((each) =>
        entry.type === "effort" ? each.motor !== undefined : each.type === "hinge" || each.type === "slide",
      );
      const named = able.filter((each) => fits(entry.joint ?? "", each.id));
      return named.map((each) => entry.id ?? `${each.id}.${entry.type}`);
    }
    return cubes.filter((id) => fits(entry.cube ?? "", id)).flatMap((id) => readings(entry, id));
  });
}

/** The sensors of a document, or those that a body has where it names none. */
export function entries(genome: Genome): readonly SensorEntry[] {
  if (genome.sensors !== undefined) return genome.sensors;
  const root = genome.body.cubes?.[0]?.id;
  return [
    ...motorsOf(genome).flatMap((joint) => ["position", "velocity"].map((type) => ({ type, joint: joint.id }))),
    ...(root === undefined ? [] : ["height", "up", "velocity", "spin"].map((type) => ({ type, cube: root }))),
  ];
}

const VECTORS = new Set([
  "up", "velocity", "spin", "target_direction", "target_velocity", "other_direction", "other_velocity",
  "food_direction", "acceleration",
]);

function readings(entry: SensorEntry, cube: string): string[] {
  const name = entry.id ?? `${cube}.${entry.type}`;
  if (VECTORS.has(entry.type)) {
    const axis = entry["axis"] as string | undefined;
    if (axis !== undefined && entry.id !== undefined) return [name];
    return (axis === undefined ? ["x", "y", "z"] : [axis]).map((each) => `${name}.${each}`);
  }
  if (entry.type === "camera") {
    const tones = entry["colors"] === "rgb" ? [".r", ".g", ".b"] : [""];
    const columns = numbers(1, Number(entry["width"] ?? 8));
    const rows = numbers(1, Number(entry["height"] ?? 8));
    return rows.flatMap((row) => columns.flatMap((column) => tones.map((tone) => `${name}.${row}.${column}${tone}`)));
  }
  if (entry.id !== undefined) return [name];
  if (entry.type === "touch" && entry["face"] !== undefined) return [`${name}.${String(entry["face"]).replace("+", "")}`];
  if (entry.type === "hear") {
    const number = Number(entry["number"] ?? 1);
    return [`${name}.${String(entry["channel"])}${number === 1 ? "" : `.${number}`}`];
  }
  return [name];
}

function outputNames(genome: Genome): string[] {
  const voices = (genome["voices"] ?? []) as readonly { id?: string; channel: string; number?: number }[];
  const said = voices.map(({ id, channel, number = 1 }) => id ?? `say.${channel}${number === 1 ? "" : `.${number}`}`);
  return [...motorsOf(genome).map((joint) => joint.id), ...said];
}

// -- how each kind begins -----------------------------------------------------------------------------------------------

const BEGINNINGS: Record<Exclude<Kind, "none">, (genome: Genome, motors: readonly Joint[]) => Brain> = {
  sine: (genome, motors) => ({ kind: "sine", oscillators: motors.map((motor) => oscillator(genome, motor)) }),
  cpg: (genome, motors) => {
    const oscillators = motors.map((motor) => oscillator(genome, motor));
    const links = oscillators.slice(1).flatMap((to, i) => {
      const from = oscillators[i] as Oscillator;
      const lag = round((from.phase ?? 0) - (to.phase ?? 0));
      return [
        { from: from.motor, to: to.motor, lag },
        { from: to.motor, to: from.motor, lag: round(-lag) },
      ];
    });
    return links.length === 0 ? { kind: "cpg", oscillators } : { kind: "cpg", oscillators, links };
  },
  graph: (genome, motors) => {
    // Two nodes that turn each other round are a clock; each motor listens to it in a phase of its own.
    const angle = (2 * Math.PI * FREQUENCY) / 60;
    const [cos, sin] = [round(1.1 * Math.cos(angle)), round(1.1 * Math.sin(angle))];
    const clock: Link[] = [
      { from: "clock.x", to: "clock.x", weight: cos },
      { from: "clock.y", to: "clock.x", weight: -sin },
      { from: "clock.x", to: "clock.y", weight: sin },
      { from: "clock.y", to: "clock.y", weight: cos },
    ];
    return {
      kind: "graph",
      nodes: [{ id: "clock.x", bias: 0.01 }, { id: "clock.y" }, ...motors.map((each) => node(genome, each))],
      links: [...clock, ...motors.flatMap((motor) => listening(genome, motor))],
    };
  },
  ctrnn: (genome, motors) => {
    // The last two neurons swing by themselves (Beer 1995); the others, one a motor, listen to these.
    const inputs = sensorNames(genome).length;
    const rows = motors.map((motor) => {
      const phase = phaseOf(genome, motor);
      return [Math.cos(phase), Math.sin(phase)].map((value) => round(4 * value)) as [number, number];
    });
    const still = motors.map(() => 0);
    return {
      kind: "ctrnn",
      time_constants: [...motors.map(() => 0.05), 0.1, 0.1],
      biases: [...rows.map(([x, y], i) => round(-(x + y) / 2 + (isLeg(genome, motors[i] as Joint) ? 2 * LEAN : 0))), -2.75, -1.75],
      weights: [...rows.map((row) => [...still, ...row]), [...still, 4.5, 1], [...still, -1, 4.5]],
      input_weights: numbers(1, motors.length + 2).map(() => numbers(1, inputs).map(() => 0)),
    };
  },
  mlp: (genome, motors) => {
    const inputs = sensorNames(genome).length;
    const draw = numbersFrom(1);
    const weights = (rows: number, columns: number): number[][] =>
      numbers(1, rows).map(() => numbers(1, columns).map(() => round((draw() - 0.5) * (2 / Math.sqrt(columns)))));
    return {
      kind: "mlp",
      layers: [
        { weights: weights(HIDDEN, inputs), biases: numbers(1, HIDDEN).map(() => 0) },
        { weights: weights(motors.length, HIDDEN), biases: motors.map(() => 0) },
      ],
    };
  },
};

/** An oscillator for a motor: legs trot, each link of a limb runs behind the one before, wheels roll forward. */
function oscillator(genome: Genome, joint: Joint): Oscillator {
  if (joint.motor?.mode === "velocity") return { motor: joint.id, amplitude: 0, offset: -0.5 };
  const swing = { motor: joint.id, frequency: FREQUENCY, amplitude: AMPLITUDE, phase: phaseOf(genome, joint) };
  return isLeg(genome, joint) ? { ...swing, offset: LEAN } : swing;
}

/** Says whether a joint is a hip: it hangs on the root, off its middle, and swings forward and back. */
function isLeg(genome: Genome, joint: Joint): boolean {
  const cubes = genome.body.cubes ?? [];
  const [root, hanging] = [cubes[0] as Cube, cubes.find((each) => each.id === joint.cube2) as Cube];
  const aside = Math.abs(hanging.position[2] - root.position[2]) > 0.001;
  return aside && joint.cube1 === root.id && joint.axis?.[0] === 0 && joint.axis[1] === 0;
}

function phaseOf(genome: Genome, joint: Joint): number {
  const cubes = genome.body.cubes ?? [];
  const hanging = [joint.cube1, joint.cube2].find((id) => hangsBy(genome, id)?.id === joint.id) ?? joint.cube2;
  const cube = cubes.find((each) => each.id === hanging) as Cube;
  const root = cubes[0] as Cube;
  const aside = cube.position[2] - root.position[2];
  const left = aside < -0.001;
  const right = aside > 0.001;
  const rear = (left || right) && cube.position[0] < root.position[0] - edges(root)[0] * 0.01;
  const behind = depthOf(genome, hanging) - (left || right ? 1 : 0);
  return round((right !== rear ? Math.PI : 0) - behind * (left || right ? Math.PI / 2 : BEHIND));
}

function node(genome: Genome, motor: Joint): Node {
  return isLeg(genome, motor) ? { id: motor.id, motor: motor.id, bias: LEAN } : { id: motor.id, motor: motor.id };
}

function listening(genome: Genome, motor: Joint): Link[] {
  const phase = phaseOf(genome, motor);
  return [
    { from: "clock.x", to: motor.id, weight: round(0.8 * Math.cos(phase)) },
    { from: "clock.y", to: motor.id, weight: round(0.8 * Math.sin(phase)) },
  ];
}

// -- how they go along --------------------------------------------------------------------------------------------------

function followWaves(genome: Genome, brain: Brain, outputs: readonly string[]): Brain | undefined {
  const drives = (pattern: string): boolean => outputs.some((name) => fits(pattern, name));
  const before = brain["oscillators"] as readonly Oscillator[];
  const kept = before.filter((each) => drives(each.motor));
  const lacking = motorsOf(genome).filter((motor) => !kept.some((each) => fits(each.motor, motor.id)));
  const oscillators = [...kept, ...lacking.map((motor) => oscillator(genome, motor))];
  if (oscillators.length === 0) return undefined;
  const driven = (pattern: string): boolean =>
    outputs.some((name) => fits(pattern, name) && oscillators.some((each) => fits(each.motor, name)));
  const senses = sensorNames(genome);
  const made: Record<string, unknown> = { ...brain, oscillators };
  const links = brain["links"] as readonly { from: string; to: string }[] | undefined;
  const chains = brain["chains"] as readonly { motors: string }[] | undefined;
  const feedback = brain["feedback"] as readonly { sensor: string; motor: string }[] | undefined;
  keep(made, "links", links, (each) => driven(each.from) && driven(each.to));
  keep(made, "chains", chains, (each) => driven(each.motors));
  keep(made, "feedback", feedback, (each) => driven(each.motor) && senses.some((name) => fits(each.sensor, name)));
  return made as Brain;
}

function followNodes(genome: Genome, brain: Brain, outputs: readonly string[]): Brain | undefined {
  const before = brain["nodes"] as readonly Node[];
  const links = (brain["links"] ?? []) as readonly Link[];
  const kept = before.filter((node) => node.motor === undefined || outputs.some((name) => fits(node.motor ?? "", name)));
  const driven = (motor: Joint): boolean => kept.some((node) => node.motor !== undefined && fits(node.motor, motor.id));
  const lacking = motorsOf(genome).filter((motor) => !driven(motor) && !kept.some((node) => node.id === motor.id));
  const nodes = [...kept, ...lacking.map((motor) => node(genome, motor))];
  if (!nodes.some((node) => node.motor !== undefined)) return undefined;
  const names = new Set(nodes.map((node) => node.id));
  const senses = sensorNames(genome);
  const made: Record<string, unknown> = { ...brain, nodes };
  const fresh = names.has("clock.x") && names.has("clock.y") ? lacking.flatMap((motor) => listening(genome, motor)) : [];
  keep(made, "links", [...links, ...fresh], (link) =>
    names.has(link.to)
    && (link.from === undefined || names.has(link.from))
    && (link.sensor === undefined || senses.some((name) => fits(link.sensor ?? "", name))),
  );
  return made as Brain;
}

/** Keeps those of a list that are good; a list that was not there, or of which nothing is left, is left out. */
function keep<T>(made: Record<string, unknown>, field: string, list: readonly T[] | undefined, good: (each: T) => boolean): void {
  const kept = list?.filter(good) ?? [];
  if (kept.length > 0) made[field] = kept;
  else delete made[field];
}

function numbers(first: number, last: number): number[] {
  return Array.from({ length: Math.max(0, last - first + 1) }, (_, i) => first + i);
}

/** Numbers from 0 to 1 that are the same for the same seed (mulberry32): a brain made anew is the same brain. */
function numbersFrom(seed: number): () => number {
  let state = seed;
  return () => {
    state = (state + 0x6d2b79f5) | 0;
    let mixed = Math.imul(state ^ (state >>> 15), 1 | state);
    mixed = (mixed + Math.imul(mixed ^ (mixed >>> 7), 61 | mixed)) ^ mixed;
    return ((mixed ^ (mixed >>> 14)) >>> 0) / 4294967296;
  };
}
