"""Many motors driven and many joints read at once, for controllers that do both at every tick.

Hides where in MuJoCo's arrays they are. A target that is set here is a control of the data at once, and becomes a
parameter of its joint only in `sync`, since making new parameters costs more than all the rest; so `sync` comes before
anything that looks at the parameters of joints. An `ActuatorBatch` belongs to one compiled model and its data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt

from nmes.backend import Array
from nmes.backends.mujoco3d.forest import Joint
from nmes.backends.mujoco3d.model import CompiledModel

__all__ = ["ActuatorBatch", "compact"]

Joints = tuple[int, ...]
Indices = slice | npt.NDArray[np.intp]


def compact(indices: Sequence[int]) -> Indices:
    """Returns a slice where indices follow one another, which copies several times faster, else an array of them."""
    first = indices[0] if indices else 0
    last = first + len(indices)
    return slice(first, last) if list(indices) == list(range(first, last)) else np.array(indices, np.intp)


class _Motors(NamedTuple):
    """Where the controls of motors are, and the bodies and trees (both of the model) that they move."""

    controls: Indices
    bodies: list[int]
    trees: list[int]


class _Coordinates(NamedTuple):
    """Where joints are in qpos and qvel, which of them (rows) have motors, and these motors."""

    q: Indices
    v: Indices
    rows: Indices
    motors: Indices


class ActuatorBatch:
    """Motors and joints of one model; `joints` are all joints by number."""

    def __init__(self, compiled: CompiledModel, data: mujoco.MjData, joints: Mapping[int, Joint]) -> None:
        self._compiled, self._joints = compiled, joints
        self._qpos, self._qvel, self._ctrl, self._efforts = data.qpos, data.qvel, data.ctrl, data.actuator_force
        self._asleep = data.tree_asleep
        self._motors: dict[Joints, _Motors | None] = {}  # None where there is no fast way
        self._coordinates: dict[Joints, _Coordinates | None] = {}
        self._powered: Sequence[int] | None = None  # the joints that powers were last looked up for
        self._unsynced: dict[Joints, None] = {}  # those whose controls are newer than their parameters

    def forget(self) -> None:
        """Looks motors up again, since more than the target of a joint has changed."""
        self._motors.clear()

    def set_targets(self, joints: Joints, targets: Array) -> list[int] | None:
        """Sets the targets of motors; returns the bodies of the model that this wakes, None where it has to be slow."""
        if joints not in self._motors:
            self._motors[joints] = self._locate_motors(joints)
        motors = self._motors[joints]
        if motors is None:
            return None
        self._ctrl[motors.controls] = targets
        self._unsynced[joints] = None
        for tree in motors.trees:
            if self._asleep[tree] >= 0:
                return motors.bodies
        return []

    def _locate_motors(self, joints: Joints) -> _Motors | None:
        driven, compiled = [self._joints[joint] for joint in joints], self._compiled
        # A motor without strength has no control: its target is nowhere but in its parameters.
        if not all(joint.number in compiled.actuator and joint.params.max_effort > 0.0 for joint in driven):
            return None
        bodies = dict.fromkeys(compiled.body_index[number] for joint in driven for number in (joint.body1, joint.body2))
        trees = dict.fromkeys(int(compiled.model.body_treeid[index]) for index in bodies)
        controls = compact([compiled.actuator[joint] for joint in joints])
        return _Motors(controls, list(bodies), [tree for tree in trees if tree >= 0])

    def sync(self) -> None:
        """Makes the parameters of joints have the targets that were set."""
        for joints in self._unsynced:
            for number in joints:
                joint, target = self._joints[number], float(self._ctrl[self._compiled.actuator[number]])
                joint.params = joint.params.with_target(target)
        self._unsynced.clear()

    def readings(self, joints: Joints) -> Array | None:
        """Returns a new array (n, 3) of positions, velocities and efforts, or None where that has to be slow."""
        if joints not in self._coordinates:
            self._coordinates[joints] = self._locate_joints(joints)
        at = self._coordinates[joints]
        if at is None:
            return None
        out = np.zeros((len(joints), 3))
        out[:, 0] = self._qpos[at.q]
        out[:, 1] = self._qvel[at.v]
        out[at.rows, 2] = self._efforts[at.motors]
        return out

    def _locate_joints(self, joints: Joints) -> _Coordinates | None:
        slots, actuator = self._compiled.joint, self._compiled.actuator
        if any(joint not in slots for joint in joints):  # a joint between frozen bodies is in no model
            return None
        rows = [row for row, joint in enumerate(joints) if joint in actuator]
        return _Coordinates(
            compact([slots[joint].q for joint in joints]),
            compact([slots[joint].v for joint in joints]),
            compact(rows),
            compact([actuator[joints[row]] for row in rows]),
        )

    def powers(self, joints: Sequence[int], out: Array, *, edited: bool) -> bool:
        """Writes the power of the motors of joints, W; returns False where that has to be slow.

        The same list, whole and unchanged, is looked up only once: then it costs one multiplication.
        """
        if joints is not self._powered:
            actuator = self._compiled.actuator
            if edited or any(joint not in actuator for joint in joints):
                return False
            self._motor_at = compact([actuator[joint] for joint in joints])
            self._speed_at = compact([self._compiled.joint[joint].v for joint in joints])
            self._motor_efforts, self._speeds = self._efforts[self._motor_at], self._qvel[self._speed_at]
            self._powered = joints
        if not isinstance(self._motor_at, slice):  # a slice is a view and follows the engine, an array is a copy
            self._motor_efforts = self._efforts[self._motor_at]
        if not isinstance(self._speed_at, slice):
            self._speeds = self._qvel[self._speed_at]
        np.multiply(self._motor_efforts, self._speeds, out=out)
        return True
