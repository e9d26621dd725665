"""Tabular Q-learning: what each action is worth in each state, one number each.

    learner = QLearning(states=625, actions=4, options=QLearning.Options())
    action = learner.choose(state, chance, draw)
    learner.learn(state, action, reward, following, over)

Source: C. J. C. H. Watkins, "Learning from delayed rewards", PhD thesis, University of Cambridge (1989); C. J. C. H.
Watkins and P. Dayan, "Q-learning", Machine Learning 8 (1992).
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import blake2b

import numpy as np

from nmes.backend import Array
from nmes.evolution.algorithms.bounds import within_bounds
from nmes.variation.draw import Draw

__all__ = ["QLearning"]


class QLearning:
    """A table of values that learns from single steps.

    Args:
        states: How many there are.
        actions: How many there are to choose from.
        options: See `Options`.

    Attributes:
        values: Array (states, actions): what each action is worth, the rewards to come, later ones worth less.
        visits: Array (states, actions): how often each was learned from.
    """

    @dataclass(frozen=True)
    class Options:
        """The options.

        Attributes:
            rate: How far a value goes towards what one step says, at first.
            slower: After how many visits it goes half as far.
            gamma: What a reward one step later is worth.
        """

        rate: float = 0.5
        slower: float = 20.0
        gamma: float = 0.95

        def __post_init__(self) -> None:
            within_bounds(self, {"rate": (1e-9, 1), "slower": (1e-9, 1e9), "gamma": (0, 1)})

    def __init__(self, states: int, actions: int, options: Options) -> None:
        self._options = options
        self.values: Array = np.zeros((states, actions))
        self.visits = np.zeros((states, actions), np.int64)

    @property
    def digest(self) -> str:
        """Of all values and visits, 32 hexadecimal digits."""
        return blake2b(self.values.tobytes() + self.visits.tobytes(), digest_size=16).hexdigest()

    def best(self, state: int) -> int:
        """Returns the action of the highest value; of several the first."""
        return int(np.argmax(self.values[state]))

    def choose(self, state: int, chance: float, draw: Draw) -> int:
        """Returns the best action, or with this chance any."""
        if draw.chance(chance):
            return draw.count(0, self.values.shape[1] - 1)
        return self.best(state)

    def learn(self, state: int, action: int, reward: float, following: int, over: bool) -> None:
        """Learns from one step.

        Args:
            state: Before it.
            action: What was done.
            reward: What came of it.
            following: The state after it.
            over: Whether the episode ended in it, so that nothing is to come.
        """
        options = self._options
        self.visits[state, action] += 1
        rate = options.rate / (1.0 + (int(self.visits[state, action]) - 1) / options.slower)
        later = 0.0 if over else options.gamma * float(np.max(self.values[following]))
        self.values[state, action] += rate * (reward + later - self.values[state, action])
