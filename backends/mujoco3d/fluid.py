"""A medium about bodies, as far as MuJoCo has one itself, and else as forces on bodies.

MuJoCo's own drag and buoyancy (`gravcomp`) are everywhere; so they serve where the medium has no level. They are also
those of each body of the model: where a loop is closed by a proxy, which stands for a body that is there already, and
where there is a level, forces by the same formulas act in their place.
"""

from __future__ import annotations

import mujoco
import numpy as np

from nmes.backend import SceneSpec
from nmes.backend.medium import Immersion
from nmes.backend.shapes import volume
from nmes.backends.mujoco3d.forest import Body
from nmes.backends.mujoco3d.model import CompiledModel
from nmes.backends.mujoco3d.tracking import states_of

__all__ = ["Fluid", "lift"]


def lift(scene: SceneSpec, body: Body) -> float:
    """Returns which part of its weight the medium of a scene takes off a body, by MuJoCo's own buoyancy."""
    medium = scene.medium
    if medium is None or medium.level is not None:
        return 0.0
    return medium.density * volume(body.shape, body.size) / body.mass


class Fluid:
    """The medium of one scene.

    Attributes:
        acts: Whether it acts by forces of ours, before each engine step.
    """

    def __init__(self, scene: SceneSpec) -> None:
        self._scene, self._medium = scene, scene.medium
        self.acts = False

    def install(self, compiled: CompiledModel) -> None:
        """Takes up the model whose bodies are in it from now on, or the bodies that came and went in one."""
        medium, model = self._medium, compiled.model
        if medium is None:
            return
        self.acts = medium.level is not None or bool(compiled.loop_proxy)
        native = not self.acts
        model.opt.density, model.opt.viscosity = (medium.density, medium.viscosity) if native else (0.0, 0.0)
        if native:
            return
        model.body_gravcomp[:] = 0.0
        numbers = [number for number in compiled.body_index if not compiled.bodies[number].frozen]
        bodies = [compiled.bodies[number] for number in numbers]
        index = np.array([compiled.body_index[number] for number in numbers], np.intp)
        self._any, self._roots = len(index) > 0, model.body_rootid[index]
        # Most often they follow each other in the model: slices of its arrays are to be had for less.
        follow = self._any and np.array_equal(index, np.arange(index[0], index[0] + len(index)))
        self._index = slice(index[0], index[-1] + 1) if follow else index
        self._immersion = Immersion(
            medium,
            self._scene.gravity,
            self._scene.timestep,
            [body.shape for body in bodies],
            [body.size for body in bodies],
            model.body_mass[index],
        )

    def act(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Adds to the forces on bodies for the engine step that follows."""
        if not self._any:
            return
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        index = self._index
        states = states_of(data.xpos[index], data.xquat[index], data.cvel[index], data.subtree_com[self._roots])
        forces = self._immersion.wrenches(states)
        awake = data.body_awake[index] != 0  # a force would wake what sleeps, which is what nothing acted on
        data.xfrc_applied[index] += np.where(awake, forces, 0.0).T
