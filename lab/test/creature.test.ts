import assert from "node:assert/strict";
import { test } from "node:test";

import { cubeOf, cubesOf, hangsBy, Impossible, jointOf, jointsOf, twinOf } from "../src/creature/anatomy.js";
import { motorsOf, sensorNames, withBrain } from "../src/creature/brains.js";
import { add, fresh, join, motorize, move, rejoin, remove, reshape, resize, sense } from "../src/creature/creature.js";
import { edges, type Genome } from "../src/creature/genome.js";
import { changePart, grow, prune } from "../src/creature/graph.js";
import { History } from "../src/creature/history.js";

/** A trunk with four legs, in two clicks on its side. */
function quadruped(): Genome {
  const front = add(fresh(), "trunk", "+z", [0.25, 0, 0.15], "leg", true).genome;
  return add(front, "trunk", "+z", [-0.25, 0.05, 0.15], "leg", true).genome;
}

test("two clicks on a side make four legs that stand on the ground", () => {
  const genome = quadruped();
  assert.deepEqual(cubesOf(genome).map((cube) => cube.id), ["trunk", "leg", "leg.mirror", "leg2", "leg2.mirror"]);
  const [trunk, ...legs] = cubesOf(genome);
  for (const leg of legs) assert.ok(Math.abs(leg.position[1] - 0.15) < 1e-9);
  assert.ok((trunk?.position[1] ?? 0) > 0.2);
});

test("a new body has oscillators that let diagonal legs swing together", () => {
  const oscillators = quadruped().brain?.["oscillators"] as { motor: string; phase: number }[];
  const phases = Object.fromEntries(oscillators.map((each) => [each.motor, each.phase]));
  assert.equal(phases["leg"], phases["leg2.mirror"]);
  assert.equal(phases["leg2"], phases["leg.mirror"]);
  assert.notEqual(phases["leg"], phases["leg.mirror"]);
});

test("without a mirror there is one leg", () => {
  const { genome } = add(fresh(), "trunk", "+z", [0, 0, 0.15], "leg", false);
  assert.equal(cubesOf(genome).length, 2);
});

test("what is in the middle has no twin", () => {
  const { genome, id } = add(fresh(), "trunk", "+x", [0.3, 0, 0.02], "ball", true);
  assert.equal(cubesOf(genome).length, 2);
  assert.equal(cubeOf(genome, id).position[2], 0);
  assert.equal(twinOf(genome, id), undefined);
});

test("what grows on a twin's image grows on the twin too", () => {
  const front = add(fresh(), "trunk", "+z", [0.25, 0, 0.15], "leg", true);
  const { genome, id } = add(front.genome, front.id, "-y", [0, -0.15, 0], "leg", true);
  assert.equal(hangsBy(genome, `${id}.mirror`)?.cube1, "leg.mirror");
});

test("a change of a joint reaches its twin as its mirror image", () => {
  const genome = rejoin(quadruped(), "leg", { axis: [1, 2, 3], limits: [-0.5, 0.25] }, true);
  assert.deepEqual(jointOf(genome, "leg.mirror").axis, [-1, -2, 3]);
  assert.deepEqual(jointOf(genome, "leg.mirror").limits, [-0.5, 0.25]);
  assert.deepEqual(jointOf(genome, "leg2").axis, [0, 0, 1]);
});

test("the anchor of a mirrored joint is beside its own leg", () => {
  const genome = quadruped();
  assert.equal(jointOf(genome, "leg.mirror").anchor[2], -jointOf(genome, "leg").anchor[2]);
});

test("a larger trunk takes its legs along, and keeps its density", () => {
  const before = quadruped();
  const genome = resize(before, "trunk", [1.2, 0.16, 0.3], true);
  assert.equal(cubeOf(genome, "trunk").mass, 2 * cubeOf(before, "trunk").mass);
  assert.equal(cubeOf(genome, "leg").position[0], 2 * cubeOf(before, "leg").position[0]);
  assert.deepEqual(edges(cubeOf(genome, "leg")), edges(cubeOf(before, "leg")));
});

test("a longer leg stays at its hip, and lifts the body", () => {
  const genome = resize(quadruped(), "leg", [0.1, 0.6, 0.1], true);
  const leg = cubeOf(genome, "leg");
  const low = leg.position[1] - 0.3;
  assert.ok(Math.abs(low) < 1e-6);
  assert.deepEqual(edges(cubeOf(genome, "leg.mirror")), [0.1, 0.6, 0.1]);
  assert.ok(jointOf(genome, "leg").anchor[1] > leg.position[1]);
});

test("a limb moves with what hangs on it", () => {
  const front = add(fresh(), "trunk", "+z", [0, 0, 0.15], "leg", true);
  const knee = add(front.genome, front.id, "-y", [0, -0.15, 0], "leg", true);
  const genome = move(knee.genome, "leg", [0.1, 0, 0.05], true);
  assert.ok(Math.abs(cubeOf(genome, knee.id).position[0] - cubeOf(knee.genome, knee.id).position[0] - 0.1) < 1e-9);
  assert.ok(Math.abs(cubeOf(genome, "leg.mirror").position[2] + cubeOf(genome, "leg").position[2]) < 1e-9);
});

test("a part goes with all that hangs on it, its twin, its joints, its sensors and its oscillators", () => {
  const front = add(quadruped(), "leg", "-y", [0, -0.15, 0], "leg", true).genome;
  const sensing = sense(front, [{ type: "touch", cube: "leg3" }, { type: "up", cube: "trunk" }]);
  const genome = remove(sensing, "leg", true);
  assert.deepEqual(cubesOf(genome).map((cube) => cube.id), ["trunk", "leg2", "leg2.mirror"]);
  assert.equal(jointsOf(genome).length, 2);
  assert.deepEqual(genome.sensors, [{ type: "up", cube: "trunk" }]);
  assert.equal((genome.brain?.["oscillators"] as unknown[]).length, 2);
});

test("the root stays", () => {
  assert.throws(() => remove(quadruped(), "trunk", true), Impossible);
});

test("two parts are joined once", () => {
  const { genome } = join(quadruped(), "leg", "leg2", "fixed");
  assert.equal(jointsOf(genome).length, 5);
  assert.throws(() => join(genome, "leg2", "leg", "fixed"), Impossible);
  assert.throws(() => join(genome, "leg", "leg", "fixed"), Impossible);
});

test("a joint of another type loses what it cannot have", () => {
  const fixed = rejoin(quadruped(), "leg", { type: "fixed" }, true);
  assert.deepEqual(Object.keys(jointOf(fixed, "leg")).sort(), ["anchor", "cube1", "cube2", "id", "type"]);
  assert.equal(motorsOf(fixed).length, 2);
  assert.throws(() => motorize(fixed, "leg", true), Impossible);
});

test("shapes have the edges that they must have, and keep density", () => {
  const ball = cubeOf(reshape(quadruped(), "leg", "sphere", true), "leg");
  assert.deepEqual(ball.size, [0.1, 0.1, 0.1]);
  assert.ok(Math.abs(ball.mass / ((Math.PI / 6) * 0.001) - 300) < 1);
  const capsule = reshape(quadruped(), "leg", "capsule", true);
  assert.deepEqual(cubeOf(capsule, "leg.mirror").shape, "capsule");
  assert.deepEqual(edges(cubeOf(resize(capsule, "leg", [0.05, 0.3, 0.1], true), "leg")), [0.05, 0.3, 0.05]);
});

test("a body has the senses that the command line gives it", () => {
  const { genome } = add(fresh(), "trunk", "+x", [0.3, 0, 0], "segment", true);
  const root = ["height", "up.x", "up.y", "up.z", "velocity.x", "velocity.y", "velocity.z", "spin.x", "spin.y", "spin.z"];
  const names = ["segment.position", "segment.velocity", ...root.map((name) => `trunk.${name}`)];
  assert.deepEqual(sensorNames(genome), names);
});

test("a brain made anew is the same brain", () => {
  assert.deepEqual(withBrain(quadruped(), "mlp"), withBrain(quadruped(), "mlp"));
});

test("documents are never changed", () => {
  const frozen = deepFreeze(quadruped());
  add(frozen, "leg", "-y", [0, -0.15, 0], "leg", true);
  remove(frozen, "leg", true);
  resize(frozen, "trunk", [1, 0.2, 0.2], true);
  move(frozen, "leg", [0.1, 0, 0], true);
  reshape(frozen, "leg", "capsule", true);
  withBrain(frozen, "cpg");
});

test("what is done is undone and done again, a drawn slider in one", () => {
  const history = new History(1);
  history.commit(2);
  history.commit(3, "size");
  history.commit(4, "size");
  history.commit(4);
  history.undo();
  assert.equal(history.now, 2);
  history.redo();
  assert.equal(history.now, 4);
  history.undo();
  history.undo();
  assert.deepEqual([history.now, history.canUndo, history.canRedo], [1, false, true]);
  history.commit(5);
  assert.equal(history.canRedo, false);
});

test("parts of a graph grow, change and go", () => {
  const trunk: Genome = { format: "nmes-genome/1", name: "g", body: { graph: { root: "a", parts: [{ id: "a", size: 0.2 }] } } };
  const genome = grow(grow(trunk, "a", "+z"), "part1", "+x");
  assert.deepEqual(genome.body.graph?.connections?.map((each) => each.mirror), ["z", undefined]);
  assert.equal(changePart(genome, "part1", { recursive_limit: 3 }).body.graph?.parts[1]?.recursive_limit, 3);
  assert.deepEqual(prune(genome, "part1").body.graph?.parts.map((part) => part.id), ["a"]);
  assert.throws(() => prune(genome, "a"), Impossible);
});

function deepFreeze<T>(value: T): T {
  if (typeof value === "object" && value !== null) Object.values(Object.freeze(value)).forEach(deepFreeze);
  return value;
}
