"""The sleep of a hosted world: when it is saved and let go, and how it is taken up again.

Both are done in the world's thread. Invariant: a world sleeps only while nobody is in it and nothing moves, and its
recording is whole and closed then.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Future
from time import monotonic

from nmes.errors import RecordingError
from nmes.server.threads import Worker
from nmes.server.world_recorder import WorldRecorder
from nmes.world import World

__all__ = ["Hibernation"]

logger = logging.getLogger(__name__)


class Hibernation:
    """The sleep of one world.

    Attributes:
        failure: Why the world cannot be woken any more; None: it can.
    """

    def __init__(
        self, world: World, worker: Worker, recorder: WorldRecorder | None, deserted: Callable[[], bool]
    ) -> None:
        """Begins with a world that is awake; `deserted` tells whether nobody is in it, nor waits for its disk."""
        self.failure: BaseException | None = None
        self._world, self._worker, self._recorder = world, worker, recorder
        self._deserted = deserted
        self._since = monotonic()  # when somebody was in it last
        self._sleepless = False  # it was to sleep, and what was saved could not be taken up

    @property
    def resting(self) -> bool:
        """Whether the world sleeps, and nobody wakes it."""
        return self._world.asleep and not self._worker.away

    def put_off(self) -> None:
        """Notes that somebody was in the world until now."""
        self._since = monotonic()

    async def begin(self, after: float) -> None:
        """Saves the world, and lets its engine and its recording's file go until somebody joins.

        Does nothing unless it was deserted for so long (s), and is idle.
        """
        if not self._is_due(after):
            return
        if self._worker.away:  # as one in `fast` nearly always is
            await self._worker.wait()
        if not self._is_due(after) or self._worker.away or not self._world.idle:
            return
        if self._worker.run(self._let_go, lambda done: done.result()):
            await self._worker.wait()

    def _is_due(self, after: float) -> bool:
        return self._deserted() and not self._sleepless and monotonic() >= self._since + after

    def _let_go(self) -> None:
        """Saves the world and closes its recording; called in the world's thread."""
        self._world.hibernate()
        self._sleepless = not self._world.asleep
        if self._world.asleep and self._recorder is not None:
            try:
                self._recorder.rest()
            except RecordingError as error:
                self._world.stop_recording(error)

    def wake(self) -> bool:
        """Takes the world up again; returns whether that is done in a thread, as it is unless the world is faulted."""
        if self._recorder is not None:
            self._recorder.settle()
        if self._worker.run(self._world.wake, self._woken):
            return True
        self._world.wake()
        return False

    def _woken(self, done: Future[None]) -> None:
        """Goes on with a world that is awake; where that failed, whoever comes from now on is told so."""
        self.put_off()
        self.failure = done.exception()
        if self.failure is not None:
            name = self._world.config["name"]
            logger.error("world %r cannot be woken; see its recording", name, exc_info=self.failure)
