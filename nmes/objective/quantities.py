"""The quantities that expressions name: each name with its meaning and unit, and what is made of it over time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

__all__ = ["CUBE_QUANTITIES", "FOLDS", "MEETING_QUANTITIES", "QUANTITIES", "Cast", "Quantity", "meeting_name"]

_AXES = {"x": "along x", "y": "upwards", "z": "along z"}


def _vector(name: str, meaning: str, unit: str) -> dict[str, tuple[str, str]]:
    return {f"{name}.{axis}": (f"{meaning}, {along}", unit) for axis, along in _AXES.items()}


# What can be said of one cube as well as of a whole body.
CUBE_QUANTITIES: Final[Mapping[str, tuple[str, str]]] = {
    **_vector("position", "where the centre of mass is", "m"),
    **_vector("displacement", "how far the centre of mass is from where it was at the start", "m"),
    "displacement.horizontal": ("the same over the ground: the length of its x and z", "m"),
    **_vector("velocity", "velocity of the centre of mass", "m/s"),
    "speed": ("length of that velocity", "m/s"),
    "distance": ("from the centre of mass to the target; without one, to where it was at the start", "m"),
    "height": ("y of the centre of mass: how high it is above y = 0", "m"),
    "lowest": ("y of the lowest point of any of its cubes", "m"),
    "highest": ("y of the highest point of any of its cubes", "m"),
    "reach": ("from the centre of mass to the farthest point of any of its cubes", "m"),
    "uprightness": ("cosine of the angle between the first cube's own y axis and up: 1 upright, -1 upside down", ""),
    "contacts": ("how many of its cubes touch something that is not one of them", ""),
}
"""What may be asked of a cube, `cube("id").height`: each name with its meaning and unit."""

QUANTITIES: Final[Mapping[str, tuple[str, str]]] = {
    **CUBE_QUANTITIES,
    "time": ("since the start", "s"),
    "time_upright": ("time so far in which uprightness was at least 0.5, which is 60 degrees from upright", "s"),
    "energy": (
        "work of its motors since the start: the size of effort times velocity, over time",
        "J",
    ),
    "work": ("the same, without what parts that came since have brought along of motion and height", "J"),
    "grown": (
        "how much higher the centre of mass is than at the start, no more than by what has grown since: in the pose "
        "of the document; 0 while it touches nothing that is not one of its cubes",
        "m",
    ),
    "cubes": ("how many cubes it has", ""),
    "mass": ("of all its cubes", "kg"),
}
"""What an expression may name: each name with its meaning and unit."""

FOLDS: Final[Mapping[str, str]] = {
    "final": "at the end, as without a word before it",
    "start": "at the start",
    "min": "the least of the episode, its start included",
    "max": "the greatest of the episode, its start included",
    "mean": "the mean over the episode, its start included",
}
"""What may stand before a quantity, `max.height`."""

MEETING_QUANTITIES: Final[Mapping[str, tuple[str, str]]] = {
    "apart": ("from its centre of mass to that of the other", "m"),
    "touching": ("1 if one of its cubes touches the other, else 0", ""),
    **_vector("after_touch", "how far its centre of mass is from where it was when it first touched the other", "m"),
    "after_touch.horizontal": ("the same over the ground: the length of its x and z", "m"),
}
"""What may be asked of a role and another one, or a prop: `hunter.apart.prey`, `second.after_touch.first.x`."""


@dataclass(frozen=True, slots=True)
class Cast:
    """Whom expressions of a task with roles may name.

    Attributes:
        roles: The names of the roles.
        props: The ids of the props.
    """

    roles: tuple[str, ...]
    props: tuple[str, ...] = ()

    def quantities(self, role: str) -> dict[str, tuple[str, str]]:
        """Returns the quantities of a role's whole body: each name with its meaning and unit."""
        others = [other for other in (*self.roles, *self.props) if other != role]
        pairs = ((name, other) for other in others for name in MEETING_QUANTITIES)
        return {**QUANTITIES, **{meeting_name(name, other): MEETING_QUANTITIES[name] for name, other in pairs}}


def meeting_name(name: str, other: str) -> str:
    """Returns the name of a quantity of `MEETING_QUANTITIES` and another role: `after_touch.first.x`."""
    first, *axis = name.split(".")
    return ".".join([first, other, *axis])


@dataclass(frozen=True, slots=True)
class Quantity:
    """One thing that an expression names.

    Attributes:
        name: Of `QUANTITIES`, or, where there is a cube, of `CUBE_QUANTITIES`; of a role also as in `Cast.quantities`.
        cube: The cube's id, or None for the whole body.
        fold: Of `FOLDS`: what is made of its values over the episode.
        role: Whose, in a task with roles; None elsewhere, and of what is nobody's: the time, and props.
    """

    name: str
    cube: str | None = None
    fold: str = "final"
    role: str | None = None

    def __str__(self) -> str:
        """Returns it as an expression names it."""
        fold = "" if self.fold == "final" else f"{self.fold}."
        role = "" if self.role is None else f"{self.role}."
        return fold + role + ("" if self.cube is None else f'cube("{self.cube}").') + self.name
