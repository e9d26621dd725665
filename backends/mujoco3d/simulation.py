"""A running MuJoCo scene that is edited while it lives.

Edits only note what changed (`structure`); the model is brought up to date once, at the next step (`rebuild`). Between
an edit and the next step queries answer from the edits (new and moved bodies) or from the old model.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from math import atan2, pi

import mujoco
import numpy as np

from nmes.backend import (
    Array,
    BodySpec,
    BodyState,
    CameraSpec,
    Contact,
    Hit,
    Image,
    JointParams,
    JointSpec,
    JointState,
    SceneSpec,
    Simulation,
    Vector,
)
from nmes.backend.rotation import conjugate, cross, dot, minus, multiply, plus, rotate
from nmes.backends.mujoco3d.compiler import compile_model
from nmes.backends.mujoco3d.forest import Forest, Joint, relative_orientation
from nmes.backends.mujoco3d.model import CompiledModel
from nmes.backends.mujoco3d.motors import WorkLog
from nmes.backends.mujoco3d.rebuild import apply_edits
from nmes.backends.mujoco3d.rendering import Renderer
from nmes.backends.mujoco3d.rows import MujocoRow
from nmes.backends.mujoco3d.running import RunningModel, Wrenches
from nmes.backends.mujoco3d.scenery import Scenery, set_options
from nmes.backends.mujoco3d.snapshots import read_snapshot, write_snapshot
from nmes.backends.mujoco3d.structure import Structure
from nmes.backends.mujoco3d.tracking import MujocoTrack

__all__ = ["MujocoSimulation"]

_ZERO: Vector = (0.0, 0.0, 0.0)
_FEW = 5  # bodies: up to so many, one by one is faster than by arrays


class _Sensed(Simulation):
    """What a scene's sensors read after the last step."""

    structure: Structure
    running: RunningModel

    def touching(self, bodies: Sequence[int]) -> Array:
        """Returns a new array (n,), from the engine's list of contacts where all is awake."""
        senses = self.running.senses
        if self.structure.edited or senses.resting:
            return super().touching(bodies)
        return senses.touching([self.running.compiled.body_index[body] for body in bodies])

    def contacts(self, body: int) -> list[Contact]:
        """Returns the body's contacts in the last step."""
        index = self.running.compiled.body_index.get(body)
        if index is None:
            return []
        contacts = self.running.senses.contacts(index)
        if self.structure.stale or self.structure.departed:  # somebody may have been removed since
            there = self.structure.bodies
            return [contact for contact in contacts if contact.other is None or contact.other in there]
        return contacts

    def guess_contacts(self, body: int) -> int:
        """Returns how many contacts are to be looked at for those of a body."""
        index = self.running.compiled.body_index.get(body)
        return 0 if index is None else self.running.senses.guess_contacts(index)

    def proper_accelerations(self, bodies: Sequence[int]) -> Array:
        """Returns a new array (n, 3)."""
        self.running.refresh()
        index, senses = self.running.compiled.body_index, self.running.senses
        rows = [
            senses.proper_acceleration(index[body], self.body_state(body).position) if body in index else _ZERO
            for body in bodies
        ]
        return np.array(rows).reshape(-1, 3)

    def hits(self, body: int, directions: Array, limit: float) -> list[Hit | None]:
        """Returns the first surfaces along rays from the body's centre."""
        self.running.refresh()
        index = self.running.compiled.body_index.get(body, -1)
        return self.running.senses.hits(index, self.body_state(body).position, directions, limit)


class MujocoSimulation(_Sensed):
    """One scene. See `nmes.backend.Simulation` for the promise of each call.

    Attributes:
        structure: The bodies and joints, and their edits since the last step.
        running: The model that runs, for tools that look at MuJoCo itself: `running.model` and `running.data`.
    """

    def __init__(self, scene: SceneSpec) -> None:
        self._scene = scene
        scenery = Scenery(scene)
        set_options(mujoco.MjSpec().option, scene.options)  # says what is wrong with them, now
        self.structure = Structure(scenery.identity)
        self._wrenches = Wrenches()
        self._renderer = Renderer(scenery)
        self.running = RunningModel(scenery, scene)
        compiled, data = _empty_model(scenery)
        self.running.install(compiled, self.structure.joints, shared_data=data)

    # -- structure ----------------------------------------------------------------------------------------------

    def add_body(self, body: int, spec: BodySpec) -> None:
        """Adds a body; the model follows at the next step."""
        self.structure.add_body(body, spec)

    def remove_body(self, body: int) -> None:
        """Removes a body; what slept on a frozen one wakes."""
        self.structure.remove_body(body, self.running.compiled)
        self._wrenches.forget(body)
        self.running.depenetration.forget(body)

    def add_joint(self, joint: int, spec: JointSpec) -> None:
        """Joins two bodies in their present poses, which are the joint's zero."""
        one, two = self.body_state(spec.body1), self.body_state(spec.body2)
        self.structure.add_joint(Joint.from_spec(joint, spec, one, two))

    def remove_joint(self, joint: int) -> None:
        """Cuts a joint."""
        self.running.motors.sync()
        self.structure.remove_joint(joint)

    def set_joint_params(self, joint: int, params: JointParams) -> None:
        """Sets motor, spring and limits; the model is rebuilt only where a motor comes or goes."""
        running = self.running
        running.motors.sync()
        changed = self.structure.joints[joint]
        before = changed.params
        if params == before:
            return
        aimed = replace(before, target_velocity=params.target_velocity, target_position=params.target_position)
        compiled = running.compiled
        if params == aimed:  # what controllers do at every tick
            changed.params = params
            if running.motors.is_idle(changed):
                running.motors.forget_idle_targets()
            if joint in compiled.actuator:
                running.set_target(changed)
                running.wake(compiled.body_index[changed.body1], compiled.body_index[changed.body2])
            return
        running.motors.forget()
        if self.structure.set_joint_params(changed, params) and joint in compiled.joint:
            running.drive(changed)
            running.wake(compiled.body_index[changed.body1], compiled.body_index[changed.body2])

    def set_motor_targets(self, joints: Sequence[int], params: Sequence[JointParams], targets: Array) -> None:
        """Sets the controls of motors; their parameters follow when somebody looks at them."""
        woken = None if self.structure.edited else self.running.motors.set_targets(tuple(joints), targets)
        if woken is None:
            super().set_motor_targets(joints, params, targets)
        elif woken:
            self.running.wake(*woken)

    def set_frozen(self, body: int, frozen: bool) -> None:
        """Makes a body part of the world, or lets it go at rest."""
        self.structure.set_frozen(body, frozen, self.body_state(body))
        self._wrenches.forget(body)

    # -- state --------------------------------------------------------------------------------------------------

    def set_body_state(self, body: int, state: BodyState) -> None:
        """Moves a body; its structure takes up the new state at the next step."""
        self.structure.move_body(body, state)

    def apply(self, body: int, force: Vector, torque: Vector, impulse: Vector, angular_impulse: Vector) -> None:
        """Adds to what acts on the body during the next step."""
        if not self.structure.bodies[body].frozen:
            self._wrenches.add(body, force, torque, impulse, angular_impulse)

    def body_state(self, body: int) -> BodyState:
        """Returns one body's pose and velocity."""
        state = self.structure.overrides.get(body)
        if state is not None:
            return state
        return self.running.body_state(self.running.compiled.body_index[body], self.structure.bodies[body].frozen)

    def states(self, bodies: Sequence[int]) -> Array:
        """Returns a new array (n, 13): position, quaternion, linear and angular velocity."""
        if len(bodies) <= _FEW:
            out = np.empty((len(bodies), 13))
            for row, state in enumerate(map(self.body_state, bodies)):
                out[row] = (*state.position, *state.quaternion, *state.linear_velocity, *state.angular_velocity)
            return out
        index, overrides = self.running.compiled.body_index, self.structure.overrides
        out = self.running.body_states([index.get(body, 0) for body in bodies])
        if overrides:
            for row, body in enumerate(bodies):
                if body in overrides:
                    state = overrides[body]
                    out[row] = (*state.position, *state.quaternion, *state.linear_velocity, *state.angular_velocity)
        return out

    def track(self, bodies: Sequence[int], joints: Sequence[int], motors: Sequence[int], rows: int) -> MujocoTrack:
        """Returns a Track that copies rows from MuJoCo's arrays."""
        return MujocoTrack(self, bodies, joints, motors, rows, self.running, self.structure)

    def sleeping(self, body: int) -> bool:
        """Tells whether the body's tree sleeps."""
        index = self.running.compiled.body_index.get(body)
        if index is None or body in self.structure.touched or self.structure.bodies[body].frozen:
            return False
        tree = self.running.model.body_treeid[index]
        return bool(tree >= 0 and self.running.asleep[tree] >= 0)

    def joint_state(self, joint: int) -> JointState:
        """Returns one joint's reading; before the joint's first step its position is zero."""
        spec = self.structure.joints[joint]
        one, two = self.body_state(spec.body1), self.body_state(spec.body2)
        axis = rotate(two.quaternion, spec.axis2)
        anchor = plus(one.position, rotate(one.quaternion, spec.anchor1))
        position = velocity = effort = 0.0
        if spec.kind == "conetwist":
            position, velocity = _twist(spec, one, two), _turning(one, two, axis)
        elif spec.kind in ("hinge", "slide"):
            running = self.running
            slot = running.compiled.joint.get(joint)
            position = spec.held_at if slot is None else float(running.qpos[slot.q])
            if slot is not None and not self.structure.touched:
                velocity = float(running.qvel[slot.v])
            else:
                velocity = _turning(one, two, axis) if spec.kind == "hinge" else _sliding(spec, one, two, axis)
            motor = running.compiled.actuator.get(joint)
            if motor is not None:
                effort = float(running.efforts[motor])
        return JointState(position, velocity, effort, anchor, axis)

    def joint_readings(self, joints: Sequence[int]) -> Array:
        """Returns a new array (n, 3), read all at once where nothing was edited since the last step."""
        readings = None if self.structure.edited else self.running.motors.readings(tuple(joints))
        return super().joint_readings(joints) if readings is None else readings

    def powers(self, joints: Sequence[int], out: Array) -> None:
        """Writes powers, as a track keeps them."""
        log = WorkLog(joints, 1)
        log.note(self.running.motors)
        out[:] = log.powers(0, 1)[0]

    def draw(self, camera: CameraSpec, colors: Mapping[int, tuple[float, float, float, float]]) -> Image:
        """Returns a picture, drawn from copies."""
        return self._renderer.draw(camera, self.running.compiled, self.running.qpos.copy(), colors)

    def close(self) -> None:
        """Gives back what drawing took."""
        self._renderer.close()

    # -- time ---------------------------------------------------------------------------------------------------

    def hand_over(self) -> MujocoRow | None:
        """Gives the scene away as a row, unless it has edits or wrenches to take up, or a body sleeps or attracts."""
        structure, running = self.structure, self.running
        if structure.edited or self._wrenches.forces or self._wrenches.impulses:
            return None
        return MujocoRow.of(running, structure.joints)

    def step(self, substeps: int) -> None:
        """Takes up all edits, then advances."""
        if self.structure.edited:
            apply_edits(self.running, self.structure, self._scene, self.body_state)
        self.running.step(substeps, self._wrenches)

    def recover(self) -> bool:
        """Forgets that a step failed; the state is the one before it already."""
        self.running.data.warning.number[:] = 0
        return True

    def digest(self) -> bytes:
        """Returns the digest over MuJoCo's integration state, sleep, structure, and edits not yet taken up."""
        running, structure, wrenches = self.running, self.structure, self._wrenches
        digest = hashlib.blake2b(running.state().data, digest_size=16)
        digest.update(running.asleep.data)
        digest.update(structure.identity.to_bytes(16, "little"))
        if structure.edited or wrenches.forces or wrenches.impulses:
            pending = (sorted(structure.touched), structure.overrides, wrenches.forces, wrenches.impulses)
            digest.update(repr(pending).encode())
            running.motors.sync()
            # The targets of motors that are not built yet are in no control.
            params = [joint.params for joint in structure.joints.values()]
            digest.update(repr([(p.target_velocity, p.target_position) for p in params]).encode())
        else:
            digest.update(running.motors.idle_targets)
        if running.depenetration.bodies:
            digest.update(repr(sorted(running.depenetration.bodies)).encode())
            if running.depenetration.crowds.gliding:
                digest.update(repr(sorted(running.depenetration.crowds.gliding)).encode())
        if running.heaped:
            digest.update(b"heaped")
        return digest.digest()

    def snapshot(self) -> bytes:
        """Returns the whole state as JSON; the live scene takes up its edits, as a restored one would."""
        if self.structure.edited:
            apply_edits(self.running, self.structure, self._scene, self.body_state)
        return write_snapshot(self.running, self.structure, self._wrenches)

    def members(self) -> tuple[dict[int, bool], dict[int, tuple[str, int, int]]]:
        """Returns the bodies and the joints."""
        bodies = {number: body.frozen for number, body in self.structure.bodies.items()}
        joints = {number: (joint.kind, joint.body1, joint.body2) for number, joint in self.structure.joints.items()}
        return bodies, joints

    def restore(self, snapshot: bytes) -> None:
        """Takes up a state that `snapshot` returned, in place of all that is here."""
        read_snapshot(snapshot, self._scene, self.running, self.structure, self._wrenches)


def _twist(joint: Joint, one: BodyState, two: BodyState) -> float:
    """Returns the rotation of body2 about the axis since the joint was made, rad, from -pi to pi."""
    turn = multiply(conjugate(joint.zero), relative_orientation(one.quaternion, two.quaternion))
    angle = 2.0 * atan2(dot(turn[:3], joint.axis2), turn[3])
    return (angle + pi) % (2.0 * pi) - pi


def _turning(one: BodyState, two: BodyState, axis: Vector) -> float:
    """Returns the angular velocity of body2 relative to body1 about an axis, rad/s."""
    return dot(minus(two.angular_velocity, one.angular_velocity), axis)


def _sliding(joint: Joint, one: BodyState, two: BodyState, axis: Vector) -> float:
    """Returns the velocity of body2's anchor relative to body1 along an axis, m/s."""
    arm2 = rotate(two.quaternion, joint.anchor2)
    arm1 = minus(plus(two.position, arm2), one.position)
    tip1 = plus(one.linear_velocity, cross(one.angular_velocity, arm1))
    tip2 = plus(two.linear_velocity, cross(two.angular_velocity, arm2))
    return dot(minus(tip2, tip1), axis)


@lru_cache(maxsize=8)
def _empty_model(scenery: Scenery) -> tuple[CompiledModel, mujoco.MjData]:
    """Returns a scene without bodies. The first step replaces it, so it is only looked at: all scenes share it."""
    compiled = compile_model(SceneSpec(timestep=1.0), scenery, {}, {}, Forest(), {}, ())
    return compiled, mujoco.MjData(compiled.model)
