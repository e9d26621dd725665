"""Proximal policy optimisation: a policy and a critic that learn from blocks of steps, a little at a time.

    learner = Ppo(Spaces(26, 8), Ppo.Options(), Draw(1))
    collector = Collector(rows, seed=1)
    for number in range(100):
        report = learner.learn(collector, 600, Draw(1, number), rest=1.0 - number / 100)

Sources: J. Schulman et al., "Proximal policy optimization algorithms" (2017); S. Huang et al., "The 37 implementation
details of proximal policy optimization", ICLR Blog Track 2022, whose file
ppo_continuous_action.py of CleanRL is the model: orthogonal weights, the rate annealed, advantages normalised in each
batch, losses of the value clipped, gradients clipped, observations normalised, rewards scaled by the deviation of
their discounted sums.

Otherwise than there: an episode that is cut off goes on in the critic's value; normalised observations are not
clipped, so that the normalisation can become part of a brain's weights; what normalises stays as it is within a block.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nmes.backend import Array
from nmes.brain.base import Indices
from nmes.evolution.algorithms.bounds import within_bounds
from nmes.learning.learners.actor_critic import ActorCritic, Report
from nmes.learning.learners.arithmetic import average, exp
from nmes.learning.learners.experience import Collector, Experience, Scale, advantages, discounted
from nmes.learning.learners.networks import Adam, Network, clipped, together
from nmes.learning.learners.novelty import ForwardModel
from nmes.learning.learners.rows import Spaces
from nmes.variation.draw import Draw

__all__ = ["Batch", "Ppo", "losses"]


class Ppo(ActorCritic):
    """A policy that never goes far from the one that gathered the steps that it learns from.

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
            rate: How far a step along the gradient goes at first; at the end it is 0.
            epochs: How often each block is learned from.
            batch: How many steps make a gradient.
            gamma: What a reward one step later is worth.
            decay: How much later surprises count, lambda of the advantage estimates.
            clip: How far the probability of an action may go, as a part of it, before it no longer counts.
            entropy: What a nat of the policy's entropy is worth.
            spread: The standard deviation of controls at first.
            longest: The greatest length of a gradient.
            normalise: Whether observations are normalised by what was seen so far. Where blocks are short, that changes
                what the policy does more than learning does.
            novelty: What is new is worth so much beside the reward: of the mean error of a forward model.
        """

        rows: int = 16
        ticks: int = 0
        units: int = 64
        rate: float = 3e-4
        epochs: int = 10
        batch: int = 512
        gamma: float = 0.99
        decay: float = 0.95
        clip: float = 0.2
        entropy: float = 0.0
        spread: float = 0.5
        longest: float = 0.5
        normalise: bool = True
        novelty: float = 0.0

        def __post_init__(self) -> None:
            counts = {"rows": (1, 4096), "ticks": (0, 100_000), "units": (1, 1024), "epochs": (1, 1000)}
            parts = {"gamma": (0, 1), "decay": (0, 1), "clip": (1e-6, 10), "entropy": (0, 1000)}
            steps = {"rate": (1e-9, 10), "spread": (1e-6, 100), "longest": (1e-9, 1e9), "novelty": (0, 1e6)}
            within_bounds(self, {**counts, "batch": (1, 1_000_000), **parts, **steps})

    def __init__(
        self, spaces: Spaces, options: Options, draw: Draw, start: tuple[Network, Array] | None = None
    ) -> None:
        super().__init__(spaces, options.units, options.spread, draw, start)
        self._options = options
        self._adam, self._gains = Adam(len(self.parameters)), Scale(1)
        self._model = ForwardModel(spaces, options.units, draw) if options.novelty else None

    def learn(self, collector: Collector, ticks: int, draw: Draw, rest: float) -> Report:
        """Gathers a block of steps, and learns from it.

        Args:
            collector: Of the rows.
            ticks: How many steps of each row.
            draw: Of actions and batches.
            rest: How much of the learning is still to be done, from 1 down to 0.
        """
        options = self._options
        experience = self.collect(collector, ticks, draw)
        seen, following = self.normalised(experience)
        rewards = self._rewards(experience)
        figures = {}
        if self._model is not None:
            actions = experience.actions.reshape(-1, self.policy.width)
            errors = self._model.learn(seen, self.policy.act(actions), following, draw)
            rewards = rewards + options.novelty * errors.reshape(rewards.shape)
            figures["novelty"] = average(errors)
        block = self._block(experience, seen, following, rewards)
        rounds = []
        for _ in range(options.epochs):
            order = draw.order(len(seen))
            for begin in range(0, len(seen), options.batch):
                batch = block.part(order[begin : begin + options.batch])
                gradient, told = losses(self, self.parameters, batch, options.clip, options.entropy)
                rounds.append(told)
                self._adam.step(self.parameters, clipped(gradient, options.longest), rest * options.rate)
        if options.normalise:
            self.scale_by(experience)
        figures |= {name: average(np.array([each[name] for each in rounds])) for name in rounds[0]}
        return Report(experience.rewards.size, experience.returns, experience.lengths, figures)

    def _rewards(self, experience: Experience) -> Array:
        """Returns rewards of about the size that a critic learns well."""
        gains = discounted(experience.rewards, experience.over, self._options.gamma)
        self._gains.take(gains.reshape(-1, 1))
        return np.asarray(experience.rewards / self._gains.deviations[0])

    def _block(self, experience: Experience, seen: Array, following: Array, rewards: Array) -> Batch:
        """Returns the steps with what they came to be worth."""
        values, after = self.values(seen), self.values(following)
        shape, options = rewards.shape, self._options
        better = advantages(
            experience, rewards, values.reshape(shape), after.reshape(shape), options.gamma, options.decay
        ).reshape(-1)
        actions = experience.actions.reshape(-1, self.policy.width)
        logs = self.likelihood(self.parameters, seen, actions)[1].logs
        return Batch(seen, actions, logs, better, values, better + values)

    def arrays(self) -> dict[str, Array]:
        """Returns all that it knows, which whoever goes on with it writes into."""
        model = {} if self._model is None else self._model.arrays()
        parts = together(adam=self._adam.arrays(), gains=self._gains.arrays(), model=model)
        return {**super().arrays(), **parts}


@dataclass(frozen=True, eq=False, slots=True)
class Batch:
    """Steps that make a gradient.

    Attributes:
        seen: Array (n, sensors), normalised.
        actions: Array (n, width).
        logs: Array (n,): of the probabilities that the actions had when they were drawn.
        better: Array (n,): advantages.
        values: Array (n,): what the critic expected then.
        returns: Array (n,): what it should have expected.
    """

    seen: Array
    actions: Array
    logs: Array
    better: Array
    values: Array
    returns: Array

    def part(self, places: Indices) -> Batch:
        """Returns some of the steps."""
        return Batch(*(getattr(self, name)[places] for name in self.__slots__))


def losses(
    learner: ActorCritic, parameters: Array, batch: Batch, clip: float, entropy: float
) -> tuple[Array, dict[str, float]]:
    """Returns the gradient of the loss of a batch by all parameters, and the parts of the loss.

    Args:
        learner: Whose parameters they are.
        parameters: Its parameters.
        batch: The steps.
        clip: See `Ppo.Options`; the critic's values are kept as near to those before.
        entropy: See `Ppo.Options`.
    """
    count = len(batch.seen)
    away = batch.better - average(batch.better)
    better = away / (np.sqrt(average(away * away)) + 1e-8)
    forward, likelihood = learner.likelihood(parameters, batch.seen, batch.actions)
    moved = likelihood.logs - batch.logs
    ratios = exp(moved)
    free, kept = -better * ratios, -better * np.minimum(np.maximum(ratios, 1.0 - clip), 1.0 + clip)
    of_logs = np.where(free >= kept, free, 0.0) / count
    by_policy = learner.policy_slopes(parameters, forward, likelihood, of_logs, np.full(count, -entropy / count))

    expected = learner.expected(parameters, batch.seen)
    change = expected.outputs[:, 0] - batch.values
    near = batch.values + np.minimum(np.maximum(change, -clip), clip)
    off, near_off = expected.outputs[:, 0] - batch.returns, near - batch.returns
    worse = off * off >= near_off * near_off
    of_values = np.where(worse, off, np.where(np.abs(change) < clip, near_off, 0.0)) * (0.5 / count)
    by_critic = learner.critic_slopes(parameters, expected, of_values)
    told = {
        "policy loss": average(np.maximum(free, kept)),
        "value loss": 0.5 * average(np.maximum(off * off, near_off * near_off)),
        "entropy": average(likelihood.entropies),
        "divergence": average((ratios - 1.0) - moved),
        "clipped": average((np.abs(ratios - 1.0) > clip).astype(np.float64)),
    }
    return np.concatenate([by_policy, by_critic]), told
