"""`nmes measure`: what is computed follows from the seed, and what is compared is what it is said to be."""

from __future__ import annotations

import json
import sys
from math import isclose
from typing import Any

import numpy as np
import pytest

from command_line import run
from nmes.evaluation import Task
from nmes.genome import Genome
from nmes.learning.environment import TaskEnv
from nmes.measure import encodings, peers
from nmes.measure.encodings import measure_encodings
from nmes.measure.turns import in_turns, ratio


def measured(*arguments: str) -> Any:
    result = run("measure", *arguments, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


# -- turns ------------------------------------------------------------------------------------------------------------


def test_trials_take_turns_forwards_and_backwards_after_one_for_warmth() -> None:
    order: list[str] = []
    times = {"a": iter([9.0, 1.0, 2.0, 6.0]), "b": iter([9.0, 2.0, 8.0, 3.0])}

    def trial(name: str) -> float:
        order.append(name)
        return next(times[name])

    samples = in_turns({"a": lambda: trial("a"), "b": lambda: trial("b")}, 3)
    assert order == ["a", "b", "a", "b", "b", "a", "a", "b"]
    assert samples == {"a": [1.0, 2.0, 6.0], "b": [2.0, 8.0, 3.0]}
    assert ratio(samples, "b", "a") == 2.0  # of 2, 4 and 0.5


# -- crowds -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("backend", "hinges", "asleep"), [("mujoco", True, 6), ("pymunk", True, 6), ("ballistic", False, 0)]
)
def test_a_crowd_has_its_cubes_and_comes_to_the_same_again(backend: str, hinges: bool, asleep: int) -> None:
    asked = ("crowd", "--backend", backend, "--active", "4", "--still", "6", "--rounds", "3")
    found = measured(*asked, "--seed", "1")
    assert {name: world["cubes"] for name, world in found["worlds"].items()} == {
        "alone": 4,
        "frozen": 10,
        "resting": 10,
        "moving": 10,
    }
    assert (found["hinges"], found["asleep"]) == (hinges, asleep)  # those that are pushed never sleep
    assert found["worlds"]["alone"]["ratio"] == 1.0
    assert all(world["pace"] > 0 and 0 <= world["late"] <= 1 for world in found["worlds"].values())
    assert measured(*asked, "--seed", "1")["digest"] == found["digest"]
    assert measured(*asked, "--seed", "2")["digest"] != found["digest"]


def test_memory_is_told_for_each_cube() -> None:
    asked = ("crowd", "--active", "200", "--still", "300", "--rounds", "1")
    grown = measured(*asked)["bytes_per_cube"]
    assert grown is None or grown < 1e6


def test_an_engine_that_there_is_none_of_is_told() -> None:
    result = run("measure", "crowd", "--backend", "bullet")
    assert result.exit_code == 1 and "bullet" in result.output


def test_what_is_measured_is_printed_line_by_line() -> None:
    output = run("measure", "crowd", "--backend", "ballistic", "--active", "2", "--still", "0", "--rounds", "1").output
    assert "backend: ballistic\n" in output and "worlds alone cubes: 2\n" in output and "asleep: 0\n" in output


# -- hosts ------------------------------------------------------------------------------------------------------------

on_linux = pytest.mark.skipif(sys.platform != "linux", reason="a host's time of processors is read on Linux alone")


@on_linux
def test_agents_cost_time_and_their_cubes_come_to_the_same_again() -> None:
    asked = ("agents", "--agents", "1", "--agents", "3", "--ticks", "5", "--rounds", "2")
    found = measured(*asked)
    assert [each["agents"] for each in found["agents"]] == [1, 3]
    assert all(each["milliseconds"] > 0 for each in found["agents"]) and found["agents"][0]["each"] == 1.0
    assert measured(*asked)["digest"] == found["digest"] != measured(*asked, "--seed", "1")["digest"]


def test_decisions_are_counted_in_lockstep_and_in_real_time() -> None:
    found = measured("decisions", "--seconds", "0.5")
    assert found["lockstep"] > 0 and 0 < found["in_time"] <= 1
    assert 0 < found["real_time"] < 70  # the world ticks 60 times a second


def test_cubes_are_spawned_in_three_ways() -> None:
    found = measured("spawning", "--cubes", "12", "--connections", "3", "--rounds", "2")
    assert found.keys() == {"one", "many", "together", "one_over_many", "one_over_together"}
    assert all(value > 0 for value in found.values())


def test_a_host_that_does_not_begin_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    result = run("measure", "decisions", "--seconds", "0.1")
    assert result.exit_code == 1 and "a host does not begin here" in result.output


# -- encodings --------------------------------------------------------------------------------------------------------


def test_all_channels_lead_to_the_same_states() -> None:
    asked = ("encodings", "--cubes", "3", "--rounds", "2")
    found = measured(*asked)
    assert found["alike"] is True and found["bytes"] > 3 * 13
    assert found["microseconds"].keys() == set(encodings.CHANNELS)
    assert measured(*asked)["digest"] == found["digest"] != measured(*asked, "--seed", "1")["digest"]


def test_a_channel_that_leads_to_other_states_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(encodings, "_flat", lambda state: (float(len(state["cubes"])),))
    assert measure_encodings(2, 0, 1).alike is False  # shared memory has the states themselves


def test_msgpack_that_is_not_installed_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "msgpack", None)
    result = run("measure", "encodings", "--cubes", "1")
    assert result.exit_code == 1 and "pip install 'nmes[bench]'" in result.output


# -- peers ------------------------------------------------------------------------------------------------------------


def test_the_plain_environment_has_the_same_body() -> None:
    """The same actions bring it as far, tick by tick, as in our environment."""
    genome, task = Genome.load("walker"), Task(peers._TASK)
    ours, plain = TaskEnv(genome, task), peers._Plain(genome, task)
    ours.reset(seed=1)
    plain.reset(seed=1)
    draw = np.random.Generator(np.random.PCG64(1))
    far = 0.0
    for _ in range(peers._TICKS):
        action = draw.uniform(-1.0, 1.0, plain.action_space.shape)
        (_, mine, _, over, _), (_, theirs, _, cut, _) = ours.step(action), plain.step(action)
        assert isclose(mine, theirs, abs_tol=1e-9)
        assert over == cut
        far += mine
    assert cut and abs(far) > 1e-3


def test_a_body_and_a_learner_are_measured_beside_gymnasium() -> None:
    asked = ("peer", "walker", "--steps", "2400", "--rounds", "2")
    found = measured(*asked)
    assert all(found[name] > 0 for name in ("rate", "rate_rows", "rate_remote", "steps_per_second", "learning"))
    assert found["exact"] is found["exact_plain"] is True
    assert found["change"]["grown"] is found["change"]["unmoved"] is True and found["change"]["milliseconds"] > 0
    assert found["megabytes"] > found["megabytes_plain"] > 10
    assert measured(*asked)["digest"] == found["digest"] != measured(*asked, "--seed", "1")["digest"]


def test_an_environment_that_does_not_come_again_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    step, count = peers._Plain.step, iter(range(10**9))

    def drifting(self: peers._Plain, action: np.ndarray) -> Any:
        self._data.qvel[0] += 1e-12 * next(count)
        return step(self, action)

    genome, task = Genome.load("walker"), Task(peers._TASK)
    assert peers._comes_again(lambda: peers._Plain(genome, task), 1)
    monkeypatch.setattr(peers._Plain, "step", drifting)
    assert not peers._comes_again(lambda: peers._Plain(genome, task), 1)


def test_gymnasium_that_is_not_installed_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nmes.cli.measure.find_spec", lambda name: None)
    result = run("measure", "peer")
    assert result.exit_code == 1 and "pip install 'nmes[gym]'" in result.output
