/** What can be asked of a creature that is being built: its parts, what hangs on what, and what is whose twin. */

import { type Cube, edges, type Genome, type Joint, type Vector } from "./genome.js";
import { round } from "./vectors.js";

/** Two numbers of documents, in m or kg, that are nearer than this are the same. */
export const NEAR = 1e-6;

/** A step that cannot be made, in words for whoever asked for it. */
export class Impossible extends Error {}

export const cubesOf = (genome: Genome): readonly Cube[] => genome.body.cubes ?? [];
export const jointsOf = (genome: Genome): readonly Joint[] => genome.body.joints ?? [];

/** The cube of a name. */
export function cubeOf(genome: Genome, id: string): Cube {
  return known(cubesOf(genome).find((cube) => cube.id === id), `There is no part ${id}.`);
}

/** The joint of a name. */
export function jointOf(genome: Genome, id: string): Joint {
  return known(jointsOf(genome).find((joint) => joint.id === id), `There is no joint ${id}.`);
}

/** The joint by which a cube hangs on what is nearer to the root; none of the root. */
export function hangsBy(genome: Genome, id: string): Joint | undefined {
  return tree(genome).get(id);
}

/** The cube's image on the other side; none where it has none, or lies on the plane itself. */
export function twinOf(genome: Genome, id: string): Cube | undefined {
  const cube = cubeOf(genome, id);
  const place = mirrored(genome, cube.position);
  if (Math.abs(place[2] - cube.position[2]) < NEAR) return undefined;
  const size = edges(cube);
  return cubesOf(genome).find((other) => other !== cube && same(other.position, place) && same(edges(other), size));
}

/** How deep in the body a cube is: 0 of the root, 1 of what hangs on it. */
export function depthOf(genome: Genome, id: string): number {
  const hanging = tree(genome);
  let depth = 0;
  for (let joint = hanging.get(id); joint !== undefined; joint = hanging.get(id)) {
    id = joint.cube1 === id ? joint.cube2 : joint.cube1;
    depth += 1;
  }
  return depth;
}

/** For each cube but the root, the joint by which it is reached first from there. */
export function tree(genome: Genome): Map<string, Joint> {
  const hanging = new Map<string, Joint>();
  const root = cubesOf(genome)[0];
  const reached = root === undefined ? [] : [root.id];
  for (const here of reached) {
    for (const joint of jointsOf(genome)) {
      const there = joint.cube1 === here ? joint.cube2 : joint.cube2 === here ? joint.cube1 : undefined;
      if (there === undefined || reached.includes(there)) continue;
      hanging.set(there, joint);
      reached.push(there);
    }
  }
  return hanging;
}

/** A cube and all that hangs on it. */
export function limb(genome: Genome, id: string): Set<string> {
  const hanging = tree(genome);
  const found = new Set([id]);
  for (const [cube, joint] of hanging) {
    if (found.has(joint.cube1 === cube ? joint.cube2 : joint.cube1)) found.add(cube);
  }
  return found;
}


/** The image of a point across the root's middle plane. */
export function mirrored(genome: Genome, [x, y, z]: Vector): Vector {
  const plane = cubesOf(genome)[0]?.position[2] ?? 0;
  return [x, y, round(2 * plane - z)];
}

function same(a: Vector, b: Vector): boolean {
  return a.every((value, i) => Math.abs(value - (b[i] ?? NaN)) < NEAR * 10);
}

function known<T>(value: T | undefined, message: string): T {
  if (value === undefined) throw new Impossible(message);
  return value;
}
