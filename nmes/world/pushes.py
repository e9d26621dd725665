"""What clients pushed last, for whoever watches a world: part of no state, no digest and no recording."""

from __future__ import annotations

from nmes.schemas.documents import JsonObject

__all__ = ["Pushes"]


class Pushes:
    """The `apply_physics` commands of the last frame in which there was one.

    Attributes:
        frame: That frame; -1 where nothing was pushed yet.
        commands: The last of them for each cube, by the cube's name.
    """

    __slots__ = ("commands", "frame")

    def __init__(self) -> None:
        self.frame = -1
        self.commands: dict[str, JsonObject] = {}

    def note(self, frame: int, cube: str, command: JsonObject) -> None:
        """Notes a command that was carried out."""
        if frame != self.frame:  # so there are never more than there are cubes
            self.frame = frame
            self.commands.clear()
        self.commands[cube] = command
