"""Collision groups: which cubes of a world pass through each other, as its config says.

Hides by which numbers an engine knows the groups, and that it is enough for one of two to name the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from nmes.errors import WorldError

__all__ = ["CollisionGroups"]


class CollisionGroups:
    """The collision groups of a world's config.

    Args:
        config: The complete config.

    Attributes:
        passes: As `SceneSpec.passes` has it.

    Raises:
        WorldError: `invalid`: a group names one that there is not.
    """

    def __init__(self, config: Mapping[str, Any]) -> None:
        groups: Mapping[str, list[str]] = config.get("collision_groups", {})
        self._numbers = {name: number for number, name in enumerate(sorted(groups), 1)}
        passes = dict.fromkeys(self._numbers, 0)
        for name, others in groups.items():
            for i, other in enumerate(others):
                if other not in groups:
                    raise WorldError("invalid", f"there is no group {other!r} here", f"collision_groups/{name}/{i}")
                passes[name] |= 1 << self._numbers[other]
                passes[other] |= 1 << self._numbers[name]
        self.passes = tuple(passes.values())

    def number(self, group: str | None, path: str) -> int:
        """Returns the number of a group in the engine, 0 for none.

        Raises:
            WorldError: `invalid`: there is no such group; `path` is the field to blame.
        """
        if group is None:
            return 0
        number = self._numbers.get(group)
        if number is None:
            known = f"it has {', '.join(self._numbers)}" if self._numbers else "its config has no collision_groups"
            raise WorldError("invalid", f"the world has no collision group {group!r}: {known}", path)
        return number
