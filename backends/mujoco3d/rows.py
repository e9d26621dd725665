"""Scenes of one layout as rows of a `mujoco.batch.Batch`: each bit for bit as its own simulation.

Hides the batch: that its threads share one `MjData` each where nothing can sleep and nobody asks for contacts, and that
a row else has one of its own (186 KiB for eight cubes in place of 1.2); where the values of motors and sensors are in
its arrays; and what of a simulation a row cannot do. That is left to whoever runs the scene as a simulation again: a
fault, whatever its kind, and the contacts of what sleeps.

A step computes poses and velocities of the new state too, as a simulation does when they are read; contacts are those
of the last engine step, so where they are wanted they are taken out before. Where many ticks are known beforehand, the
batch takes them in one call and records each engine step: what it records of poses is that of the state before the
step, so that of the state after a tick comes with the first step of the next. Not so with rk4, which evaluates a step
in several states and leaves the poses of the last of these.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from math import prod
from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt

from nmes.backend import Array, BodyState, Contact, Places, Row, Rows, RowsTrack
from nmes.backend.rotation import total
from nmes.backends.mujoco3d.forest import Joint
from nmes.backends.mujoco3d.model import CompiledModel
from nmes.backends.mujoco3d.motors import Indices, Slopes, compact, mean_powers
from nmes.backends.mujoco3d.running import RunningModel
from nmes.backends.mujoco3d.sensing import Senses
from nmes.backends.mujoco3d.sleep import AWAKE
from nmes.backends.mujoco3d.tracking import states_of

if TYPE_CHECKING:
    from mujoco.batch import Batch, RecordItem

__all__ = ["MujocoRow", "MujocoRows"]

_SLEEP = int(mujoco.mjtEnableBit.mjENBL_SLEEP)
_NEVER = (int(mujoco.mjtSleepPolicy.mjSLEEP_NEVER), int(mujoco.mjtSleepPolicy.mjSLEEP_AUTO_NEVER))
_NONE, _MOTION = int(mujoco.mjtStage.mjSTAGE_NONE), int(mujoco.mjtStage.mjSTAGE_VEL)
# What must be equal for models to share the memory of one MjData, besides the places of bodies and joints.
_SIZES = "nq nv nu nbody njnt ngeom nsite ntendon neq ntree nM nB nC nD nJmom narena".split()
_ROOM = 1 << 19  # numbers that are recorded in one call: about as many as the processor's caches hold


class MujocoRow(Row):
    """See `nmes.backend.rows.Row`.

    Args:
        running: The model that runs, which nobody steps any more, all of it awake.
        strong: Whether each of its motors has any strength, by actuator: one that has none has no control.
    """

    def __init__(self, running: RunningModel, strong: npt.NDArray[np.bool_]) -> None:
        self.compiled, self.scenery, self.strong = running.compiled, running.scenery, strong
        self.model, self.state = running.model, running.state().copy()
        sleepless = np.isin(self.model.tree_sleep_policy, _NEVER).all()
        self.sleeps = bool(self.model.opt.enableflags & _SLEEP) and not sleepless
        if not self.sleeps:
            self.model.opt.enableflags &= ~_SLEEP  # which is what lets rows share their data
        self.layout: Hashable = _layout(self.compiled, self.sleeps)

    @classmethod
    def of(cls, running: RunningModel, joints: Mapping[int, Joint]) -> MujocoRow | None:
        """Returns the row that a scene without edits becomes; None where something in it is a simulation's alone."""
        if running.one_by_one or running.depenetration.bodies or (running.asleep != AWAKE).any():
            return None
        strong = np.ones(running.model.nu, bool)
        for joint, motor in running.compiled.actuator.items():
            strong[motor] = joints[joint].params.max_effort > 0.0
        return cls(running, strong)

    def rows(self, count: int, *, threads: int = 1, contacts: bool = False) -> MujocoRows:
        """Returns places for rows of this layout."""
        return MujocoRows(self, count, threads, contacts)


def _layout(compiled: CompiledModel, sleeps: bool) -> Hashable:
    model = compiled.model
    sizes = [int(getattr(model, name)) for name in _SIZES]
    slots = [(number, slot.q, slot.v) for number, slot in compiled.joint.items()]
    maps = (tuple(compiled.body_index.items()), tuple(slots), tuple(compiled.actuator.items()))
    arrays = (model.body_parentid, model.body_rootid, model.jnt_type, model.geom_type, model.geom_bodyid)
    return (sleeps, model.opt.timestep, *sizes, *maps, *(array.tobytes() for array in arrays))


class _Located(NamedTuple):
    """Where joints are in qpos and qvel, which of them (rows) have motors, and these motors: also as an array."""

    q: Indices
    v: Indices
    rows: Indices
    motors: Indices
    driven: Places


class MujocoRows(Rows):
    """See `nmes.backend.rows.Rows`."""

    def __init__(self, first: MujocoRow, count: int, threads: int, contacts: bool) -> None:
        from mujoco.batch import Batch, SimulationError  # as much as loading all of MuJoCo; few processes need it

        self.count, self._failure = count, SimulationError
        staged = first.model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
        self._one_by_one = first.sleeps or contacts or staged  # whether ticks cannot be taken many in one call
        self.compiled: CompiledModel = first.compiled
        self._batch = batch = Batch(first.model, count, threads, contacts or first.sleeps)
        self._rows: list[MujocoRow] = [first] * count
        self._joints: dict[tuple[int, ...], _Located] = {}
        self.puts = 0  # how often rows were put: what follows from their models is then to be looked up again
        self._senses = _ContactSenses(first, count) if contacts else None
        self.qpos, self.qvel, self._ctrl = batch.bind("qpos"), batch.bind("qvel"), batch.bind("ctrl")
        self.efforts = batch.bind("actuator_force")
        self.xpos, self.xquat = batch.bind("xpos"), batch.bind("xquat")
        self.cvel, self.centre = batch.bind("cvel"), batch.bind("subtree_com")
        self._warnings = batch.warning[:, :, 1]
        self._strong = np.ones(self._ctrl.shape, bool)
        nu, nv = first.model.nu, first.model.nv
        self.step_efforts, self.step_speeds = np.zeros((count, 0, nu)), np.zeros((count, 1, nv))

    def put(self, places: Sequence[int], rows: Sequence[Row]) -> None:
        """Begins scenes in places."""
        for place, row in zip(places, rows, strict=True):
            assert isinstance(row, MujocoRow)
            self._rows[place] = row
            self._batch.state[place], self._strong[place] = row.state, row.strong
            self._batch.warning[place] = 0
        self._batch.set_models([row.model for row in self._rows])
        self.puts += 1

    def slopes(self, motors: Indices) -> Slopes:
        """Returns the slopes of motors in each place."""
        return Slopes.stack([Slopes.of(row.model, motors) for row in self._rows])

    # -- motors and time ----------------------------------------------------------------------------------------------

    def set_motor_targets(self, places: Places, joints: Sequence[int], targets: Array) -> None:
        """Sets the controls of motors."""
        motors = self._located(tuple(joints))
        if len(places) == self.count:  # the common case, in which nothing need be gathered
            self._ctrl[:, motors.motors] = np.where(self._strong[:, motors.motors], targets, 0.0)
            return
        at = places[:, None], motors.driven
        self._ctrl[at] = np.where(self._strong[at], targets, 0.0)

    def step(self, places: Places, substeps: int) -> list[int]:
        """Advances rows by engine steps."""
        batch, failed = self._batch, set()
        if self.step_efforts.shape[1] != substeps:
            nu, nv = self._ctrl.shape[1], self.qvel.shape[1]
            self.step_efforts = np.zeros((self.count, substeps, nu))
            self.step_speeds = np.zeros((self.count, substeps + 1, nv))
        ids = None if len(places) == self.count else np.asarray(places, np.int32)
        self.step_speeds[:, 0] = self.qvel
        for i in range(substeps):
            last = i + 1 == substeps and self._senses is None
            try:
                batch.step(ids, 1, _MOTION if last else _NONE)
            except self._failure as error:
                failed.update(error.ids.tolist())
            self.step_efforts[:, i], self.step_speeds[:, i + 1] = self.efforts, self.qvel
        if self._senses is not None:
            failed.update(self._senses.look(batch, places))
            batch.forward(ids, _MOTION)
        return self._lost(places, failed)

    def run(self, places: Places, joints: Sequence[int], targets: Array, substeps: int, track: RowsTrack) -> list[int]:
        """Drives and advances rows for some ticks."""
        if len(targets) == 1 or self._one_by_one:
            return super().run(places, joints, targets, substeps, track)
        assert isinstance(track, MujocoRowsTrack)
        motors = self._located(tuple(joints)).driven
        controls = np.repeat(self._ctrl[places][:, None], len(targets), axis=1)
        strong = self._strong[places[:, None], motors]
        controls[:, :, motors] = np.where(strong[:, None], targets.transpose(1, 0, 2), 0.0)
        failed: set[int] = set()
        most = max(1, _ROOM // (len(places) * substeps * track.width))
        for begin in range(0, len(targets), most):
            some = controls[:, begin : begin + most]
            failed.update(self._record(places, np.repeat(some, substeps, axis=1), substeps, track))
        return self._lost(places, failed)

    def _record(self, places: Places, controls: Array, substeps: int, track: MujocoRowsTrack) -> list[int]:
        """Goes on with controls for each engine step, array (places, steps, motors); returns the places that fail."""
        ids, failed = np.asarray(places, np.int32), []
        before, records = self.qvel[places], track.records(len(places), controls.shape[1])
        try:
            self._batch.rollout(controls.shape[1], controls, record=tuple(records), ids=ids, out=records)
        except self._failure as error:
            failed += error.ids.tolist()
        try:
            self._batch.forward(ids, _MOTION)
        except self._failure as error:
            failed += error.ids.tolist()
        track.take(places, records, before, substeps)
        return failed

    def _lost(self, places: Places, failed: set[int]) -> list[int]:
        """Returns the places, of some, that failed or were warned of."""
        if self._warnings.any():
            failed.update(np.flatnonzero(self._warnings.any(axis=1)).tolist())
        if not failed:
            return []
        self._warnings[sorted(failed)] = 0
        return sorted(failed.intersection(places.tolist()))

    # -- readings -----------------------------------------------------------------------------------------------------

    def body_state(self, body: int) -> BodyState:
        """Returns the pose and velocity of a body, each number an array (places,)."""
        index = slice(at := self.compiled.body_index[body], at + 1)
        root = int(self.compiled.model.body_rootid[at])
        centre = self.centre[:, root : root + 1]
        states = states_of(self.xpos[:, index], self.xquat[:, index], self.cvel[:, index], centre)
        columns = states[:, 0].T
        return BodyState(tuple(columns[0:3]), tuple(columns[3:7]), tuple(columns[7:10]), tuple(columns[10:13]))

    def joint_readings(self, joints: Sequence[int]) -> Array:
        """Returns a new array (places, n, 3)."""
        at = self._located(tuple(joints))
        out = np.zeros((self.count, len(joints), 3))
        out[:, :, 0], out[:, :, 1] = self.qpos[:, at.q], self.qvel[:, at.v]
        out[:, at.rows, 2] = self.efforts[:, at.motors]
        return out

    def _located(self, joints: tuple[int, ...]) -> _Located:
        """Returns where joints are in the batch's arrays: looked up once."""
        at = self._joints.get(joints)
        if at is None:
            slots, actuator = self.compiled.joint, self.compiled.actuator
            rows = [row for row, joint in enumerate(joints) if joint in actuator]
            driven = np.array([actuator[joints[row]] for row in rows], np.intp)
            q, v = (compact([getattr(slots[joint], name) for joint in joints]) for name in "qv")
            at = self._joints[joints] = _Located(q, v, compact(rows), compact(driven.tolist()), driven)
        return at

    def touching(self, bodies: Sequence[int]) -> Array:
        """Returns a new array (places, n)."""
        assert self._senses is not None
        return self._senses.touching([self.compiled.body_index[body] for body in bodies])

    def contacts(self, place: int, body: int) -> list[Contact]:
        """Returns the contacts of a body in one place."""
        assert self._senses is not None
        return self._senses.contacts(place, self.compiled.body_index[body])

    def track(
        self, bodies: Sequence[int], joints: Sequence[int], motors: Sequence[int], rows: int, substeps: int
    ) -> MujocoRowsTrack:
        """Returns a track of all places."""
        return MujocoRowsTrack(self, bodies, joints, motors, rows, substeps)


class _ContactSenses:
    """The contacts of rows in their last engine step, seen in a copy of the data of each."""

    def __init__(self, first: MujocoRow, count: int) -> None:
        self._data = [mujoco.MjData(first.model) for _ in range(count)]
        self._senses = [Senses(first.compiled, data, first.scenery) for data in self._data]
        self._seen: list[int] = []

    def look(self, batch: Batch, places: Places) -> list[int]:
        """Takes the contacts of some places; returns those where something sleeps, which only a simulation can feel."""
        self._seen = places.tolist()
        for place in self._seen:
            batch.get_data(place, self._data[place])
            self._senses[place].forget()
        return [place for place in self._seen if self._senses[place].resting]

    def touching(self, indices: list[int]) -> Array:
        """Returns a new array (places, n): 1 for each of these bodies that has contacts, else 0."""
        out = np.zeros((len(self._senses), len(indices)))
        for place in self._seen:
            out[place] = self._senses[place].touching(indices)
        return out

    def contacts(self, place: int, index: int) -> list[Contact]:
        """Returns the contacts of a body of the model."""
        return self._senses[place].contacts(index)


class MujocoRowsTrack(RowsTrack):
    """See `nmes.backend.rows.RowsTrack`: MuJoCo's arrays are copied as they are, and computed with when asked."""

    def __init__(
        self,
        rows: MujocoRows,
        bodies: Sequence[int],
        joints: Sequence[int],
        motors: Sequence[int],
        room: int,
        substeps: int,
    ) -> None:
        compiled, count, n = rows.compiled, rows.count, len(bodies)
        self.rows, self._source, self._recorded = 0, rows, (0, 0)
        at = [compiled.body_index[body] for body in bodies]
        roots = compiled.model.body_rootid[at].tolist()
        roots = roots[:1] if len(set(roots)) == 1 else roots  # bodies of one tree share its centre of mass
        self._columns = [column for column, joint in enumerate(motors) if joint in compiled.actuator]
        driven = [motors[column] for column in self._columns]
        self._motors = compact([compiled.actuator[joint] for joint in driven])
        self._puts, self._slopes = rows.puts, rows.slopes(self._motors)
        self._powers = np.zeros((count, room, 2, len(motors)))
        # What is copied, the places of it that are wanted, and where it goes to.
        self._pose, self._turn = np.empty((count, room, n, 3)), np.empty((count, room, n, 4))
        self._motion, self._centre = np.empty((count, room, n, 6)), np.empty((count, room, len(roots), 3))
        self._position = np.empty((count, room, len(joints)))
        self._kept = {
            "xpos": (rows.xpos, compact(at), self._pose),
            "xquat": (rows.xquat, compact(at), self._turn),
            "cvel": (rows.cvel, compact(at), self._motion),
            "subtree_com": (rows.centre, compact(roots), self._centre),
            "qpos": (rows.qpos, compact([compiled.joint[joint].q for joint in joints]), self._position),
        }
        self._shapes = {name: array.shape[1:] for name, (array, _, _) in self._kept.items()}
        self._shapes |= {"actuator_force": rows.efforts.shape[1:], "qvel": rows.qvel.shape[1:]}
        self.width = int(total(prod(shape) for shape in self._shapes.values()))
        self._efforts = np.empty((count, room, substeps, len(driven)))
        self._speeds = np.empty((count, room, substeps + 1, len(driven)))
        self._dofs = compact([compiled.joint[joint].v for joint in driven])

    def note(self) -> None:
        """Keeps the present states and readings of all places as the next row."""
        row, source = self.rows, self._source
        for array, wanted, kept in self._kept.values():
            kept[:, row] = array[:, wanted]
        self._efforts[:, row] = source.step_efforts[:, :, self._motors]
        self._speeds[:, row] = source.step_speeds[:, :, self._dofs]
        self.rows = row + 1

    def records(self, places: int, steps: int) -> dict[RecordItem, Array]:
        """Returns arrays (places, steps, ...) for what `take` takes of each engine step, by the name of the field."""
        if self._recorded != (places, steps):
            self._recorded = places, steps
            self._records = {name: np.empty((places, steps, *shape)) for name, shape in self._shapes.items()}
        return self._records

    def take(self, places: Places, records: Mapping[RecordItem, Array], before: Array, substeps: int) -> None:
        """Keeps many ticks in some places as the next rows, after a call that recorded them.

        Args:
            places: Which.
            records: What was recorded of each engine step; the batch's arrays are those of the last state.
            before: The velocities before the first step, array (places, nv).
            substeps: How many engine steps a tick has.
        """
        ticks = records["qvel"].shape[1] // substeps
        row, last = self.rows, self.rows + ticks - 1
        for name, (array, wanted, kept) in self._kept.items():
            kept[places, row:last] = _later(records[name], name, substeps)[:, :, wanted]
            kept[places, last] = array[places][:, wanted]
        shape = len(places), ticks, substeps, -1
        self._efforts[places, row : last + 1] = records["actuator_force"].reshape(shape)[..., self._motors]
        after = records["qvel"].reshape(shape)[..., self._dofs]
        self._speeds[places, row : last + 1, 1:] = after
        self._speeds[places, row + 1 : last + 1, 0] = after[:, :-1, -1]
        self._speeds[places, row, 0] = before[:, self._dofs]
        self.rows = last + 1

    def clear(self) -> None:
        """Forgets all rows."""
        self.rows = 0

    def states(self) -> Array:
        """Returns the states of the bodies, array (places, rows, n, 13)."""
        rows = self.rows
        return states_of(self._pose[:, :rows], self._turn[:, :rows], self._motion[:, :rows], self._centre[:, :rows])

    def positions(self) -> Array:
        """Returns the positions of the joints, array (places, rows, m)."""
        return self._position[:, : self.rows]

    def powers(self) -> Array:
        """Returns the powers of the motors, array (places, rows, 2, m)."""
        rows, out = self.rows, self._powers[:, : self.rows]
        if self._columns:
            if self._puts != self._source.puts:
                self._puts, self._slopes = self._source.puts, self._source.slopes(self._motors)
            efforts, speeds = self._efforts[:, :rows], self._speeds[:, :rows]
            out[..., self._columns] = mean_powers(efforts, speeds[:, :, :-1], speeds[:, :, 1:], self._slopes)
        return out


def _later(record: Array, name: str, substeps: int) -> Array:
    """Returns the recorded states after all ticks but the last, array (places, ticks - 1, ...)."""
    ahead = int(name == "qpos")  # a state, which is recorded after the step; all else follows from the one before it
    return record[:, substeps - ahead : record.shape[1] - ahead : substeps]
