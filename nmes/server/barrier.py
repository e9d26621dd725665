"""Agents that share a world in lockstep: it ticks when all of them have said `step`, or have taken too long."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable

from nmes.world import Barrier, World

__all__ = ["StepBarrier"]


class StepBarrier:
    """The clients that step a world together, and the ticks that each of them still waits for.

    Attributes:
        waiting: The clients that wait, and the number of ticks that they still wait for.
    """

    def __init__(
        self,
        world: World,
        advance: Callable[[int, Callable[[int], None]], None],
        resume: Callable[[int], None],
        update_soon: Callable[[], None],
        expire: Callable[[], None],
    ) -> None:
        """Makes a barrier at which nobody waits yet.

        Args:
            world: Whose barrier it is. While it has none, only `forget` and `update` do anything.
            advance: Ticks a number of times, or less often, and then calls back with the number of ticks.
            resume: Called with each client whose `step` may be submitted again: now it need not wait.
            update_soon: Has `update` called when others have had their turn.
            expire: Called when those that wait have waited for the barrier's time-out.
        """
        self.waiting: dict[int, int] = {}
        self._world = world
        self._advance = advance
        self._resume = resume
        self._update_soon = update_soon
        self._expire = expire
        self._controlling: set[int] = set()
        self._released: set[int] = set()  # had their ticks, and their `step` is executed next
        self._barrier: Barrier | None = None  # which the others are about
        self._started = False
        self._alarm: asyncio.TimerHandle | None = None  # set for the time-out
        self._alarm_frame = 0

    def arrive(self, client: int, ticks: int) -> bool:
        """Counts a client's `step` of so many ticks; returns whether it has to wait."""
        if client in self._released:
            self._released.discard(client)
            return False
        self._follow()
        self._controlling.add(client)
        self.waiting.setdefault(client, ticks)
        self._update_soon()
        return True

    def forget(self, client: int) -> None:
        """Waits no longer for a client that leaves."""
        self._controlling.discard(client)
        self._released.discard(client)
        self.waiting.pop(client, None)

    def update(self) -> None:
        """Ticks if all have said `step`; where there is no barrier any more, or a fault, nobody has to wait."""
        if not self.waiting and self._alarm is None:
            return
        if self._world.barrier is None or self._world.fault is not None:
            self._dissolve()
        elif self._complete():
            self._advance(min(self.waiting.values()), self._ticked)
        else:
            self._set_alarm()

    def give_up(self) -> list[int]:
        """Waits no longer for clients that are late, nor for more to come; returns those that were late."""
        late = sorted(self._controlling - self.waiting.keys())
        self._controlling &= self.waiting.keys()
        self._started = True
        return late

    def stop(self) -> None:
        """Takes the time of those that wait no longer."""
        if self._alarm is not None:
            self._alarm.cancel()
            self._alarm = None

    def _complete(self) -> bool:
        """Whether all who control the world wait in a `step`."""
        if self._world.barrier is None or not self.waiting:
            return False
        self._follow()
        enough = self._started or len(self._controlling) >= self._world.barrier.agents
        return enough and self._controlling <= self.waiting.keys()

    def _follow(self) -> None:
        """Counts anew where the world's barrier is another one; those that wait already take part in it."""
        if self._world.barrier is not self._barrier:
            self._barrier, self._started = self._world.barrier, False
            self._controlling = set(self.waiting)

    def _ticked(self, count: int) -> None:
        """Counts ticks, no more than anybody waits for, and releases those that have now had all of theirs."""
        self._started = self._started or count > 0
        done = [client for client, ticks in self.waiting.items() if ticks == count]
        self.waiting = {client: ticks - count for client, ticks in self.waiting.items() if ticks > count}
        self._released.update(done)
        self._release(done)
        if self._complete():  # the slice was over before
            self._update_soon()
        self._set_alarm()

    def _dissolve(self) -> None:
        self._release(self.waiting)
        self.waiting, self._controlling, self._released = {}, set(), set()
        self._barrier, self._started = None, False
        self.stop()

    def _release(self, clients: Iterable[int]) -> None:
        for client in clients:
            self._resume(client)

    def _set_alarm(self) -> None:
        """Takes the time from the last tick on; not where nobody waits."""
        barrier, frame = self._world.barrier, self._world.frame
        if not self.waiting or self._alarm_frame != frame:
            self.stop()
        if barrier is not None and self.waiting and self._alarm is None:
            self._alarm = asyncio.get_running_loop().call_later(barrier.timeout, self._expired)
            self._alarm_frame = frame

    def _expired(self) -> None:
        self._alarm = None
        self._expire()
