"""Several creatures in one world: side by side, each judged by the task on its own body."""

from __future__ import annotations

import itertools
import json
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import nmes.learning
from creatures import snake
from nmes.errors import DocumentError, MissingPackage, RecordingError, WorldError
from nmes.evaluation import Environments, Task
from nmes.genome import Genome
from nmes.genome.genome import GenomeLike
from nmes.learning.several import METADATA, CreaturesEnv, parallel_env
from nmes.playback import replay
from nmes.recording import Recorder, Recording
from nmes.recording.records import Kind

with warnings.catch_warnings():  # of the games that its tests load, where pygame is installed
    warnings.simplefilter("ignore", DeprecationWarning)
    from pettingzoo.test import parallel_api_test, parallel_seed_test

Actions = dict[str, np.ndarray]


def short(**changes: Any) -> Task:
    """Returns a task of half a second."""
    document = {"format": "nmes-task/1", "name": "dash", "description": "Get away.", "duration": 0.5, "seeds": [1, 2]}
    return Task({**document, "objective": "displacement.horizontal", **changes})


def draw(env: CreaturesEnv, numbers: np.random.Generator) -> Actions:
    """Returns actions at random for those that are there."""
    return {name: numbers.uniform(-1.0, 1.0, env.action_space(name).shape) for name in env.agents}


def still(env: CreaturesEnv) -> Actions:
    return {name: np.zeros(env.action_space(name).shape) for name in env.agents}


@pytest.mark.parametrize("seeds", [np.arange(1, 3), [np.int64(1), np.int64(2)]])
def test_seeds_may_be_whole_numbers_of_any_kind(seeds: Any) -> None:
    env = parallel_env("walk", {"a": snake()}, seeds=seeds)
    assert env.reset(seed=0)[1]["a"]["seed"] in (1, 2)
    env.close()


def test_a_seed_below_0_is_refused_and_the_episode_goes_on() -> None:
    env = parallel_env("walk", {"a": "walker"}, seeds=[3])
    env.reset(seed=1)
    with pytest.raises(ValueError, match="a seed is 0 or more, not -1"):
        env.reset(seed=-1)
    env.step({"a": np.zeros(8)})
    assert env.agents == ["a"]
    env.close()


@pytest.mark.parametrize(
    ("task", "genome"), [("walk", "walker"), ("pole", "juggler"), ("reach", "seeker"), ("carry", "roller")]
)
def test_a_creature_that_is_alone_has_the_bits_of_a_row_of_environments(task: str, genome: str) -> None:
    asked = Task({**Task.load(task).document, "duration": 1.1, "settle": 0.5})
    env = parallel_env(asked, {"a": genome}, seeds=[3, 5, 7])
    rows = Environments(Genome.load(genome), asked, 1, seeds=[3, 5, 7])
    numbers = np.random.default_rng(1)
    observations, infos = env.reset(seed=4)
    assert np.array_equal(observations["a"], rows.reset(4)[0])
    seeds = [infos["a"]["seed"]]
    for episode in range(2):
        if episode:
            observations, infos = env.reset()
            seeds.append(infos["a"]["seed"])
            assert np.array_equal(observations["a"], rows.observations[0])
        while env.agents:
            actions = draw(env, numbers)
            observations, rewards, terminations, truncations, infos = env.step(actions)
            _, reward, terminated, truncated = rows.step(actions["a"][np.newaxis])
            assert (rewards["a"], terminations["a"], truncations["a"]) == (reward[0], terminated[0], truncated[0])
            seen = rows.observations if env.agents else rows.last_observations
            assert np.array_equal(observations["a"], seen[0])
        result = rows.results[0]
        assert result is not None and infos["a"]["result"] == result.to_json()
        assert result.seed == seeds[-1]


def test_pettingzoo_finds_nothing_wrong() -> None:
    task = short(ends=[{"name": "away", "when": "displacement.horizontal > 0.01"}])
    genomes: dict[str, GenomeLike] = {"a": "walker", "b": "roller", "c": snake()}
    parallel_api_test(parallel_env(task, genomes), num_cycles=40)
    parallel_seed_test(lambda: parallel_env(task, genomes), num_cycles=40)


def test_creatures_begin_apart_in_a_row_across_the_way() -> None:
    env = parallel_env(short(), {"a": "walker", "b": "walker", "c": "centipede"})
    env.reset(seed=0)
    counts = [len(env.genomes[name].body.cubes) for name in env.possible_agents]
    cubes = np.split(env.state()[:, :3], np.cumsum(counts)[:-1])
    ends = [(part[:, 2].min(), part[:, 2].max()) for part in cubes]
    assert all(one[1] + 1.0 < other[0] for one, other in itertools.pairwise(ends))
    # All begin at the same line.
    assert max(abs(float(part[:, 0].mean())) for part in cubes) < 0.5


def test_all_begin_when_the_last_of_them_is_at_rest() -> None:
    env = parallel_env(short(settle=0.25, vary={"drop": [0.3, 0.3]}), {"soon": "roller", "late": "tumbler"})
    env.reset(seed=1)
    assert np.abs(env.state()[:, 7:10]).max() < 0.05
    env.close()


def test_in_a_planar_world_creatures_begin_behind_each_other() -> None:
    env = parallel_env(short(world={"backend": "pymunk"}), {"a": snake(), "b": snake()})
    env.reset(seed=0)
    a, b = np.split(env.state()[:, 0], 2)
    assert a.max() + 1.0 < b.min()


def test_each_is_judged_on_its_own_body_and_leaves_when_its_episode_is_over() -> None:
    ends = [{"name": "away", "when": "displacement.horizontal > 0.02"}]
    env = parallel_env(short(ends=ends), {"moves": "roller", "rests": "roller"})
    env.reset(seed=1)
    given = {"moves": 0.0, "rests": 0.0}
    results = {}
    while env.agents:
        before = env.agents
        actions = {name: np.full(env.action_space(name).shape, float(name == "moves")) for name in before}
        observations, rewards, terminations, truncations, infos = env.step(actions)
        for part in (observations, rewards, terminations, truncations, infos):
            assert list(part) == before
        for name in before:
            given[name] += rewards[name]
            if name not in env.agents:
                results[name] = infos[name]["result"], terminations[name], truncations[name]
            else:
                assert not terminations[name] and not truncations[name] and "result" not in infos[name]
        if "moves" not in env.agents and env.agents:
            assert not env.state()[:9].any() and env.state()[9:].any()
    (moved, *how), (rested, *end) = results["moves"], results["rests"]
    assert moved["ended"] == "away" and how == [True, False] and moved["ticks"] < 30
    assert rested["ended"] is None and end == [False, True] and rested["ticks"] == 30
    assert given["moves"] == pytest.approx(moved["score"], abs=1e-12) and moved["score"] > 0.02
    assert given["rests"] == pytest.approx(rested["score"], abs=1e-12) and rested["score"] < 0.02


def test_who_leaves_takes_what_it_was_given_along(tmp_path: Path) -> None:
    task = short(
        props=[{"id": "cargo", "size": [0.1, 0.1, 0.1], "mass": 0.2}],
        ends=[{"name": "away", "when": "displacement.horizontal > 0.02"}],
        objective='cube("cargo").height',
    )
    env = parallel_env(task, {"moves": "roller", "rests": "roller"}, record=tmp_path)
    env.reset(seed=1)
    heights = []
    while env.agents:
        actions = {name: np.full(env.action_space(name).shape, float(name == "moves")) for name in env.agents}
        _, _, _, _, infos = env.step(actions)
        heights += [info["result"]["score"] for info in infos.values() if "result" in info]
    assert heights == pytest.approx([0.36, 0.36], abs=0.05)  # each has cargo of its own, on its back
    gone = [m["cube_name"] for m in commands(env.recording) if m["type"] == "despawn_cube"]
    assert gone[-1] == "moves.cargo" and len(gone) == 10


def commands(path: Path | None) -> list[dict[str, Any]]:
    assert path is not None
    return [json.loads(record.data) for record in Recording(path) if record.kind is Kind.COMMAND]


def test_a_limit_of_the_body_ends_the_episode_of_that_creature_alone() -> None:
    env = parallel_env(short(limits={"energy": 0.5}), {"works": "roller", "rests": snake()})
    env.reset(seed=1)
    results: dict[str, dict[str, Any]] = {}
    while env.agents:
        actions = still(env)
        if "works" in actions:
            actions["works"] += 1.0
        *_, infos = env.step(actions)
        results |= {name: info["result"] for name, info in infos.items() if "result" in info}
    assert (results["works"]["ended"], results["rests"]["ended"]) == ("energy", None)
    assert results["rests"]["ticks"] == 30 > results["works"]["ticks"]


def test_an_engine_that_gives_up_ends_the_episodes_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    env = parallel_env(short(), {"a": snake(), "b": snake()})
    env.reset(seed=1)
    numbers = np.random.default_rng(1)
    given = sum(env.step(draw(env, numbers))[1]["a"] for _ in range(3))
    fail_at_next_tick(env, monkeypatch)
    _, taken, terminations, truncations, infos = env.step(still(env))
    assert env.agents == [] and all(terminations.values()) and not any(truncations.values())
    assert {info["result"]["fault"] for info in infos.values()} == {"engine_failed: RuntimeError: it broke"}
    assert given > 0.0 and taken["a"] == pytest.approx(-given, abs=1e-15)


def fail_at_next_tick(env: CreaturesEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    """Has the engine of the environment's world break."""

    def broken(_: int) -> None:
        raise RuntimeError("it broke")

    assert env._episode is not None
    monkeypatch.setattr(env._episode._world.simulation, "step", broken)


def test_an_episode_is_recorded_and_replays(tmp_path: Path) -> None:
    task = short(ends=[{"name": "away", "when": "displacement.horizontal > 0.02"}])
    env = parallel_env(task, {"a": "walker", "b": "roller"}, record=tmp_path)
    numbers = np.random.default_rng(1)
    for seed in (1, 2):
        env.reset(seed=seed)
        while env.agents:
            *_, infos = env.step(draw(env, numbers))
        (named,) = [info["recording"] for info in infos.values() if "recording" in info]
        assert Path(named) == env.recording and env.recording is not None
        report = replay(env.recording)
        assert report.verdict == "reproduced" and report.ticks > 6
        about = Recording(env.recording).metadata[METADATA]
        assert set(about) == {"task", "seed", "creatures"}
        assert env.genomes["b"].hash in about["creatures"]
    assert not list(tmp_path.glob("*.part"))


def test_a_reset_in_the_middle_of_an_episode_keeps_what_was(tmp_path: Path) -> None:
    env = parallel_env(short(seeds=[7]), {"a": snake()}, record=tmp_path)
    env.reset(seed=0)
    env.step(still(env))
    env.reset(seed=0)
    broken_off = env.recording
    assert broken_off is not None and broken_off.name.startswith("dash-") and "-7-" in broken_off.name
    assert replay(broken_off).verdict == "reproduced"
    env.step(still(env))
    env.close()
    assert env.recording == broken_off  # the same episode, the same file
    (signature := tmp_path / f"{broken_off.name}.sig").touch()
    env.reset(seed=0)
    env.step(still(env))
    before = broken_off.stat()
    with pytest.raises(RecordingError, match="is signed"):
        env.close()
    assert broken_off.stat() == before
    signature.unlink()
    env.reset(seed=0)
    env.step({"a": np.full(3, 0.5)})
    env.close()
    assert env.recording != broken_off and len(list(tmp_path.iterdir())) == 2


def test_what_can_no_longer_be_recorded_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    env = parallel_env(short(), {"a": snake()}, record=tmp_path)
    env.reset(seed=1)

    def full(*_: object) -> None:
        raise RecordingError("recording_failed", "the disk is full")

    monkeypatch.setattr(Recorder, "received", full)
    with pytest.raises(RecordingError, match="the disk is full"):
        env.step(still(env))
    with pytest.raises(RecordingError, match="the disk is full"):
        env.close()
    monkeypatch.undo()
    assert env.reset(seed=1)[0]["a"].shape == (len(env.genomes["a"].body.sensors),)
    env.close()
    assert len(list(tmp_path.iterdir())) == 1


def test_agents_come_and_go_with_resets() -> None:
    env = parallel_env(short(), {"a": snake(), "b": "roller"})
    observations, infos = env.reset(seed=1, options={"agents": ["b"]})
    assert list(observations) == list(infos) == env.agents == ["b"] and env.possible_agents == ["a", "b"]
    env.step(still(env))
    observations, _ = env.reset(seed=1, options={"agents": ["b", "a"]})
    assert list(observations) == env.agents == ["a", "b"]


def test_without_a_seed_episodes_go_on_and_environments_differ() -> None:
    task, genomes = short(seeds=list(range(1000))), {"a": snake()}

    def scenes(env: CreaturesEnv, first: int | None = None) -> list[int]:
        return [env.reset(first)[1]["a"]["seed"], *(env.reset()[1]["a"]["seed"] for _ in range(2))]

    one, other = parallel_env(task, genomes), parallel_env(task, genomes)
    assert scenes(one, 3) == scenes(other, 3) == scenes(one, 3)
    assert scenes(one, 3) != scenes(other, 4)
    assert len({*scenes(parallel_env(task, genomes)), *scenes(parallel_env(task, genomes))}) > 3


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda a: {**a, "a": a["a"] * np.nan}, "a: actions are from -1 to 1; that for 'j0' is nan"),
        (lambda a: {**a, "b": a["b"] + 1.5}, "b: actions are from -1 to 1; that for 'j0' is 2.0"),
        (lambda a: {**a, "b": a["b"][:2]}, r"b: an action has the shape \(3,\), one a motor, not \(2,\)"),
        (lambda a: {"a": a["a"]}, "actions must be those of a, b, not of a"),
        (lambda a: {**a, "stranger": a["a"]}, "not of a, b, stranger"),
        (lambda a: {}, "not of nobody"),
    ],
)
def test_actions_that_are_none_move_nothing(spoil: Callable[[Actions], Actions], words: str) -> None:
    env, twin = (parallel_env(short(), {"a": snake(), "b": snake()}) for _ in range(2))
    env.reset(seed=1), twin.reset(seed=1)
    with pytest.raises(ValueError, match=words):
        env.step(spoil({name: action + 0.5 for name, action in still(env).items()}))
    one, other = env.step(still(env)), twin.step(still(twin))
    assert np.array_equal(one[0]["a"], other[0]["a"]) and one[1] == other[1]


def test_a_step_needs_an_episode() -> None:
    env = parallel_env(short(duration=0.1), {"a": snake()})
    with pytest.raises(gymnasium.error.ResetNeeded, match="reset comes first"):
        env.step({"a": np.zeros(3)})
    env.reset(seed=1)
    while env.agents:
        env.step(still(env))
    with pytest.raises(gymnasium.error.ResetNeeded, match="reset comes first"):
        env.step({})


def test_what_cannot_take_part_is_refused() -> None:
    with pytest.raises(ValueError, match="1 genome and 1 seed or more, not 0 and 2"):
        parallel_env(short(), {})
    with pytest.raises(WorldError, match="big: the body has 4 cubes, at most 3 are allowed"):
        parallel_env(short(limits={"cubes": 3}), {"big": snake()})
    with pytest.raises(DocumentError, match="no genome"):
        parallel_env("walk", {"a": "nobody-of-that-name"})
    with pytest.raises(ValueError, match="agents: expected one or more of a, got b"):
        parallel_env(short(), {"a": snake()}).reset(options={"agents": ["b"]})
    with pytest.raises(WorldError, match="name"):
        parallel_env(short(), {"two words": snake()}).reset(seed=1)


def test_creatures_that_do_not_come_to_rest_are_named() -> None:
    task = short(settle=0.0, settle_limit=0.25, vary={"drop": [1.0, 1.0]})
    with pytest.raises(WorldError, match=r"cannot begin with seed [12]: a: restless: not yet at rest after 0.25 s"):
        parallel_env(task, {"a": snake()}).reset(seed=1)


def test_a_recording_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="cannot make the folder"):
        parallel_env(short(), {"a": snake()}, record=tmp_path / "file")
    env = parallel_env(short(), {"a": snake()}, record=tmp_path / "folder")
    (tmp_path / "folder").rmdir()
    with pytest.raises(RecordingError, match="folder"):
        env.reset(seed=1)


def test_a_package_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pettingzoo", None)
    monkeypatch.delitem(sys.modules, "nmes.learning.several")
    with pytest.raises(MissingPackage, match=r"parallel_env needs pettingzoo: pip install 'nmes\[gym\]'"):
        _ = nmes.learning.parallel_env
