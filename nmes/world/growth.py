"""How a creature that lives gains parts of its body: they grow, or are made of cubes that are there.

Hides by which joint a part hangs, what it is called where another still has its name, and what comes along with it.

Invariants:

- What is refused has changed nothing.
- What grows brings no momentum, and what was there in its place takes none along: the whole body is as much slower, or
  faster. Else who throws a part backwards, and grows it anew in front, would fly.
"""

from __future__ import annotations

from collections.abc import Callable, Container
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from nmes.errors import WorldError
from nmes.genome.body import overlaps
from nmes.world.building import (
    ORIGIN,
    TOUCHING,
    cube_command,
    grown_part,
    hanging_joint,
    joint_command,
    joint_where,
    require_free,
)
from nmes.world.limbs import beyond
from nmes.world.momentum import keep_momentum, moving
from nmes.world.structure import connected_cubes

if TYPE_CHECKING:
    from nmes.genome.body import BodyCube, BodyJoint
    from nmes.world.creature import Creature
    from nmes.world.entities import Cube, Entities, Joint

__all__ = ["adopt", "grow", "hold", "may_hang", "regrow"]

_NAME_LENGTH = 128


def grow(entities: Entities, creature: Creature, part: str) -> Cube:
    """Grows a part of a creature that is not there, at rest where its body has it; returns the new cube.

    The body keeps its momentum, and so is slower, having more mass.

    Raises:
        WorldError: `cube_not_found`: its body has no such part, or what that hangs on is not there; `invalid`: the part
            is there; `no_room`: it would be in another cube, or in the ground; `limit_reached`; `joint_exists`.
    """
    before = moving(entities, connected_cubes(hold(creature, part)[2], entities.joints))
    new = _grow(entities, creature, part, checked=False)
    creature.jolted += keep_momentum(entities, connected_cubes(before[0].cube, entities.joints), before)
    return new


def _grow(entities: Entities, creature: Creature, part: str, *, checked: bool) -> Cube:
    """Grows a part; `checked`: where it comes to be was looked at before."""
    joint, base, cube = hold(creature, part)
    entities.require_room(cubes=1, joints=1)
    name = _free_name(creature, part, entities.cubes)
    joint_name = _free_name(creature, joint.id, entities.joints)
    grown, motion = grown_part(entities, _shape(creature, part), base, cube)
    if not checked:
        require_free(entities, grown, [cube])
    entities.require_joinable([(cube, replace(cube, name=name, body=-1, joints={}))], "part")
    new = entities.spawn({**cube_command(grown, creature.name, ORIGIN), "cube_name": name, **motion})
    new.player = cube.player
    made = _join(entities, part, new, (joint, base, cube), joint_name)
    creature.extend({part: new}, {joint.id: made})
    return new


def regrow(entities: Entities, creature: Creature, part: str) -> None:
    """Grows a part that is there anew, with all that hangs on it alone: each where the creature's form has it, at rest.

    The body keeps its momentum, but for that of the mass that is gone where parts are smaller.

    Raises:
        WorldError: `no_room`.
    """
    gone = beyond(*creature.there, part)
    numbers = {cube.body for cube in gone}
    there = creature.there[0]
    again = [name for name, cube in there.items() if cube.body in numbers]
    kept = {name: cube for name, cube in there.items() if name not in again}
    joint = hanging_joint(creature.form, part, kept)
    assert joint is not None  # it hangs on the root, and not through itself
    base = joint.cube2 if joint.cube1 == part else joint.cube1
    placed: list[BodyCube] = []
    for name in again:  # all are at rest, and so move with what the first hangs on
        grown, _ = grown_part(entities, _shape(creature, name), _shape(creature, base), kept[base])
        require_free(entities, grown, [kept[base], *gone])
        placed.append(grown)
    joined = {frozenset((each.cube1, each.cube2)) for each in creature.form.joints}
    sizes = np.array([each.size for each in placed])
    places = np.array([[*each.position, *each.quaternion] for each in placed])
    for number, one in enumerate(placed[:-1], 1):
        depths = overlaps(one, sizes[number:], places[number:]).tolist()
        for other, depth in zip(placed[number:], depths, strict=True):
            if depth > TOUCHING and {one.id, other.id} not in joined:
                raise WorldError("no_room", f"{one.id!r} would be in {other.id!r}", "part")
    masses = {there[name].name: _shape(creature, name).mass for name in again}
    before = moving(entities, connected_cubes(kept[base], entities.joints))
    for cube in gone:
        entities.despawn(cube)
    creature.settle()
    while again:
        name = next(each for each in again if may_hang(creature, each))
        again.remove(name)
        _grow(entities, creature, name, checked=True)
    whole = connected_cubes(kept[base], entities.joints)
    still = {id(cube) for cube in (*whole, *gone)}  # and not what somebody else had joined to what is gone
    lasting = [each._replace(mass=min(each.mass, masses.get(each.cube.name, each.mass))) for each in before]
    creature.jolted += keep_momentum(entities, whole, [each for each in lasting if id(each.cube) in still])


def may_hang(creature: Creature, part: str) -> bool:
    """Whether what a part hangs on is there."""
    return hanging_joint(creature.form, part, creature.there[0]) is not None


def _shape(creature: Creature, part: str) -> BodyCube:
    """Returns a part as the creature's form has it."""
    return next(each for each in creature.form.cubes if each.id == part)


def adopt(entities: Entities, creature: Creature, part: str, cube: Cube, is_part: Callable[[int], bool]) -> None:
    """Makes a cube of the world a part of a creature that is not there, joined where it is now, at position 0.

    What the body's other joints, where they are still there under their first names, hold to it comes along, but for
    what is a part by now.

    Args:
        entities: Where.
        creature: Who gains the part.
        part: Its id.
        cube: What becomes it, which is no part.
        is_part: Tells whether a cube, by its number in the engine, is a part of some creature.

    Raises:
        WorldError: As by `grow`, but for want of room.
    """
    held = hold(creature, part)
    entities.require_room(joints=1)
    made = _join(entities, part, cube, held, _free_name(creature, held[0].id, entities.joints))
    cubes, joints = creature.there
    more_cubes, more_joints = {part: cube}, {held[0].id: made}
    while (found := _also(entities, creature, cubes | more_cubes, joints | more_joints, is_part)) is not None:
        one, old, fresh = found
        more_joints[one.id] = old
        more_cubes |= fresh
    creature.extend(more_cubes, more_joints)


def _also(
    entities: Entities,
    creature: Creature,
    cubes: dict[str, Cube],
    joints: dict[str, Joint],
    is_part: Callable[[int], bool],
) -> tuple[BodyJoint, Joint, dict[str, Cube]] | None:
    """Returns a joint of a body that is there as at birth on one of some cubes, and is not one of some joints.

    And what hangs on it, where it is none of these cubes; a joint to what is a part by now is passed over.
    """
    taken = {cube.body for cube in cubes.values()}
    for each in creature.body.joints:
        old = entities.joints.get(f"{creature.name}.{each.id}")
        if old is None or each.id in joints or old.kind != each.kind:
            continue
        ends = {each.cube1: old.cube1, each.cube2: old.cube2}
        own = {end: cubes[end].name if end in cubes else f"{creature.name}.{end}" for end in ends}
        if cubes.keys().isdisjoint(ends) or any(held.name != own[end] for end, held in ends.items()):
            continue
        fresh = {end: held for end, held in ends.items() if end not in cubes}
        if not any(held.body in taken or is_part(held.body) for held in fresh.values()):
            return each, old, fresh
    return None


def hold(creature: Creature, part: str) -> tuple[BodyJoint, BodyCube, Cube]:
    """Returns the joint by which a part that is not there hangs on one that is; that, and its cube.

    Raises:
        WorldError: `cube_not_found`, `invalid`.
    """
    cubes, _ = creature.there
    if part in cubes:
        raise WorldError("invalid", f"part: {creature.name!r} has its part {part!r}", "part")
    joint = hanging_joint(creature.form, part, cubes)
    if joint is None:
        known = any(each.id == part for each in creature.body.cubes)
        why = "what it hangs on is not there" if known else "its body has none"
        raise WorldError("cube_not_found", f"{creature.name!r} can have no part {part!r} now: {why}", "part")
    base = joint.cube2 if joint.cube1 == part else joint.cube1
    return joint, _shape(creature, base), cubes[base]


def _free_name(creature: Creature, part: str, taken: Container[str]) -> str:
    """Returns a name for a part in the world, with a number where one that was lost still has its name.

    Raises:
        WorldError: `invalid`: it is too long.
    """
    name, number = f"{creature.name}.{part}", 1
    while name in taken:
        number += 1
        name = f"{creature.name}.{part}.{number}"
    if len(name) > _NAME_LENGTH:
        raise WorldError("invalid", f"part: with a number the name {name!r} is too long", "part")
    return name


def _join(entities: Entities, part: str, cube: Cube, held_by: tuple[BodyJoint, BodyCube, Cube], name: str) -> Joint:
    """Makes the joint by which a cube becomes a part.

    Raises:
        WorldError: As by `connect`; nothing has changed.
    """
    joint, base, held = held_by
    ends = {base.id: held.name, part: cube.name}
    here = joint_where(joint, base, entities.simulation.body_state(held.body))
    command = {**joint_command(here, "", ORIGIN), "cube1": ends[joint.cube1], "cube2": ends[joint.cube2]}
    return entities.joint(entities.connect({**command, "joint_name": name}, joint.kind, "joint"))
