"""A forward model: it learns what is seen after an action, and what it does not expect is new.

Nobody rewards it: it learns from what is observed alone. Its error is the novelty of a step, which a learner of a
policy may seek beside its reward.

Sources: J. Schmidhuber, "A possibility for implementing curiosity and boredom in model-building neural controllers",
SAB 1991; D. Pathak et al., "Curiosity-driven exploration by self-supervised prediction", ICML 2017.
"""

from __future__ import annotations

import numpy as np

from nmes.backend import Array
from nmes.learning.learners.experience import Scale
from nmes.learning.learners.networks import Adam, Network, together
from nmes.learning.learners.rows import Spaces
from nmes.variation.draw import Draw

__all__ = ["ForwardModel"]

_RATE, _BATCH = 1e-3, 512


class ForwardModel:
    """A network that is given what was seen and done, and says by how much what is seen changes.

    Args:
        spaces: What is seen and done.
        units: Of each of its two hidden layers.
        draw: Where the first weights come from.
    """

    def __init__(self, spaces: Spaces, units: int, draw: Draw) -> None:
        self._choices = spaces.motors if spaces.choices else 0
        self._network = Network((spaces.sensors + spaces.motors, units, units, spaces.sensors))
        self._parameters = self._network.initial(draw, 0.01)
        self._adam, self._scale = Adam(self._network.count), Scale(1)

    def errors(self, seen: Array, actions: Array, following: Array) -> Array:
        """Returns the mean squared error of what is expected after each step, shape (n,).

        Args:
            seen: Array (n, sensors), normalised: before the steps.
            actions: Array (n, width), as rows take them.
            following: Array (n, sensors), normalised: after the steps.
        """
        off = self._network.forward(self._parameters, self._rows(seen, actions)).outputs - (following - seen)
        return np.asarray(np.add.reduce(off * off, axis=1) / off.shape[1])

    def learn(self, seen: Array, actions: Array, following: Array, draw: Draw) -> Array:
        """Goes once over steps, and learns to expect what came of them.

        Returns:
            How new each step was before, shape (n,): its error as a part of the mean error so far, at most 10.
        """
        errors = self.errors(seen, actions, following)
        self._scale.take(errors[:, None])
        order, rows = draw.order(len(seen)), self._rows(seen, actions)
        for begin in range(0, len(order), _BATCH):
            places = order[begin : begin + _BATCH]
            forward = self._network.forward(self._parameters, rows[places])
            off = forward.outputs - (following - seen)[places]
            gradient = self._network.backward(self._parameters, forward, off * (2.0 / off.size))
            self._adam.step(self._parameters, gradient, _RATE)
        return np.minimum(errors / max(float(self._scale.means[0]), 1e-12), 10.0)

    def _rows(self, seen: Array, actions: Array) -> Array:
        if self._choices:
            actions = (np.arange(self._choices) == actions).astype(np.float64)
        return np.hstack([seen, actions])

    def arrays(self) -> dict[str, Array]:
        """Returns all that it knows, which whoever goes on with it writes into."""
        parts = together(adam=self._adam.arrays(), scale=self._scale.arrays())
        return {"parameters": self._parameters, **parts}
