"""A running MuJoCo scene that is edited while it lives.

Edits only note what changed; the model is rebuilt once, at the next step, and the state carried over (see `carry`).
Between an edit and the next step queries answer from `_override` (new and moved bodies) or from the old model.

Sleep is no part of what `mj_getState` returns, and a sleeping tree's derived quantities are not computed afresh; so
whenever a state is installed they are all computed once, with everything awake, before the sleepers are put back.
"""

from __future__ import annotations

import base64
import hashlib
import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from math import atan2, pi

import mujoco
import numpy as np
import numpy.typing as npt
import orjson

from nmes.backend import (
    Array,
    BodySpec,
    BodyState,
    CameraSpec,
    Contact,
    Image,
    JointParams,
    JointSpec,
    JointState,
    SceneSpec,
    Simulation,
    Vector,
)
from nmes.backend.rotation import conjugate, cross, dot, minus, multiply, normalize, plus, rotate
from nmes.backends.mujoco3d.carry import AWAKE, affected, carry, kept_sleep, place, promoted, put_sleep, rezero, turns
from nmes.backends.mujoco3d.drawing import Painter
from nmes.backends.mujoco3d.layout import (
    SPARE,
    Body,
    Forest,
    Joint,
    Layout,
    build,
    occupy,
    relative,
    span,
    vacate,
    weigh,
    write_params,
)
from nmes.backends.mujoco3d.parting import Parting
from nmes.backends.mujoco3d.reins import Reins
from nmes.backends.mujoco3d.scenery import Scenery, set_options
from nmes.backends.mujoco3d.sensing import STATE, Senses, count_awake
from nmes.backends.mujoco3d.tracking import MujocoTrack
from nmes.errors import SimulationFault

__all__ = ["MujocoSimulation"]

logger = logging.getLogger(__name__)

ZERO: Vector = (0.0, 0.0, 0.0)
_WARNINGS = mujoco.mjtWarning
_FAULTS = {
    _WARNINGS.mjWARN_CONTACTFULL: ("contact_overflow", "the engine ran out of room for contacts"),
    _WARNINGS.mjWARN_CNSTRFULL: ("constraint_overflow", "the engine ran out of room for constraints"),
}
_FEW = 5  # bodies: up to so many, one by one is faster than by arrays
_HUGE = 1e10  # mjMAXVAL: beyond this the engine calls a state bad
_MANY = 64  # bodies from which on compiling the model for one more takes too long

# What MuJoCo prints of a diverging world goes to the log; the fault says it to the user.
mujoco.set_mju_user_warning(lambda message: logger.debug("mujoco: %s", message))


class MujocoSimulation(Simulation):
    """One scene. See `nmes.backend.Simulation` for what each call promises."""

    def __init__(self, scene: SceneSpec) -> None:
        self._scene = scene
        self._bodies: dict[int, Body] = {}
        self._joints: dict[int, Joint] = {}
        self._override: dict[int, BodyState] = {}  # new and moved bodies, until the next step
        self._touched: set[int] = set()  # bodies of which the structure was edited since the last step
        self._arrived: dict[int, None] = {}  # free bodies that came since, and those that went
        self._left: dict[int, None] = {}
        self._parting = Parting()
        self._stale_model = True
        self._wake_all = False
        self._force: dict[int, list[float]] = {}  # wrenches for the next step, by body
        self._impulse: dict[int, list[float]] = {}
        self._scenery = Scenery(scene)
        self._painter = Painter(self._scenery)
        self._identity = self._scenery.identity  # XOR of the hashes of everything that the state arrays do not say
        set_options(mujoco.MjSpec().option, scene.options)  # says what is wrong with them, now
        self._install(*_nothing(self._scenery))
        self._borrowed = True

    def _install(self, layout: Layout, data: mujoco.MjData | None = None) -> None:
        self._layout = layout
        self._model = model = layout.model
        self._data = data = mujoco.MjData(model) if data is None else data
        self._borrowed = False  # whether the data are others', too: then they are only read
        self._read = False  # whether xpos, xquat, cvel belong to qpos, qvel
        self._state = np.empty(mujoco.mj_stateSize(model, STATE))
        self._before = np.empty_like(self._state)  # the state that a step began with
        # Attribute access on MjData makes a new view each time; these are what a tick and a query need.
        self._warnings = data.warning.number
        self._calm = self._warnings.tobytes()
        self._xfrc, self._xpos, self._xquat, self._cvel = data.xfrc_applied, data.xpos, data.xquat, data.cvel
        self._centre, self._root = data.subtree_com, model.body_rootid
        self._asleep = data.tree_asleep
        self._senses = Senses(layout, data, self._scenery)
        self._reins = Reins(layout, data, self._joints)

    # -- structure ----------------------------------------------------------------------------------------------

    def add_body(self, body: int, spec: BodySpec) -> None:
        """Adds a body; the model follows at the next step."""
        self._bodies[body] = Body(body, spec.size, spec.mass, spec.friction, spec.restitution, spec.frozen)
        self._identity ^= self._bodies[body].identity
        still = spec.frozen
        self._override[body] = BodyState(
            spec.position,
            spec.quaternion,
            ZERO if still else spec.linear_velocity,
            ZERO if still else spec.angular_velocity,
        )
        self._touched.add(body)
        if spec.frozen:
            self._stale_model = self._wake_all = True
        else:
            self._arrived[body] = None

    def remove_body(self, body: int) -> None:
        """Removes a body; what slept on a frozen one wakes."""
        self._identity ^= self._bodies[body].identity
        if self._bodies.pop(body).frozen:
            self._stale_model = self._wake_all = True
        elif body in self._arrived:
            del self._arrived[body]
        elif body in self._layout.free:
            self._left[body] = None
        else:
            self._stale_model = True
        self._override.pop(body, None)
        self._force.pop(body, None)
        self._impulse.pop(body, None)
        self._touched.discard(body)
        self._parting.bodies.discard(body)

    def add_joint(self, joint: int, spec: JointSpec) -> None:
        """Joins two bodies as they stand now, which is the joint's zero."""
        one, two = self.body_state(spec.body1), self.body_state(spec.body2)
        back1, back2 = conjugate(one.quaternion), conjugate(two.quaternion)
        self._joints[joint] = Joint(
            number=joint,
            kind=spec.kind,
            body1=spec.body1,
            body2=spec.body2,
            anchor1=rotate(back1, minus(spec.anchor, one.position)),
            anchor2=rotate(back2, minus(spec.anchor, two.position)),
            axis2=rotate(back2, spec.axis),
            zero=normalize(relative(one.quaternion, two.quaternion)),
            params=spec.params,
        )
        self._identity ^= self._joints[joint].identity
        self._edited(spec.body1)
        self._edited(spec.body2)

    def remove_joint(self, joint: int) -> None:
        """Cuts a joint."""
        self._reins.note()
        cut = self._joints.pop(joint)
        self._identity ^= cut.identity
        self._edited(cut.body1)
        self._edited(cut.body2)

    def set_joint_params(self, joint: int, params: JointParams) -> None:
        """Sets motor, spring and limits; the model is rebuilt only where a motor comes or goes."""
        self._reins.note()
        held = self._joints[joint]
        before, form = held.params, held.form
        if params == before:
            return
        aimed = replace(before, target_velocity=params.target_velocity, target_position=params.target_position)
        if params == aimed:  # what controllers do at every tick
            held.params = params
            if held.number in self._layout.actuator:
                self._aim(held)
                self._wake(self._layout.body[held.body1], self._layout.body[held.body2])
            return
        self._reins.forget()
        self._identity ^= held.identity
        held.params = params
        self._identity ^= held.identity
        if (params.motor == "off") != (before.motor == "off"):
            self._stale_model = True
        if held.form != form:  # a ball gets or loses its limits
            self._edited(held.body1)
            self._edited(held.body2)
        elif joint in self._layout.joint:
            self._drive(held)
            self._wake(self._layout.body[held.body1], self._layout.body[held.body2])

    def set_motor_targets(self, joints: Sequence[int], params: Sequence[JointParams], targets: Array) -> None:
        """Sets the controls of motors; their parameters follow when somebody looks at them."""
        woken = None if self._edits else self._reins.aim(tuple(joints), targets)
        if woken is None:
            super().set_motor_targets(joints, params, targets)
        elif woken:
            self._wake(*woken)

    def set_frozen(self, body: int, frozen: bool) -> None:
        """Makes a body part of the world, or lets it go at rest."""
        state = self.body_state(body)
        self._override[body] = BodyState(state.position, state.quaternion, ZERO, ZERO)
        held = self._bodies[body]
        self._identity ^= held.identity
        held.frozen = frozen
        self._identity ^= held.identity
        self._edited(body)
        for joint in self._joints.values():
            if body in (joint.body1, joint.body2):
                self._touched.update((joint.body1, joint.body2))
        self._wake_all = True

    def _edited(self, body: int) -> None:
        self._touched.add(body)
        self._stale_model = True

    # -- state --------------------------------------------------------------------------------------------------

    def set_body_state(self, body: int, state: BodyState) -> None:
        """Moves a body; its structure takes up the new state at the next step."""
        if self._bodies[body].frozen:
            state = BodyState(state.position, state.quaternion, ZERO, ZERO)
            self._stale_model = self._wake_all = True
        self._override[body] = state
        self._touched.add(body)

    def apply(self, body: int, force: Vector, torque: Vector, impulse: Vector, angular_impulse: Vector) -> None:
        """Notes what acts on the body during the next step."""
        if self._bodies[body].frozen:
            return
        for pending, linear, angular in (
            (self._force, force, torque),
            (self._impulse, impulse, angular_impulse),
        ):
            if linear != ZERO or angular != ZERO:
                held = pending.get(body)
                given = [*linear, *angular]
                pending[body] = given if held is None else [a + b for a, b in zip(held, given, strict=True)]

    def body_state(self, body: int) -> BodyState:
        """Returns one body's pose and velocity."""
        held = self._override.get(body)
        if held is not None:
            return held
        self._refresh()
        index = self._layout.body[body]
        x, y, z = self._xpos[index].tolist()
        qw, qx, qy, qz = self._xquat[index].tolist()
        if self._bodies[body].frozen:
            return BodyState((x, y, z), (qx, qy, qz, qw), ZERO, ZERO)
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

    def states(self, bodies: Sequence[int]) -> Array:
        """Returns a new array (n, 13)."""
        out = np.empty((len(bodies), 13))
        if len(bodies) <= _FEW:
            for row, state in enumerate(map(self.body_state, bodies)):
                out[row] = (*state.position, *state.quaternion, *state.linear_velocity, *state.angular_velocity)
            return out
        self._refresh()
        where = self._layout.body
        index = np.array([where.get(body, 0) for body in bodies], np.intp)
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
        out[self._model.body_treeid[index] < 0, 7:] = 0.0
        if self._override:
            for row, body in enumerate(bodies):
                held = self._override.get(body)
                if held is not None:
                    out[row] = (*held.position, *held.quaternion, *held.linear_velocity, *held.angular_velocity)
        return out

    def _refresh(self) -> None:
        """Makes poses and velocities those of the coordinates: a step leaves them one step behind."""
        if not self._read:
            if self._borrowed:
                self._install(self._layout)
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_comPos(self._model, self._data)
            mujoco.mj_comVel(self._model, self._data)
            self._read = True

    def track(self, bodies: Sequence[int], joints: Sequence[int], rows: int) -> MujocoTrack:
        """Returns what keeps rows by copying what MuJoCo holds."""
        return MujocoTrack(self, bodies, joints, rows, self._look)

    def _look(self) -> tuple[Layout, mujoco.MjData] | None:
        if self._edits:
            return None
        self._refresh()
        return self._layout, self._data

    def sleeping(self, body: int) -> bool:
        """Tells whether the body's tree sleeps."""
        index = self._layout.body.get(body)
        if index is None or body in self._touched or self._bodies[body].frozen:
            return False
        tree = self._model.body_treeid[index]
        return bool(tree >= 0 and self._asleep[tree] >= 0)

    def joint_state(self, joint: int) -> JointState:
        """Returns one joint's reading; before the joint's first step its position is zero."""
        held = self._joints[joint]
        one, two = self.body_state(held.body1), self.body_state(held.body2)
        axis = rotate(two.quaternion, held.axis2)
        arm1, arm2 = rotate(one.quaternion, held.anchor1), rotate(two.quaternion, held.anchor2)
        anchor = plus(one.position, arm1)
        position = velocity = effort = 0.0
        if held.kind == "conetwist":
            turn = multiply(conjugate(held.zero), relative(one.quaternion, two.quaternion))
            position = 2.0 * atan2(dot(turn[:3], held.axis2), turn[3])
            position = (position + pi) % (2.0 * pi) - pi
            velocity = dot(minus(two.angular_velocity, one.angular_velocity), axis)
        elif held.kind in ("hinge", "slide"):
            slot = self._layout.joint.get(joint)
            if slot is not None:
                position = float(self._data.qpos[slot.q])
            if slot is not None and not self._touched:
                velocity = float(self._data.qvel[slot.v])
            elif held.kind == "hinge":
                velocity = dot(minus(two.angular_velocity, one.angular_velocity), axis)
            else:
                arm1 = minus(plus(two.position, arm2), one.position)
                tip1 = plus(one.linear_velocity, cross(one.angular_velocity, arm1))
                tip2 = plus(two.linear_velocity, cross(two.angular_velocity, arm2))
                velocity = dot(minus(tip2, tip1), axis)
            motor = self._layout.actuator.get(joint)
            if motor is not None:
                effort = float(self._data.actuator_force[motor])
        return JointState(position, velocity, effort, anchor, axis)

    def joint_readings(self, joints: Sequence[int]) -> Array:
        """Returns a new array (n, 3), read all at once where nothing was edited since the last step."""
        found = None if self._edits else self._reins.readings(tuple(joints))
        return super().joint_readings(joints) if found is None else found

    def touching(self, bodies: Sequence[int]) -> Array:
        """Returns a new array (n,), from the engine's list of contacts where all is awake."""
        if self._edits or self._senses.resting:
            return super().touching(bodies)
        return self._senses.touching([self._layout.body[body] for body in bodies])

    def powers(self, joints: Sequence[int], out: Array) -> None:
        """Writes powers, of all motors at once where nothing was edited since the last step."""
        if not self._reins.powers(joints, out, edited=self._edits):
            super().powers(joints, out)

    def contacts(self, body: int) -> list[Contact]:
        """Returns what the body touched in the last step."""
        index = self._layout.body.get(body)
        if index is None:
            return []
        found = self._senses.contacts(index)
        if self._stale_model or self._left:  # somebody may have been removed since
            return [contact for contact in found if contact.other is None or contact.other in self._bodies]
        return found

    def proper_accelerations(self, bodies: Sequence[int]) -> Array:
        """Returns a new array (n, 3)."""
        self._refresh()
        where = self._layout.body
        rows = [
            self._senses.proper_acceleration(where[body], self.body_state(body).position) if body in where else ZERO
            for body in bodies
        ]
        return np.array(rows).reshape(-1, 3)

    def ranges(self, body: int, directions: Array, limit: float) -> list[float | None]:
        """Returns the distances from the body's centre along rays."""
        self._refresh()
        index = self._layout.body.get(body, -1)
        return self._senses.ranges(index, self.body_state(body).position, directions, limit)

    def draw(self, camera: CameraSpec, colors: Mapping[int, tuple[float, float, float, float]]) -> Image:
        """Returns a picture, drawn from copies."""
        return self._painter.draw(camera, self._layout, self._data.qpos.copy(), colors)

    def close(self) -> None:
        """Gives back what drawing took."""
        self._painter.close()

    # -- time ---------------------------------------------------------------------------------------------------

    def step(self, substeps: int) -> None:
        """Takes up all edits, then advances."""
        self._take_up()
        mujoco.mj_getState(self._model, self._data, self._before, STATE)
        xfrc = self._xfrc
        acted = self._force or self._impulse
        if acted:
            for body, wrench in self._force.items():
                xfrc[self._layout.body[body]] = wrench
        try:
            if self._impulse:
                # An impulse is the force that gives it within the first engine step, so that it meets joints and
                # contacts like any other force.
                rate = 1.0 / self._scene.timestep
                for body, wrench in self._impulse.items():
                    xfrc[self._layout.body[body]] += np.multiply(wrench, rate)
                self._advance(1)
                for body in self._impulse:
                    xfrc[self._layout.body[body]] = self._force.get(body, 0.0)
                substeps -= 1
            if substeps:
                self._advance(substeps)
        except mujoco.FatalError as error:
            self._go_back()
            code = "arena_exhausted" if "memory" in str(error) else "engine_failed"
            raise SimulationFault(code, f"MuJoCo: {error}") from error
        finally:
            if acted:
                xfrc[:] = 0.0
                self._force.clear()
                self._impulse.clear()
        self._read = False
        self._senses.forget()
        if self._warnings.tobytes() != self._calm:
            try:
                self._fail()
            finally:
                self._go_back()

    def _go_back(self) -> None:
        """Shows the state before the step that failed."""
        mujoco.mj_setState(self._model, self._data, self._before, STATE)
        self._read = False

    def _advance(self, steps: int) -> None:
        if self._scenery.attracts:
            self._advance_attracted(steps)
            return
        while self._parting.bodies and steps:
            self._parting.step(self._layout, self._data)
            steps -= 1
        if steps:
            mujoco.mj_step(self._model, self._data, steps)

    def _advance_attracted(self, steps: int) -> None:
        """Takes engine steps in a field of gravity that is another at every place: a force on each body, each step."""
        applied = self._xfrc.copy()
        for _ in range(steps):
            self._scenery.pull(self._model, self._data, applied)
            if self._parting.bodies:
                self._parting.step(self._layout, self._data)
            else:
                mujoco.mj_step(self._model, self._data)
        self._xfrc[:] = applied

    def _fail(self) -> None:
        data = self._data
        for warning, (code, message) in _FAULTS.items():
            if self._warnings[warning]:
                raise SimulationFault(code, message)
        owner = self._model.dof_bodyid
        for values, what in ((data.qvel, "velocity"), (data.qacc, "acceleration")):
            bad = np.flatnonzero(~(np.abs(values) <= _HUGE))
            if len(bad):
                body = self._layout.number[int(owner[bad[0]])]
                raise SimulationFault("diverged", f"the engine diverged: {what} out of bounds", body)
        raise SimulationFault("diverged", "the engine diverged")

    def digest(self) -> bytes:
        """Returns the digest over MuJoCo's integration state, sleep, structure, and edits not yet taken up."""
        mujoco.mj_getState(self._model, self._data, self._state, STATE)
        h = hashlib.blake2b(self._state.data, digest_size=16)
        h.update(self._asleep.data)
        h.update(self._identity.to_bytes(16, "little"))
        if self._edits or self._force or self._impulse:
            h.update(repr((sorted(self._touched), self._override, self._force, self._impulse)).encode())
            self._reins.note()
            # The targets of motors that are not built yet are in no control.
            targets = [(joint.params.target_velocity, joint.params.target_position) for joint in self._joints.values()]
            h.update(repr(targets).encode())
        if self._parting.bodies:
            h.update(repr(sorted(self._parting.bodies)).encode())
        return h.digest()

    def snapshot(self) -> bytes:
        """Returns the whole state as JSON: structure, and MuJoCo's integration state and sleep in base64.

        The live world then does what a restored one would: it takes up its edits, and computes its readings
        (contacts, efforts) from the state alone.
        """
        self._take_up()
        self._reins.note()
        self._settle(self._asleep.copy())
        mujoco.mj_getState(self._model, self._data, self._state, STATE)
        return orjson.dumps(
            {
                "bodies": list(self._bodies.values()),  # orjson writes dataclasses by their fields
                "joints": list(self._joints.values()),
                "frozen_at": {
                    str(body.number): [*(state := self.body_state(body.number)).position, *state.quaternion]
                    for body in self._bodies.values()
                    if body.frozen
                },
                "force": list(self._force.items()),
                "impulse": list(self._impulse.items()),
                "parting": sorted(self._parting.bodies),
                "state": base64.b64encode(self._state.tobytes()).decode(),
                "asleep": self._asleep.tolist(),
                "roots": self._layout.roots,
            }
        )

    def restore(self, snapshot: bytes) -> None:
        """Takes up a state that `snapshot` returned, in place of all that is here."""
        held = orjson.loads(snapshot)
        self._bodies = {body.number: body for body in map(Body.read, held["bodies"])}
        self._joints = {joint.number: joint for joint in map(Joint.read, held["joints"])}
        self._identity = self._scenery.identity
        parts: list[Body | Joint] = [*self._bodies.values(), *self._joints.values()]
        for part in parts:
            self._identity ^= part.identity
        frozen_at = {int(n): (tuple(p[:3]), tuple(p[3:])) for n, p in held["frozen_at"].items()}
        self._forget_edits()
        self._force = {body: wrench for body, wrench in held["force"]}
        self._impulse = {body: wrench for body, wrench in held["impulse"]}
        self._parting.bodies = set(held["parting"])
        forest = span(self._bodies, self._joints.values())
        roots = held["roots"]
        self._take(build(self._scene, self._scenery, self._bodies, self._joints, forest, frozen_at, roots))
        state = np.frombuffer(base64.b64decode(held["state"]))
        mujoco.mj_setState(self._model, self._data, state.copy(), STATE)
        self._settle(np.array(held["asleep"], self._asleep.dtype))

    # -- carrying the state over --------------------------------------------------------------------------------

    @property
    def _edits(self) -> bool:
        """Whether anything was edited since the last step."""
        return bool(self._stale_model or self._touched or self._arrived or self._left)

    def _forget_edits(self) -> None:
        self._override.clear()
        self._touched.clear()
        self._arrived.clear()
        self._left.clear()
        self._stale_model = self._wake_all = False

    def _take_up(self) -> None:
        """Takes up all edits since the last step, the cheapest way."""
        if not self._edits:
            return
        self._reins.note()
        room = len(self._layout.spares) + len(self._left)
        if self._stale_model or len(self._arrived) > room or not self._touched <= self._free_bodies():
            self._rebuild()
        else:
            self._fill_places()
        self._forget_edits()

    def _free_bodies(self) -> set[int]:
        """Returns the bodies that hang on nothing, new ones included."""
        free = self._layout.free.keys() | self._arrived.keys()
        for joint in self._joints.values():
            free -= {joint.body1, joint.body2}
        return free

    def _fill_places(self) -> None:
        """Takes up free bodies that came, went or were moved, in the model as it is: parked ones stand ready."""
        layout, model, data = self._layout, self._model, self._data
        moved = [body for body in self._touched if body not in self._arrived]
        self._wake(*(layout.body[body] for body in [*sorted(moved), *self._left]))
        for body in self._left:
            slot, index = layout.free[body], vacate(layout, body)
            place(data, slot, BodyState(ZERO, (0.0, 0.0, 0.0, 1.0), ZERO, ZERO))
            tree = int(model.body_treeid[index])
            self._asleep[tree] = tree
        for body in self._arrived:
            index = occupy(layout, self._scene, self._bodies[body])
            self._asleep[model.body_treeid[index]] = AWAKE
        for body in self._touched:
            place(data, layout.free[body], self._override[body])
        if self._arrived or self._left:
            weigh(layout)
        count_awake(model, data)
        self._parting.bodies.update(self._touched)
        self._read = False
        self._senses = Senses(layout, data, self._scenery)

    def _spares(self) -> int:
        """How many parked bodies a new model gets: some where free bodies come into a big world."""
        free = len(self._bodies)
        sleeps = self._model.opt.enableflags & int(mujoco.mjtEnableBit.mjENBL_SLEEP)
        if not self._arrived or free < _MANY or not sleeps or self._scenery.attracts:
            return 0
        return max(16, free // 8)

    def _rebuild(self) -> None:
        """Compiles the model where the structure changed, and installs the state."""
        old, old_data = self._layout, self._data
        touched = affected(self._touched, self._bodies, self._joints.values())
        states = {body: self.body_state(body) for body in touched}
        if self._stale_model or self._arrived or self._left:
            forest = span(self._bodies, self._joints.values())
            for joint in promoted(forest, old):
                slot = old.joint.get(joint.number)
                at = float(old_data.qpos[slot.q]) if slot is not None else 0.0
                self._identity ^= joint.identity
                rezero(joint, self.body_state(joint.body1), self.body_state(joint.body2), at)
                self._identity ^= joint.identity
            frozen_at = {}
            for body in self._bodies.values():
                if body.frozen:
                    state = self.body_state(body.number)
                    frozen_at[body.number] = (state.position, state.quaternion)
            try:
                roots = [*forest.trees, *[SPARE] * self._spares()]
                layout = build(self._scene, self._scenery, self._bodies, self._joints, forest, frozen_at, roots)
            except (ValueError, mujoco.FatalError) as error:
                raise SimulationFault("engine_failed", f"MuJoCo cannot build this structure: {error}") from error
        else:
            layout = old
        balls = turns(self._joints.values(), states, self.body_state)
        sleep = {} if self._wake_all else kept_sleep(old, self._asleep, states, self._bodies)
        self._take(layout)
        carry(old, old_data, layout, self._data, self._joints, states, balls)
        self._parting.bodies.update(body for body in states if body in self._touched)
        asleep = put_sleep(layout, sleep)
        if (asleep >= 0).any():
            self._settle(asleep)
        else:
            self._asleep[:] = asleep

    def _take(self, layout: Layout) -> None:
        self._install(layout)
        for joint in layout.joint_index:
            self._drive(self._joints[joint])

    def _drive(self, joint: Joint) -> None:
        """Makes the model and the controls those that a joint's parameters ask for."""
        write_params(self._layout, joint)
        self._aim(joint)

    def _aim(self, joint: Joint) -> None:
        motor, params = self._layout.actuator.get(joint.number), joint.params
        if motor is not None:
            target = params.target_velocity if params.motor == "velocity" else params.target_position
            self._data.ctrl[motor] = target if params.max_effort > 0.0 else 0.0

    # -- sleep --------------------------------------------------------------------------------------------------

    def _settle(self, asleep: npt.NDArray[np.int32]) -> None:
        """Computes all that follows from the state, with everything awake, then puts trees to sleep as told."""
        model, data, state = self._model, self._data, self._state
        mujoco.mj_getState(model, data, state, STATE)
        self._asleep[:] = AWAKE
        count_awake(model, data)
        if self._scenery.attracts:
            self._scenery.pull(model, data, 0.0)  # the state has no forces in it: these go again
        mujoco.mj_forward(model, data)
        mujoco.mj_setState(model, data, state, STATE)
        self._asleep[:] = asleep
        count_awake(model, data)
        self._read = True
        self._senses = Senses(self._layout, data, self._scenery)

    def _wake(self, *indices: int) -> None:
        """Wakes the islands of these bodies (indices in the model)."""
        woken = False
        for index in indices:
            tree = int(self._model.body_treeid[index])
            while tree >= 0 and (following := int(self._asleep[tree])) >= 0:
                self._asleep[tree] = AWAKE
                tree, woken = following, True
        if woken:
            count_awake(self._model, self._data)
            self._read = False  # what was read of a static root left its sleeping branches out


@lru_cache(maxsize=8)
def _nothing(scenery: Scenery) -> tuple[Layout, mujoco.MjData]:
    """Returns a scene before anything is in it. The first step replaces it, so it is only looked at: all share it."""
    layout = build(SceneSpec(timestep=1.0), scenery, {}, {}, Forest(), {}, ())
    return layout, mujoco.MjData(layout.model)
