"""State transfer from one compiled model of a running scene to the next: coordinates, velocities and warm start.

- Structures that no edit touched keep their coordinates, velocities and warm start bit for bit.
- Touched ones keep every joint's coordinate and the pose of their root. Their velocities are the ones that the tree
  can have and that carry the bodies' momentum: the mass-weighted projection `M qvel = sum J^T p`, exact where the
  motion fits the joints, and a perfectly inelastic catch where two moving bodies are joined.

All functions work on a model as `compiler.compile_model` returned it, and its data. The edited bodies and their motion
(`states`) come from the simulation; an edit touches a whole structure, and frozen bodies end one.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Mapping
from math import asin, atan2, cos, sin
from typing import Any, NamedTuple

import mujoco
import numpy as np

from nmes.backend import Array, BodyState, Quaternion, Vector
from nmes.backend.rotation import conjugate, dot, minus, multiply, normalize, plus, rotate
from nmes.backends.mujoco3d.forest import Body, Forest, Joint, perpendicular_axes, relative_orientation
from nmes.backends.mujoco3d.model import CompiledModel, Slot

__all__ = [
    "affected_bodies",
    "ball_orientations",
    "freed_loop_joints",
    "place_body",
    "rezero",
    "transfer_state",
]


def affected_bodies(touched: Iterable[int], bodies: Mapping[int, Body], joints: Iterable[Joint]) -> set[int]:
    """Returns the movable bodies of all structures that were touched."""
    neighbours: dict[int, list[int]] = {}
    for joint in joints:
        neighbours.setdefault(joint.body1, []).append(joint.body2)
        neighbours.setdefault(joint.body2, []).append(joint.body1)
    affected = {body for body in touched if body in bodies}
    stack = sorted(affected)
    while stack:
        body = stack.pop()
        if bodies[body].frozen:
            continue
        for other in neighbours.get(body, ()):
            if other not in affected:
                affected.add(other)
                stack.append(other)
    return {body for body in affected if not bodies[body].frozen}


# -- loops that end --------------------------------------------------------------------------------------------------


def freed_loop_joints(forest: Forest, old: CompiledModel) -> list[Joint]:
    """Returns the joints that closed a loop and now are part of a tree."""
    loops = {joint.number for joint in old.forest.loops}
    return [joint for _, joint in forest.parent.values() if joint.number in loops]


def rezero(joint: Joint, one: BodyState, two: BodyState, at: float) -> None:
    """Makes a joint with coordinate `at` fit exactly where its bodies are.

    A loop is held by soft constraints, to within micrometres; a tree is exact. Without this a cube would jump by that
    difference when another joint of its loop is cut.
    """
    turn = relative_orientation(one.quaternion, two.quaternion)
    arm = minus(two.position, one.position)
    anchor = plus(rotate(conjugate(one.quaternion), arm), rotate(turn, joint.anchor2))
    if joint.kind == "hinge":
        joint.zero = normalize(multiply(turn, _about(joint.axis2, -at)))
    elif joint.form not in ("ball", "cone"):
        joint.zero = normalize(turn)
        axis1 = rotate(joint.zero, joint.axis2)
        anchor = (anchor[0] - at * axis1[0], anchor[1] - at * axis1[1], anchor[2] - at * axis1[2])
    joint.anchor1 = anchor


# -- coordinates and velocities --------------------------------------------------------------------------------------


def ball_orientations(
    joints: Iterable[Joint], states: Container[int], state_of: Callable[[int], BodyState]
) -> dict[int, Quaternion]:
    """Returns the orientations of the balls of edited structures, of body2 seen from body1, by joint."""
    return {
        joint.number: relative_orientation(state_of(joint.body1).quaternion, state_of(joint.body2).quaternion)
        for joint in joints
        if joint.form in ("ball", "cone") and (joint.body1 in states or joint.body2 in states)
    }


class _Arrays(NamedTuple):
    """The arrays of an MjData that hold coordinates, velocities and warm start."""

    qpos: Array
    qvel: Array
    warm_start: Array

    @classmethod
    def of(cls, data: Any) -> _Arrays:
        return cls(data.qpos, data.qvel, data.qacc_warmstart)

    def copy(self, slot: Slot, source: _Arrays, source_slot: Slot) -> None:
        """Copies a coordinate with its velocity and warm start, bit for bit."""
        q, v, source_q, source_v = slot.q, slot.v, source_slot.q, source_slot.v
        self.qpos[q : q + slot.nq] = source.qpos[source_q : source_q + slot.nq]
        self.qvel[v : v + slot.nv] = source.qvel[source_v : source_v + slot.nv]
        self.warm_start[v : v + slot.nv] = source.warm_start[source_v : source_v + slot.nv]


def transfer_state(
    old: CompiledModel,
    source: Any,
    new: CompiledModel,
    target: Any,
    joints: Mapping[int, Joint],
    states: Mapping[int, BodyState],
    balls: Mapping[int, Quaternion],
) -> None:
    """Fills the coordinates, velocities and warm start of fresh data.

    Args:
        old: The model of `source`, the data until now.
        source: See above.
        new: The model of `target`, data as MuJoCo makes it.
        target: See above.
        joints: All joints.
        states: The states of the bodies of edited structures.
        balls: The orientations that `ball_orientations` returned before the edit was installed.
    """
    before, after = _Arrays.of(source), _Arrays.of(target)
    jointed: set[int] = set()  # bodies of edited structures that hang on joints
    for body, slot in new.free.items():
        state = states.get(body)
        if state is None:
            after.copy(slot, before, old.free[body])
        else:
            place_body(target, slot, state)
    for number, slot in new.joint.items():
        joint, old_slot = joints[number], old.joint.get(number)
        if joint.body1 not in states and joint.body2 not in states and old_slot is not None:
            after.copy(slot, before, old_slot)
            continue
        jointed |= {joint.body1, joint.body2}
        if joint.form == "ball":
            after.qpos[slot.q : slot.q + 4] = _ball(joint.zero, balls[number], slot.flipped)
        elif joint.form == "cone":
            after.qpos[slot.q : slot.q + 3] = _cone(joint, balls[number], slot.flipped)
        else:
            after.qpos[slot.q] = joint.held_at if old_slot is None else before.qpos[old_slot.q]
    fixed = {end for joint in joints.values() if joint.kind == "fixed" for end in (joint.body1, joint.body2)}
    jointed |= fixed & states.keys()
    if jointed:
        _project(new, target, joints, states, jointed)


def place_body(data: Any, slot: Slot, state: BodyState) -> None:
    """Sets the coordinates of a free body."""
    x, y, z, w = state.quaternion
    data.qpos[slot.q : slot.q + 7] = (*state.position, w, x, y, z)
    data.qvel[slot.v : slot.v + 6] = (
        *state.linear_velocity,
        *rotate(conjugate(state.quaternion), state.angular_velocity),
    )
    data.qacc_warmstart[slot.v : slot.v + 6] = 0.0


def _project(
    new: CompiledModel, data: Any, joints: Mapping[int, Joint], states: Mapping[int, BodyState], jointed: Container[int]
) -> None:
    """Gives edited trees the generalized velocity that carries their bodies' momentum."""
    model = new.model
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_makeM(model, data)
    mujoco.mj_factorM(model, data)
    parts = [(new.body_index[body], body) for body in states]
    parts += [(index, body) for index, body in new.loop_proxy.values() if body in states]
    momentum = np.zeros(model.nv)
    for index, body in sorted(parts):
        state = states[body]
        turn = data.ximat[index].reshape(3, 3)
        own = (turn.T * state.angular_velocity).sum(axis=1)  # not `@`: BLAS adds up as it suits the processor
        spin = (turn * (model.body_inertia[index] * own)).sum(axis=1)
        push = model.body_mass[index] * np.array(state.linear_velocity)
        mujoco.mj_applyFT(model, data, push, spin, data.xipos[index], index, momentum)
    velocity = np.zeros((1, model.nv))
    mujoco.mj_solveM(model, data, velocity, momentum.reshape(1, -1))
    slots = [slot for body, slot in new.free.items() if body in states and body in jointed]
    slots += [
        slot for number, slot in new.joint.items() if joints[number].body1 in states or joints[number].body2 in states
    ]
    for slot in slots:
        data.qvel[slot.v : slot.v + slot.nv] = velocity[0, slot.v : slot.v + slot.nv]


def _ball(zero: Quaternion, turn: Quaternion, flipped: bool) -> list[float]:
    """Returns the coordinate (w, x, y, z) of a ball joint: the rotation of the child from its orientation at zero."""
    x, y, z, w = normalize(multiply(zero, conjugate(turn)) if flipped else multiply(conjugate(zero), turn))
    return [w, x, y, z]


def _cone(joint: Joint, turn: Quaternion, flipped: bool) -> list[float]:
    """Returns the coordinates of a cone in the order of its hinges, rad: the swings about two axes, and the twist."""
    x, y, z, w = normalize(multiply(conjugate(joint.zero), turn))
    u, v = perpendicular_axes(joint.axis2)
    # The same rotation with the axis as x, u as y and v as z: Ry(a) Rz(b) Rx(twist).
    x, y, z = (dot((x, y, z), one) for one in (joint.axis2, u, v))
    b = asin(max(-1.0, min(1.0, 2.0 * (x * y + z * w))))
    a = atan2(2.0 * (y * w - x * z), 1.0 - 2.0 * (y * y + z * z))
    twist = atan2(2.0 * (x * w - y * z), 1.0 - 2.0 * (x * x + z * z))
    return [twist, b, a] if flipped else [a, b, twist]


def _about(axis: Vector, angle: float) -> Quaternion:
    s = sin(angle / 2.0)
    return (axis[0] * s, axis[1] * s, axis[2] * s, cos(angle / 2.0))
