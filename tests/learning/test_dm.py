"""The environment of `dm_env`: upstream's tests pass, and it does what the one of Gymnasium does."""

from __future__ import annotations

import unittest
from typing import Any

import dm_env
import numpy as np
import pytest
from absl.testing import absltest
from dm_env import specs, test_utils

from creatures import able, snake
from nmes.errors import DocumentError
from nmes.evaluation import Task
from nmes.learning import TaskEnv, dm_environment
from nmes.learning.dm import DmEnvironment

DRIVEN = [name for name in Task.names() if "injury" not in Task.load(name).document]  # there bodies keep their parts


def task(**changes: Any) -> Task:
    return Task({**Task.load("walk").document, "duration": 0.2, "seeds": [1, 2, 3], "limits": {}, **changes})


class Upstream(test_utils.EnvironmentTestMixin, absltest.TestCase):  # type: ignore[misc]
    """Upstream's own tests; run by the test below, for each task."""

    __test__ = False  # pytest finds it by the parameters below
    made: DmEnvironment

    def make_object_under_test(self) -> DmEnvironment:
        return self.made

    def make_action_sequence(self) -> Any:
        return (np.sin(0.3 * tick) * np.ones(self.made.action_spec().shape) for tick in range(40))


NAMES = [name for name in dir(Upstream) if name.startswith("test_")]


@pytest.mark.parametrize("name", DRIVEN)
def test_upstreams_tests_pass_for_each_task(name: str) -> None:
    short = Task({**Task.load(name).document, "duration": 0.3})
    Upstream.made = dm_environment(short, able(name), seeds=[1])
    result = unittest.TestResult()
    for test in NAMES:
        Upstream(test).run(result)
    assert result.testsRun == len(NAMES) == 4 and not result.failures and not result.errors, result


def test_names_and_specs_are_as_dm_control_has_them() -> None:
    environment = dm_environment("walk", "walker")
    observed, acted = environment.observation_spec(), environment.action_spec()
    assert set(observed) == {
        "position",
        "velocity",
        *(f"torso.{what}" for what in ("height", "up", "velocity", "spin")),
    }
    assert all(spec.name == name and spec.dtype == np.float64 for name, spec in observed.items())
    assert observed["position"].shape == (8,) and environment.sensors["torso.up"] == (
        "torso.up.x",
        "torso.up.y",
        "torso.up.z",
    )
    assert acted.name.split("\t")[:2] == ["front_left_hip", "front_left_knee"]
    assert (acted.minimum == -1).all() and (acted.maximum == 1).all() and acted.shape == (8,)
    assert environment.discount_spec() == specs.BoundedArray((), float, 0.0, 1.0)
    assert environment.control_timestep() == 1 / 60


def play(environment: DmEnvironment, ticks: int) -> list[dm_env.TimeStep]:
    return [environment.reset(), *(environment.step(np.full(3, np.sin(0.7 * tick))) for tick in range(ticks))]


def bits(step: dm_env.TimeStep) -> list[bytes]:
    return [array.tobytes() for array in step.observation.values()]


def test_an_episode_is_that_of_gymnasiums_environment() -> None:
    asked = task(seeds=list(range(20, 24)))
    environment, env = dm_environment(asked, snake(), random=5), TaskEnv(snake(), asked)
    for seed in (5, None):
        steps = play(environment, 12)
        observation, _ = env.reset(seed=seed)
        for tick, step in enumerate(steps):
            for name, columns in environment.sensors.items():
                assert step.observation[name].tolist() == [observation[env.sensors.index(id)] for id in columns]
            if tick < 12:
                observation, reward, *_, info = env.step(np.full(3, np.sin(0.7 * tick)))
                assert steps[tick + 1].reward == reward
        assert environment.result is not None and environment.result.to_json() == info["result"]
    assert steps[-1].last() and steps[-1].discount == 1.0  # it has lasted its time
    assert environment.step(np.full(3, 9.0)).first()  # the action is ignored
    ended = play(dm_environment(task(ends=[{"name": "soon", "when": "time > 0.05"}]), snake()), 4)[-1]
    assert ended.last() and ended.discount == 0.0


def test_a_seed_gives_the_same_episodes_and_what_was_given_stays_as_it_was() -> None:
    asked = task(seeds=list(range(20, 24)))
    first, second = (dm_environment(asked, snake(), random=5) for _ in range(2))
    steps = play(first, 5)
    kept = [bits(step) for step in steps]
    assert [bits(step) for step in play(second, 5)] == kept
    play(first, 5)
    assert [bits(step) for step in steps] == kept
    unseeded = [dm_environment(asked, snake()) for _ in range(2)]
    assert len({tuple(bits(environment.reset())[0] for _ in range(40)) for environment in unseeded}) == 2


@pytest.mark.parametrize("action", [np.zeros(2), np.array([0, np.nan, 0]), np.array([0, 0, 1.01])])
def test_a_bad_action_moves_nothing(action: Any) -> None:
    environment, other = dm_environment(task(), snake(), random=1), dm_environment(task(), snake(), random=1)
    environment.reset(), other.reset()
    with pytest.raises(ValueError, match=r"shape|from -1 to 1"):
        environment.step(action)
    assert bits(environment.step(np.zeros(3))) == bits(other.step(np.zeros(3)))


def test_who_is_not_there_is_named() -> None:
    with pytest.raises(DocumentError, match="fly"):
        dm_environment("fly", "walker")
