/**
 * A creature that is being built: what each step of building makes of its document.
 *
 * Documents are never changed: each function returns another one, which is a whole genome as the command line reads it,
 * standing on the ground, with a brain that names no motor that is gone. Symmetry is found by geometry: the twin of a
 * cube is the one of its size on the other side of the root's middle plane (that z is normal to).
 */

import { cubeOf, cubesOf, hangsBy, Impossible, jointOf, jointsOf, limb, mirrored, NEAR, tree, twinOf } from "./anatomy.js";
import { follow, motorsOf, withBrain } from "./brains.js";
import { type Cube, edges, type Face, fits, type Genome, type Hold, type Joint } from "./genome.js";
import type { JointType, Motor, Rule, SensorEntry, Shape, Vector } from "./genome.js";
import { minus, opposite, plus, quaternion, round, rounded, times, turn } from "./vectors.js";

/** What a click on a face adds. */
export type Stamp = "leg" | "segment" | "block" | "wheel" | "ball";
export const STAMPS: readonly Stamp[] = ["leg", "segment", "block", "wheel", "ball"];

/** The outcome of a step that makes cubes: the creature, and the cube that was asked for. */
export interface Added {
  readonly genome: Genome;
  readonly id: string;
}

const DENSITY = 300; // kg/m³, between wood and what walks
const SMALLEST = 0.01;
const LARGEST = 10;
const HINGE_MOTOR: Motor = { mode: "position", range: [-0.8, 0.8], max_effort: 30 };
const SLIDE_MOTOR: Motor = { mode: "position", range: [-0.1, 0.1], max_effort: 200 };
const WHEEL_MOTOR: Motor = { mode: "velocity", range: [-10, 10], max_effort: 10 };

/** A trunk by itself, which is what a new creature begins as. */
export function fresh(name = "creature"): Genome {
  const trunk: Cube = { id: "trunk", size: [0.6, 0.16, 0.3], mass: 6, position: [0, 0.08, 0], color: [0.25, 0.47, 0.75] };
  return { format: "nmes-genome/1", name, body: { cubes: [trunk], joints: [] } };
}

/**
 * Adds a part on a face of a cube, at a point of it.
 *
 * @param at Where, from the cube's centre in the cube's own directions, in m. It is moved so that the part is on the face.
 * @param mirror Whether a part beside the middle plane gets a twin on the other side.
 */
export function add(genome: Genome, on: string, face: Face, at: Vector, stamp: Stamp, mirror: boolean): Added {
  const parent = cubeOf(genome, on);
  const id = unique(genome, stamp);
  const [cube, joint] = grown(parent, id, face, at, stamp, mirror);
  const cubes = [cube];
  const joints = [joint];
  const place = mirrored(genome, cube.position);
  const twin = twinOf(genome, on);
  const middle = Math.abs(mirrored(genome, parent.position)[2] - parent.position[2]) < NEAR;
  if (mirror && Math.abs(place[2] - cube.position[2]) >= NEAR && (twin !== undefined || middle)) {
    const image = reflectCube(genome, cube, `${id}.mirror`);
    cubes.push(image);
    joints.push({ ...reflectHold(joint), ...ends(twin?.id ?? on, image.id), anchor: mirrored(genome, joint.anchor) });
  }
  const body = { ...genome.body, cubes: [...cubesOf(genome), ...cubes], joints: [...jointsOf(genome), ...joints] };
  return { genome: awake(genome, finish({ ...genome, body })), id };
}

/** Takes a part away, with all that hangs on it alone, and its twin. */
export function remove(genome: Genome, id: string, mirror: boolean): Genome {
  const root = cubesOf(genome)[0];
  if (root?.id === id) throw new Impossible("The first part is what all others hang on: it stays.");
  const gone = new Set([id, ...(mirror ? [twinOf(genome, id)?.id ?? id] : [])]);
  const joints = jointsOf(genome).filter((joint) => !gone.has(joint.cube1) && !gone.has(joint.cube2));
  const rest = cubesOf(genome).filter((cube) => !gone.has(cube.id));
  const reached = tree({ ...genome, body: { cubes: rest, joints } });
  const cubes = rest.filter((cube, index) => index === 0 || reached.has(cube.id));
  const kept = new Set(cubes.map((cube) => cube.id));
  const body = { ...genome.body, cubes, joints: joints.filter((each) => kept.has(each.cube1) && kept.has(each.cube2)) };
  return finish({ ...genome, body });
}

/** Shifts a part, with all that hangs on it, and its twin the mirrored way. Of the root, nothing moves along. */
export function move(genome: Genome, id: string, by: Vector, mirror: boolean): Genome {
  const twin = mirror ? twinOf(genome, id) : undefined;
  const shifted = shift(genome, id, by);
  return finish(twin === undefined ? shifted : shift(shifted, twin.id, [by[0], by[1], -by[2]]));
}

/** Gives a part other edges, and its twin too; density stays, and what hangs on it goes along. */
export function resize(genome: Genome, id: string, size: Vector, mirror: boolean): Genome {
  const twin = mirror ? twinOf(genome, id) : undefined;
  const cube = cubeOf(genome, id);
  const wanted = conforming(cube.shape ?? "box", edges(cube), size);
  const bounded = rounded(wanted.map((edge) => Math.min(Math.max(edge, SMALLEST), LARGEST)) as unknown as Vector);
  const grown = stretched(genome, id, bounded);
  return finish(twin === undefined ? grown : stretched(grown, twin.id, bounded));
}

/** Changes what a part is: its mass, its colour, its friction. */
export function change(genome: Genome, id: string, fields: Partial<Omit<Cube, "id" | "size">>, mirror: boolean): Genome {
  const ids = [id, ...(mirror ? [twinOf(genome, id)?.id ?? id] : [])];
  return finish(withCubes(genome, (cube) => (ids.includes(cube.id) ? { ...cube, ...fields } : cube)));
}

/** Makes a part a ball, a capsule, a cylinder or a box; edges that the shape wants equal become so. */
export function reshape(genome: Genome, id: string, shape: Shape, mirror: boolean): Genome {
  const size = edges(cubeOf(genome, id));
  const ids = [id, ...(mirror ? [twinOf(genome, id)?.id ?? id] : [])];
  const fitted = fitting(shape, size);
  const boxes = withCubes(genome, (cube) => {
    if (!ids.includes(cube.id)) return cube;
    const { shape: before = "box", ...rest } = cube;
    return { ...rest, mass: round((cube.mass * volume("box", size)) / volume(before, size)) };
  });
  const sized = resize(boxes, id, fitted, mirror);
  return finish(withCubes(sized, (cube) => {
    if (!ids.includes(cube.id) || shape === "box") return cube;
    return { ...cube, shape, mass: round(Math.max(0.001, (cube.mass * volume(shape, fitted)) / volume("box", fitted))) };
  }));
}

/** Joins two parts that are not joined yet, half-way between them. */
export function join(genome: Genome, one: string, other: string, type: JointType): Added {
  if (one === other) throw new Impossible("A part cannot be joined to itself.");
  const pair = jointsOf(genome).find((joint) => [joint.cube1, joint.cube2].sort().join() === [one, other].sort().join());
  if (pair !== undefined) throw new Impossible(`${one} and ${other} are joined by ${pair.id} already.`);
  const anchor = times(plus(cubeOf(genome, one).position, cubeOf(genome, other).position), 0.5);
  const id = unique(genome, "joint");
  const joint: Joint = { id, cube1: one, cube2: other, type, anchor: rounded(anchor) };
  return { genome: finish({ ...genome, body: { ...genome.body, joints: [...jointsOf(genome), joint] } }), id };
}

/** Changes a joint and, the mirrored way, its twin; `undefined` takes a field away. What a type lacks goes. */
export function rejoin(genome: Genome, id: string, fields: Changes<Hold & { anchor: Vector }>, mirror: boolean): Genome {
  const joint = jointOf(genome, id);
  const twin = mirror ? twinJoint(genome, joint) : undefined;
  const changed = sound({ ...joint, ...retyped(joint, fields.type), ...fields } as Joint);
  const joints = jointsOf(genome).map((each) => {
    if (each === joint) return changed;
    if (each !== twin) return each;
    return { ...reflectHold(changed), ...{ id: each.id, cube1: each.cube1, cube2: each.cube2 }, anchor: mirrored(genome, changed.anchor) };
  });
  return finish({ ...genome, body: { ...genome.body, joints } });
}

/** Puts a motor on a joint that can have one, as its type wants it. */
export function motorize(genome: Genome, id: string, mirror: boolean): Genome {
  const type = jointOf(genome, id).type;
  if (type !== "hinge" && type !== "slide") throw new Impossible("Only hinges and slides have motors.");
  return awake(genome, rejoin(genome, id, { motor: type === "hinge" ? HINGE_MOTOR : SLIDE_MOTOR }, mirror));
}

/** Says what it senses; `undefined` leaves it the senses that every body has. */
export function sense(genome: Genome, sensors: readonly SensorEntry[] | undefined): Genome {
  const { sensors: _, ...rest } = genome;
  return sensors === undefined ? finish(rest as Genome) : finish({ ...(rest as Genome), sensors });
}


export type Changes<T> = { readonly [K in keyof T]?: T[K] | undefined };

// -- what moves along ---------------------------------------------------------------------------------------------------

function shift(genome: Genome, id: string, by: Vector): Genome {
  const own = hangsBy(genome, id);
  const moving = own === undefined ? new Set([id]) : limb(genome, id);
  const cubes = cubesOf(genome).map((each) =>
    moving.has(each.id) ? { ...each, position: rounded(plus(each.position, by)) } : each,
  );
  const joints = jointsOf(genome).map((each) =>
    each === own || (moving.has(each.cube1) && moving.has(each.cube2))
      ? { ...each, anchor: rounded(plus(each.anchor, by)) }
      : each,
  );
  return { ...genome, body: { ...genome.body, cubes, joints } };
}

function stretched(genome: Genome, id: string, size: Vector): Genome {
  const cube = cubeOf(genome, id);
  const before = edges(cube);
  const q = quaternion(cube.rotation);
  const scale = (point: Vector): Vector => {
    const local = turn(opposite(q), minus(point, cube.position));
    return turn(q, [(local[0] * size[0]) / before[0], (local[1] * size[1]) / before[1], (local[2] * size[2]) / before[2]]);
  };
  const own = hangsBy(genome, id);
  const centre = own === undefined ? cube.position : minus(own.anchor, scale(own.anchor));
  const mass = round(Math.max(0.001, (cube.mass * volume(cube.shape ?? "box", size)) / volume(cube.shape ?? "box", before)));
  let made = withCubes(genome, (each) =>
    each === cube ? { ...cube, size, mass, position: rounded(centre) } : each,
  );
  for (const [there, joint] of tree(genome)) {
    if (joint === own || (joint.cube1 !== id && joint.cube2 !== id)) continue;
    made = shift(made, there, minus(plus(centre, scale(joint.anchor)), joint.anchor));
  }
  return made;
}

// -- symmetry -----------------------------------------------------------------------------------------------------------

function reflectCube(genome: Genome, cube: Cube, id: string): Cube {
  const image = { ...cube, id, position: mirrored(genome, cube.position) };
  if (cube.rotation === undefined) return image;
  const [x = 0, y = 0, ...rest] = cube.rotation; // turns about x and y go the other way, of a quaternion too
  return { ...image, rotation: [0 - x, 0 - y, ...rest] };
}

/** A joint whose image moves as its mirror image when both get the same controls. */
function reflectHold<T extends Hold>(joint: T): T {
  if (joint.axis === undefined) return joint;
  const [x, y, z] = joint.axis;
  // What a hinge turns about is no arrow: in a mirror it is the two other numbers that change their sign.
  return { ...joint, axis: joint.type === "hinge" ? [0 - x, 0 - y, z] : [x, y, 0 - z] };
}

function twinJoint(genome: Genome, joint: Joint): Joint | undefined {
  const [one, other] = [joint.cube1, joint.cube2].map((id) => twinOf(genome, id)?.id ?? id) as [string, string];
  return jointsOf(genome).find((each) => each !== joint && each.cube1 === one && each.cube2 === other);
}

// -- new parts ----------------------------------------------------------------------------------------------------------

const AXES = ["x", "y", "z"] as const;
const LEG = 0.1;
const PALETTE: Record<Stamp, Vector> = {
  leg: [0.93, 0.87, 0.74],
  segment: [0.36, 0.55, 0.75],
  block: [0.45, 0.65, 0.45],
  wheel: [0.25, 0.25, 0.3],
  ball: [0.85, 0.62, 0.31],
};

function grown(parent: Cube, id: string, face: Face, at: Vector, stamp: Stamp, mirror: boolean): [Cube, Joint] {
  const along = AXES.indexOf(face[1] as "x" | "y" | "z");
  const sign = face[0] === "+" ? 1 : -1;
  const half = times(edges(parent), 0.5);
  const size = sizeOf(stamp, parent, along);
  const hangs = stamp === "leg" && along !== 1;
  // On the face, and not over its edges where there is room.
  const spot = at.map((value, i) => {
    if (i === along) return sign * (half[i] ?? 0);
    const room = Math.max(0, (half[i] ?? 0) - (size[i] ?? 0) / 2);
    return Math.min(Math.max(value, -room), room);
  }) as unknown as [number, number, number];
  if (mirror && along !== 2 && Math.abs(spot[2]) < size[2] / 2) spot[2] = 0; // its twin would be in its way
  const pivot = [...spot] as [number, number, number];
  const centre = [...spot] as [number, number, number];
  centre[along] = (centre[along] ?? 0) + (sign * (size[along] ?? 0)) / 2;
  if (hangs) {
    pivot[along] = centre[along] ?? 0;
    pivot[1] = Math.min(0, half[1] - LEG / 2); // however high the click was: legs are to be level
    centre[1] = pivot[1] + LEG / 2 - size[1] / 2;
  } else if (stamp === "wheel") {
    pivot[along] = centre[along] ?? 0;
  }
  const q = quaternion(parent.rotation);
  const world = (local: Vector): Vector => rounded(plus(parent.position, turn(q, local.map(toMillimetres) as unknown as Vector)));
  const shape = SHAPES[stamp];
  const cube: Cube = {
    id,
    size: rounded(size),
    ...(shape === "box" ? {} : { shape }),
    mass: round(Math.max(0.001, DENSITY * volume(shape, size))),
    position: world(centre),
    ...(parent.rotation === undefined ? {} : { rotation: parent.rotation }),
    color: PALETTE[stamp],
  };
  return [cube, { ...hold(stamp, along, (local) => rounded(turn(q, local))), ...ends(parent.id, id), anchor: world(pivot) }];
}

const SHAPES: Record<Stamp, Shape> = { leg: "box", segment: "box", block: "box", wheel: "cylinder", ball: "sphere" };

/** Rounds to a millimetre, which is as exact as a hand with a mouse is. */
const toMillimetres = (value: number): number => Math.round(value * 1e3) / 1e3;

function sizeOf(stamp: Stamp, parent: Cube, along: number): Vector {
  const own = edges(parent);
  if (stamp === "leg") return [LEG, 0.3, LEG];
  if (stamp === "ball") return [0.16, 0.16, 0.16];
  if (stamp === "wheel") return [0, 1, 2].map((i) => (i === along ? 0.08 : 0.26)) as unknown as Vector;
  const length = stamp === "block" ? 0.16 : 0.25;
  return own.map((edge, i) => (i === along ? length : Math.max(SMALLEST, round(edge * 0.9)))) as unknown as Vector;
}

function hold(stamp: Stamp, along: number, turned: (local: Vector) => Vector): Hold {
  const across: Vector = along === 2 ? [0, 1, 0] : [0, 0, 1]; // what hangs on a side sweeps, all else swings
  if (stamp === "block" || stamp === "ball") return { type: "fixed" };
  if (stamp === "wheel") {
    const axle = AXES.map((_, i) => (i === along ? 1 : 0)) as unknown as Vector;
    return { type: "hinge", axis: turned(axle), motor: WHEEL_MOTOR };
  }
  return { type: "hinge", axis: turned(stamp === "leg" ? [0, 0, 1] : across), limits: [-1, 1], motor: HINGE_MOTOR };
}

function ends(parent: string, id: string): { id: string; cube1: string; cube2: string } {
  return { id, cube1: parent, cube2: id };
}

/** A name that no cube and no joint has, nor the twin of one. */
function unique(genome: Genome, base: string): string {
  const taken = new Set([...cubesOf(genome), ...jointsOf(genome)].map((each) => each.id));
  for (let number = 1; ; number += 1) {
    const id = number === 1 ? base : `${base}${number}`;
    if (!taken.has(id) && !taken.has(`${id}.mirror`)) return id;
  }
}

// -- what is always so --------------------------------------------------------------------------------------------------

/** Gives a body that has just got its first motors oscillators, so that it moves. */
function awake(before: Genome, genome: Genome): Genome {
  return genome.brain === undefined && motorsOf(before).length === 0 ? withBrain(genome, "sine") : genome;
}

/** Puts a body on the ground, and lets go of names of what is gone. */
function finish(genome: Genome): Genome {
  const lowest = Math.min(...cubesOf(genome).map(lowestOf));
  const lift: Vector = [0, -lowest, 0];
  let made = genome;
  if (Math.abs(lowest) >= NEAR && Number.isFinite(lowest)) {
    made = withCubes(made, (cube) => ({ ...cube, position: rounded(plus(cube.position, lift)) }));
    const joints = jointsOf(made).map((each) => ({ ...each, anchor: rounded(plus(each.anchor, lift)) }));
    made = { ...made, body: { ...made.body, joints } };
  }
  return follow(forget(made));
}

function lowestOf(cube: Cube): number {
  const half = times(edges(cube), 0.5);
  const q = quaternion(cube.rotation);
  const reach = AXES.map((_, i) => {
    const edge = [0, 0, 0] as [number, number, number];
    edge[i] = half[i] ?? 0;
    return Math.abs(turn(q, edge)[1]);
  });
  return cube.position[1] - reach.reduce((total, each) => total + each, 0);
}

/** Takes sensors, later parts and rules of development away that are about parts that are gone. */
function forget(genome: Genome): Genome {
  const cubes = cubesOf(genome).map((cube) => cube.id);
  const joints = jointsOf(genome).map((joint) => joint.id);
  const there = (names: readonly string[], pattern: string): boolean => names.some((name) => fits(pattern, name));
  const made: { -readonly [K in keyof Genome]: Genome[K] } = { ...genome };
  if (genome.sensors !== undefined) {
    made.sensors = genome.sensors.filter(
      (each) => (each.cube === undefined || there(cubes, each.cube)) && (each.joint === undefined || there(joints, each.joint)),
    );
  }
  if (genome.later !== undefined) {
    const later = genome.later.filter((id) => cubes.includes(id));
    if (later.length > 0) made.later = later;
    else delete made.later;
  }
  if (genome.development !== undefined) {
    const rules = genome.development.map((rule) => lean(rule, cubes)).filter((rule) => rule !== undefined);
    if (rules.length > 0) made.development = rules;
    else delete made.development;
  }
  return made;
}

function lean(rule: Rule, cubes: readonly string[]): Rule | undefined {
  const names = /has\("([^"]*)"\)/g;
  if ([...rule.when.matchAll(names)].some((match) => !cubes.includes(match[1] ?? ""))) return undefined;
  const made: Record<string, unknown> = { ...rule };
  for (const field of ["shed", "adopt", "grow"] as const) {
    const kept = rule[field]?.filter((id) => cubes.includes(id));
    if (kept?.length === 0) delete made[field];
    else if (kept !== undefined) made[field] = kept;
  }
  const sizes = rule.resize?.filter((each) => cubes.includes(each.part));
  if (sizes?.length === 0) delete made["resize"];
  else if (sizes !== undefined) made["resize"] = sizes;
  return ["shed", "adopt", "grow", "resize", "enter"].some((field) => field in made) ? (made as unknown as Rule) : undefined;
}

/** What becomes of limits and motor when the type of a joint changes: a number of rad is none of m. */
function retyped(joint: Joint, type: JointType | undefined): Changes<Hold> {
  if (type === undefined || type === joint.type) return {};
  const motor = joint.motor === undefined ? undefined : type === "slide" ? SLIDE_MOTOR : HINGE_MOTOR;
  const limits = type === "conetwist" ? ([0.5, 0.5] as const) : undefined;
  return { limits, motor, stiffness: undefined, damping: undefined };
}

/** A joint without what its type cannot have, and without fields that are undefined. */
function sound(joint: Joint): Joint {
  const made: Record<string, unknown> = {};
  for (const [field, value] of Object.entries(joint)) {
    if (value !== undefined) made[field] = value;
  }
  const driven = joint.type === "hinge" || joint.type === "slide";
  if (!driven) for (const field of ["motor", "stiffness", "damping"]) delete made[field];
  if (joint.type === "fixed" || joint.type === "pin") for (const field of ["axis", "limits"]) delete made[field];
  return made as unknown as Joint;
}

function withCubes(genome: Genome, update: (cube: Cube) => Cube): Genome {
  return genome.body.cubes === undefined ? genome : { ...genome, body: { ...genome.body, cubes: genome.body.cubes.map(update) } };
}

function fitting(shape: Shape, [x, y, z]: Vector): Vector {
  if (shape === "box") return [x, y, z];
  if (shape === "sphere") return [x, x, x].map(() => Math.min(x, y, z)) as unknown as Vector;
  const longest = Math.max(x, y, z);
  const along = shape === "capsule" ? [x, y, z].indexOf(longest) : oddOne([x, y, z]);
  const others = [x, y, z].filter((_, i) => i !== along);
  const width = Math.min(...others);
  return [x, y, z].map((edge, i) => {
    if (i !== along) return width;
    return shape === "capsule" && edge <= width ? width * 2 : edge;
  }) as unknown as Vector;
}

/** Edges that a shape can have, where some of those before were changed. */
function conforming(shape: Shape, before: Vector, size: Vector): Vector {
  if (shape === "box") return size;
  const changed = [0, 1, 2].filter((i) => size[i] !== before[i]);
  const all = (edge: number): Vector => [edge, edge, edge];
  if (shape === "sphere") return all(size[changed[0] ?? 0] as number);
  const along = lying(before);
  const across = size[changed.find((i) => i !== along) ?? (along + 1) % 3] as number;
  const length = size[along] as number;
  return all(across).map((edge, i) => {
    if (i !== along) return edge;
    return shape === "capsule" ? Math.max(length, across * 1.05) : length;
  }) as unknown as Vector;
}

/** The axis (0, 1, 2) along which a capsule or a cylinder lies. */
function lying([x, y, z]: Vector): number {
  return x === z ? 1 : y === z ? 0 : 2;
}

/** Which of three edges is least like the two others: along it a cylinder lies. */
function oddOne(size: Vector): number {
  const sorted = [...size].sort((a, b) => a - b) as [number, number, number];
  const odd = sorted[1] - sorted[0] > sorted[2] - sorted[1] ? sorted[0] : sorted[2];
  return size.indexOf(odd);
}

function volume(shape: Shape, size: Vector): number {
  const along = lying(size);
  const [length, across] = [size[along] as number, size[(along + 1) % 3] as number];
  if (shape === "box") return size[0] * size[1] * size[2];
  if (shape === "sphere") return (Math.PI / 6) * across ** 3;
  if (shape === "capsule") return (Math.PI / 4) * across ** 2 * (length - across) + (Math.PI / 6) * across ** 3;
  return (Math.PI / 4) * across ** 2 * length;
}
