"""What an offspring must be like, so that it may live where it was bred for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

from nmes.backend.shapes import Shape
from nmes.genome.body import Body
from nmes.genome.limits import Limits

__all__ = ["ANY", "Requirements"]


def _none(body: Body) -> Sequence[str]:
    return ()


@dataclass(frozen=True, slots=True)
class Requirements:
    """What a body must be like, and what it may come to sense and say.

    Attributes:
        limits: Its limits.
        planar: Whether it must lie in the plane z = 0.
        further: Returns what else is wrong with a body, in words.
        senses: Types of sensors of cubes that are of use where it will live, besides those that are everywhere.
        channels: The channels on which it may come to speak and hear, each with how many numbers it has.
        shapes: What its parts may come to be besides boxes.
        development: Whether bodies may come to develop.
    """

    limits: Limits = field(default_factory=Limits)
    planar: bool = False
    further: Callable[[Body], Sequence[str]] = _none
    senses: tuple[str, ...] = ()
    channels: tuple[tuple[str, int], ...] = ()
    shapes: tuple[Shape, ...] = ()
    development: bool = False

    def check(self, body: Body) -> list[str]:
        """Returns the reasons why a body does not meet them, in words; none if it does."""
        reasons = [*self.limits.check(body), *self.further(body)]
        if self.planar and not body.planar:
            reasons.append("it leaves the plane z = 0, and the engine knows no other")
        return reasons


ANY: Final = Requirements()
"""What every body meets."""
