"""What learners of policies have in common: a policy's network, a critic, what normalises, and what they report."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from math import log

import numpy as np

from nmes.backend import Array
from nmes.brain.base import JsonObject
from nmes.learning.learners.experience import Collector, Experience, Scale
from nmes.learning.learners.networks import Network, Pass, together
from nmes.learning.learners.policies import Likelihood, policy_of
from nmes.learning.learners.rows import Spaces
from nmes.variation.draw import Draw

__all__ = ["ActorCritic", "Report"]


@dataclass(frozen=True, slots=True)
class Report:
    """What came of a block of steps.

    Attributes:
        steps: How many there were, of all rows together.
        returns: The sums of rewards of the episodes that were over.
        lengths: Their numbers of steps.
        figures: What the learner tells of its own state, by name.
    """

    steps: int
    returns: tuple[float, ...]
    lengths: tuple[int, ...]
    figures: Mapping[str, float]


class ActorCritic(ABC):
    """A policy, and a critic that knows what to expect of it.

    Args:
        spaces: What goes in and out of the policy.
        units: Of each of the two hidden layers, of policy and critic.
        spread: The standard deviation of controls at first.
        draw: Where the first weights come from.
        start: The policy's network and its parameters at first, where it goes on from a brain.

    Attributes:
        policy: What the outputs of its network mean.
        parameters: All of them, one array: the policy's network's, the policy's own, the critic's.
        scale: By which observations are normalised.
    """

    def __init__(
        self, spaces: Spaces, units: int, spread: float, draw: Draw, start: tuple[Network, Array] | None
    ) -> None:
        self.policy = policy_of(spaces)
        self.scale = Scale(spaces.sensors)
        self._actor = Network((spaces.sensors, units, units, self.policy.outputs)) if start is None else start[0]
        self._critic = Network((spaces.sensors, units, units, 1))
        actor = self._actor.initial(draw, 0.01) if start is None else start[1]
        own, critic = np.full(self.policy.count, log(spread)), self._critic.initial(draw, 1.0)
        self.parameters = np.concatenate([actor, own, critic])
        self._kept = start is not None

    @property
    def critic_count(self) -> int:
        """How many of the parameters, the last, are the critic's."""
        return self._critic.count

    @abstractmethod
    def learn(self, collector: Collector, ticks: int, draw: Draw, rest: float) -> Report:
        """Gathers a block of steps, and learns from it.

        Args:
            collector: Of the rows.
            ticks: How many steps of each row.
            draw: Of all that is drawn meanwhile.
            rest: How much of the learning is still to be done, from 1 down to 0.
        """

    def collect(self, collector: Collector, ticks: int, draw: Draw) -> Experience:
        """Gathers steps with actions that the policy draws."""
        actor, own, _ = self._parts(self.parameters)

        def choose(seen: Array) -> Array:
            return self.policy.draw(self._actor.forward(actor, self.scale.apply(seen)).outputs, own, draw)

        return collector.collect(ticks, self.policy.width, choose, self.policy.act)

    def normalised(self, experience: Experience) -> tuple[Array, Array]:
        """Returns the observations before and after each step, normalised, shapes (n, sensors)."""
        columns = experience.observations.shape[-1]
        seen, following = self.scale.apply(experience.observations), self.scale.apply(experience.following)
        return seen.reshape(-1, columns), following.reshape(-1, columns)

    def scale_by(self, experience: Experience) -> None:
        """Takes what was seen into the scale, by which later steps are normalised.

        A policy that goes on from a brain does what it did before; another is carried along: its first weights know
        nothing of what they are given anyway.
        """
        means, deviations = self.scale.means.copy(), self.scale.deviations
        self.scale.take(experience.observations.reshape(-1, experience.observations.shape[-1]))
        if self._kept:
            ratios, shifts = self.scale.deviations / deviations, (self.scale.means - means) / deviations
            self._actor.rescaled(self._parts(self.parameters)[0], ratios, shifts)

    def best(self, observations: Array) -> Array:
        """Returns the actions without chance (n, width) at observations (n, sensors)."""
        rows = self._actor.forward(self._parts(self.parameters)[0], self.scale.apply(observations))
        return self.policy.best(rows.outputs)

    def brain(self) -> JsonObject:
        """Returns the brain that does what `best` does; only where actions are controls."""
        return self._actor.document(self._parts(self.parameters)[0], self.scale.means, self.scale.deviations)

    def values(self, seen: Array) -> Array:
        """Returns the critic's values, shape (n,), of normalised observations (n, sensors)."""
        return self.expected(self.parameters, seen).outputs[:, 0]

    # -- slopes: parameters may be others than the learner's own ---------------------------------------------------

    def likelihood(self, parameters: Array, seen: Array, actions: Array) -> tuple[Pass, Likelihood]:
        """Returns how probable actions are, and the pass through the policy's network that says so."""
        actor, own, _ = self._parts(parameters)
        forward = self._actor.forward(actor, seen)
        return forward, self.policy.likelihood(forward.outputs, own, actions)

    def policy_slopes(
        self, parameters: Array, forward: Pass, likelihood: Likelihood, of_logs: Array, of_entropies: Array
    ) -> Array:
        """Returns the gradient of a sum by the parameters of the policy, those of its network first.

        Args:
            parameters: Those of the pass.
            forward: The pass that `likelihood` gave.
            likelihood: What it gave too.
            of_logs: The derivatives of the sum by the logarithms of probabilities, shape (n,).
            of_entropies: By the entropies.
        """
        by_outputs, own = likelihood.slopes(of_logs, of_entropies)
        return np.concatenate([self._actor.backward(self._parts(parameters)[0], forward, by_outputs), own])

    def expected(self, parameters: Array, seen: Array) -> Pass:
        """Returns the pass through the critic's network."""
        return self._critic.forward(self._parts(parameters)[2], seen)

    def critic_slopes(self, parameters: Array, forward: Pass, of_values: Array) -> Array:
        """Returns the gradient of a sum by the critic's parameters, from its derivatives by the values (n,)."""
        return self._critic.backward(self._parts(parameters)[2], forward, of_values[:, None])

    def _parts(self, parameters: Array) -> tuple[Array, Array, Array]:
        first, second = self._actor.count, self._actor.count + self.policy.count
        return parameters[:first], parameters[first:second], parameters[second:]

    def arrays(self) -> dict[str, Array]:
        """Returns all that it knows, which whoever goes on with it writes into."""
        return {"parameters": self.parameters, **together(scale=self.scale.arrays())}
