"""What episodes are worth so far, and whether the task ends them, told of a tick of all of them at a time.

Hides how a task's objective, its ends and its limits are followed without keeping the rows: to the same figures, to the
last bit, as a `Judge` has who is told all rows. It draws no balance of energy.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from nmes.backend import Array, Vector
from nmes.errors import WorldError
from nmes.evaluation.balance import Excess
from nmes.evaluation.judge import MEASURED, Result, result_of
from nmes.evaluation.task import Task
from nmes.genome import Genome
from nmes.objective import Objective, Quantity
from nmes.objective.trajectory import Flags, ObservedBodies, QuantityRows, beyond, duty_of

__all__ = ["Progress", "read_reward"]


def read_reward(text: str, genome: Genome, task: Task) -> Objective:
    """Reads the expression of a reward.

    Raises:
        WorldError: `bad_expression`, also where it names a cube that is not there.
    """
    reward = Objective(text, "reward")
    known = {*(cube.id for cube in genome.body.cubes), *task.prop_ids()}
    strangers = sorted({quantity.cube for quantity in reward.needs if quantity.cube is not None} - known)
    if strangers:
        raise WorldError("bad_expression", f"reward: there is no cube {strangers[0]!r}", "reward")
    return reward


class Progress:
    """Episodes of one creature on one task that go on in step, each in its place.

    Args:
        task: What is asked.
        bodies: What the episodes are about; the target is each episode's own.
        count: The number of places.
        reward: What each tick is worth; None: by how much the task's objective grew.

    Attributes:
        ticks: Of the episode in each place, array (count,).
        rewards: Of the last tick in each place, array (count,).
        over: Whether a condition or a limit of the task holds since the last tick, array (count,).
    """

    def __init__(self, task: Task, bodies: ObservedBodies, count: int, reward: Objective | None = None) -> None:
        self._task, self._bodies, self._count, self._reward = task, bodies, count, reward
        asked = () if reward is None else reward.needs
        needs = dict.fromkeys((*MEASURED, *task.needs, *asked))
        self._quantities = QuantityRows(bodies, needs, count)
        self._now: dict[Quantity, Array] = {quantity: np.zeros(count) for quantity in needs}
        self._before = self._now
        self._given = self._settled = np.zeros(count)  # in all so far, and before the last tick
        # At how many ticks each cube touched what is no part of its body, and whether it did at the last one.
        self._trodden, self._treads = np.zeros((count, bodies.body), np.intp), np.zeros((count, bodies.body), np.bool_)
        self._limits: Mapping[str, Flags] = {}
        self._ends: list[tuple[str, Flags]] = []
        self.ticks, self.rewards = np.zeros(count, np.intp), np.zeros(count)
        self.over: Flags = np.zeros(count, np.bool_)

    def begin(self, place: int, states: Array, touches: Flags, target: Vector | str | None) -> None:
        """Begins an episode in a place, whatever was there.

        Args:
            place: Which.
            states: Of its cubes at the start, array (n, 13).
            touches: At the start, array (n, 2), or without rows; see `Trajectory.touches`.
            target: As in `ObservedBodies`.
        """
        for quantity, value in self._quantities.begin(place, states, touches, target).items():
            self._now[quantity][place] = value
        self.ticks[place], self._given[place], self._trodden[place] = 0, 0.0, 0

    def take(self, states: Array, work: Array, touches: Flags, going: Flags) -> None:
        """Takes a tick of every place.

        Args:
            states: Array (count, n, 13).
            work: What each motor has worked since the start, array (count, m), J.
            touches: Array (count, n, 2), or (count, 0, 2).
            going: The places in which an episode goes on, array (count,); what is told of others means nothing.
        """
        with np.errstate(all="ignore"):
            self.ticks += going
            if self._task.duty:
                self._treads[:] = touches[:, : self._bodies.body, 1]
                self._trodden += self._treads
            self._before, self._now = self._now, self._quantities.add(states, work, touches)
            self._limits = beyond(self._bodies, states, work, **self._task.bounds)
            self._ends = [(name, condition.flags(self._now, self._count)) for name, condition in self._task.ends]
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

    def ended(self, place: int) -> tuple[str | None, bool]:
        """Returns which limit or condition has ended an episode, a limit first, and whether the last tick counts."""
        for name, flags in self._limits.items():
            if flags[place]:
                return name, False
        return next((name for name, flags in self._ends if flags[place]), None), True

    def result(self, place: int, seed: int, fault: str | None, excess: Excess | None = None) -> Result:
        """Returns how an episode came out that is over since the last tick, and settles its reward.

        Args:
            place: Which.
            seed: The episode's.
            fault: Why its world could not make the last tick, which then does not count.
            excess: Where the body had energy of nothing, if it had.
        """
        name, counts = (None, False) if fault is not None else self.ended(place)
        columns = self._now if counts else self._before
        values = {quantity: float(column[place]) for quantity, column in columns.items()}
        ticks = int(self.ticks[place]) - (not counts)
        result = result_of(self._task, seed, values, ticks, name, fault, excess)
        if self._task.duty:
            trodden = self._trodden[place] - (0 if counts else self._treads[place])
            result = replace(result, duty=duty_of(trodden.tolist(), ticks))
        self.settle(place, result.score, faulted=fault is not None)
        return result

    def settle(self, place: int, score: float | None, *, faulted: bool) -> None:
        """Has the rewards of an episode that is over come to its score; those of one's own stay what they are.

        Args:
            place: Which.
            score: None where it has none: then all that it was given is taken back.
            faulted: Whether its world could not make the last tick, for which then nothing is given.
        """
        if self._reward is None:
            self.rewards[place] = (score or 0.0) - self._settled[place]
        elif faulted:
            self.rewards[place] = 0.0
