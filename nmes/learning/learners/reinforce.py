"""REINFORCE with a baseline: what went better than expected is made more probable, once for each block of steps.

Sources: R. J. Williams, "Simple statistical gradient-following algorithms for connectionist reinforcement learning",
Machine Learning 8 (1992); R. S. Sutton and A. G. Barto, "Reinforcement learning" (2018), 13.4: with a
critic for a baseline.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nmes.backend import Array
from nmes.evolution.algorithms.bounds import within_bounds
from nmes.learning.learners.actor_critic import ActorCritic, Report
from nmes.learning.learners.arithmetic import average
from nmes.learning.learners.experience import Collector, Scale, advantages, discounted
from nmes.learning.learners.networks import Adam, Network, clipped, together
from nmes.learning.learners.rows import Spaces
from nmes.variation.draw import Draw

__all__ = ["Reinforce"]

_BATCH = 512  # steps that the critic learns from at once


class Reinforce(ActorCritic):
    """A policy that goes one step along the gradient of what its own episodes were worth.

    Args:
        spaces: What goes in and out of the policy.
        options: See `Options`.
        draw: Where the first weights come from.
        start: The policy's network and its parameters at first, where it goes on from a brain.
    """

    @dataclass(frozen=True)
    class Options:
        """The options.

        Attributes:
            rows: How many environments are stepped side by side.
            ticks: How many steps of each make a block; 0: as long as an episode may last.
            units: Of each of the two hidden layers, of policy and critic.
            rate: How far the policy goes along the gradient at first; at the end it is 0.
            critic_rate: How far the critic goes along its own.
            gamma: What a reward one step later is worth.
            spread: The standard deviation of controls at first.
            longest: The greatest length of a gradient.
        """

        rows: int = 16
        ticks: int = 0
        units: int = 64
        rate: float = 3e-3
        critic_rate: float = 1e-3
        gamma: float = 0.99
        spread: float = 0.5
        longest: float = 0.5

        def __post_init__(self) -> None:
            counts = {"rows": (1, 4096), "ticks": (0, 100_000), "units": (1, 1024), "gamma": (0, 1)}
            steps = {"rate": (1e-9, 10), "critic_rate": (1e-9, 10), "spread": (1e-6, 100), "longest": (1e-9, 1e9)}
            within_bounds(self, {**counts, **steps})

    def __init__(
        self, spaces: Spaces, options: Options, draw: Draw, start: tuple[Network, Array] | None = None
    ) -> None:
        super().__init__(spaces, options.units, options.spread, draw, start)
        self._options = options
        self._adam, self._critic_adam = Adam(len(self.parameters)), Adam(len(self.parameters))
        self._gains = Scale(1)

    def learn(self, collector: Collector, ticks: int, draw: Draw, rest: float) -> Report:
        """Gathers a block of steps, and learns from it; see `ActorCritic.learn`."""
        options = self._options
        experience = self.collect(collector, ticks, draw)
        seen, following = self.normalised(experience)
        actions = experience.actions.reshape(-1, self.policy.width)
        self._gains.take(discounted(experience.rewards, experience.over, options.gamma).reshape(-1, 1))
        rewards = experience.rewards / self._gains.deviations[0]
        values, after = self.values(seen), self.values(following)
        better = advantages(
            experience, rewards, values.reshape(rewards.shape), after.reshape(rewards.shape), options.gamma, 1.0
        ).reshape(-1)
        gradient, loss = policy_loss(self, self.parameters, seen, actions, better)
        self._adam.step(self.parameters, clipped(gradient, options.longest), rest * options.rate)
        value_loss = self._expect(seen, better + values, draw)
        self.scale_by(experience)
        figures = {"policy loss": loss, "value loss": value_loss}
        return Report(experience.rewards.size, experience.returns, experience.lengths, figures)

    def _expect(self, seen: Array, returns: Array, draw: Draw) -> float:
        """Lets the critic go once over steps; returns its loss before."""
        order, policy = draw.order(len(seen)), np.zeros(len(self.parameters) - self.critic_count)
        off = self.values(seen) - returns
        for begin in range(0, len(order), _BATCH):
            places = order[begin : begin + _BATCH]
            forward = self.expected(self.parameters, seen[places])
            slopes = (forward.outputs[:, 0] - returns[places]) / len(places)
            gradient = np.concatenate([policy, self.critic_slopes(self.parameters, forward, slopes)])
            self._critic_adam.step(self.parameters, gradient, self._options.critic_rate)
        return 0.5 * average(off * off)

    def arrays(self) -> dict[str, Array]:
        """Returns all that it knows, which whoever goes on with it writes into."""
        parts = together(adam=self._adam.arrays(), critic_adam=self._critic_adam.arrays(), gains=self._gains.arrays())
        return {**super().arrays(), **parts}


def policy_loss(
    learner: ActorCritic, parameters: Array, seen: Array, actions: Array, better: Array
) -> tuple[Array, float]:
    """Returns the gradient of the policy's loss by all parameters, and the loss.

    Args:
        learner: Whose parameters they are.
        parameters: Its parameters.
        seen: Array (n, sensors), normalised.
        actions: Array (n, width).
        better: Array (n,): by how much each step was better than expected; its mean and its size do not count.
    """
    away = better - average(better)
    better = away / (np.sqrt(average(away * away)) + 1e-8)
    forward, likelihood = learner.likelihood(parameters, seen, actions)
    slopes = learner.policy_slopes(parameters, forward, likelihood, -better / len(seen), np.zeros(len(seen)))
    return np.concatenate([slopes, np.zeros(learner.critic_count)]), -average(better * likelihood.logs)
