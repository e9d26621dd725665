"""Many motors driven and many joints read at once, for controllers that do both at every tick; what motors worked.

Hides where in MuJoCo's arrays they are. A target that is set here is a control of the data at once, and becomes a
parameter of its joint only in `sync`, since making new parameters costs more than all the rest; so `sync` comes before
anything that looks at the parameters of joints. An `ActuatorBatch` belongs to one compiled model and its data.

The work of motors is that of every engine step, with the effort that the integrator applied: where a motor brakes in
proportion to its velocity, the implicit integrators take the velocity after the step, and MuJoCo tells the effort at
the velocity before it. A motor at the bound of its effort brakes no more than that.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt

from nmes.backend import Array
from nmes.backends.mujoco3d.forest import Joint
from nmes.backends.mujoco3d.model import CompiledModel

__all__ = ["ActuatorBatch", "WorkLog", "braking", "compact", "mean_powers"]

_IMPLICIT = (mujoco.mjtIntegrator.mjINT_IMPLICIT, mujoco.mjtIntegrator.mjINT_IMPLICITFAST)

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
    """Motors and joints of one model; `joints` are all joints by number.

    Attributes:
        step_efforts: What motors gave in each engine step of the last step, array (steps, motors), N m or N.
        step_speeds: `qvel` before the first and after each of them, array (steps + 1, dofs).
        version: Another number whenever these became other arrays, or parameters of a motor changed.
    """

    def __init__(self, compiled: CompiledModel, data: mujoco.MjData, joints: Mapping[int, Joint]) -> None:
        self.compiled, self._joints = compiled, joints
        self._qpos, self._qvel, self._ctrl, self._efforts = data.qpos, data.qvel, data.ctrl, data.actuator_force
        self._asleep = data.tree_asleep
        self._motors: dict[Joints, _Motors | None] = {}  # None where there is no fast way
        self._coordinates: dict[Joints, _Coordinates | None] = {}
        self.step_efforts, self.step_speeds = np.zeros((0, len(data.ctrl))), np.zeros((1, len(data.qvel)))
        self._slots: list[tuple[Array, Array]] = []
        self.version = 0
        self._unsynced: dict[Joints, None] = {}  # those whose controls are newer than their parameters

    def forget(self) -> None:
        """Looks motors up again, since more than the target of a joint has changed."""
        self._motors.clear()
        self.version += 1

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
        driven, compiled = [self._joints[joint] for joint in joints], self.compiled
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
                joint, target = self._joints[number], float(self._ctrl[self.compiled.actuator[number]])
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
        slots, actuator = self.compiled.joint, self.compiled.actuator
        if any(joint not in slots for joint in joints):  # a joint between frozen bodies is in no model
            return None
        rows = [row for row, joint in enumerate(joints) if joint in actuator]
        return _Coordinates(
            compact([slots[joint].q for joint in joints]),
            compact([slots[joint].v for joint in joints]),
            compact(rows),
            compact([actuator[joints[row]] for row in rows]),
        )

    # -- work -----------------------------------------------------------------------------------------------------

    def begin(self, steps: int) -> Iterator[tuple[Array, Array]]:
        """Begins a step: yields where efforts and `qvel` belong as each of its engine steps ends."""
        if len(self.step_efforts) != steps:
            self.step_efforts = np.zeros((steps, self.step_efforts.shape[1]))
            self.step_speeds = np.zeros((steps + 1, len(self._qvel)))
            self._slots = list(zip(self.step_efforts, self.step_speeds[1:], strict=True))
            self.version += 1
        self.step_speeds[0] = self._qvel
        return iter(self._slots)


class WorkLog:
    """The power of some joints' motors, tick by tick: kept as the engine has it, computed many ticks at a time.

    Args:
        joints: The joints, with motors or without.
        rows: The number of ticks that there is room for.
    """

    def __init__(self, joints: Sequence[int], rows: int) -> None:
        self._joints = joints
        self._powers = np.zeros((rows, 2, len(joints)))
        self._known = self._rows = 0  # rows of which the powers are computed, and rows in all
        self._batch: ActuatorBatch | None = None
        self._version = 0

    def note(self, batch: ActuatorBatch) -> None:
        """Keeps what the motors of the model that runs gave in its last step."""
        if batch is not self._batch or batch.version != self._version:
            self._settle()
            self._locate(batch)
        row = self._rows
        self._efforts[row], self._speeds[row] = batch.step_efforts[:, self._motors], batch.step_speeds[:, self._dofs]
        self._rows = row + 1

    def powers(self, begin: int, end: int) -> Array:
        """Returns the mean powers of the motors in rows, and their mean sizes, array (rows, 2, joints), W."""
        self._settle()
        return self._powers[begin:end]

    def _locate(self, batch: ActuatorBatch) -> None:
        """Looks up where the joints' motors are, and how they brake; makes room for rows of them."""
        compiled = batch.compiled
        model, actuator = compiled.model, compiled.actuator
        self._columns = [column for column, joint in enumerate(self._joints) if joint in actuator]
        self._motors = compact([actuator[self._joints[column]] for column in self._columns])
        self._dofs = compact([compiled.joint[self._joints[column]].v for column in self._columns])
        self._braking, self._bounds = braking(model, self._motors)
        rows, steps, motors = len(self._powers), len(batch.step_efforts), len(self._columns)
        self._efforts, self._speeds = np.empty((rows, steps, motors)), np.empty((rows, steps + 1, motors))
        self._batch, self._version = batch, batch.version

    def _settle(self) -> None:
        """Computes the powers of the rows that are new."""
        begin, end = self._known, self._rows
        self._known = end
        if begin < end and self._efforts.shape[1]:
            efforts, before, after = self._efforts[begin:end], self._speeds[begin:end, :-1], self._speeds[begin:end, 1:]
            self._powers[begin:end, :, self._columns] = mean_powers(efforts, before, after, self._braking, self._bounds)


def braking(model: mujoco.MjModel, motors: Indices) -> tuple[Array, Array]:
    """Returns how the efforts of motors grow with the velocity in the integrator, and the bounds of the efforts."""
    implicit = float(model.opt.integrator in _IMPLICIT)
    return model.actuator_biasprm[motors, 2] * implicit, model.actuator_forcerange[motors, 1].copy()


def mean_powers(efforts: Array, before: Array, after: Array, braking: Array, bounds: Array) -> Array:
    """Returns the mean powers of motors over the engine steps of each tick, and their mean sizes, W.

    Args:
        efforts: What MuJoCo tells of each engine step, shape (..., steps, motors), N m or N.
        before: Velocities before each, the same shape, rad/s or m/s.
        after: Velocities after each.
        braking: How the efforts grow with the velocity in the integrator, shape (..., motors).
        bounds: The bounds of the efforts, shape (..., motors).

    Returns:
        Array (..., 2, motors).
    """
    efforts = efforts + np.where(np.abs(efforts) >= bounds, 0.0, braking * (after - before))
    powers = efforts * (before + after) / 2.0
    sums = [np.add.accumulate(each, axis=-2)[..., -1, :] for each in (powers, np.abs(powers))]
    return np.asarray(np.stack(sums, axis=-2) / powers.shape[-2])
