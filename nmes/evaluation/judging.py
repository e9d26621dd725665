"""How episodes come out that go on in step: told of a tick of all at a time, and keeping no more than some of them.

Invariant: each episode comes out, to the last bit, as a `Judge` says who is told all of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from nmes.evaluation.balance import BalanceRows, Excess
from nmes.evaluation.driven import Parts, Scene
from nmes.evaluation.judge import Result
from nmes.evaluation.progress import Progress
from nmes.evaluation.task import Task
from nmes.objective import Objective
from nmes.objective.trajectory import Flags

__all__ = ["JudgeRows"]

_BLOCK = 32  # ticks that are kept until their balance of energy is drawn


class JudgeRows:
    """Decides how episodes of one task come out, each in its place.

    Args:
        task: What is asked.
        first: Any of the scenes.
        count: The number of places.
        reward: What each tick is worth; None: by how much the task's objective grew.

    Attributes:
        ticks: Of the episode in each place, array (count,).
        rewards: Of the last tick in each place, array (count,).
        over: Whether a condition or a limit of the task holds since the last tick, array (count,).
    """

    def __init__(self, task: Task, first: Scene, count: int, reward: Objective | None) -> None:
        self._task = task
        self._progress = progress = Progress(task, first.start.balance.bodies, count, reward)
        self._balance, self._block = (
            BalanceRows(first.start.balance, count),
            Parts.zeros((_BLOCK, count), first.watched),
        )
        self._filled = 0  # ticks of the block
        self._touches: Flags = np.zeros((count, *first.start.touches.shape), np.bool_)
        self._seeds = [first.start.seed] * count
        self._watts = np.zeros((count, len(first.watched.motors)))
        self.ticks, self.rewards, self.over = progress.ticks, progress.rewards, progress.over

    def begin(self, place: int, scene: Scene) -> None:
        """Begins an episode in a place, whatever was there."""
        start, block, past = scene.start, self._block, slice(0, self._filled)
        self._progress.begin(place, start.states, start.touches, scene.target)
        # Before its start it was as at its start, and nothing was worked: so its balance is as if it had been alone.
        block.states[past, place], block.powers[past, place] = start.states, 0.0
        block.positions[past, place] = start.positions
        self._balance.begin(place, start.energy)
        self._seeds[place], self._watts[place] = start.seed, 0.0

    @property
    def parts(self) -> Parts:
        """Where what is to be judged of the next tick belongs, arrays (count, ...)."""
        return self._block.at(self._filled)

    @property
    def touches(self) -> Flags:
        """Where what touches what at the next tick belongs, array (count, n, 2); (count, 0, 2) where nobody asks."""
        return self._touches

    def take(self, going: Flags) -> None:
        """Takes the tick that was written into `parts` and `touches`.

        Args:
            going: The places in which an episode goes on, array (count,).
        """
        parts = self.parts
        self._filled += 1
        with np.errstate(all="ignore"):  # of a place in which nothing goes on, numbers mean nothing
            self._watts += parts.powers[:, 1]
        self._progress.take(parts.states, self._watts / self._task.tick_rate, self._touches, going)

    def results(self, places: Sequence[int], faults: Mapping[int, str]) -> list[Result]:
        """Returns how episodes came out that are over since the last tick, and settles their rewards.

        Args:
            places: Which, ascending.
            faults: Of those whose world could not go on, why: their last tick does not count.
        """
        excesses: dict[int, Excess] = {}
        late = [place for place in places if place in faults or not self._progress.ended(place)[1]]
        for some, rows in (([p for p in places if p not in late], self._filled), (late, self._filled - 1)):
            at, block = np.array(some, np.intp), self._block
            parts = block.states[:rows, at], block.powers[:rows, at], block.positions[:rows, at]
            excesses |= self._balance.excesses(at, *parts, self.ticks[at] - (self._filled - rows))
        return [
            self._progress.result(place, self._seeds[place], faults.get(place), excesses.get(place)) for place in places
        ]

    def turn(self) -> None:
        """Draws the balance of a block that is full; after the results of the tick, before others begin."""
        if self._filled == _BLOCK:
            block = self._block
            self._balance.take(block.states, block.powers, block.positions, self.ticks)
            self._filled = 0
