"""What a network's outputs mean: a normal distribution of controls, or probabilities of choices; and their slopes.

A policy draws actions, says how probable given ones are, and how that changes with the network's outputs. What it
does without chance is the mean, or the most probable choice.

Invariant: a brain that was made of a network does what the policy does without chance.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from math import exp, log, pi

import numpy as np

from nmes.brain.arithmetic import each
from nmes.brain.base import Array
from nmes.learning.learners import arithmetic
from nmes.learning.learners.rows import Spaces
from nmes.variation.draw import Draw

__all__ = ["Choices", "Controls", "Likelihood", "Policy", "policy_of"]

_HALF_LOG_2PI = 0.5 * log(2.0 * pi)


class Likelihood(ABC):
    """How probable actions are under some outputs.

    Attributes:
        logs: Array (n,): the logarithm of each action's probability, or density.
        entropies: Array (n,): of the distributions that the actions are from, nats.
    """

    logs: Array
    entropies: Array

    @abstractmethod
    def slopes(self, of_logs: Array, of_entropies: Array) -> tuple[Array, Array]:
        """Returns the derivatives of a sum: by the outputs (n, outputs), and by the policy's own parameters (count,).

        Args:
            of_logs: The derivatives of the sum by `logs`, shape (n,).
            of_entropies: By `entropies`.
        """


class Policy(ABC):
    """A distribution of actions for every row of a network's outputs.

    Attributes:
        outputs: How many the network must have.
        width: Of an action: the columns of actions.
        count: How many parameters the policy has of its own, beside the network's.
    """

    outputs: int
    width: int
    count: int

    @abstractmethod
    def draw(self, outputs: Array, own: Array, draw: Draw) -> Array:
        """Returns an action for each row, shape (n, width)."""

    @abstractmethod
    def best(self, outputs: Array) -> Array:
        """Returns the actions without chance, shape (n, width)."""

    @abstractmethod
    def likelihood(self, outputs: Array, own: Array, actions: Array) -> Likelihood:
        """Returns how probable actions (n, width) are."""

    @abstractmethod
    def act(self, actions: Array) -> Array:
        """Returns the actions as `Rows.step` takes them."""


def policy_of(spaces: Spaces) -> Policy:
    """Returns the policy for what rows take."""
    return Choices(spaces.motors) if spaces.choices else Controls(spaces.motors)


# -- controls ---------------------------------------------------------------------------------------------------------


class Controls(Policy):
    """Normally distributed controls, whose spread is the same for all observations, as CleanRL has them.

    The outputs are the means; the parameters of its own are the logarithms of the standard deviations. What is drawn
    beyond -1 or 1 is put on the bound when it is done, as a brain does it.
    """

    def __init__(self, motors: int) -> None:
        self.outputs = self.width = self.count = motors

    def draw(self, outputs: Array, own: Array, draw: Draw) -> Array:
        """Returns an action for each row, shape (n, width)."""
        return outputs + _exps(own) * draw.normals(outputs.size).reshape(outputs.shape)

    def best(self, outputs: Array) -> Array:
        """Returns the actions without chance, shape (n, width)."""
        return self.act(outputs)

    def likelihood(self, outputs: Array, own: Array, actions: Array) -> Likelihood:
        """Returns how probable actions (n, width) are."""
        return _Normal(outputs, own, actions)

    def act(self, actions: Array) -> Array:
        """Returns the actions as `Rows.step` takes them."""
        return np.minimum(np.maximum(actions, -1.0), 1.0)


class _Normal(Likelihood):
    def __init__(self, means: Array, own: Array, actions: Array) -> None:
        deviations = _exps(own)
        self._away = (actions - means) / deviations
        self._deviations = deviations
        terms = -0.5 * self._away * self._away - (own + _HALF_LOG_2PI)
        self.logs = np.add.reduce(terms, axis=1)
        self.entropies = np.full(len(means), float(np.add.reduce(own)) + len(own) * (0.5 + _HALF_LOG_2PI))

    def slopes(self, of_logs: Array, of_entropies: Array) -> tuple[Array, Array]:
        by_means = of_logs[:, None] * self._away / self._deviations
        own = np.add.reduce(of_logs[:, None] * (self._away * self._away - 1.0), axis=0)
        return by_means, own + float(np.add.reduce(of_entropies))


def _exps(values: Array) -> Array:
    return np.array([exp(value) for value in values.tolist()])


# -- choices ----------------------------------------------------------------------------------------------------------


class Choices(Policy):
    """One of some choices; the outputs are the logarithms of their probabilities, up to a sum."""

    def __init__(self, count: int) -> None:
        self.outputs, self.width, self.count = count, 1, 0

    def draw(self, outputs: Array, own: Array, draw: Draw) -> Array:
        """Returns an action for each row, shape (n, width)."""
        sums = np.add.accumulate(_Softmax.of(outputs)[0], axis=1)
        places = np.array([[draw.uniform(0.0, 1.0)] for _ in range(len(outputs))])
        chosen = np.add.reduce(sums <= places * sums[:, -1:], axis=1, dtype=np.intp)
        return np.asarray(np.minimum(chosen, self.outputs - 1), np.float64)[:, None]

    def best(self, outputs: Array) -> Array:
        """Returns the actions without chance, shape (n, width)."""
        return np.asarray(np.argmax(outputs, axis=1), np.float64)[:, None]

    def likelihood(self, outputs: Array, own: Array, actions: Array) -> Likelihood:
        """Returns how probable actions (n, width) are."""
        return _Softmax(outputs, actions)

    def act(self, actions: Array) -> Array:
        """Returns the actions as `Rows.step` takes them."""
        return actions


class _Softmax(Likelihood):
    def __init__(self, outputs: Array, actions: Array) -> None:
        self._parts, logs = self.of(outputs)
        self._logs = logs
        self._chosen = np.arange(outputs.shape[1]) == actions
        self.logs = np.add.reduce(np.where(self._chosen, logs, 0.0), axis=1)
        self.entropies = -np.add.reduce(self._parts * logs, axis=1)

    @staticmethod
    def of(outputs: Array) -> tuple[Array, Array]:
        """Returns the probabilities, and their logarithms."""
        least = outputs - np.maximum.reduce(outputs, axis=1)[:, None]
        grown = arithmetic.exp(least)
        sums = np.add.reduce(grown, axis=1)[:, None]
        logs = sums.copy()
        each(log, logs)
        return grown / sums, least - logs

    def slopes(self, of_logs: Array, of_entropies: Array) -> tuple[Array, Array]:
        by_logs = of_logs[:, None] * (self._chosen - self._parts)
        by_entropies = -of_entropies[:, None] * self._parts * (self._logs + self.entropies[:, None])
        return by_logs + by_entropies, np.empty(0)
