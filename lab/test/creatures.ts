/** Prints creatures that the builder makes, a line each: after the steps of a person, and after drawn ones. */

import { cubesOf, Impossible, jointsOf } from "../src/creature/anatomy.js";
import { KINDS, motorsOf, withBrain } from "../src/creature/brains.js";
import { add, change, fresh, join, motorize, move, rejoin, remove, reshape, resize, STAMPS } from "../src/creature/creature.js";
import type { Face, Genome, JointType, Shape } from "../src/creature/genome.js";

const FACES: readonly Face[] = ["+x", "-x", "+y", "-y", "+z", "-z"];
const TYPES: readonly JointType[] = ["fixed", "hinge", "slide", "pin", "conetwist"];
const SHAPES: readonly Shape[] = ["box", "sphere", "capsule", "cylinder"];

let state = Number(process.argv[2] ?? 1);

function draw(): number {
  state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
  return state / 4294967296;
}

function choose<T>(list: readonly T[]): T {
  return list[Math.floor(draw() * list.length)] as T;
}

const between = (low: number, high: number): number => low + draw() * (high - low);

function step(genome: Genome): Genome {
  const id = choose(cubesOf(genome)).id;
  const joint = jointsOf(genome).length > 0 ? choose(jointsOf(genome)).id : undefined;
  const mirror = draw() < 0.8;
  const kind = draw();
  const at = [between(-0.3, 0.3), between(-0.3, 0.3), between(-0.3, 0.3)] as const;
  if (kind < 0.45) return add(genome, id, choose(FACES), at, choose(STAMPS), mirror).genome;
  if (kind < 0.55) return resize(genome, id, [between(0.001, 0.6), between(0.05, 0.6), between(0.05, 12)], mirror);
  if (kind < 0.62) return move(genome, id, at, mirror);
  if (kind < 0.68) return change(genome, id, { mass: between(0.1, 5), rotation: [0, between(-1, 1), 0.3] }, mirror);
  if (kind < 0.74) return reshape(genome, id, choose(SHAPES), mirror);
  if (kind < 0.8) return remove(genome, id, mirror);
  if (kind < 0.83) return join(genome, id, choose(cubesOf(genome)).id, choose(TYPES)).genome;
  if (joint === undefined) return genome;
  if (kind < 0.93) return rejoin(genome, joint, { type: choose(TYPES) }, mirror);
  return motorize(genome, joint, mirror);
}

const [front] = [add(fresh("quadruped"), "trunk", "+z", [0.25, 0, 0.15], "leg", true).genome];
const quadruped = add(front, "trunk", "+z", [-0.25, 0, 0.15], "leg", true).genome;
const made: Genome[] = KINDS.map((kind) => withBrain({ ...quadruped, name: `quadruped-${kind}` }, kind));

let cart = fresh("cart");
for (const x of [0.22, -0.22]) cart = add(cart, "trunk", "+z", [x, -0.05, 0.15], "wheel", true).genome;
made.push(cart);

let snake = fresh("snake");
for (let on = "trunk", i = 0; i < 4; i += 1) {
  const added = add(snake, on, "-x", [-1, 0, 0], "segment", true);
  [snake, on] = [added.genome, added.id];
}
made.push(snake);

for (let walk = 0; walk < 40; walk += 1) {
  let genome = fresh(`drawn-${walk}`);
  for (let i = 0; i < 14; i += 1) {
    try {
      genome = step(genome);
    } catch (error) {
      if (!(error instanceof Impossible)) throw error;
    }
  }
  made.push(motorsOf(genome).length > 0 ? withBrain(genome, choose(KINDS)) : genome);
}
for (const genome of made) console.log(JSON.stringify(genome));
