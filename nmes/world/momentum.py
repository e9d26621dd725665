"""The momentum of structures: it stays what it was where cubes come to them out of nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from nmes.backend import BodyState, Vector
from nmes.backend.rotation import dot, minus, plus, total

if TYPE_CHECKING:
    from nmes.world.entities import Cube, Entities

__all__ = ["Moving", "keep_momentum", "moving"]


class Moving(NamedTuple):
    """A cube with a state that it has or had.

    Attributes:
        cube: The cube, which may be gone by now.
        mass: How much of its mass counts, kg.
        state: Its pose and velocities.
    """

    cube: Cube
    mass: float
    state: BodyState


def moving(entities: Entities, cubes: Sequence[Cube]) -> list[Moving]:
    """Returns cubes as they move now."""
    return [Moving(cube, cube.mass, entities.simulation.body_state(cube.body)) for cube in cubes]


def keep_momentum(entities: Entities, cubes: Sequence[Cube], before: Sequence[Moving]) -> float:
    """Gives a structure the momentum that was there before some of its cubes came: all get the same velocity more.

    So joints go on as they went. Where one of the cubes is frozen nothing is done: that one takes any momentum.

    Args:
        entities: Where.
        cubes: The whole structure.
        before: What it was made of.

    Returns:
        How much energy of motion that gave the cubes that were there before, J.
    """
    if any(cube.frozen for cube in cubes):
        return 0.0
    now = moving(entities, cubes)
    lacks = minus(_momentum(before), _momentum(now))
    if not any(lacks):
        return 0.0
    mass = total(each.mass for each in now)
    more = (lacks[0] / mass, lacks[1] / mass, lacks[2] / mass)
    for each in now:  # no edit to be counted: that a cube has come is one
        state = replace(each.state, linear_velocity=plus(each.state.linear_velocity, more))
        entities.simulation.set_body_state(each.cube.body, state)
    there = {id(each.cube) for each in before}
    old = [each for each in now if id(each.cube) in there]
    return dot(_momentum(old), more) + total(each.mass for each in old) * dot(more, more) / 2.0


def _momentum(parts: Sequence[Moving]) -> Vector:
    velocities = [part.state.linear_velocity for part in parts]
    masses = [part.mass for part in parts]
    x, y, z = (total(m * v[at] for m, v in zip(masses, velocities, strict=True)) for at in range(3))
    return x, y, z
