"""Depenetration: bodies that an edit left inside others are let apart gently.

Contact springs alone would shoot off what was put deep inside something, and all that touches it with it: so the whole
island of trees in contact is held back. And contacts of many things in one place are as many as their pairs: hundreds
of cubes there would take minutes a step. So only the first few of them touch others until these have made room.

Hides how deep is deep, which trees of the model are held back, and which wait. Which bodies are watched is part of a
simulation's state: its digest and its snapshots have it; who waits follows from where they are.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco
import numpy as np

from nmes.backend import Array
from nmes.backends.mujoco3d.model import CompiledModel, Slot
from nmes.backends.mujoco3d.sleep import AWAKE

__all__ = ["Depenetration"]

_DEEP = 0.01  # part of a box's shortest edge
_SPEED = 3.0  # m/s and rad/s
_CROWD = 16  # bodies that may be watched before some have to wait
_FIRST = 4  # of watched ones in one place so many touch each other, the rest wait
_INSIDE = 0.9  # part of the sum of two inner radii; nearer centres are in one place
_WAITING = 2  # the bit of MuJoCo's collision masks by which those that wait touch what cannot move


class Depenetration:
    """The bodies that may be deep inside others; none, and then of no cost, soon after an edit.

    Attributes:
        bodies: Their numbers.
    """

    def __init__(self) -> None:
        self.bodies: set[int] = set()

    def step(self, compiled: CompiledModel, data: mujoco.MjData) -> None:
        """Takes one engine step in which trees with these bodies gain little speed by being deep inside others.

        Trees that they are in go on being held back, and those so fast that they may be inside others after the next
        step go on being watched; all others are forgotten.
        """
        model = compiled.model
        before = data.qvel.copy()
        with self.crowds(compiled, data) as waiting:
            data.tree_asleep[waiting] = AWAKE
            mujoco.mj_step(model, data)
        bodies = model.geom_bodyid[data.contact.geom]
        edges = np.where(model.geom_size > 0.0, 2.0 * model.geom_size, np.inf).min(axis=1)  # a plane has none
        depth = _DEEP * edges[data.contact.geom].min(axis=1)
        trees = model.body_treeid[bodies[data.contact.dist < -depth]]
        watched = {int(model.body_treeid[compiled.body_index[body]]) for body in self.bodies}
        deep = {tree for pair in trees.tolist() if watched.intersection(pair) for tree in pair if tree >= 0}
        islands = data.tree_island[sorted(deep)]
        for tree in np.flatnonzero(np.isin(data.tree_island, islands[islands >= 0])).tolist():
            dofs = slice(model.tree_dofadr[tree], model.tree_dofadr[tree] + model.tree_dofnum[tree])
            bound = max(_SPEED, float(np.abs(before[dofs]).max()))
            speed = float(np.abs(data.qvel[dofs]).max())
            if bound < speed <= mujoco.mjMAXVAL:  # beyond it the world faults as diverged
                data.qvel[dofs] *= bound / speed
        deep.update(waiting, self._fast(compiled, data))
        self.bodies = {body for body, index in compiled.body_index.items() if int(model.body_treeid[index]) in deep}

    @contextmanager
    def crowds(self, compiled: CompiledModel, data: mujoco.MjData) -> Iterator[list[int]]:
        """Gives the trees that wait; while it lasts they touch nothing but what cannot move."""
        model, waiting = compiled.model, self._waiting(compiled, data)
        if not waiting:
            yield waiting
            return
        masks = [model.geom_contype, model.geom_conaffinity, model.body_contype, model.body_conaffinity]
        saved = [mask.copy() for mask in masks]
        trees = model.body_treeid
        for (kind, affinity), tree in ((masks[:2], trees[model.geom_bodyid]), (masks[2:], trees)):
            affinity[(kind != 0) & (tree < 0)] |= _WAITING
            wait = np.isin(tree, waiting)
            kind[wait], affinity[wait] = _WAITING, 0
        try:
            yield waiting
        finally:
            for mask, values in zip(masks, saved, strict=True):
                mask[:] = values

    def _waiting(self, compiled: CompiledModel, data: mujoco.MjData) -> list[int]:
        """Returns the trees that wait: those whose roots lie in the roots of too many watched ones before them."""
        if len(self.bodies) <= _CROWD:
            return []
        trees, radii, slots = self._roots(compiled)
        rows = [[slot.q, slot.q + 1, slot.q + 2] for slot in slots]
        places = np.clip(data.qpos[rows], -mujoco.mjMAXVAL, mujoco.mjMAXVAL)
        first, count, waiting = np.empty(len(trees), np.intp), 0, []
        for row, tree in enumerate(trees):
            others = first[:count]
            way = places[others] - places[row]
            # Balls within the boxes: plates that lie on each other are in places of their own.
            inside = (way * way).sum(axis=1) < (_INSIDE * (radii[others] + radii[row])) ** 2
            if inside.sum() < _FIRST:
                first[count] = row
                count += 1
            else:
                waiting.append(tree)
        return sorted(waiting)

    def _fast(self, compiled: CompiledModel, data: mujoco.MjData) -> list[int]:
        """Returns the trees of watched roots that go further in a step than contacts can see."""
        trees, radii, slots = self._roots(compiled)
        velocities = data.qvel[[[slot.v, slot.v + 1, slot.v + 2] for slot in slots]].reshape(-1, 3)
        return [
            trees[row] for row in np.flatnonzero(np.abs(velocities).max(axis=1) * compiled.model.opt.timestep > radii)
        ]

    def _roots(self, compiled: CompiledModel) -> tuple[list[int], Array, list[Slot]]:
        """Returns the trees of watched free bodies by their numbers, the radii of balls in them, their coordinates."""
        model, bodies = compiled.model, sorted(self.bodies & compiled.free.keys())
        index = [compiled.body_index[body] for body in bodies]
        trees: list[int] = model.body_treeid[index].tolist()
        return trees, model.geom_size[model.body_geomadr[index]].min(axis=1), [compiled.free[body] for body in bodies]
