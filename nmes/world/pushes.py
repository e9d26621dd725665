"""What clients pushed last, for whoever watches a world: part of no state, no digest and no recording."""

from __future__ import annotations

from dataclasses import dataclass, field

from nmes.schemas.documents import JsonObject

__all__ = ["Pushes"]


@dataclass(slots=True)
class Pushes:
    """The `apply_physics` commands of the last frame in which there was one.

    Attributes:
        frame: That frame; -1 where nothing was pushed yet.
        commands: The last of them for each cube, by the cube's name.
    """

    frame: int = -1
    commands: dict[str, JsonObject] = field(default_factory=dict)
