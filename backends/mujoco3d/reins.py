"""Many motors aimed and many joints read at once, for controllers that do both at every tick.

Hides where in MuJoCo's arrays they are. A target that is set here is a control of the data at once, and becomes a
parameter of its joint only in `note`, since making new parameters costs more than all the rest; so `note` comes before
anything that looks at the parameters of joints. A `Reins` belongs to one compiled model and its data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt

from nmes.backend import Array
from nmes.backends.mujoco3d.layout import Joint, Layout

__all__ = ["Reins", "compact"]

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


class Reins:
    """Motors and joints of one model; `joints` are all joints by number."""

    def __init__(self, layout: Layout, data: mujoco.MjData, joints: Mapping[int, Joint]) -> None:
        self._layout, self._joints = layout, joints
        self._qpos, self._qvel, self._ctrl, self._efforts = data.qpos, data.qvel, data.ctrl, data.actuator_force
        self._asleep = data.tree_asleep
        self._motors: dict[Joints, _Motors | None] = {}  # None where there is no fast way
        self._coordinates: dict[Joints, _Coordinates | None] = {}
        self._powered: Sequence[int] | None = None  # the joints that powers were last looked up for
        self._ahead: dict[Joints, None] = {}  # those whose controls are newer than their parameters

    def forget(self) -> None:
        """Takes notice that the parameters of a joint have changed, more than by a target."""
        self._motors.clear()

    def aim(self, joints: Joints, targets: Array) -> list[int] | None:
        """Sets what motors aim at; returns the bodies of the model that this wakes, None where it has to be slow."""
        if joints not in self._motors:
            self._motors[joints] = self._find(joints)
        motors = self._motors[joints]
        if motors is None:
            return None
        self._ctrl[motors.controls] = targets
        self._ahead[joints] = None
        for tree in motors.trees:
            if self._asleep[tree] >= 0:
                return motors.bodies
        return []

    def _find(self, joints: Joints) -> _Motors | None:
        held, layout = [self._joints[joint] for joint in joints], self._layout
        # A motor without strength has no control: its target is nowhere but in its parameters.
        if not all(joint.number in layout.actuator and joint.params.max_effort > 0.0 for joint in held):
            return None
        bodies = dict.fromkeys(layout.body[number] for joint in held for number in (joint.body1, joint.body2))
        trees = dict.fromkeys(int(layout.model.body_treeid[index]) for index in bodies)
        controls = compact([layout.actuator[joint] for joint in joints])
        return _Motors(controls, list(bodies), [tree for tree in trees if tree >= 0])

    def note(self) -> None:
        """Makes the parameters of joints say what their motors aim at."""
        for joints in self._ahead:
            for number in joints:
                held, target = self._joints[number], float(self._ctrl[self._layout.actuator[number]])
                held.params = held.params.aimed(target)
        self._ahead.clear()

    def readings(self, joints: Joints) -> Array | None:
        """Returns a new array (n, 3) of positions, velocities and efforts, or None where that has to be slow."""
        if joints not in self._coordinates:
            self._coordinates[joints] = self._locate(joints)
        at = self._coordinates[joints]
        if at is None:
            return None
        out = np.zeros((len(joints), 3))
        out[:, 0] = self._qpos[at.q]
        out[:, 1] = self._qvel[at.v]
        out[at.rows, 2] = self._efforts[at.motors]
        return out

    def powers(self, joints: Sequence[int], out: Array, *, edited: bool) -> bool:
        """Writes what the motors of joints perform, W, and returns whether that could be done at once.

        The same list, whole and unchanged, is looked up only once: then it costs one multiplication.
        """
        if joints is not self._powered:
            actuator = self._layout.actuator
            if edited or any(joint not in actuator for joint in joints):
                return False
            self._motor_at = compact([actuator[joint] for joint in joints])
            self._speed_at = compact([self._layout.joint[joint].v for joint in joints])
            self._motor_efforts, self._speeds = self._efforts[self._motor_at], self._qvel[self._speed_at]
            self._powered = joints
        if not isinstance(self._motor_at, slice):  # a slice is a view and follows the engine, an array is a copy
            self._motor_efforts = self._efforts[self._motor_at]
        if not isinstance(self._speed_at, slice):
            self._speeds = self._qvel[self._speed_at]
        np.multiply(self._motor_efforts, self._speeds, out=out)
        return True

    def _locate(self, joints: Joints) -> _Coordinates | None:
        slot, actuator = self._layout.joint, self._layout.actuator
        slots = [slot[joint] for joint in joints if joint in slot]
        if len(slots) < len(joints):  # a joint between frozen bodies is in no model
            return None
        rows = [row for row, joint in enumerate(joints) if joint in actuator]
        found = (
            [slot.q for slot in slots],
            [slot.v for slot in slots],
            rows,
            [actuator[joints[row]] for row in rows],
        )
        return _Coordinates(*map(compact, found))
