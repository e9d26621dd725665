"""Structures: cubes that joints connect, and how one of them that is put elsewhere takes the others along.

Hides the rigid motion: the same turn and shift for all, and velocities that suit it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from nmes.backend import BodyState, Quaternion
from nmes.backend.rotation import conjugate, cross, minus, multiply, normalize, plus, rotate

if TYPE_CHECKING:
    from nmes.world.entities import Cube, Joint

__all__ = ["StructureMotion", "connected_cubes", "joined_cubes", "most_connected"]

UNTURNED: Quaternion = (0.0, 0.0, 0.0, 1.0)


def connected_cubes(cube: Cube, joints: Mapping[str, Joint]) -> list[Cube]:
    """Returns the cubes that joints connect with a cube, itself first."""
    numbers, cubes = {cube.body}, [cube]
    for here in cubes:  # grows meanwhile
        for name in here.joints:
            joint = joints[name]
            other = joint.cube2 if joint.cube1 is here else joint.cube1
            if other.body not in numbers:
                numbers.add(other.body)
                cubes.append(other)
    return cubes


def joined_cubes(cube: Cube, joints: Mapping[str, Joint]) -> list[Cube]:
    """Returns a cube, and those that a joint on it goes to."""
    return [cube, *(end for name in cube.joints for end in (joints[name].cube1, joints[name].cube2))]


def most_connected(pairs: Sequence[tuple[Cube, Cube]], joints: Mapping[str, Joint]) -> int:
    """Returns how many cubes the largest structure has that joints between these pairs would make."""
    structures: dict[int, set[int]] = {}  # by body: the bodies of its structure

    def structure(cube: Cube) -> set[int]:
        if cube.body not in structures:
            bodies = {other.body for other in connected_cubes(cube, joints)}
            structures.update(dict.fromkeys(bodies, bodies))
        return structures[cube.body]

    most = 0
    for one, two in pairs:
        smaller, larger = sorted((structure(one), structure(two)), key=len)
        if smaller is not larger:
            larger |= smaller
            structures.update(dict.fromkeys(smaller, larger))
            most = max(most, len(larger))
    return most


class StructureMotion:
    """The motion of a structure of which one body is put elsewhere.

    Args:
        old: That body's state before.
        new: That body's state after.
        turns: Whether it is turned at all: where it is not, rounding changes no attitude.
        rigid: Whether velocities become those of one rigid body that has the new ones; else each body keeps its
            velocity relative to that body, turned along.
    """

    def __init__(self, old: BodyState, new: BodyState, *, turns: bool, rigid: bool) -> None:
        self._old, self._new, self._turns, self._rigid = old, new, turns, rigid
        self._turn = multiply(new.quaternion, conjugate(old.quaternion)) if turns else UNTURNED

    def moved(self, state: BodyState) -> BodyState:
        """Returns the new state of another body of the structure."""
        old, new, turn = self._old, self._new, self._turn
        arm = minus(state.position, old.position)
        arm = rotate(turn, arm) if self._turns else arm
        if self._rigid:
            linear, angular = plus(new.linear_velocity, cross(new.angular_velocity, arm)), new.angular_velocity
        else:
            linear = plus(new.linear_velocity, rotate(turn, minus(state.linear_velocity, old.linear_velocity)))
            angular = plus(new.angular_velocity, rotate(turn, minus(state.angular_velocity, old.angular_velocity)))
        quaternion = normalize(multiply(turn, state.quaternion)) if self._turns else state.quaternion
        return BodyState(plus(new.position, arm), quaternion, linear, angular)
