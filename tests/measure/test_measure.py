"""`nmes measure`: what is computed follows from the seed, and what is compared is what it is said to be."""

from __future__ import annotations

import json
import os
import signal
import socket
import struct
import subprocess
import sys
import time
from importlib.metadata import distribution, files
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_line import run
from nmes.errors import MachineError
from nmes.evaluation import Task
from nmes.evaluation.processes import start_process
from nmes.genome import Genome
from nmes.learning.environment import TaskEnv
from nmes.measure import encodings, installs, peers
from nmes.measure.encodings import measure_encodings
from nmes.measure.hosts import measure_decisions, running_host
from nmes.measure.installs import measure_installs
from nmes.measure.turns import in_turns, ratio
from processes import NMES


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
    assert found["real_time"] > 0  # 60 where all is in time; a world that was late catches up, with more


def test_a_decision_that_takes_longer_than_the_time_for_all_is_measured() -> None:
    assert 0.0 < measure_decisions(1e-9, 0).in_time <= 1.0


def test_cubes_are_spawned_in_three_ways() -> None:
    found = measured("spawning", "--cubes", "12", "--connections", "3", "--rounds", "2")
    assert found.keys() == {"one", "many", "together", "one_over_many", "one_over_together"}
    assert all(value > 0 for value in found.values())


def test_a_host_that_does_not_begin_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    result = run("measure", "decisions", "--seconds", "0.1")
    assert result.exit_code == 1 and "a host does not begin here" in result.output


# -- encodings --------------------------------------------------------------------------------------------------------


def test_a_signal_that_ends_measuring_ends_the_host() -> None:
    asked = [NMES, "measure", "decisions", "--seconds", "60"]
    with subprocess.Popen(asked, start_new_session=True, stdout=-1, stderr=-1) as process:
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        while process.poll() is None and not children.read_text():
            time.sleep(0.01)
        process.terminate()
        _, told = process.communicate(timeout=60)
    assert process.returncode == 1 and b"Traceback" not in told
    with pytest.raises(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def test_a_signal_that_comes_while_a_host_is_begun_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def interrupted(*arguments: Any, **options: Any) -> subprocess.Popen[bytes]:
        begun.append(popen(*arguments, **options))
        signal.raise_signal(signal.SIGINT)
        return begun[0]

    monkeypatch.setattr("nmes.measure.hosts.subprocess.Popen", interrupted)
    with pytest.raises(KeyboardInterrupt), running_host("lockstep"):
        pytest.fail("a host runs, and nobody wants it")
    (process,) = begun
    assert process.poll() is not None


def test_all_channels_lead_to_the_same_states() -> None:
    asked = ("encodings", "--cubes", "3", "--rounds", "2")
    found = measured(*asked)
    assert found["alike"] is True and found["bytes"] > 3 * 13
    assert found["microseconds"].keys() == set(encodings.CHANNELS)
    assert measured(*asked)["digest"] == found["digest"] != measured(*asked, "--seed", "1")["digest"]


def test_ctrl_c_ends_all_channels_without_a_traceback() -> None:
    asked = [NMES, "measure", "encodings", "--rounds", "10000"]
    with subprocess.Popen(asked, start_new_session=True, stdout=-1, stderr=-1) as process:
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        while process.poll() is None and len(children.read_text().split()) < 4:  # three, and what tracks their memory
            time.sleep(0.01)
        os.killpg(process.pid, signal.SIGINT)
        _, told = process.communicate(timeout=60)
    assert process.returncode == 1 and told.splitlines()[-1:] == [b"Aborted!"] and b"Traceback" not in told, told


def test_a_channel_ends_when_whoever_measures_was_killed(capfd: pytest.CaptureFixture[str]) -> None:
    memory = SharedMemory(create=True, size=encodings._Memory.size(2))
    try:
        channels = [start_process(encodings._serve_memory, 2, memory.name)]
        channels += [start_process(encodings._serve_tcp, 2, name) for name in ("json", "msgpack")]
        for process, pipe in channels:
            port = pipe.recv()
            with socket.socket() as line:
                if port is not True:
                    line.connect(("127.0.0.1", port))
                    line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # it ends by a reset
            pipe.close()
            process.join(60)
            assert process.exitcode == 0
    finally:
        memory.close()
        memory.unlink()
    assert capfd.readouterr().err == ""


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
        assert mine == theirs
        assert over == cut
        far += mine
    assert cut and abs(far) > 1e-3


@pytest.mark.parametrize("name", ["walker", "centipede", "galloper"])
def test_where_something_is_learned_the_plain_environment_observes_the_same(name: str) -> None:
    genome, task = Genome.load(name), Task(peers._TASK)
    ours, plain = TaskEnv(genome, task), peers._Sensed(genome, task)
    draw = np.random.Generator(np.random.PCG64(1))
    for seed in (1, 2):
        assert ours.reset(seed=seed)[0].tobytes() == plain.reset(seed=seed)[0].tobytes()
        for _ in range(60):
            action = draw.uniform(-1.0, 1.0, plain.action_space.shape)
            assert ours.step(action)[0].tobytes() == plain.step(action)[0].tobytes()


def test_a_body_is_measured_beside_gymnasium() -> None:
    asked = ("peer", "walker", "--rounds", "2")
    found = measured(*asked)
    assert all(found[name] > 0 for name in ("rate", "rate_rows", "rate_remote", "steps_per_second"))
    assert found["exact"] is found["exact_plain"] is True
    assert found["change"]["grown"] is found["change"]["unmoved"] is True and found["change"]["milliseconds"] > 0
    assert measured(*asked)["digest"] == found["digest"] != measured(*asked, "--seed", "1")["digest"]


def test_a_learner_comes_to_a_score_after_as_many_steps_here_as_in_gymnasium() -> None:
    asked = ("learning", "roller", "--goal", "0.2", "--steps", "24000")
    found = measured(*asked)
    ours, plain = found["ours"], found["plain"]
    assert found["alike"] is True
    assert ours["steps"] == plain["steps"] > 2400 and ours["score"] == plain["score"]
    assert found["ratio"] == ours["seconds"] / plain["seconds"] > 0
    again = measured(*asked)
    assert again["digest"] == found["digest"] and again["ours"]["steps"] == ours["steps"]
    assert measured(*asked, "--seed", "1")["digest"] != found["digest"]


def test_a_score_that_is_not_reached_has_no_time() -> None:
    found = measured("learning", "walker", "--steps", "2400", "--goal", "1000")
    assert found["ratio"] is found["ours"]["steps"] is found["plain"]["seconds"] is None
    assert found["alike"] is True


def test_learners_that_do_not_learn_the_same_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    step = peers._Sensed.step

    def windy(self: peers._Sensed, action: np.ndarray) -> Any:
        self._data.qvel[0] += 1e-12
        return step(self, action)

    genome, task = Genome.load("walker"), Task(peers._TASK)
    learner, other = peers._learn(genome, task, 2400, 1000.0, 1)
    assert learner.policy == other.policy
    monkeypatch.setattr(peers._Sensed, "step", windy)
    learner, other = peers._learn(genome, task, 2400, 1000.0, 1)
    assert learner.policy != other.policy


def test_a_body_with_sensors_that_a_plain_environment_cannot_read_is_refused() -> None:
    result = run("measure", "learning", "newt")
    assert result.exit_code == 1 and "cannot read touch" in result.output


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
    for command in ("peer", "learning"):
        result = run("measure", command)
        assert result.exit_code == 1 and "pip install 'nmes[gym]'" in result.output


# -- installs ---------------------------------------------------------------------------------------------------------


def test_packages_are_installed_with_what_they_need() -> None:
    found = measured("install", "rich", "click,mdurl")["installs"]
    assert [(each["asked"], each["packages"]) for each in found] == [("rich", 4), ("click,mdurl", 2)]
    size = sum(
        Path(str(file.locate())).stat().st_size
        for name in ("rich", "pygments", "markdown-it-py", "mdurl")
        for file in files(name) or ()
        if ".." not in file.parts and "__pycache__" not in file.parts
    )
    assert found[0]["megabytes"] > size / 1e6  # byte code comes to it
    assert found[1]["megabytes_over_first"] == found[1]["megabytes"] / found[0]["megabytes"] < 1
    assert found[1]["seconds_over_first"] == found[1]["seconds"] / found[0]["seconds"] > 0


def test_what_an_extra_of_a_package_needs_is_packed_where_that_is_asked_for() -> None:
    assert "etils[epath]" in " ".join(distribution("mujoco").requires or ())
    asked = {package.name for package in installs._needed(["mujoco"])}
    assert "fsspec" in asked and "fsspec" not in {package.name for package in installs._needed(["etils"])}


def test_a_package_that_lacks_what_it_needs_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(installs, "_needed", lambda names: [distribution(name) for name in names])
    with pytest.raises(MachineError, match=r"pip failed: (?s:.*)mdurl"):
        measure_installs(["markdown-it-py"])


@pytest.mark.parametrize("name", ["nothing-of-the-kind", "", "--help", "../x"])
def test_a_package_that_is_not_installed_is_told(name: str) -> None:
    result = run("measure", "install", "--", name)
    assert result.exit_code == 1 and "is not installed here" in result.output


@pytest.mark.long
def test_nmes_is_installed_from_its_source_or_as_it_is_here() -> None:
    (found,) = measured("install", "nmes")["installs"]
    assert found["packages"] > 20 and found["megabytes"] > 100
