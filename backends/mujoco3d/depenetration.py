"""Depenetration: bodies that an edit left inside others are let apart gently.

Contact springs alone would shoot off what was put deep inside something. Hides how deep is deep, and which trees of the
model are held back. Which bodies are watched is part of a simulation's state: its digest and its snapshots have it.
"""

from __future__ import annotations

import mujoco
import numpy as np

from nmes.backends.mujoco3d.model import CompiledModel

__all__ = ["Depenetration"]

_DEEP = 0.01  # part of a box's shortest edge
_SPEED = 3.0  # m/s and rad/s


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
        self.bodies = {body for body, index in compiled.body_index.items() if int(model.body_treeid[index]) in deep}
