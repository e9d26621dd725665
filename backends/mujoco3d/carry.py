"""Taking a running scene's state over into another model: coordinates, velocities, warm start and sleep.

- Structures that no edit touched keep their coordinates, velocities and warm start bit for bit, and their sleep.
- Touched ones keep every joint's coordinate and the pose of their root. Their velocities are the ones that the tree
  can have and that carry the bodies' momentum: the mass-weighted projection `M qvel = sum J^T p`, exact where the
  motion fits the joints, and a perfectly inelastic catch where two moving bodies are joined.

All functions work on a model and its data as `layout.build` laid them out. Which bodies were edited, and how they move
(`states`), comes from the simulation; an edit touches a whole structure, and frozen bodies end one.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Container, Iterable, Mapping
from math import asin, atan2, cos, sin
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from nmes.backend import BodyState, Quaternion, Vector
from nmes.backend.rotation import conjugate, dot, multiply, normalize, rotate
from nmes.backends.mujoco3d.layout import Body, Forest, Joint, Layout, Slot, across, relative

__all__ = ["AWAKE", "affected", "carry", "kept_sleep", "place", "promoted", "put_sleep", "rezero", "turns"]

AWAKE = -(1 + mujoco.mjMINAWAKE)
"""`tree_asleep` of a tree that has just woken."""


def affected(touched: Iterable[int], bodies: Mapping[int, Body], joints: Iterable[Joint]) -> set[int]:
    """Returns the movable bodies of all structures that were touched."""
    neighbours: dict[int, list[int]] = {}
    for joint in joints:
        neighbours.setdefault(joint.body1, []).append(joint.body2)
        neighbours.setdefault(joint.body2, []).append(joint.body1)
    found = {body for body in touched if body in bodies}
    stack = sorted(found)
    while stack:
        here = stack.pop()
        if bodies[here].frozen:
            continue
        for other in neighbours.get(here, ()):
            if other not in found:
                found.add(other)
                stack.append(other)
    return {body for body in found if not bodies[body].frozen}


# -- loops that end --------------------------------------------------------------------------------------------------


def promoted(forest: Forest, old: Layout) -> list[Joint]:
    """Returns the joints that closed a loop and now are part of a tree."""
    loops = {joint.number for joint in old.forest.loops}
    return [joint for _, joint in forest.parent.values() if joint.number in loops]


def rezero(joint: Joint, one: BodyState, two: BodyState, at: float) -> None:
    """Makes a joint with coordinate `at` fit exactly where its bodies are.

    A loop is held by soft constraints, to within micrometres; a tree is exact. Without this a cube would jump by that
    difference when another joint of its loop is cut.
    """
    turn = relative(one.quaternion, two.quaternion)
    arm = (
        two.position[0] - one.position[0],
        two.position[1] - one.position[1],
        two.position[2] - one.position[2],
    )
    there, tip = rotate(conjugate(one.quaternion), arm), rotate(turn, joint.anchor2)
    anchor = (there[0] + tip[0], there[1] + tip[1], there[2] + tip[2])
    if joint.kind == "hinge":
        joint.zero = normalize(multiply(turn, _about(joint.axis2, -at)))
    elif joint.form not in ("ball", "cone"):
        joint.zero = normalize(turn)
        axis1 = rotate(joint.zero, joint.axis2)
        anchor = (anchor[0] - at * axis1[0], anchor[1] - at * axis1[1], anchor[2] - at * axis1[2])
    joint.anchor1 = anchor


# -- coordinates and velocities --------------------------------------------------------------------------------------


def turns(
    joints: Iterable[Joint], states: Container[int], state_of: Callable[[int], BodyState]
) -> dict[int, Quaternion]:
    """Returns how the balls of edited structures stand: the orientation of body2 seen from body1, by joint."""
    return {
        joint.number: relative(state_of(joint.body1).quaternion, state_of(joint.body2).quaternion)
        for joint in joints
        if joint.form in ("ball", "cone") and (joint.body1 in states or joint.body2 in states)
    }


def carry(
    old: Layout,
    source: Any,
    new: Layout,
    target: Any,
    joints: Mapping[int, Joint],
    states: Mapping[int, BodyState],
    balls: Mapping[int, Quaternion],
) -> None:
    """Fills the coordinates, velocities and warm start of fresh data.

    Args:
        old: The layout of `source`, the data until now.
        source: See above.
        new: The layout of `target`, data as MuJoCo makes it.
        target: See above.
        joints: All joints.
        states: The bodies of edited structures, and how they move.
        balls: What `turns` returned before the edit was installed.
    """
    fields = [
        (target.qpos, source.qpos),
        (target.qvel, source.qvel),
        (target.qacc_warmstart, source.qacc_warmstart),
    ]

    def copy(to: Slot, by: Slot) -> None:
        for (into, out), a, b, n in zip(
            fields, (to.q, to.v, to.v), (by.q, by.v, by.v), (to.nq, to.nv, to.nv), strict=True
        ):
            into[a : a + n] = out[b : b + n]

    jointed: set[int] = set()  # bodies of edited structures that hang on joints
    for body, slot in new.free.items():
        state = states.get(body)
        if state is None:
            copy(slot, old.free[body])
        else:
            place(target, slot, state)
    for number, slot in new.joint.items():
        joint, was = joints[number], old.joint.get(number)
        if joint.body1 not in states and joint.body2 not in states and was is not None:
            copy(slot, was)
            continue
        jointed |= {joint.body1, joint.body2}
        if joint.form == "ball":
            target.qpos[slot.q : slot.q + 4] = _ball(joint.zero, balls[number], slot.flipped)
        elif joint.form == "cone":
            target.qpos[slot.q : slot.q + 3] = _cone(joint, balls[number], slot.flipped)
        elif was is not None:
            target.qpos[slot.q] = source.qpos[was.q]
    fixed = {end for joint in joints.values() if joint.kind == "fixed" for end in (joint.body1, joint.body2)}
    jointed |= fixed & states.keys()
    if jointed:
        _project(new, target, joints, states, jointed)


def place(data: Any, slot: Slot, state: BodyState) -> None:
    """Sets the coordinates of a free body."""
    x, y, z, w = state.quaternion
    data.qpos[slot.q : slot.q + 7] = (*state.position, w, x, y, z)
    data.qvel[slot.v : slot.v + 6] = (
        *state.linear_velocity,
        *rotate(conjugate(state.quaternion), state.angular_velocity),
    )
    data.qacc_warmstart[slot.v : slot.v + 6] = 0.0


def _project(
    new: Layout, data: Any, joints: Mapping[int, Joint], states: Mapping[int, BodyState], jointed: Container[int]
) -> None:
    """Gives edited trees the generalized velocity that carries their bodies' momentum."""
    model = new.model
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_makeM(model, data)
    mujoco.mj_factorM(model, data)
    parts = [(new.body[body], body) for body in states]
    parts += [(index, body) for index, body in new.twin.values() if body in states]
    momentum = np.zeros(model.nv)
    for index, body in sorted(parts):
        state = states[body]
        turn = data.ximat[index].reshape(3, 3)
        spin = turn @ (model.body_inertia[index] * (turn.T @ np.array(state.angular_velocity)))
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
    """The coordinate (w, x, y, z) of a ball joint: how the child is turned from its orientation at zero."""
    x, y, z, w = normalize(multiply(zero, conjugate(turn)) if flipped else multiply(conjugate(zero), turn))
    return [w, x, y, z]


def _cone(joint: Joint, turn: Quaternion, flipped: bool) -> list[float]:
    """The coordinates of a cone, in the order of its hinges: how far it is swung about two axes, and twisted."""
    x, y, z, w = normalize(multiply(conjugate(joint.zero), turn))
    u, v = across(joint.axis2)
    # The same rotation with the axis as x, u as y and v as z: Ry(a) Rz(b) Rx(twist).
    x, y, z = (dot((x, y, z), one) for one in (joint.axis2, u, v))
    b = asin(max(-1.0, min(1.0, 2.0 * (x * y + z * w))))
    a = atan2(2.0 * (y * w - x * z), 1.0 - 2.0 * (y * y + z * z))
    twist = atan2(2.0 * (x * w - y * z), 1.0 - 2.0 * (x * x + z * z))
    return [twist, b, a] if flipped else [a, b, twist]


def _about(axis: Vector, angle: float) -> Quaternion:
    s = sin(angle / 2.0)
    return (axis[0] * s, axis[1] * s, axis[2] * s, cos(angle / 2.0))


# -- sleep -----------------------------------------------------------------------------------------------------------


def kept_sleep(
    layout: Layout, asleep: npt.NDArray[np.int32], edited: Container[int], bodies: Collection[int]
) -> dict[int, int]:
    """Returns what may be kept of `tree_asleep`, with trees named by the keys of their first bodies.

    A negative value is the count-down of a tree that is awake; another is the key of the next tree of a sleeping
    island. An island in which anything was edited, or is not among the `bodies` any more, wakes.
    """
    model, links = layout.model, asleep.tolist()
    keys = [layout.key.get(int(index)) for index in model.tree_bodyadr]  # None: parked
    gone = {
        int(model.body_treeid[index])
        for index, body in layout.number.items()
        if (body in edited or body not in bodies) and model.body_treeid[index] >= 0
    }
    for tree in sorted(gone):
        while (following := links[tree]) >= 0:
            links[tree] = AWAKE
            gone.add(tree := following)
    kept = {}
    for tree, link in enumerate(links):
        key, following_key = keys[tree], keys[link] if link >= 0 else link
        if key is not None and following_key is not None and tree not in gone:
            kept[key] = following_key
    return kept


def put_sleep(layout: Layout, kept: Mapping[int, int]) -> npt.NDArray[np.int32]:
    """Returns `tree_asleep` for a model that may have other trees, from what was kept; parked bodies always sleep."""
    model = layout.model
    tree_of = {layout.key.get(int(index)): tree for tree, index in enumerate(model.tree_bodyadr)}
    asleep = np.full(model.ntree, AWAKE, np.int32)
    for key, link in kept.items():
        asleep[tree_of[key]] = link if link < 0 else tree_of[link]
    parked = model.body_treeid[layout.spares]
    asleep[parked] = parked
    return asleep
