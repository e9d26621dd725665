"""Depenetration: bodies that an edit left inside others are let apart gently.

Contact springs alone would shoot off what was put deep inside something, and contacts of many things in one place are
as many as their pairs: hundreds of cubes there would take minutes a step. So where too many are in one place, only the
first few of them touch the others until these have made room.

Hides how deep is deep, which trees of the model are held back, and which wait. Which bodies are watched is part of a
simulation's state: its digest and its snapshots have it; who waits follows from where they are.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from math import frexp

import mujoco
import numpy as np

from nmes.backends.mujoco3d.model import CompiledModel
from nmes.backends.mujoco3d.sleep import AWAKE

__all__ = ["Depenetration"]

_DEEP = 0.01  # part of a box's shortest edge
_SPEED = 3.0  # m/s and rad/s
_CROWD = 16  # trees whose roots may be in one place before some have to wait
_FIRST = 4  # of a crowd so many do not wait
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

        Trees that they are in go on being held back; all others are forgotten.
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
        for tree in sorted(deep):
            dofs = slice(model.tree_dofadr[tree], model.tree_dofadr[tree] + model.tree_dofnum[tree])
            bound = max(_SPEED, float(np.abs(before[dofs]).max()))
            speed = float(np.abs(data.qvel[dofs]).max())
            if speed > bound:
                data.qvel[dofs] *= bound / speed
        deep.update(waiting)
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
        """Returns the trees that wait: of watched ones whose roots are in one place, where these are too many."""
        if len(self.bodies) <= _CROWD:
            return []
        model, places = compiled.model, dict[tuple[int, ...], list[int]]()
        for body in sorted(self.bodies & compiled.free.keys()):
            index, q = compiled.body_index[body], compiled.free[body].q
            # Boxes of about one size are in one place where their centres are in one cell of a grid of that size.
            size = frexp(float(model.geom_rbound[model.body_geomadr[index]]))[1]
            cell = np.floor(data.qpos[q : q + 3] / 2.0**size).astype(int).tolist()
            places.setdefault((size, *cell), []).append(int(model.body_treeid[index]))
        return sorted(tree for trees in places.values() if len(trees) > _CROWD for tree in trees[_FIRST:])
