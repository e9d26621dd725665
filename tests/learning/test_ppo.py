"""PPO: its gradient by differences, that it learns, that it comes out the same, and what its brain does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from nmes.brain import load_brain
from nmes.errors import DocumentError
from nmes.learning.learners.experience import Collector
from nmes.learning.learners.networks import read_layers
from nmes.learning.learners.ppo import Batch, Ppo, losses
from nmes.learning.learners.rows import GymnasiumRows, Spaces
from nmes.variation.draw import Draw
from slopes import slopes
from teaching import SPACES, Follow, mean_returns

SMALL = Ppo.Options(rows=8, ticks=60, units=16, rate=3e-3, epochs=8, batch=120, gamma=0.5, spread=0.3)


@pytest.mark.parametrize("spaces", [Spaces(3, 2), Spaces(3, 4, choices=True)], ids=["controls", "choices"])
def test_the_gradient_of_its_losses_is_that_by_differences(spaces: Spaces) -> None:
    """Also where probabilities and values have gone so far that they are clipped."""
    learner = Ppo(spaces, replace(SMALL, units=5), Draw(1))
    draw, count, entropy = Draw(2), 40, 0.3
    parameters = learner.parameters + 0.3 * draw.normals(len(learner.parameters))
    seen = draw.normals(3 * count).reshape(count, 3)
    forward, _ = learner.likelihood(parameters, seen, np.zeros((count, learner.policy.width)))
    own = parameters[len(parameters) - learner.critic_count - learner.policy.count : -learner.critic_count]
    actions = learner.policy.draw(forward.outputs, own, draw)
    logs = learner.likelihood(parameters, seen, actions)[1].logs + 0.3 * draw.normals(count)
    values = learner.expected(parameters, seen).outputs[:, 0]
    batch = Batch(seen, actions, logs, draw.normals(count), values + 0.3 * draw.normals(count), draw.normals(count))

    def loss(point: np.ndarray) -> float:
        told = losses(learner, point, batch, 0.2, entropy)[1]
        return told["policy loss"] + 0.5 * told["value loss"] - entropy * told["entropy"]

    gradient, told = losses(learner, parameters, batch, 0.2, entropy)
    assert 0.1 < told["clipped"] < 0.9
    np.testing.assert_allclose(gradient, slopes(loss, parameters), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("choices", [False, True], ids=["controls", "choices"])
def test_it_learns_what_is_rewarded(choices: bool) -> None:
    rows = Follow(SMALL.rows, choices=choices)
    returns = mean_returns(Ppo(rows.spaces, SMALL, Draw(1)), rows, 15, SMALL.ticks)
    assert returns[0] < 14.0
    assert returns[-1] > 17.0


def test_novelty_is_learned_beside_the_reward() -> None:
    rows, learner = Follow(SMALL.rows), Ppo(SPACES, replace(SMALL, novelty=0.01), Draw(1))
    collector = Collector(rows, 1)
    told = [learner.learn(collector, SMALL.ticks, Draw(1, block), 1.0).figures["novelty"] for block in range(3)]
    assert told[0] == pytest.approx(1.0)  # what was never seen is as new as the mean
    assert told[-1] < 0.9


def test_it_comes_out_the_same_and_goes_on_from_its_arrays() -> None:
    options = replace(SMALL, novelty=0.01)

    def learned(learner: Ppo, *blocks: int) -> dict[str, np.ndarray]:
        for block in blocks:
            learner.learn(Collector(Follow(SMALL.rows), block), SMALL.ticks, Draw(1, block), 1.0)
        return {name: array.copy() for name, array in learner.arrays().items()}

    whole, first = learned(Ppo(SPACES, options, Draw(1)), 1, 2, 3), learned(Ppo(SPACES, options, Draw(1)), 1)
    other = Ppo(SPACES, options, Draw(99))
    for name, array in other.arrays().items():
        array[...] = first[name]
    again = learned(other, 2, 3)
    assert {name: array.tobytes() for name, array in again.items()} == {
        name: array.tobytes() for name, array in whole.items()
    }
    assert (whole["parameters"] != first["parameters"]).mean() > 0.9


def test_its_brain_does_what_it_does_without_chance() -> None:
    rows, learner = Follow(SMALL.rows), Ppo(SPACES, SMALL, Draw(1))
    mean_returns(learner, rows, 3, SMALL.ticks)
    brain = load_brain(learner.brain(), ["goal", "noise"], ["motor"])
    brain.reset(seed=0, dt=0.1)
    seen = rows.reset(7)
    controls = np.array([brain.step(row).copy() for row in seen])
    np.testing.assert_allclose(controls, learner.best(seen), rtol=0, atol=1e-9)
    assert np.ptp(controls) > 0.4


def test_it_goes_on_from_a_brain_that_does_the_same_after_the_scale_has_changed() -> None:
    rows, teacher = Follow(SMALL.rows), Ppo(SPACES, SMALL, Draw(1))
    mean_returns(teacher, rows, 3, SMALL.ticks)
    pupil = Ppo(SPACES, replace(SMALL, rate=1e-9), Draw(2), read_layers(teacher.brain(), 2))
    seen = rows.reset(7)
    np.testing.assert_allclose(pupil.best(seen), teacher.best(seen), atol=1e-9)
    mean_returns(pupil, rows, 2, SMALL.ticks)
    assert pupil.scale.means[0] == pytest.approx(100.0, abs=1.0)
    np.testing.assert_allclose(pupil.best(seen), teacher.best(seen), atol=1e-5)


def test_observations_are_normalised_unless_told_otherwise() -> None:
    for normalise in (True, False):
        learner = Ppo(SPACES, replace(SMALL, normalise=normalise), Draw(1))
        mean_returns(learner, Follow(SMALL.rows), 1, SMALL.ticks)
        assert learner.scale.means[0] == (pytest.approx(100.0, abs=1.0) if normalise else 0.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [({"gamma": 1.5}, "options.gamma: must be from 0 to 1"), ({"rows": 0}, "options.rows: must be from 1 to 4,096")],
)
def test_options_out_of_bounds_are_refused(options: dict[str, float], words: str) -> None:
    with pytest.raises(DocumentError, match=words):
        Ppo.Options(**options)  # type: ignore[arg-type]


# -- Gymnasium --------------------------------------------------------------------------------------------------------

CARTPOLE = Ppo.Options(
    rows=8, ticks=32, units=64, rate=1e-3, epochs=20, batch=256, gamma=0.98, decay=0.8, normalise=False
)
PENDULUM = Ppo.Options(rows=4, ticks=1024, rate=1e-3, epochs=10, batch=64, gamma=0.9, spread=1.0)


def vector(name: str, count: int) -> GymnasiumRows:
    gymnasium = pytest.importorskip("gymnasium")
    makers: list[Callable[[], object]] = [lambda: gymnasium.make(name)] * count
    mode = gymnasium.vector.AutoresetMode.SAME_STEP
    return GymnasiumRows(gymnasium.vector.SyncVectorEnv(makers, autoreset_mode=mode))


def trained(name: str, options: Ppo.Options, steps: int, seed: int) -> Ppo:
    rows = vector(name, options.rows)
    learner, collector = Ppo(rows.spaces, options, Draw(seed)), Collector(rows, seed)
    blocks = steps // (options.rows * options.ticks)
    for block in range(blocks):
        learner.learn(collector, options.ticks, Draw(seed, block), 1.0 - block / blocks)
    return learner


def evaluated(name: str, learner: Ppo, seed: int, episodes: int = 20) -> float:
    """Returns the mean return of episodes without chance."""
    rows = vector(name, episodes)
    seen, gained = rows.reset(1000 + seed), np.zeros(episodes)
    going = np.ones(episodes, bool)
    while going.any():
        seen, rewards, terminated, truncated = rows.step(learner.policy.act(learner.best(seen)))
        gained += rewards * going
        going &= ~(terminated | truncated)
    return float(gained.mean())


def test_it_learns_to_balance_the_pole_of_gymnasium() -> None:
    learner = trained("CartPole-v1", CARTPOLE, 7_000, 1)
    assert evaluated("CartPole-v1", learner, 1) > 100.0


def test_what_ends_an_episode_is_seen_in_rows_of_gymnasium() -> None:
    rows = vector("Pendulum-v1", 2)
    first = rows.reset(3)
    for _ in range(199):
        seen, _, _, truncated = rows.step(np.ones((2, 1)))
        assert not truncated.any()
    ended, _, _, truncated = rows.step(np.ones((2, 1)))
    assert truncated.all()
    assert (ended != rows.last_observations).any()
    assert not (seen == first).all()


def test_rows_that_reset_otherwise_are_refused() -> None:
    gymnasium = pytest.importorskip("gymnasium")
    with pytest.raises(ValueError, match="SAME_STEP"):
        GymnasiumRows(gymnasium.make_vec("CartPole-v1", num_envs=2))


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "options", "steps", "least"),
    [("CartPole-v1", CARTPOLE, 100_000, 450.0), ("Pendulum-v1", PENDULUM, 100_000, -250.0)],
)
def test_ten_seeds_learn_what_stable_baselines_learns(
    name: str, options: Ppo.Options, steps: int, least: float
) -> None:
    """The same as benchmarks/learners.py, which measures Stable-Baselines3's beside it."""
    scores = [evaluated(name, trained(name, options, steps, seed), seed) for seed in range(10)]
    assert np.mean(scores) > least, scores
