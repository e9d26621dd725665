"""The damping of bodies' own velocities, which MuJoCo does not have: its own damps joints.

Where linear and angular damping are alike, all velocities are scaled alike, and so are those of coordinates, whatever
joins the bodies. Else a free body that is alone in its tree has coordinates of its own for both; of all others
everything is scaled as the angular velocities are, and what the linear ones lack acts as a force at each centre.
"""

from __future__ import annotations

from math import exp

import mujoco
import numpy as np

from nmes.backend import Array, SceneSpec

__all__ = ["Damping"]


class Damping:
    """The damping of one scene.

    Attributes:
        acts: Whether there is any.
    """

    def __init__(self, scene: SceneSpec) -> None:
        self._timestep = scene.timestep
        self._linear = exp(-scene.linear_damping * scene.timestep)  # what an engine step leaves
        self._angular = exp(-scene.angular_damping * scene.timestep)
        self.acts = scene.linear_damping > 0.0 or scene.angular_damping > 0.0

    def install(self, model: mujoco.MjModel) -> None:
        """Takes up the model whose bodies are damped from now on."""
        self._kept, self._joined = np.full(model.nv, self._angular), np.empty(0, np.intp)
        if self._linear == self._angular:
            return
        movable = model.body_treeid >= 0
        sizes = np.bincount(model.body_treeid[movable], minlength=1)
        free = model.jnt_type == mujoco.mjtJoint.mjJNT_FREE
        free &= sizes[model.body_treeid[model.jnt_bodyid]] == 1
        self._kept[(model.jnt_dofadr[free][:, None] + np.arange(3)).ravel()] = self._linear
        movable[model.jnt_bodyid[free]] = False
        self._joined = np.flatnonzero(movable)

    def act(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Damps for the engine step that follows: scales velocities, and adds to the forces on bodies."""
        if len(self._joined):
            self._push(model, data)
        data.qvel *= self._kept

    def _push(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Adds the forces that make up for the linear velocities of joined bodies being scaled as the angular ones."""
        joined = self._joined
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        spin, velocity = data.cvel[joined, :3], data.cvel[joined, 3:]
        velocity = velocity + _cross(spin, data.xipos[joined] - data.subtree_com[model.body_rootid[joined]])
        # MuJoCo lets nothing sleep that a force acts on, however small.
        moving = (velocity * velocity).sum(axis=1) > model.opt.sleep_tolerance**2
        rate = np.where(moving, (self._linear - self._angular) / self._timestep, 0.0)
        data.xfrc_applied[joined, :3] += (rate * model.body_mass[joined])[:, None] * velocity


def _cross(a: Array, b: Array) -> Array:
    """Returns the cross products of rows; numpy's own takes as long as all the rest."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)
