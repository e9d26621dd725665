"""Episodes run again under the eye of an auditor of momentum: what a creature has of it that nothing outside gave.

MuJoCo steps a tree in the coordinates of its joints. The coordinates of its root's place are those of the whole tree,
so the forces along them are all that acts on it from outside: contacts, weight and the medium, as the integrator has
applied them. What the tree's momentum changes beyond their impulses the step has made of nothing. That holds for
integrators that compute forces once a step, so not for rk4.
"""

from __future__ import annotations

from typing import Any
from unittest.mock import patch

import mujoco
import numpy as np

from energy_audit import begin
from nmes.backend import Array
from nmes.backends.mujoco3d.simulation import MujocoSimulation
from nmes.evaluation import Task
from nmes.genome import Genome
from nmes.world import World

__all__ = ["momentum_of_nothing"]


def momentum_of_nothing(genome: Genome, task: Task, seed: int) -> Array:
    """Runs one episode, in MuJoCo and of a creature that keeps its parts, as evaluating does.

    Returns:
        The momentum since the start that nothing gave the creature, of each kilogram of it, after each tick that
        counts: array (ticks, 3), m/s.

    Raises:
        DocumentError: The genome's brain does not fit it.
        WorldError: The world refuses the creature.
    """
    world = World(task.world_config(seed))
    try:
        episode, ticks = begin(world, genome, task, seed)
        if episode._observer is None:
            return np.zeros((0, 3))
        cubes = [world.entities.cube(name) for name in world.creature("creature").cubes.values()]
        numbers, masses = [cube.body for cube in cubes], np.array([cube.mass for cube in cubes])
        given, rows = np.zeros(3), []

        def momentum() -> Array:
            moving: Array = masses @ world.simulation.states(numbers)[:, 7:10]
            return moving

        def mujoco_step(model: Any, data: Any, count: int = 1) -> None:
            assert isinstance(world.simulation, MujocoSimulation)
            index = world.simulation.running.compiled.body_index
            bodies = [index[number] for number in numbers if model.body_dofnum[index[number]] == 6]
            roots, dofs = np.array(bodies), model.body_dofadr[bodies][:, None] + np.arange(3)
            weights = model.body_subtreemass[roots][:, None] * model.opt.gravity
            impulses, seconds = np.zeros(model.nv), model.opt.timestep
            for _ in range(count):
                before = data.qvel.copy()
                mj_step(model, data)
                mujoco.mj_mulM(model, data, impulses, data.qvel - before)
                pushed = impulses[dofs] + seconds * (data.qfrc_bias[dofs] + weights)
                given[:] += pushed[data.body_awake[roots] > 0].sum(axis=0)

        mj_step, began = mujoco.mj_step, momentum()
        with patch.object(mujoco, "mj_step", mujoco_step):
            for _ in ticks:
                rows.append((momentum() - began - given) / masses.sum())
        return np.array(rows[: episode.result().ticks]).reshape(-1, 3)
    finally:
        world.close()
