"""When a world saves itself: the schedule of its keyframes.

Keyframes count from the last reset, so that what a world answers after one does not depend on what was before. Where
episodes are shorter than the time between two keyframes, a reset is the place for the one that came due in the episode
that it ends.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from typing import Any

from nmes.backend import Backend

__all__ = ["KeyframeSchedule"]


class KeyframeSchedule:
    """The ticks at which keyframes are due.

    Args:
        config: The world's complete config; `keyframes` is the time between two of them, s.
        backend: The engine; one that has no snapshots has no keyframes.

    Attributes:
        due: The number of ticks, over all resets, at which the next keyframe is due; infinite where there is none.
    """

    def __init__(self, config: Mapping[str, Any], backend: Backend) -> None:
        seconds = config.get("keyframes", 0) if "snapshot" in backend.capabilities else 0
        self._every = max(1, round(seconds * config["tick_rate"])) if seconds else 0
        self.due: float = inf
        self.advance(0, 0)

    def advance(self, past: int, frame: int) -> None:
        """Sets the next keyframe after a frame; `past` is the number of ticks before the last reset."""
        if self._every:
            self.due = past + (frame // self._every + 1) * self._every

    def restart(self, began: int, past: int) -> None:
        """Sets the next keyframe at a reset: at once, where a short episode had one due.

        Args:
            began: The number of ticks, over all resets, at which the episode began that ends now.
            past: The number of ticks now.
        """
        every = self._every
        if every and past - began < every and began // every < past // every:
            self.due = past
        else:
            self.advance(past, 0)
