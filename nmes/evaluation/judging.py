"""How episodes come out that go on in step: told of a tick of all at a time, and keeping no more than some of them.

Invariant: each episode comes out, to the last bit, as a `Judge` says who is told all of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from nmes.backend import Array
from nmes.evaluation.balance import BalanceRows, Excess
from nmes.evaluation.driven import Parts, Scene
from nmes.evaluation.episode import MEASURED, Result, result_of
from nmes.evaluation.task import Task
from nmes.objective import Objective, Quantity
from nmes.objective.trajectory import Flags, QuantityRows, beyond, duty_of

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
        self._task, self._reward, self._count = task, reward, count
        asked = () if reward is None else reward.needs
        needs = dict.fromkeys((*MEASURED, *task.needs, *asked))
        bodies = first.start.balance.bodies
        self._bodies, self._quantities = bodies, QuantityRows(bodies, needs, count)
        self._now: dict[Quantity, Array] = {quantity: np.zeros(count) for quantity in needs}
        self._before = self._now
        self._balance, self._block = (
            BalanceRows(first.start.balance, count),
            Parts.zeros((_BLOCK, count), first.watched),
        )
        self._filled = 0  # ticks of the block
        self._touches: Flags = np.zeros((count, *first.start.touches.shape), np.bool_)
        self._feet = np.zeros((count, bodies.body), np.intp)  # at how many ticks each cube touched what is no part
        self._scenes = [first] * count
        self._watts = np.zeros((count, len(first.watched.motors)))
        self._given = self._settled = np.zeros(count)  # in all so far, and before the last tick
        self._limits: Mapping[str, Flags] = {}
        self._ends: list[tuple[str, Flags]] = []
        self.ticks, self.rewards = np.zeros(count, np.intp), np.zeros(count)
        self.over: Flags = np.zeros(count, np.bool_)

    def begin(self, place: int, scene: Scene) -> None:
        """Begins an episode in a place, whatever was there."""
        start, block, past = scene.start, self._block, slice(0, self._filled)
        values = self._quantities.begin(place, start.states, start.touches, scene.target)
        for quantity, value in values.items():
            self._now[quantity][place] = value
        # Before its start it was as at its start, and nothing was worked: so its balance is as if it had been alone.
        block.states[past, place], block.powers[past, place] = start.states, 0.0
        block.positions[past, place] = start.positions
        self._balance.begin(place, start.energy)
        self._scenes[place], self.ticks[place] = scene, 0
        self._watts[place], self._given[place], self._feet[place] = 0.0, 0.0, 0

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
        with np.errstate(all="ignore"):  # of a place in which nothing goes on, numbers mean nothing
            self._take(going)

    def _take(self, going: Flags) -> None:
        task, parts = self._task, self.parts
        self._filled += 1
        self.ticks += going
        self._watts += parts.powers[:, 1]
        work = self._watts / task.tick_rate
        if task.duty:
            self._feet += self._touching
        self._before, self._now = self._now, self._quantities.add(parts.states, work, self._touches)
        self._limits = beyond(self._bodies, parts.states, work, **task.bounds)
        self._ends = [(name, condition.flags(self._now, self._count)) for name, condition in task.ends]
        flags = [*self._limits.values(), *(flags for _, flags in self._ends)]
        np.logical_and(np.logical_or.reduce(flags), going, out=self.over)
        self._pay(going)

    def _pay(self, going: Flags) -> None:
        """Gives rewards for the last tick; nothing where what it is worth is no finite number."""
        objective = self._task.objective if self._reward is None else self._reward
        worth = objective.values(self._now, self._count)
        paid = np.isfinite(worth) & going
        if self._reward is None:
            np.subtract(worth, self._given, out=self.rewards, where=paid)
            self.rewards[~paid] = 0.0
            self._settled, self._given = self._given, self._given + self.rewards
        else:
            self.rewards[:] = np.where(paid, worth, 0.0)

    def results(self, places: Sequence[int], faults: Mapping[int, str]) -> list[Result]:
        """Returns how episodes came out that are over since the last tick, and settles their rewards.

        Args:
            places: Which, ascending.
            faults: Of those whose world could not go on, why: their last tick does not count.
        """
        excesses: dict[int, Excess] = {}
        names = {place: None if place in faults else self._ended(place) for place in places}
        late = [place for place in places if place in faults or names[place] in self._limits]
        for some, rows in (([p for p in places if p not in late], self._filled), (late, self._filled - 1)):
            at, block = np.array(some, np.intp), self._block
            parts = block.states[:rows, at], block.powers[:rows, at], block.positions[:rows, at]
            excesses |= self._balance.excesses(at, *parts, self.ticks[at] - (self._filled - rows))
        results = []
        for place in places:
            columns = self._before if place in late else self._now
            values = {quantity: float(column[place]) for quantity, column in columns.items()}
            told = int(self.ticks[place]) - (place in late), names[place], faults.get(place), excesses.get(place)
            result = result_of(self._task, self._scenes[place].start.seed, values, *told)
            results.append(replace(result, duty=self._duty(place, late=place in late)) if self._task.duty else result)
            self._settle(place, results[-1], faulted=place in faults)
        return results

    def _ended(self, place: int) -> str | None:
        """Returns which limit or condition ended an episode: a limit, then the condition that is named first."""
        named = [*self._limits.items(), *self._ends]
        return next((name for name, flags in named if flags[place]), None)

    @property
    def _touching(self) -> Flags:
        """Whether each cube touches something outside the body, array (count, cubes)."""
        return self._touches[:, : self._bodies.body, 1]

    def _duty(self, place: int, *, late: bool) -> float:
        counts = self._feet[place] - (self._touching[place] if late else 0)
        return duty_of(counts.tolist(), int(self.ticks[place]) - late)

    def _settle(self, place: int, result: Result, *, faulted: bool) -> None:
        """Has the rewards of an episode that is over come to its score; one's own stay what they are."""
        if self._reward is None:
            self.rewards[place] = (result.score or 0.0) - self._settled[place]
        elif faulted:
            self.rewards[place] = 0.0

    def turn(self) -> None:
        """Draws the balance of a block that is full; after the results of the tick, before others begin."""
        if self._filled == _BLOCK:
            block = self._block
            self._balance.take(block.states, block.powers, block.positions, self.ticks)
            self._filled = 0
