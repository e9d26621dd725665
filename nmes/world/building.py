"""How parts of a genome's body become cubes and joints of a world, at birth and later.

A part that grows is where the document has it, seen from the part that it hangs on, wherever that is now, and moves
with it as one rigid body: its joint begins at rest, at position 0, and nothing is flung.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import replace

import numpy as np

from nmes.backend import BodyState, StaticBox, Vector
from nmes.backend.rotation import conjugate, minus, multiply, normalize, plus, rotate, total
from nmes.errors import WorldError
from nmes.genome.body import Body, BodyCube, BodyJoint, overlaps
from nmes.schemas.documents import JsonObject
from nmes.world.entities import Cube, Entities
from nmes.world.structure import StructureMotion

__all__ = [
    "ORIGIN",
    "TOUCHING",
    "cube_command",
    "grown_part",
    "hanging_joint",
    "joint_command",
    "joint_where",
    "require_free",
]

ORIGIN: Vector = (0.0, 0.0, 0.0)
_AXES = {"hinge": (0.0, 0.0, 1.0), "slide": (1.0, 0.0, 0.0)}  # where the document has none
TOUCHING = 1e-4
"""How far cubes may overlap by rounding, as in a genome, m."""
_SUNK = 0.01  # m that a part may be in the ground: a body that rests on it is in it by about a millimetre, and tilts
_BLOCK = 256  # cubes whose overlap is computed at once


def hanging_joint(body: Body, part: str, there: Container[str]) -> BodyJoint | None:
    """Returns the first joint of a body that joins a part to one of those that are there; None where there is none."""
    for joint in body.joints:
        ends = joint.cube1, joint.cube2
        if part in ends and (ends[0] in there or ends[1] in there):
            return joint
    return None


def grown_part(entities: Entities, part: BodyCube, base: BodyCube, cube: Cube) -> tuple[BodyCube, JsonObject]:
    """Returns a part of a body where it grows, and the fields of `spawn_cube` that tell how it moves there.

    Args:
        entities: Where.
        part: What grows.
        base: What it hangs on, as its document has it.
        cube: The same as it is there now.
    """
    rest = BodyState(base.position, base.quaternion, ORIGIN, ORIGIN)
    motion = StructureMotion(rest, entities.simulation.body_state(cube.body), turns=True, rigid=True)
    state = motion.moved(BodyState(part.position, part.quaternion, ORIGIN, ORIGIN))
    grown = replace(part, position=state.position, quaternion=state.quaternion)
    return grown, {"linear_velocity": list(state.linear_velocity), "angular_velocity": list(state.angular_velocity)}


def require_free(entities: Entities, part: BodyCube, spared: Sequence[Cube]) -> None:
    """Raises `no_room` where a part would be in the ground, or in a cube other than some that are spared."""
    box = StaticBox(part.size, part.position, part.quaternion, part.shape)
    shift = minus(entities.terrain.outside([box])[0], box.position)
    if total(each * each for each in shift) > _SUNK**2:
        raise WorldError("no_room", f"{part.id!r} would be in the ground", "part")
    numbers = {cube.body for cube in spared}
    others = [other for other in entities.cubes.values() if other.body not in numbers]
    states = entities.simulation.states([other.body for other in others])
    sizes = np.array([part.size, *(other.size for other in others)])
    reach = np.sqrt((sizes * sizes).sum(axis=1)) / 2.0
    arms = states[:, :3] - np.array(part.position)
    near = np.flatnonzero((arms * arms).sum(axis=1) < (reach[1:] + reach[0]) ** 2)
    for start in range(0, len(near), _BLOCK):
        rows = near[start : start + _BLOCK]
        deep = overlaps(part, sizes[1 + rows], states[rows, :7]) > TOUCHING
        if deep.any():
            first = others[rows[deep.argmax()]]
            raise WorldError("no_room", f"{part.id!r} would be in the cube {first.name!r}", "part")


def joint_where(joint: BodyJoint, base: BodyCube, state: BodyState) -> BodyJoint:
    """Returns a joint of a body as it is where the part that it hangs on is now; `base` is that in the document."""
    turn = normalize(multiply(state.quaternion, conjugate(base.quaternion)))
    anchor = plus(state.position, rotate(turn, minus(joint.anchor, base.position)))
    axis = _AXES.get(joint.kind) if joint.axis is None else joint.axis
    return replace(joint, anchor=anchor, axis=None if axis is None else rotate(turn, axis))


def cube_command(part: BodyCube, name: str, position: Vector) -> JsonObject:
    """Returns the `spawn_cube` command that makes a cube of a creature."""
    command: JsonObject = {
        "cube_name": f"{name}.{part.id}",
        "size": list(part.size),
        "mass": part.mass,
        "position": _shifted(part.position, position),
        "rotation": list(part.quaternion),
    }
    if part.shape != "box":
        command["shape"] = part.shape
    surface = {name: getattr(part, name) for name in ("friction", "restitution", "color", "group")}
    return {**command, **{field: value for field, value in surface.items() if value is not None}}


def joint_command(joint: BodyJoint, name: str, position: Vector) -> JsonObject:
    """Returns the `create_joint` command that makes a joint of a creature: a motor begins at rest, at position 0."""
    command: JsonObject = {
        "joint_name": f"{name}.{joint.id}",
        "cube1": f"{name}.{joint.cube1}",
        "cube2": f"{name}.{joint.cube2}",
        "position": _shifted(joint.anchor, position),
    }
    if joint.axis is not None:
        command["axis"] = list(joint.axis)
    if joint.limits is not None:
        command["limits"] = list(joint.limits)
    for field, value in (("stiffness", joint.stiffness), ("damping", joint.damping)):
        if value:
            command[field] = value
    if joint.motor is not None:
        command["motor_max_force"] = joint.motor.max_effort
        command["target_position" if joint.motor.mode == "position" else "motor_target_velocity"] = 0.0
    return command


def _shifted(point: Vector, by: Vector) -> list[float]:
    return [point[0] + by[0], point[1] + by[1], point[2] + by[2]]
