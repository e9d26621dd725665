"""Behaviour cloning: a network learns to do what somebody else did where the same was seen.

    clone = Cloning(Spaces(26, 8), Cloning.Options(), Draw(1))
    for number in range(20):
        report = clone.learn(observations, actions, Draw(1, number), rest=1.0 - number / 20)

Source: D. A. Pomerleau, "ALVINN: an autonomous land vehicle in a neural network", NIPS 1988.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from nmes.backend import Array
from nmes.brain.base import JsonObject
from nmes.evolution.algorithms.bounds import within_bounds
from nmes.learning.learners.actor_critic import Report
from nmes.learning.learners.arithmetic import average
from nmes.learning.learners.experience import Scale
from nmes.learning.learners.networks import Adam, Network, together
from nmes.learning.learners.rows import Spaces
from nmes.objective.trajectory import Flags
from nmes.variation.draw import Draw

__all__ = ["Cloning"]

_HELD: Final = 10  # one in so many steps is not learned from: it tells what was learned


class Cloning:
    """A network whose outputs come near to the controls of a teacher, by the mean of the squared distance.

    Args:
        spaces: What is seen and done; actions are controls.
        options: See `Options`.
        draw: Where the first weights come from.
    """

    @dataclass(frozen=True)
    class Options:
        """The options.

        Attributes:
            units: Of each of the two hidden layers.
            rate: How far a step along the gradient goes at first; at the end it is 0.
            batch: How many steps make a gradient.
        """

        units: int = 64
        rate: float = 1e-3
        batch: int = 64

        def __post_init__(self) -> None:
            within_bounds(self, {"units": (1, 1024), "rate": (1e-9, 10), "batch": (1, 1_000_000)})

    def __init__(self, spaces: Spaces, options: Options, draw: Draw) -> None:
        self._options = options
        self._network = Network((spaces.sensors, options.units, options.units, spaces.motors))
        self._parameters = self._network.initial(draw, 0.01)
        self._adam, self._scale = Adam(self._network.count), Scale(spaces.sensors)

    def learn(self, observations: Array, actions: Array, draw: Draw, rest: float) -> Report:
        """Goes once over all steps but one in ten, which are held back.

        Args:
            observations: Array (n, sensors): what the teacher saw, the same at each call.
            actions: Array (n, motors): what it did then, from -1 to 1.
            draw: Of the order of steps.
            rest: How much of the learning is still to be done, from 1 down to 0.
        """
        if not self._scale.count[0]:
            self._scale.take(observations)
        seen = self._scale.apply(observations)
        held = _held(len(seen))
        learned, errors = np.flatnonzero(~held), []
        order = learned[draw.order(len(learned))]
        for begin in range(0, len(order), self._options.batch):
            places = order[begin : begin + self._options.batch]
            gradient, error = squares(self._network, self._parameters, seen[places], actions[places])
            errors.append(error)
            self._adam.step(self._parameters, gradient, rest * self._options.rate)
        figures = {"error": average(np.array(errors))}
        if held.any():
            off = self._network.forward(self._parameters, seen[held]).outputs - actions[held]
            figures["error of steps held back"] = average(off * off)
        return Report(len(order), (), (), figures)

    @staticmethod
    def lessons(count: int) -> int:
        """Returns how many of so many steps are learned from."""
        return count - int(np.count_nonzero(_held(count)))

    def best(self, observations: Array) -> Array:
        """Returns the clone's actions (n, motors) at observations (n, sensors)."""
        outputs = self._network.forward(self._parameters, self._scale.apply(observations)).outputs
        return np.minimum(np.maximum(outputs, -1.0), 1.0)

    def brain(self) -> JsonObject:
        """Returns the brain that does what `best` does."""
        return self._network.document(self._parameters, self._scale.means, self._scale.deviations)

    def arrays(self) -> dict[str, Array]:
        """Returns all that it knows, which whoever goes on with it writes into."""
        parts = together(adam=self._adam.arrays(), scale=self._scale.arrays())
        return {"parameters": self._parameters, **parts}


def _held(count: int) -> Flags:
    """Returns which of so many steps are held back."""
    return np.asarray(np.arange(count) % _HELD == _HELD - 1)


def squares(network: Network, parameters: Array, seen: Array, actions: Array) -> tuple[Array, float]:
    """Returns the gradient of the mean squared distance from actions by the parameters, and that mean."""
    forward = network.forward(parameters, seen)
    off = forward.outputs - actions
    return network.backward(parameters, forward, off * (2.0 / off.size)), average(off * off)
