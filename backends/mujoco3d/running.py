"""A compiled model that runs: its data, how it steps, sleeps and faults.

MuJoCo's sleep is no part of what `mj_getState` returns, and a sleeping tree's derived quantities are not computed
afresh; so whenever a state is installed they are all computed once, with everything awake, before the sleepers are put
back.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import islice

import mujoco
import numpy as np
import numpy.typing as npt

from nmes.backend import Array, BodyState, SceneSpec, Vector
from nmes.backends.mujoco3d.damping import Damping
from nmes.backends.mujoco3d.depenetration import Depenetration
from nmes.backends.mujoco3d.fluid import Fluid
from nmes.backends.mujoco3d.forest import Joint
from nmes.backends.mujoco3d.model import CompiledModel, write_params
from nmes.backends.mujoco3d.motors import ActuatorBatch
from nmes.backends.mujoco3d.scenery import Scenery
from nmes.backends.mujoco3d.sensing import STATE, Senses
from nmes.backends.mujoco3d.sleep import AWAKE, count_awake, wake_islands
from nmes.errors import SimulationFault

__all__ = ["HUGE", "RunningModel", "Wrenches"]

HUGE = 1e10
"""MuJoCo's mjMAXVAL: beyond this it calls a state bad."""

_OUT_OF_HAND = 1e3, 10.0
"""A body is out of hand that is so fast, m/s, and so many times as fast as before the step."""

logger = logging.getLogger(__name__)

# A heap: so many trees hold each other. Newton's method with round friction cones takes three times as long for it as
# with pyramids, and one of dozens of cubes always trembles by a few mm/s, so that by the usual tolerance none slept.
_HEAP = 16
_HEAP_SETTINGS = mujoco.mjtCone.mjCONE_PYRAMIDAL, 0.02  # the cone, and at which speed (m/s) it falls asleep
_USUAL_SETTINGS = mujoco.mjtCone.mjCONE_ELLIPTIC, mujoco.MjOption().sleep_tolerance

_ZERO: Vector = (0.0, 0.0, 0.0)
_WARNINGS = mujoco.mjtWarning
_FAULTS = {
    _WARNINGS.mjWARN_CONTACTFULL: ("contact_overflow", "the engine ran out of room for contacts"),
    _WARNINGS.mjWARN_CNSTRFULL: ("constraint_overflow", "the engine ran out of room for constraints"),
}

# What MuJoCo prints of a diverging world goes to the log; the fault says it to the user.
mujoco.set_mju_user_warning(lambda message: logger.debug("mujoco: %s", message))


class Wrenches:
    """The forces and torques, and the impulses, that act on bodies during the next step.

    Attributes:
        forces: Force and torque, six numbers in N and N m, by body.
        impulses: Impulse and angular impulse, six numbers in N s and N m s, by body.
    """

    def __init__(self) -> None:
        self.forces: dict[int, list[float]] = {}
        self.impulses: dict[int, list[float]] = {}

    def add(self, body: int, force: Vector, torque: Vector, impulse: Vector, angular_impulse: Vector) -> None:
        """Adds to what acts on a body."""
        for pending, linear, angular in (
            (self.forces, force, torque),
            (self.impulses, impulse, angular_impulse),
        ):
            if linear != _ZERO or angular != _ZERO:
                before, wrench = pending.get(body), [*linear, *angular]
                pending[body] = wrench if before is None else [a + b for a, b in zip(before, wrench, strict=True)]

    def forget(self, body: int) -> None:
        """Drops what acts on a body."""
        self.forces.pop(body, None)
        self.impulses.pop(body, None)

    def clear(self) -> None:
        """Drops all that acts."""
        self.forces.clear()
        self.impulses.clear()


class RunningModel:
    """The model of a scene and its data, replaced (`install`) whenever the structure changes.

    Attributes:
        compiled: The model and where everything is in it; `model` is MuJoCo's.
        data: MuJoCo's.
        scenery: The static surroundings.
        senses: The sensors of this model.
        motors: The motors and joints of this model.
        depenetration: The bodies that are let apart.
        heaped: Whether more than `_HEAP` trees hold each other, or did before they fell asleep.
        fluid: The medium.
        one_by_one: Whether something is to be done before each engine step: bodies are damped, planets attract, or the
            medium acts by forces of ours.
        qpos: `data.qpos`; likewise `qvel`, `efforts` (`actuator_force`) and `asleep` (`tree_asleep`).
    """

    def __init__(self, scenery: Scenery, scene: SceneSpec) -> None:
        self.scenery, self._timestep = scenery, scene.timestep
        self._heaps = "cone" not in scene.options  # whether heaps may have friction of their own
        self.depenetration = Depenetration(scenery)
        self.heaped = False
        self._damping = Damping(scene)
        self.fluid = Fluid(scene)

    def install(
        self, compiled: CompiledModel, joints: Mapping[int, Joint], shared_data: mujoco.MjData | None = None
    ) -> None:
        """Runs another model from now on.

        Args:
            compiled: The model.
            joints: All joints by number.
            shared_data: Data that are others', too, and so are only read; fresh ones if None.
        """
        self.compiled, self._joints = compiled, joints
        self.model = model = compiled.model
        self.data = data = mujoco.MjData(model) if shared_data is None else shared_data
        self._shared = shared_data is not None
        self._current = False  # whether xpos, xquat, cvel belong to qpos, qvel
        self._state = np.empty(mujoco.mj_stateSize(model, STATE))
        # What a step changes of that state, besides the time, and room for how it was before.
        changing = [data.qpos, data.qvel, data.qacc_warmstart, *([data.act] if model.na else [])]
        self._before = [(memoryview(values.copy()), memoryview(values)) for values in changing if len(values)]
        self._slept = data.tree_asleep.copy()  # as it was before a step, too
        # Attribute access on MjData makes a new view each time; these are what a tick and a query need.
        self._warnings = memoryview(data.warning.number)
        self._no_warnings = self._warnings.tobytes()
        self._xfrc, self.asleep = data.xfrc_applied, data.tree_asleep
        self._xpos, self._xquat, self._cvel = data.xpos, data.xquat, data.cvel
        self._centre, self._root = data.subtree_com, model.body_rootid
        self.qpos, self.qvel, self.efforts = data.qpos, data.qvel, data.actuator_force
        self.senses = Senses(compiled, data, self.scenery)
        self.motors = ActuatorBatch(compiled, data, joints)
        self._driven = bool(compiled.actuator)
        self._damping.install(model)
        self.fluid.install(compiled)
        self.one_by_one = self.scenery.attracts or self._damping.acts or self.fluid.acts
        self._may_heap = self._heaps and model.ntree > _HEAP
        self._set_heaped(self.heaped and self._may_heap)
        if self.scenery.attracts:
            self._install_weights()
        for joint in compiled.joint_index:
            self.drive(joints[joint])

    def _install_weights(self) -> None:
        """Finds where weights act: at the coordinates of free bodies at once, on all others through their joints."""
        model = self.model
        self._sleeps = bool(model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP)
        free = model.jnt_type == mujoco.mjtJoint.mjJNT_FREE  # parked bodies, too, which sleep until they are in use
        self._roots = model.jnt_bodyid[free]
        self._root_dofs = model.jnt_dofadr[free][:, None] + np.arange(3)
        others = model.body_treeid >= 0
        others[self._roots] = False
        self._branches = np.flatnonzero(others)

    def state(self) -> Array:
        """Returns MuJoCo's integration state, in an array that the next call overwrites."""
        mujoco.mj_getState(self.model, self.data, self._state, STATE)
        return self._state

    def forget_kinematics(self) -> None:
        """Computes poses and velocities anew when somebody reads them, since coordinates were changed."""
        self._current = False

    def replace_senses(self) -> None:
        """Forgets all sensor readings, since bodies came, went or were moved without a step."""
        self.senses = Senses(self.compiled, self.data, self.scenery)

    # -- poses and velocities ---------------------------------------------------------------------------------------

    def refresh(self) -> None:
        """Makes poses and velocities those of the coordinates: a step leaves them one step behind."""
        if self._current:
            return
        if self._shared:
            self.install(self.compiled, self._joints)
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_comVel(self.model, self.data)
        self._current = True

    def body_state(self, index: int, frozen: bool) -> BodyState:
        """Returns the pose and velocity of a body of the model."""
        if not self._current:
            self.refresh()
        x, y, z = self._xpos[index].tolist()
        qw, qx, qy, qz = self._xquat[index].tolist()
        if frozen:
            return BodyState((x, y, z), (qx, qy, qz, qw), _ZERO, _ZERO)
        wx, wy, wz, vx, vy, vz = self._cvel[index].tolist()
        # cvel is the velocity at the tree's centre of mass; a box's own centre is its body frame's origin.
        cx, cy, cz = self._centre[self._root[index]].tolist()
        rx, ry, rz = x - cx, y - cy, z - cz
        return BodyState(
            (x, y, z),
            (qx, qy, qz, qw),
            (vx + (wy * rz - wz * ry), vy + (wz * rx - wx * rz), vz + (wx * ry - wy * rx)),
            (wx, wy, wz),
        )

    def body_states(self, indices: Sequence[int]) -> Array:
        """Returns a new array (n, 13) of bodies of the model, as `Simulation.states`; frozen ones are at rest."""
        if not self._current:
            self.refresh()
        index, out = np.array(indices, np.intp), np.empty((len(indices), 13))
        position, velocity = self._xpos[index], self._cvel[index]
        out[:, 0:3] = position
        out[:, 3:7] = self._xquat[index][:, (1, 2, 3, 0)]
        x, y, z = (position - self._centre[self._root[index]]).T
        wx, wy, wz = velocity[:, :3].T
        out[:, 7:10] = velocity[:, 3:]
        out[:, 7] += wy * z - wz * y  # numpy.cross costs as much as all the rest
        out[:, 8] += wz * x - wx * z
        out[:, 9] += wx * y - wy * x
        out[:, 10:13] = velocity[:, :3]
        out[self.model.body_treeid[index] < 0, 7:] = 0.0
        return out

    # -- motors and joints ------------------------------------------------------------------------------------------

    def drive(self, joint: Joint) -> None:
        """Makes the model and the controls have a joint's parameters."""
        write_params(self.compiled, joint)
        self.set_target(joint)

    def set_target(self, joint: Joint) -> None:
        """Sets a motor's control to its joint's target."""
        motor, params = self.compiled.actuator.get(joint.number), joint.params
        if motor is not None:
            target = params.target_velocity if params.motor == "velocity" else params.target_position
            self.data.ctrl[motor] = target if params.max_effort > 0.0 else 0.0

    # -- sleep ------------------------------------------------------------------------------------------------------

    def settle(self, asleep: npt.NDArray[np.int32]) -> None:
        """Computes all that follows from the state, with everything awake, then puts trees to sleep (`tree_asleep`)."""
        model, data, state = self.model, self.data, self.state()
        self.asleep[:] = AWAKE
        count_awake(model, data)
        if self.scenery.attracts:
            data.xfrc_applied[:] = 0.0
            self.scenery.pull(model, data)  # the state has no forces in it: these go again
        if self.fluid.acts:
            self.fluid.act(model, data)  # likewise
        with self.depenetration.crowds.apart(self.compiled, data, self.depenetration.bodies):
            mujoco.mj_forward(model, data)
        mujoco.mj_setState(model, data, state, STATE)
        self.asleep[:] = asleep
        count_awake(model, data)
        self._current = True
        self.replace_senses()

    def wake(self, *indices: int) -> None:
        """Wakes the islands of these bodies (indices in the model)."""
        trees = self.model.body_treeid
        if wake_islands(self.asleep, [int(trees[index]) for index in indices]):
            count_awake(self.model, self.data)
            self._current = False  # what was read of a static root left its sleeping branches out

    # -- time -------------------------------------------------------------------------------------------------------

    def step(self, substeps: int, wrenches: Wrenches) -> None:
        """Advances by engine steps, with wrenches that act and then are gone.

        Raises:
            SimulationFault: The engine cannot go on; the state is the one before the call, wrenches too.
        """
        for kept, values in self._before:
            kept[:] = values
        self._slept[:] = self.asleep
        self._began, self._parting = self.data.time, self.depenetration.watched
        self._slots = self.motors.begin(substeps) if self._driven else iter(())
        try:
            if wrenches.forces or wrenches.impulses:
                self._advance_pushed(substeps, wrenches)
            else:
                self._advance(substeps)
        except mujoco.FatalError as error:
            self._go_back()
            code = "arena_exhausted" if "memory" in str(error) else "engine_failed"
            raise SimulationFault(code, f"MuJoCo: {error}") from error
        self._current = False
        self.senses.forget()
        if self._warnings.tobytes() != self._no_warnings:
            try:
                self._fail(substeps, wrenches)
            finally:
                self._go_back()
        if self._may_heap:
            self._look_for_heap()
        if self._driven:
            self.motors.end()
        wrenches.clear()

    def _advance_pushed(self, substeps: int, wrenches: Wrenches) -> None:
        xfrc, index = self._xfrc, self.compiled.body_index
        forces, impulses = wrenches.forces, wrenches.impulses
        try:
            for body, wrench in forces.items():
                xfrc[index[body]] = wrench
            if impulses:
                # An impulse is the force that gives it within the first engine step, so that it meets joints and
                # contacts like any other force.
                rate = 1.0 / self._timestep
                for body, wrench in impulses.items():
                    xfrc[index[body]] += np.multiply(wrench, rate)
                self._advance(1)
                for body in impulses:
                    xfrc[index[body]] = forces.get(body, 0.0)
                substeps -= 1
            if substeps:
                self._advance(substeps)
        finally:
            xfrc[:] = 0.0

    def _advance(self, steps: int) -> None:
        if self.one_by_one:
            self._advance_one_by_one(steps)
            return
        while self.depenetration.bodies and steps:
            self.depenetration.step(self.compiled, self.data, self._step_alone)
            self._keep()
            steps -= 1
        if self._driven:
            step, model, data, efforts, speeds = mujoco.mj_step, self.model, self.data, *self.motors.sources
            for effort, speed in islice(self._slots, steps):
                step(model, data)
                effort[:], speed[:] = efforts, speeds
        elif steps:
            mujoco.mj_step(self.model, self.data, steps)

    def _step_alone(self) -> None:
        mujoco.mj_step(self.model, self.data)

    def _keep(self) -> None:
        """Keeps what motors gave in an engine step, if there are any."""
        efforts, speeds = self.motors.sources
        for effort, speed in islice(self._slots, 1):
            effort[:], speed[:] = efforts, speeds

    def _advance_one_by_one(self, steps: int) -> None:
        """Takes engine steps in which bodies are damped, or gravity is another at every place: a force on each body."""
        applied = self._xfrc.copy()
        for _ in range(steps):
            self._xfrc[:] = applied
            # Applied weights keep bodies awake; where any is watched, and there is no heap, recordings have them so.
            pulled = self.scenery.attracts and not (self._sleeps and (self.heaped or not self.depenetration.bodies))
            if pulled:
                self.scenery.pull(self.model, self.data)
                sleeping = self.data.body_awake == 0  # parked ones, too: a force would wake them
                self._xfrc[sleeping] = applied[sleeping]
            if self._damping.acts:
                self._damping.act(self.model, self.data)
            if self.fluid.acts:
                self.fluid.act(self.model, self.data)
            step = self._step_attracted if self.scenery.attracts and not pulled else self._step_alone
            if self.depenetration.bodies:
                self.depenetration.step(self.compiled, self.data, step)
            else:
                step()
            self._keep()
        self._xfrc[:] = applied

    def _step_attracted(self) -> None:
        """Takes an engine step in which planets pull by passive forces: applied ones would let nothing sleep."""
        model, data = self.model, self.data
        mujoco.mj_step1(model, data)
        weights, awake = self.scenery.weights(model, data), data.body_awake > 0
        roots = awake[self._roots]
        data.qfrc_passive[self._root_dofs[roots]] += weights[self._roots[roots]]
        for body in self._branches[awake[self._branches]].tolist():
            mujoco.mj_applyFT(model, data, weights[body], _ZERO, data.xipos[body], body, data.qfrc_passive)
        mujoco.mj_step2(model, data)

    def _look_for_heap(self) -> None:
        """Sees after a tick whether there is a heap; one that fell asleep will be one when it wakes."""
        islands, sleepers = self.data.island_ntree, 0
        if self.heaped:
            sleepers = int(np.count_nonzero(self.asleep >= 0)) - len(self.compiled.spares)
        heaped = sleepers > _HEAP or (len(islands) > 0 and int(islands.max()) > _HEAP)
        if heaped != self.heaped:
            self._set_heaped(heaped)

    def _set_heaped(self, heaped: bool) -> None:
        self.heaped, option = heaped, self.model.opt
        if self._may_heap:
            option.cone, option.sleep_tolerance = _HEAP_SETTINGS if heaped else _USUAL_SETTINGS

    def _go_back(self) -> None:
        """Shows the state before the step that failed."""
        for kept, values in self._before:
            values[:] = kept
        self.data.time, self.depenetration.watched = self._began, self._parting
        self._xfrc[:] = 0.0
        mujoco.mj_setState(self.model, self.data, self.state(), STATE)  # which wakes all
        self._current = False

    def _fail(self, substeps: int, wrenches: Wrenches) -> None:
        for warning, (code, message) in _FAULTS.items():
            if self._warnings[warning]:
                raise SimulationFault(code, message, self._most_touched())
        owner, message, body = self.model.dof_bodyid, "the engine diverged", self._blamed()
        for values, quantity in ((self.data.qacc, "acceleration"), (self.data.qvel, "velocity")):
            sizes = np.nan_to_num(np.abs(values), nan=np.inf)
            if (sizes > HUGE).any():
                message = f"the engine diverged: {quantity} out of bounds"
                body = self.compiled.body_number[int(owner[sizes.argmax()])]
        first = self._first_out_of_hand(substeps, wrenches)
        raise SimulationFault("diverged", message, body if first is None else first)

    def _most_touched(self) -> int | None:
        """Returns the body with most contacts, in the tree that has most of them; of several it is the first."""
        numbers, roots = self.compiled.body_number, self.model.body_rootid
        touching = self.model.geom_bodyid[self.data.contact.geom].ravel().tolist()
        touching = [index for index in touching if index in numbers]  # the scenery has no number
        trees, bodies = Counter(int(roots[index]) for index in touching), Counter(touching)
        most = max(bodies, key=lambda at: (trees[int(roots[at])], bodies[at], -numbers[at]), default=None)
        return None if most is None else numbers[most]

    def _first_out_of_hand(self, substeps: int, wrenches: Wrenches) -> int | None:
        """Returns the body with which it began, once it has failed: takes the step again, an engine step at a time.

        By its end all may be out of hand that touches that body, or is computed with it. Whoever is struck is seldom
        the faster one, and never before the other is; so of those that are out of hand first it is the fastest.
        """
        asleep = self.asleep.copy()
        self._go_back()
        self.settle(self._slept)
        self._slots = self.motors.begin(substeps) if self._driven else iter(())
        speeds = self._lengths(self.qvel)
        fastest, times = _OUT_OF_HAND
        bounds, lasting, body = np.maximum(times * speeds, fastest), Wrenches(), None
        lasting.forces = wrenches.forces
        for step in range(substeps):
            self._advance_pushed(1, lasting if step else wrenches)
            before, speeds = speeds, self._lengths(self.qvel)
            if (speeds > bounds).any():
                # Of several that are no numbers, it is what was accelerated without bounds, or was the fastest before.
                first = np.lexsort((before, self._lengths(self.data.qacc), speeds))[-1]
                body = self.compiled.body_number[int(self.model.dof_bodyid[first])]
                break
        self.asleep[:] = asleep
        count_awake(self.model, self.data)
        return body

    def _lengths(self, rates: Array) -> Array:
        """Returns how large rates of the coordinates are for corners of bodies: in metres, not in radians."""
        return np.asarray(np.nan_to_num(np.abs(rates) * self.model.dof_length, nan=np.inf))

    def _blamed(self) -> int | None:
        """Returns the body over whose coordinates MuJoCo has warned."""
        model, warned = self.model, self.data.warning
        for warning, owners in (
            (
                _WARNINGS.mjWARN_BADQPOS,
                model.jnt_bodyid[np.searchsorted(model.jnt_qposadr, np.arange(model.nq), "right") - 1],
            ),
            (_WARNINGS.mjWARN_BADQVEL, model.dof_bodyid),
            (_WARNINGS.mjWARN_BADQACC, model.dof_bodyid),
        ):
            if warned.number[warning]:
                return self.compiled.body_number[int(owners[warned.lastinfo[warning]])]
        return None
