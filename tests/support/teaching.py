"""Rows of toy environments on which learners can be seen to learn in a second."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nmes.learning.learners.actor_critic import ActorCritic
from nmes.learning.learners.experience import Collector
from nmes.learning.learners.rows import Spaces, Step
from nmes.variation.draw import Draw

__all__ = ["SPACES", "Follow", "mean_returns"]

SPACES = Spaces(2, 1)
_LASTS = 20


class Follow:
    """Rows in which the reward is greatest where the action is the first observation, which a second one disturbs.

    Both observations are far from 0 and of another size, so that who does not normalise them learns slowly.
    """

    def __init__(self, count: int, *, choices: bool = False) -> None:
        self.last_observations = np.zeros((count, 2))
        self.spaces = Spaces(2, 2, choices=True) if choices else SPACES
        self._draw, self._steps = np.random.default_rng(0), np.zeros(count, int)
        self._goal = np.zeros(count)

    def reset(self, seed: int) -> NDArray[np.float64]:
        self._draw = np.random.default_rng(seed)
        self._steps[...] = 0
        return self._see()

    def step(self, actions: NDArray[np.float64], /) -> Step:
        if self.spaces.choices:
            rewards = ((self._goal > 0) == (actions[:, 0] == 1)).astype(float)
        else:
            rewards = 1.0 - np.abs(actions[:, 0] - self._goal)
        self._steps += 1
        late = self._steps == _LASTS
        self._steps[late] = 0
        seen = self._see()
        self.last_observations[...] = seen
        return seen, rewards, np.zeros(len(late), bool), late

    def _see(self) -> NDArray[np.float64]:
        self._goal = self._draw.uniform(-0.8, 0.8, len(self._steps))
        return np.stack([100.0 + 10.0 * self._goal, self._draw.normal(size=len(self._steps))], axis=1)


def mean_returns(learner: ActorCritic, rows: Follow, blocks: int, ticks: int) -> list[float]:
    """Lets a learner learn from rows; returns the mean return of each block."""
    collector = Collector(rows, 1)
    reports = [learner.learn(collector, ticks, Draw(1, block), 1.0 - block / blocks) for block in range(blocks)]
    return [float(np.mean(report.returns)) for report in reports]
