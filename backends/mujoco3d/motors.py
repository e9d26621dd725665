"""Many motors driven and many joints read at once, for controllers that do both at every tick; what motors worked.

Hides where in MuJoCo's arrays they are. A target that is set here is a control of the data at once, and becomes a
parameter of its joint only in `sync`, since making new parameters costs more than all the rest; so `sync` comes before
anything that looks at the parameters of joints. An `ActuatorBatch` belongs to one compiled model and its data.

The work of motors is that of every engine step, with the effort that the integrator applied. MuJoCo tells that at the
velocity before the step, where the implicit integrators take the velocity after it for a motor that brakes in
proportion to its velocity; and with rk4 it tells the one at the end of the step, where that in the middle of it counts.
A motor at the bound of its effort brakes no more than that.
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

__all__ = ["ActuatorBatch", "Slopes", "StepLog", "WorkLog", "compact", "mean_powers"]

_ROOM, _ROWS = 1 << 15, 256  # numbers, and steps, that are kept before their powers are computed

# How much of a motor's answer to the change of velocity within a step is in its effort beside what MuJoCo tells.
_LATER = {
    mujoco.mjtIntegrator.mjINT_IMPLICIT: 1.0,
    mujoco.mjtIntegrator.mjINT_IMPLICITFAST: 1.0,
    mujoco.mjtIntegrator.mjINT_EULER: 0.0,
    mujoco.mjtIntegrator.mjINT_RK4: -0.5,
}

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
        sources: The efforts of motors, N m or N, and what of `qvel` may be of their joints.
        last: Where the last step is kept: a log and a row of it; None before the first step of this model.
    """

    def __init__(self, compiled: CompiledModel, data: mujoco.MjData, joints: Mapping[int, Joint]) -> None:
        self.compiled, self._joints = compiled, joints
        self._qpos, self._qvel, self._ctrl, self._efforts = data.qpos, data.qvel, data.ctrl, data.actuator_force
        self._asleep = memoryview(data.tree_asleep)
        self._motors: dict[Joints, _Motors | None] = {}  # None where there is no fast way
        self._coordinates: dict[Joints, _Coordinates | None] = {}
        self._span = _span(compiled)
        self.sources = memoryview(self._efforts), memoryview(self._qvel[self._span])
        self._log: StepLog | None = None
        self.last: tuple[StepLog, int] | None = None
        self._unsynced: dict[Joints, None] = {}  # those whose controls are newer than their parameters
        self._idle_targets: bytes | None = None  # None: to be looked up

    def forget(self) -> None:
        """Looks motors up again, since more than the target of a joint has changed."""
        self._motors.clear()
        self._log = self._idle_targets = None

    def is_idle(self, joint: Joint) -> bool:
        """Whether a hinge or slide has no control: its targets are nowhere but in its parameters."""
        return joint.number not in self.compiled.actuator or joint.params.max_effort <= 0.0

    def forget_idle_targets(self) -> None:
        """Looks `idle_targets` up again."""
        self._idle_targets = None

    @property
    def idle_targets(self) -> bytes:
        """The targets that are not 0 of joints that are idle, for a digest."""
        if self._idle_targets is None:
            idle = [j for j in self._joints.values() if j.kind in ("hinge", "slide") and self.is_idle(j)]
            targets = [(j.number, j.params.target_velocity, j.params.target_position) for j in idle]
            aimed = [each for each in targets if each[1] or each[2]]
            self._idle_targets = repr(aimed).encode() if aimed else b""
        return self._idle_targets

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
        # A motor without strength has no control.
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

    def begin(self, steps: int) -> Iterator[tuple[memoryview, memoryview]]:
        """Begins a step: yields where the `sources` belong as each of its engine steps ends."""
        log = self._log
        if log is None or log.steps != steps or log.full:
            log = self._log = StepLog(self.compiled, steps, self._span)
        log.before[:] = self.sources[1]
        return iter(log.slots)

    def end(self) -> None:
        """Keeps the step that began last."""
        assert self._log is not None
        self.last = self._log, self._log.keep()


def _span(compiled: CompiledModel) -> slice:
    """Returns the part of `qvel` from the first to the last joint with a motor."""
    dofs = [compiled.joint[joint].v for joint in compiled.actuator]
    return slice(min(dofs, default=0), max(dofs, default=-1) + 1)


class StepLog:
    """What the motors of a model gave in some steps: kept as the engine has it, computed many steps at a time.

    Parameters of motors stay the same meanwhile.

    Attributes:
        compiled: The model.
        steps: Engine steps in a step.
        before: Where the speeds before a step belong.
        slots: Where efforts and speeds belong as each engine step ends.
        full: Whether there is no room for another step.
    """

    def __init__(self, compiled: CompiledModel, steps: int, span: slice) -> None:
        """Makes room; `span` is what of `qvel` is kept."""
        model, motors, dofs = compiled.model, compiled.model.nu, span.stop - span.start
        self.compiled, self.steps, self.full = compiled, steps, False
        efforts, speeds = np.empty((steps, motors)), np.empty((steps + 1, dofs))
        self.before, *after = [memoryview(row) for row in speeds]
        self.slots = list(zip([memoryview(row) for row in efforts], after, strict=True))
        room = min(max(_ROOM // (efforts.size + speeds.size), 1), _ROWS)
        self._last = efforts, speeds
        self._efforts, self._speeds = np.empty((room, *efforts.shape)), np.empty((room, *speeds.shape))
        self._powers = np.empty((room, 2, motors))
        self._known = self._rows = 0  # rows of which the powers are computed, and rows in all
        owner = {motor: compiled.joint[joint].v - span.start for joint, motor in compiled.actuator.items()}
        self._dofs = compact([owner.get(motor, 0) for motor in range(motors)])  # nobody asks for an arena's own
        self._slopes = Slopes.of(model, slice(None))

    def keep(self) -> int:
        """Keeps what is in the slots; returns its row."""
        row = self._rows
        self._efforts[row], self._speeds[row] = self._last
        self._rows = row + 1
        if self._rows == len(self._efforts):
            self.powers()
            self.full, self._efforts, self._speeds = True, self._efforts[:0], self._speeds[:0]
        return row

    def powers(self) -> Array:
        """Returns the mean powers of the motors in rows, and their mean sizes, array (rows, 2, motors), W."""
        begin, end = self._known, self._rows
        if begin < end:
            speeds = self._speeds[begin:end, :, self._dofs]
            efforts, before, after = self._efforts[begin:end], speeds[:, :-1], speeds[:, 1:]
            self._powers[begin:end] = mean_powers(efforts, before, after, self._slopes)
            self._known = end
        return self._powers[:end]


class Slopes(NamedTuple):
    """How the efforts that act in an engine step differ from those that MuJoCo tells, as `mean_powers` has it.

    Attributes:
        change: Per change of velocity in the step, shape (..., motors), N m s/rad or N s/m.
        way: Per sum of the velocities before and after it; None where that changes nothing.
        bounds: The bounds of the efforts, N m or N.
    """

    change: Array
    way: Array | None
    bounds: Array

    @classmethod
    def of(cls, model: mujoco.MjModel, motors: Indices) -> Slopes:
        """Returns the slopes of some motors of a model."""
        later, bias = _LATER[mujoco.mjtIntegrator(model.opt.integrator)], model.actuator_biasprm[motors]
        way = bias[:, 1] * (-0.25 * model.opt.timestep) if later < 0.0 else None
        return cls(bias[:, 2] * later, way, model.actuator_forcerange[motors, 1].copy())

    @classmethod
    def stack(cls, each: Sequence[Slopes]) -> Slopes:
        """Returns the slopes of many models with one integrator: arrays (models, 1, 1, motors)."""
        change, bounds = np.array([one.change for one in each]), np.array([one.bounds for one in each])
        ways = [one.way for one in each if one.way is not None]
        way = np.array(ways)[:, None, None] if ways else None
        return cls(change[:, None, None], way, bounds[:, None, None])


def mean_powers(efforts: Array, before: Array, after: Array, slopes: Slopes) -> Array:
    """Returns the mean powers of motors over the engine steps of each tick, and their mean sizes, W.

    Args:
        efforts: What MuJoCo tells of each engine step, shape (..., steps, motors), N m or N.
        before: Velocities before each, the same shape, rad/s or m/s.
        after: Velocities after each.
        slopes: What acted besides, below the bounds.

    Returns:
        Array (..., 2, motors).
    """
    besides = slopes.change * (after - before)
    if slopes.way is not None:
        besides = besides + slopes.way * (before + after)
    efforts = efforts + np.where(np.abs(efforts) >= slopes.bounds, 0.0, besides)
    if slopes.way is not None:
        efforts = np.clip(efforts, -slopes.bounds, slopes.bounds)
    powers = efforts * (before + after) / 2.0
    out = np.empty((*powers.shape[:-2], 2, powers.shape[-1]))
    for size, each in enumerate((powers, np.abs(powers))):
        total = each[..., 0, :].copy()
        for step in range(1, each.shape[-2]):  # one after the other
            total += each[..., step, :]
        np.divide(total, each.shape[-2], out=out[..., size, :])
    return out


class WorkLog:
    """The power of some joints' motors, tick by tick.

    Args:
        joints: The joints, with motors or without.
        rows: The number of ticks that there is room for.
    """

    def __init__(self, joints: Sequence[int], rows: int) -> None:
        self._joints = joints
        self._powers = np.empty((rows, 2, len(joints)))
        self._known = 0  # rows of which the powers are here
        self._log: StepLog | None = None
        self._noted: list[int] = []  # the rows of the log that come next
        self._compiled: CompiledModel | None = None

    def note(self, batch: ActuatorBatch) -> None:
        """Takes what the motors of the model that runs gave in its last step."""
        log, row = batch.last or (None, 0)
        if log is not self._log:
            self._settle()
            self._log = log
        self._noted.append(row)

    def powers(self, begin: int, end: int) -> Array:
        """Returns the mean powers of the motors in rows, and their mean sizes, array (rows, 2, joints), W."""
        self._settle()
        return self._powers[begin:end]

    def _settle(self) -> None:
        """Takes the powers of the rows that are new."""
        rows = self._powers[self._known : self._known + len(self._noted)]
        rows[:] = 0.0
        if self._log is not None and self._noted:
            compiled = self._log.compiled
            if compiled is not self._compiled:
                self._compiled, motors = compiled, compiled.actuator
                self._columns = compact([column for column, joint in enumerate(self._joints) if joint in motors])
                self._motors = compact([motors[joint] for joint in self._joints if joint in motors])
            rows[:, :, self._columns] = self._log.powers()[compact(self._noted)][:, :, self._motors]
        self._known += len(rows)
        self._noted.clear()
