"""Episodes that are read from recordings: what was sensed, done and earned in each tick."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from creatures import exploding, snake
from driven import record_driven
from nmes.backend import Array
from nmes.backends.mujoco3d import MujocoSimulation
from nmes.errors import ProofError, RecordingError, SimulationFault
from nmes.evaluation import Environments, Task, evaluate, prove
from nmes.genome import Genome
from nmes.learning import RecordedEpisode, read_episode
from nmes.recording import Recording
from recordings import Line, commands_of, rewrite


def task(**changes: Any) -> Task:
    return Task({**Task.load("walk").document, "duration": 1.2, "seeds": [3], "limits": {}, **changes})


def draws(motors: int) -> Iterator[Array]:
    draw = np.random.default_rng(7)
    while True:
        yield draw.uniform(-1.0, 1.0, motors)


CASES: dict[str, tuple[Genome, Task]] = {
    "it lasts": (Genome(snake()), task()),
    "a limit": (Genome(snake()), task(limits={"energy": 2.0})),
    "an end": (Genome(snake()), task(ends=[{"name": "energy", "when": "displacement.horizontal > 0.05"}])),
    "an end at the last tick": (Genome(snake()), task(ends=[{"name": "late", "when": "time >= 1.2"}])),
    "an end that held at the start": (
        Genome(snake()),
        task(ends=[{"name": "low", "when": "height < 1 && time < 0.01"}], limits={"energy": 0.001}),
    ),
    "worth something at the start": (Genome(snake()), task(objective="5 + displacement.x")),
    "a worth of nothing": (Genome(snake()), task(objective="time < 0.2 ? 1 / (energy - energy) : energy")),
    "a target": (
        Genome.load("seeker"),
        task(target={"distance": [0.5, 2], "bearing": [-1, 1]}, objective="start.distance - distance"),
    ),
    "contacts": (Genome(snake()), task(objective="contacts + mean.contacts")),
    "a prop": (Genome.load("juggler"), Task({**Task.load("pole").document, "duration": 1.0, "seeds": [2]})),
    "another engine": (Genome(snake()), task(world={"backend": "pymunk"})),
    "a fault": (Genome(exploding()), task()),
    "no brain": (Genome(snake(None)), task()),
    "no motors": (Genome(snake(None, segments=1)), task()),
}


def driven_rows(genome: Genome, asked: Task, actions: Array) -> tuple[Array, Array, Array, Array, Any]:
    """Returns what environments give where they are driven with the actions of one episode."""
    environments = Environments(genome, asked, 1)
    seen, rewards, ends = [environments.reset(0)[0].copy()], [], []
    for number, action in enumerate(actions):
        observations, given, terminated, truncated = environments.step(action[np.newaxis])
        over = bool(terminated[0] or truncated[0])
        assert over == (number == len(actions) - 1), f"it is over after {number + 1} ticks of {len(actions)}"
        seen.append((environments.last_observations if over else observations)[0].copy())
        rewards.append(given[0])
        ends.append([terminated[0], truncated[0]])
    result = environments.results[0]
    environments.close()
    terminated, truncated = np.array(ends).T
    return np.array(seen), np.array(rewards), terminated, truncated, result


@pytest.mark.parametrize("case", CASES)
def test_an_episode_that_is_read_has_the_bits_of_environments_that_are_driven_so(case: str, tmp_path: Path) -> None:
    genome, asked = CASES[case]
    given = list(zip(range(asked.ticks), draws(len(genome.body.motors)), strict=False))
    result = record_driven(tmp_path / "x.mcap", genome, asked, asked.seeds[0], iter(action for _, action in given))
    episode = read_episode(tmp_path / "x.mcap")
    count = len(episode.actions)
    assert np.array_equal(episode.actions, np.array([action for _, action in given])[:count])
    seen, rewards, terminated, truncated, same = driven_rows(genome, asked, episode.actions)
    assert episode.result == result == same
    assert episode.observations.tobytes() == seen.tobytes() and episode.observations.shape == seen.shape
    assert episode.rewards.tobytes() == rewards.tobytes()
    assert np.array_equal(episode.terminated, terminated) and np.array_equal(episode.truncated, truncated)
    assert (episode.genome.hash, episode.task.hash) == (genome.hash, asked.hash)
    assert episode.sensors == tuple(sensor.id for sensor in genome.body.sensors) and episode.observations.shape[1]
    assert len(episode.motors) == episode.actions.shape[1] == len(genome.body.motors)
    early = {"a limit": "energy", "an end": "energy", "a prop": "fallen", "an end that held at the start": "energy"}
    assert result.ended == early.get(case) or case == "an end at the last tick"
    assert (count < asked.ticks) == (case in early or case == "a fault")


def test_rewards_of_an_evaluation_add_up_to_its_score(tmp_path: Path) -> None:
    asked = Task({**Task.load("walk").document, "duration": 2.0, "seeds": [1, 2]})
    evaluation = evaluate(Genome.load("walker"), asked, record=tmp_path)
    for path, result in zip(evaluation.recordings, evaluation.results, strict=True):
        episode = read_episode(path)
        assert episode.result == result and len(episode.rewards) == result.ticks == asked.ticks
        assert np.add.accumulate(episode.rewards)[-1] == pytest.approx(result.score, rel=1e-12)
        assert Recording(path).summary().ticks == episode.begin * asked.tick_rate + asked.ticks
        assert [*np.flatnonzero(episode.truncated)] == [asked.ticks - 1] and not episode.terminated.any()
    assert (read_episode(evaluation.recordings[0]).observations != episode.observations).any()


def edited(tmp_path: Path, change: Any) -> Path:
    """Returns a recording of a sound episode with its lines changed, its chain in order."""
    genome, asked = CASES["it lasts"]
    record_driven(tmp_path / "x.mcap", genome, asked, 3, draws(3))
    return rewrite(tmp_path / "x.mcap", tmp_path / "y.mcap", change)


def test_a_recording_that_does_not_replay_is_refused_and_where_it_parts_is_named(tmp_path: Path) -> None:
    def other_action(lines: list[Line]) -> list[Line]:
        at = [i for i in commands_of(lines) if b'"drive"' in lines[i].data][30]
        command = json.loads(lines[at].data)
        controls = command["message"]["controls"]
        controls[0] = -controls[0]
        lines[at] = lines[at]._replace(data=json.dumps(command, separators=(",", ":")).encode())
        return lines

    with pytest.raises(ProofError, match=r"y\.mcap: it diverges at frame \d+: tick \d+ does not come out as") as info:
        read_episode(edited(tmp_path, other_action))
    assert info.value.code == "diverged"


def test_a_recording_that_ends_too_early_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ProofError) as info:
        read_episode(edited(tmp_path, lambda lines: lines[: len(lines) // 2]))
    assert info.value.code == "damaged"


def test_an_episode_without_actions_or_ticks_has_nothing_to_tell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record_driven(tmp_path / "idle.mcap", Genome(snake(None)), task(), 3, None)
    assert prove(tmp_path / "idle.mcap").result.score is not None
    with pytest.raises(ProofError, match=r"idle\.mcap: nobody drives the creature at frame \d+") as info:
        read_episode(tmp_path / "idle.mcap")
    assert info.value.code == "nothing_to_export"
    asked = task(settle=0.25, settle_limit=0.25, vary={"drop": [3, 3]})
    result = record_driven(tmp_path / "restless.mcap", Genome(snake()), asked, 3, draws(3))
    assert (result.fault or "").startswith("restless")
    with pytest.raises(ProofError, match=r"restless\.mcap: .*not yet at rest") as info:
        read_episode(tmp_path / "restless.mcap")
    assert info.value.code == "nothing_to_export"

    def fail(simulation: MujocoSimulation, substeps: int) -> None:
        raise SimulationFault("diverged", "it is off")

    monkeypatch.setattr(MujocoSimulation, "step", fail)
    result = record_driven(tmp_path / "failed.mcap", Genome(snake()), task(), 3, draws(3))
    assert (result.fault or "").startswith("diverged") and result.ticks == 0
    with pytest.raises(ProofError, match=r"failed\.mcap: .*diverged") as info:
        read_episode(tmp_path / "failed.mcap")
    assert info.value.code == "nothing_to_export"


def test_an_episode_that_would_fill_the_memory_is_refused_before_it_is_run(tmp_path: Path) -> None:
    sensors = [{"id": f"s{i}", "type": "height", "cube": "c0"} for i in range(1000)]
    asked = task(duration=600, world={"tick_rate": 160}, ends=[{"name": "soon", "when": "time > 0.1"}])
    genome = Genome({**snake(), "sensors": sensors})
    record_driven(tmp_path / "x.mcap", genome, asked, 3, draws(3))
    with pytest.raises(RecordingError, match=r"x\.mcap: .* readings and controls") as info:
        read_episode(tmp_path / "x.mcap")
    assert info.value.code == "too_long"


def test_reading_episodes_needs_nothing_of_the_extras() -> None:
    program = "import sys; from nmes.learning import read_episode\n"
    program += "sys.exit(bool({'gymnasium', 'minari', 'pyarrow', 'torch', 'pettingzoo'} & sys.modules.keys()))"
    assert subprocess.run([sys.executable, "-c", program]).returncode == 0


def test_the_type_of_what_is_read_is_public(tmp_path: Path) -> None:
    genome, asked = CASES["an end"]
    record_driven(tmp_path / "x.mcap", genome, asked, 3, draws(3))
    assert isinstance(read_episode(tmp_path / "x.mcap"), RecordedEpisode)
