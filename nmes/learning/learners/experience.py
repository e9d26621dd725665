"""What learners gather from rows: steps in a block, episodes' returns, and what each step came to be worth.

Sources: J. Schulman et al., "High-dimensional continuous control using generalized advantage estimation", ICLR 2016;
F. Pardo et al., "Time limits in reinforcement learning", ICML 2018 (an episode that is cut off goes on in its value);
T. F. Chan, G. H. Golub and R. J. LeVeque, "Updating formulae and a pairwise algorithm for computing sample variances"
(1979).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nmes.backend import Array
from nmes.learning.learners.rows import Rows
from nmes.objective.trajectory import Flags

__all__ = ["Collector", "Experience", "Scale", "advantages", "discounted"]


@dataclass(frozen=True, eq=False, slots=True)
class Experience:
    """Some steps of all rows, one after the other.

    Attributes:
        observations: Array (steps, n, sensors): what was seen before each step.
        following: Array (steps, n, sensors): what was seen after it, at the end of an episode where one was over.
        actions: Array (steps, n, width): as the policy drew them.
        rewards: Array (steps, n).
        terminated: Array (steps, n).
        over: Array (steps, n): terminated or truncated.
        returns: The sums of rewards of the episodes that were over, in their order.
        lengths: Their numbers of steps.
    """

    observations: Array
    following: Array
    actions: Array
    rewards: Array
    terminated: Flags
    over: Flags
    returns: tuple[float, ...]
    lengths: tuple[int, ...]


class Collector:
    """Steps rows, and notes what comes of it; episodes go on from one block to the next.

    Args:
        rows: The rows.
        seed: Of their reset.
    """

    def __init__(self, rows: Rows, seed: int) -> None:
        self._rows = rows
        self._seen = rows.reset(seed).copy()
        self._gained, self._lasted = np.zeros(len(self._seen)), np.zeros(len(self._seen), np.intp)

    def collect(
        self, steps: int, width: int, choose: Callable[[Array], Array], act: Callable[[Array], Array]
    ) -> Experience:
        """Goes so many steps on in every row.

        Args:
            steps: How many.
            width: Columns of actions.
            choose: Returns actions (n, width) for observations (n, sensors).
            act: Returns actions as rows take them.

        Raises:
            FloatingPointError: An action is no number.
        """
        count, sensors = self._seen.shape
        observations, following = np.empty((2, steps, count, sensors))
        actions, rewards = np.empty((steps, count, width)), np.empty((steps, count))
        ended, over = np.empty((2, steps, count), np.bool_)
        returns: list[float] = []
        lengths: list[int] = []
        for step in range(steps):
            observations[step] = self._seen
            actions[step] = choose(self._seen)
            doing = act(actions[step])
            if not np.isfinite(doing).all():
                raise FloatingPointError("what is to be done is no number")  # sums raise nothing
            seen, rewards[step], ended[step], truncated = self._rows.step(doing)
            over[step] = ended[step] | truncated
            following[step] = np.where(over[step][:, None], self._rows.last_observations, seen)
            self._seen = seen.copy()
            self._gained += rewards[step]
            self._lasted += 1
            for row in np.flatnonzero(over[step]).tolist():
                returns.append(float(self._gained[row]))
                lengths.append(int(self._lasted[row]))
                self._gained[row], self._lasted[row] = 0.0, 0
        return Experience(observations, following, actions, rewards, ended, over, tuple(returns), tuple(lengths))


def advantages(
    experience: Experience, rewards: Array, values: Array, after: Array, gamma: float, decay: float
) -> Array:
    """Returns by how much each step was better than expected: generalized advantage estimates (steps, n).

    Args:
        experience: The steps.
        rewards: Array (steps, n): what is to be maximised.
        values: Array (steps, n): what the critic expected before each step.
        after: Array (steps, n): what it expected after it.
        gamma: What a reward one step later is worth.
        decay: How fast later surprises count less, from 0 to 1.
    """
    surprise = rewards + gamma * np.where(experience.terminated, 0.0, after) - values
    result = np.empty_like(rewards)
    later = np.zeros(rewards.shape[1])
    for step in range(len(rewards) - 1, -1, -1):
        later = surprise[step] + gamma * decay * np.where(experience.over[step], 0.0, later)
        result[step] = later
    return result


def discounted(rewards: Array, over: Flags, gamma: float) -> Array:
    """Returns for each step the rewards before it and its own, in its episode, worth less the longer ago they were."""
    result = np.empty_like(rewards)
    sums = np.zeros(rewards.shape[1])
    for step, (reward, done) in enumerate(zip(rewards, over, strict=True)):
        sums = reward + gamma * sums
        result[step] = sums
        sums = np.where(done, 0.0, sums)
    return result


class Scale:
    """Means and variances of columns of all rows so far."""

    def __init__(self, columns: int) -> None:
        self.count, self.means, self.variances = np.zeros(1), np.zeros(columns), np.ones(columns)

    @property
    def deviations(self) -> Array:
        """Standard deviations, of at least 1e-4: what never changes is not blown up."""
        return np.maximum(np.sqrt(self.variances), 1e-4)

    def apply(self, rows: Array) -> Array:
        """Returns rows (..., columns) with mean 0 and deviation 1."""
        return np.asarray((rows - self.means) / self.deviations)

    def take(self, rows: Array) -> None:
        """Takes rows (n, columns) in."""
        here, before = float(len(rows)), float(self.count[0])
        means = np.add.reduce(rows, axis=0) / here
        variances = np.add.reduce((rows - means) * (rows - means), axis=0) / here
        away, total = means - self.means, before + here
        self.variances *= before / total
        self.variances += variances * (here / total) + away * away * (before * here / (total * total))
        self.means += away * (here / total)
        self.count[0] = total

    def arrays(self) -> dict[str, Array]:
        """Returns all that it knows, which whoever goes on with it writes into."""
        return {"count": self.count, "means": self.means, "variances": self.variances}
