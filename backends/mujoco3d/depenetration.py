"""Depenetration: bodies that an edit left inside others are let apart gently.

Contact springs alone would shoot off what was put deep inside something, and all that touches it with it: so the whole
island of trees in contact is held back. Many in one place are let apart by `crowds`.

Hides how deep is deep, and which trees of the model are held back. Which bodies are watched is part of a simulation's
state: its digest and its snapshots have it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import mujoco
import numpy as np
import numpy.typing as npt

from nmes.backend import Array
from nmes.backends.mujoco3d.crowds import Crowds
from nmes.backends.mujoco3d.model import CompiledModel, inner_radii
from nmes.backends.mujoco3d.scenery import Scenery

__all__ = ["Depenetration"]

Trees = npt.NDArray[np.intp]

_DEEP = 0.01  # part of a box's shortest edge
_SPEED = 3.0  # m/s and rad/s
_CAPSULE = int(mujoco.mjtGeom.mjGEOM_CAPSULE)


class Depenetration:
    """The bodies that may be deep inside others; none, and then of no cost, soon after an edit.

    Attributes:
        bodies: Their numbers.
        crowds: Those of them that glide out of a crowd.
    """

    def __init__(self, scenery: Scenery) -> None:
        self.bodies: set[int] = set()
        self.crowds = Crowds(scenery)

    @property
    def watched(self) -> tuple[set[int], set[int]]:
        """Which bodies these are, and which of them glide: as they are now, whatever steps come."""
        return self.bodies.copy(), self.crowds.gliding.copy()

    @watched.setter
    def watched(self, watched: tuple[set[int], set[int]]) -> None:
        self.bodies, self.crowds.gliding = watched

    def watch(self, bodies: Iterable[int]) -> None:
        """Watches bodies that were edited."""
        self.bodies.update(bodies)
        self.crowds.gliding.difference_update(bodies)

    def forget(self, body: int) -> None:
        """Forgets a body that is no more."""
        self.bodies.discard(body)
        self.crowds.gliding.discard(body)

    def step(self, compiled: CompiledModel, data: mujoco.MjData, step: Callable[[], None]) -> None:
        """Takes one engine step, by `step`, in which trees with these bodies gain little speed by being deep inside.

        Trees that they are in go on being held back, and those so fast that they may be inside others after the next
        step go on being watched; all others are forgotten.
        """
        model, crowds = compiled.model, self.crowds
        crowds.move(compiled, data, self.bodies)
        before = data.qvel.copy()
        watched = model.body_treeid[[compiled.body_index[body] for body in self.bodies]]
        with crowds.apart(compiled, data, ()):
            step()
        deep = _deep(model, data, watched)
        _hold_back(model, data, deep, before)
        going_on = np.isin(model.body_treeid, np.append(deep, self._fast(compiled, data)))
        numbers = compiled.body_number
        self.bodies = {numbers[index] for index in np.flatnonzero(going_on).tolist() if index in numbers}
        self.bodies |= crowds.gliding

    def _fast(self, compiled: CompiledModel, data: mujoco.MjData) -> Trees:
        """Returns the trees of watched free bodies that go further in a step than contacts can see."""
        model, bodies = compiled.model, self.bodies & compiled.free.keys()
        index = np.array([compiled.body_index[body] for body in bodies], np.intp)
        dofs = np.array([compiled.free[body].v for body in bodies], np.intp)
        speeds = np.abs(data.qvel[dofs[:, None] + np.arange(3)]).max(axis=1)
        trees: Trees = model.body_treeid[index[speeds * model.opt.timestep > inner_radii(model, index)]]
        return trees


def _deep(model: mujoco.MjModel, data: mujoco.MjData, watched: Trees) -> Trees:
    """Returns the trees that are deep inside a watched one, or are watched and deep inside anything."""
    geoms = data.contact.geom
    edges = np.where(model.geom_size > 0.0, 2.0 * model.geom_size, np.inf)  # a plane has none
    edges[model.geom_type == _CAPSULE, 1] = np.inf  # how long it is between its ends counts for nothing
    edges = edges.min(axis=1)
    pairs = model.body_treeid[model.geom_bodyid[geoms[data.contact.dist < -_DEEP * edges[geoms].min(axis=1)]]]
    trees = np.unique(pairs[np.isin(pairs, watched[watched >= 0]).any(axis=1)])
    return trees[trees >= 0]


def _hold_back(model: mujoco.MjModel, data: mujoco.MjData, deep: Trees, before: Array) -> None:
    """Bounds what trees gained of speed that are in contact with deep ones, also by way of others."""
    islands = data.tree_island[deep]
    trees = np.flatnonzero(np.isin(data.tree_island, islands[islands >= 0]))
    if not len(trees):
        return
    bounds = np.maximum(np.maximum.reduceat(np.abs(before), model.tree_dofadr)[trees], _SPEED)
    speeds = np.maximum.reduceat(np.abs(data.qvel), model.tree_dofadr)[trees]
    gaining = (bounds < speeds) & (speeds <= mujoco.mjMAXVAL)  # beyond it the world faults as diverged
    for tree, factor in zip(trees[gaining].tolist(), (bounds[gaining] / speeds[gaining]).tolist(), strict=True):
        data.qvel[model.tree_dofadr[tree] : model.tree_dofadr[tree] + model.tree_dofnum[tree]] *= factor
