"""`check_determinism` finds every planted fault, says where it is, and passes what does the same again."""

from __future__ import annotations

import random
import re
import time
from typing import Any

import gymnasium
import numpy as np
import pytest

from broken_environments import EXPECTED, FAULTS, Good
from creatures import snake
from nmes.errors import NotDeterministic
from nmes.evaluation import Task
from nmes.learning import TaskEnv, check_determinism

ALL = ("again", "another environment", "another thread", "another process")


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_is_found_and_named(name: str) -> None:
    with pytest.raises(NotDeterministic) as found:
        check_determinism(FAULTS[name])
    assert re.search(EXPECTED[name], found.value.message), found.value.message
    assert found.value.code == "not_deterministic" and found.value.problems


def test_there_are_faults_enough_that_upstreams_checker_passes() -> None:
    assert len(FAULTS) >= 20


def test_what_does_the_same_again_passes() -> None:
    assert check_determinism(Good) == ALL
    before = random.getstate(), repr(np.random.get_state()), time.time
    assert check_determinism(lambda: Good()) == ALL[:3]  # a lambda cannot be sent to another process
    assert check_determinism(Good()) == ALL[:1]  # of which no other can be made
    assert (random.getstate(), repr(np.random.get_state()), time.time) == before


@pytest.mark.parametrize("name", ["CartPole-v1", "Pendulum-v1"])
def test_gymnasiums_own_pass(name: str) -> None:
    assert check_determinism(name) == ALL


def ours() -> gymnasium.Env[Any, Any]:
    asked = {**Task.load("walk").document, "duration": 0.5, "seeds": [1, 2, 3], "limits": {}}
    return gymnasium.make("nmes/creature-v0", genome=snake(), task=asked)


def test_ours_passes_in_all_ways() -> None:
    assert check_determinism(ours, steps=40) == ALL
    assert check_determinism("nmes/walk-v0", steps=40, genome="walker", seeds=[1, 2]) == ALL
    env = TaskEnv(snake(), Task.load("walk"), seeds=[1])
    assert check_determinism(env, steps=40) == ALL[:1]
    env.close()
