"""Datasets of recorded episodes, as others read them: by Minari, and by the rules of LeRobot's format."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import av
import minari
import numpy as np
import orjson
import pyarrow.parquet
import pytest
from click.testing import CliRunner
from gymnasium.spaces import Box

from creatures import mlp, snake
from driven import record_driven
from nmes.cli import main
from nmes.evaluation import Task, evaluate
from nmes.genome import Genome
from nmes.learning import RecordedEpisode, lerobot, read_episodes, spaces
from opengl import with_opengl
from processes import NMES

SEEDS = (4, 2, 7)


def run(*arguments: str | Path) -> tuple[int, str]:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.output


def run_process(*arguments: str | Path, **environment: str) -> None:
    """Runs the program in a process of its own."""
    process = subprocess.run([NMES, *map(str, arguments)], env={**os.environ, **environment}, capture_output=True)
    assert process.returncode == 0, process.stderr


def task(**changes: Any) -> Task:
    ends = [{"name": "far", "when": "displacement.horizontal > 0.09"}]
    return Task(
        {
            **Task.load("walk").document,
            "name": "dash",
            "duration": 1.0,
            "ends": ends,
            "limits": {},
            "seeds": [*SEEDS],
            **changes,
        }
    )


@pytest.fixture(scope="module")
def proofs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three episodes of a creature, and one of another on another task; one of them ends early."""
    folder = tmp_path_factory.mktemp("proofs")
    genome, other = Genome(snake(mlp(4, seed=2))), Genome(snake(name="other"))
    paths = list(evaluate(genome, task(), seeds=SEEDS, record=folder).recordings)
    changed = task(name="rush", description="Rush.", objective="mean.speed", ends=[])
    paths += evaluate(other, changed, seeds=[1], record=folder).recordings
    return [Path(path) for path in paths]


@pytest.fixture(scope="module")
def episodes(proofs: list[Path]) -> list[RecordedEpisode]:
    found = list(read_episodes(proofs))
    assert {bool(episode.terminated.any()) for episode in found} == {True, False}
    return found


def digests(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


# -- Minari -----------------------------------------------------------------------------------------------------------


def test_a_dataset_of_minari_equals_the_replay(
    proofs: list[Path], episodes: list[RecordedEpisode], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, output = run("export", *proofs, "--to", "minari", "-o", tmp_path / "snake-v0")
    ticks = sum(len(episode.actions) for episode in episodes)
    assert (code, output) == (0, f"wrote {tmp_path / 'snake-v0'}: 4 episodes, {ticks} ticks\n")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    dataset = minari.load_dataset("snake-v0")
    assert (dataset.total_episodes, dataset.total_steps, dataset.id) == (4, ticks, "snake-v0")
    assert dataset.observation_space == spaces.of(episodes[0].genome)[0]
    assert dataset.action_space == Box(-1.0, 1.0, (3,), np.float64)
    read = list(dataset.iterate_episodes())
    assert [each.id for each in read] == [0, 1, 2, 3]
    for found, episode in zip(read, episodes, strict=True):
        assert found.observations.dtype == found.actions.dtype == found.rewards.dtype == np.float64
        assert found.observations.tobytes() == episode.observations.tobytes()
        assert found.observations.shape == episode.observations.shape
        assert found.actions.tobytes() == episode.actions.tobytes()
        assert found.rewards.tobytes() == episode.rewards.tobytes()
        assert np.array_equal(found.terminations, episode.terminated)
        assert np.array_equal(found.truncations, episode.truncated)
        assert all(observation in dataset.observation_space for observation in found.observations)
        assert all(action in dataset.action_space for action in found.actions)


def test_a_dataset_of_minari_says_where_it_is_from(
    proofs: list[Path], episodes: list[RecordedEpisode], tmp_path: Path
) -> None:
    assert run("export", *proofs, "--to", "minari", "-o", tmp_path / "snake-v0")[0] == 0
    dataset = minari.MinariDataset(str(tmp_path / "snake-v0" / "data"))
    about = dataset.storage.metadata
    assert about["author"] == {"Ada"} and "dash and rush" in about["description"]
    assert about["nmes"]["sensors"] == [*episodes[0].sensors] and about["nmes"]["motors"] == ["j0", "j1", "j2"]
    assert about["nmes"]["tick_rate"] == 60
    for found, episode, path in zip(dataset.storage.get_episode_metadata(range(4)), episodes, proofs, strict=True):
        assert found["seed"] == episode.result.seed and found["recording"] == path.name
        assert (found["score"], found["ended"]) == (episode.result.score, episode.result.ended)
        assert Task(about["nmes"]["tasks"][found["task"]]).hash == episode.task.hash
        assert Genome(about["nmes"]["genomes"][found["genome"]]).hash == episode.genome.hash


def test_the_environment_of_a_dataset_of_minari_is_recovered(proofs: list[Path], tmp_path: Path) -> None:
    assert run("export", *proofs[:3], "--to", "minari", "-o", tmp_path / "snake-v0")[0] == 0
    program = "import sys, minari\n"
    program += "dataset = minari.MinariDataset(sys.argv[1])\nenv = dataset.recover_environment()\n"
    program += "assert env.observation_space == dataset.observation_space\n"
    program += "observation, info = env.reset(seed=0)\n"
    program += "while info['seed'] != 4:\n    observation, info = env.reset()\n"
    program += "assert (observation == dataset[0].observations[0]).all()\n"
    program += "observation = env.step(dataset[0].actions[0])[0]\n"
    program += "assert (observation == dataset[0].observations[1]).all()\n"
    program += "print(env.unwrapped.task.name, env.unwrapped.genome.hash)"
    arguments = [sys.executable, "-W", "error", "-c", program, str(tmp_path / "snake-v0" / "data")]
    process = subprocess.run(arguments, capture_output=True, text=True)
    assert process.stdout.split() == ["dash", Genome(snake(mlp(4, seed=2))).hash], process.stderr
    assert run("export", *proofs, "--to", "minari", "-o", tmp_path / "both-v0")[0] == 0
    assert minari.MinariDataset(str(tmp_path / "both-v0" / "data")).env_spec is None  # two tasks are no environment


# -- LeRobot ----------------------------------------------------------------------------------------------------------


class Loaded:
    """A dataset as LeRobot v3.0 reads it: what `info.json` says, and the tables that it leads to."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.info = json.loads((folder / "meta/info.json").read_text())
        self.stats = json.loads((folder / "meta/stats.json").read_text())
        self.episodes = self._tables("meta/episodes").to_pylist()
        self.frames = self._tables("data")

    def _tables(self, place: str) -> Any:
        paths = sorted((self.folder / place).glob("*/*.parquet"))
        return pyarrow.concat_tables([pyarrow.parquet.read_table(path) for path in paths])

    def column(self, key: str) -> Any:
        """Returns a column, array (frames, k)."""
        return np.array(self.frames[key].to_pylist()).reshape(len(self.frames), -1)


@pytest.fixture(scope="module")
def loaded(proofs: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Loaded:
    folder = tmp_path_factory.mktemp("lerobot") / "snake"
    code, output = run("export", *proofs, "--to", "lerobot", "-o", folder)
    assert code == 0, output
    return Loaded(folder)


def test_every_feature_of_lerobot_is_a_column_of_that_type_and_shape(loaded: Loaded) -> None:
    features = loaded.info["features"]
    assert list(features) == loaded.frames.column_names
    for key, feature in features.items():
        kind, (size,) = loaded.frames.schema.field(key).type, feature["shape"]
        if size > 1:
            assert kind.list_size == size and len(feature["names"]) == size
            kind = kind.value_type
        assert {"float": "float32", "double": "float64"}.get(str(kind), str(kind)) == feature["dtype"]
        assert loaded.column(key).shape == (loaded.info["total_frames"], size)
    default = {"timestamp": "float32"} | dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), "int64")
    for key, dtype in default.items():
        assert features[key] == {"dtype": dtype, "shape": [1], "names": None}
    assert features["observation.state"]["dtype"] == features["action"]["dtype"] == "float32"


def test_frames_of_lerobot_are_the_ticks_of_the_replay(loaded: Loaded, episodes: list[RecordedEpisode]) -> None:
    info = loaded.info
    assert (info["codebase_version"], info["fps"], info["robot_type"]) == ("v3.0", 60, "snake")
    assert (info["total_episodes"], info["total_tasks"], info["splits"]) == (4, 2, {"train": "0:4"})
    assert info["features"]["action"]["names"] == [*episodes[0].motors]
    assert info["features"]["observation.state"]["names"] == [*episodes[0].sensors]
    path = info["data_path"].format(chunk_index=0, file_index=0)
    assert (loaded.folder / path).is_file() and info["video_path"] is None
    assert loaded.column("index")[:, 0].tolist() == [*range(info["total_frames"])]
    tasks = pyarrow.parquet.read_table(loaded.folder / "meta/tasks.parquet").to_pylist()
    assert [row["task_index"] for row in tasks] == [0, 1]
    texts = {row["task_index"]: row["__index_level_0__"] for row in tasks}
    for number, (row, episode) in enumerate(zip(loaded.episodes, episodes, strict=True)):
        begin, end = row["dataset_from_index"], row["dataset_to_index"]
        ticks = len(episode.actions)
        assert (row["episode_index"], row["length"], end - begin) == (number, ticks, ticks)
        assert row["tasks"] == [episode.task.document["description"]]
        assert (row["nmes/seed"], row["nmes/score"]) == (episode.result.seed, episode.result.score)
        assert (row["nmes/task"], row["nmes/genome"]) == (episode.task.hash, episode.genome.hash)

        def of(key: str, begin: int = begin, end: int = end) -> Any:
            return loaded.column(key)[begin:end]

        assert np.array_equal(of("observation.state"), episode.observations[:-1].astype(np.float32))
        assert np.array_equal(of("action"), episode.actions.astype(np.float32))
        assert np.array_equal(of("next.reward")[:, 0], episode.rewards.astype(np.float32))
        assert np.array_equal(of("next.truncated")[:, 0], episode.truncated)
        assert of("next.done")[:, 0].tolist() == [False] * (ticks - 1) + [True]
        assert np.array_equal(of("timestamp")[:, 0], (np.arange(ticks) / 60).astype(np.float32))
        assert of("frame_index")[:, 0].tolist() == [*range(ticks)]
        assert {*of("episode_index")[:, 0]} == {number}
        assert {texts[index] for index in of("task_index")[:, 0]} == {*row["tasks"]}
    assert [row["dataset_to_index"] for row in loaded.episodes[:-1]] == [
        row["dataset_from_index"] for row in loaded.episodes[1:]
    ]


def test_statistics_of_lerobot_are_those_of_the_frames(loaded: Loaded) -> None:
    assert list(loaded.stats) == list(loaded.info["features"])
    quantiles = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
    for key, stats in loaded.stats.items():
        values = loaded.column(key)
        assert set(stats) == {"min", "max", "mean", "std", "count", *quantiles}
        assert stats["count"] == [len(values)]
        assert np.array_equal(stats["min"], values.min(axis=0)) and np.array_equal(stats["max"], values.max(axis=0))
        assert np.allclose(stats["mean"], values.mean(axis=0, dtype=float), rtol=1e-9, atol=1e-12)
        assert np.allclose(stats["std"], values.std(axis=0, dtype=float), rtol=1e-9, atol=1e-12)
        weighted = np.zeros(values.shape[1])
        for row in loaded.episodes:
            part = values[row["dataset_from_index"] : row["dataset_to_index"]]
            assert row[f"stats/{key}/count"] == [len(part)]
            assert np.array_equal(row[f"stats/{key}/min"], part.min(axis=0))
            assert np.allclose(row[f"stats/{key}/std"], part.std(axis=0, dtype=float), rtol=1e-9, atol=1e-12)
            for name, part_of in quantiles.items():
                assert np.allclose(row[f"stats/{key}/{name}"], np.quantile(part.astype(float), part_of, axis=0))
            weighted += np.array(row[f"stats/{key}/q90"]) * len(part)
        assert np.allclose(stats["q90"], weighted / len(values))


def test_long_datasets_of_lerobot_are_split_into_files_at_ends_of_episodes(
    proofs: list[Path], loaded: Loaded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lerobot, "_FRAMES", 9_000)
    monkeypatch.setattr(lerobot, "_FILES", 2)
    assert lerobot.write_lerobot(proofs, tmp_path / "d") == (4, loaded.info["total_frames"])
    split = Loaded(tmp_path / "d")
    assert split.frames.equals(loaded.frames) and split.info["chunks_size"] == 2
    places = [(row["data/chunk_index"], row["data/file_index"]) for row in split.episodes]
    assert len({*places}) >= 3 and places == sorted(places) and places[-1][0] == 1
    for row in split.episodes:
        chunk, file = row["data/chunk_index"], row["data/file_index"]
        frames = pyarrow.parquet.read_table(
            tmp_path / "d" / split.info["data_path"].format(chunk_index=chunk, file_index=file)
        )
        assert row["episode_index"] in frames["episode_index"].to_pylist()
    assert all(before <= after for before, after in pairwise(places))


def test_a_creature_with_one_sensor_and_one_motor_has_plain_columns(tmp_path: Path) -> None:
    genome = Genome({**snake(segments=2), "sensors": [{"type": "height", "cube": "c0"}]})
    record_driven(tmp_path / "x.mcap", genome, task(), 1, iter([np.array([0.5])] * 60))
    assert run("export", tmp_path / "x.mcap", "--to", "lerobot", "-o", tmp_path / "d")[0] == 0
    loaded = Loaded(tmp_path / "d")
    assert loaded.frames.schema.field("action").type == pyarrow.float32()
    assert loaded.info["features"]["observation.state"]["shape"] == [1] and {*loaded.column("action")[:, 0]} == {0.5}


@with_opengl
def test_videos_of_lerobot_have_a_picture_for_each_tick(proofs: list[Path], tmp_path: Path) -> None:
    paths = []
    for number, duration in enumerate((0.1, 0.15)):  # pictures cost much where no graphics card draws them
        paths.append(tmp_path / f"{number}.mcap")
        record_driven(paths[-1], Genome(snake()), task(duration=duration), 2, iter([np.ones(3)] * 9))
    code, output = run("export", *paths, "--to", "lerobot", "--videos", "-o", tmp_path / "d")
    assert code == 0, output
    episodes = list(read_episodes(paths))
    filmed, key = Loaded(tmp_path / "d"), "observation.images.follow"
    feature = filmed.info["features"][key]
    assert (feature["dtype"], feature["shape"]) == ("video", [240, 320, 3]) and key not in filmed.frames.column_names
    told = {"video.fps": 60, "video.codec": "h264", "video.pix_fmt": "yuv420p", "has_audio": False}
    assert told.items() <= feature["info"].items()
    colors = np.zeros((0, 3))
    for row, episode in zip(filmed.episodes, episodes, strict=True):
        place = {name: row[f"videos/{key}/{name}"] for name in ("chunk_index", "file_index")}
        with av.open(str(tmp_path / "d" / filmed.info["video_path"].format(video_key=key, **place))) as video:
            frames = list(video.decode(video=0))
            assert video.streams.video[0].codec_context.name == "h264"
        times = [frame.time for frame in frames]
        assert times == pytest.approx([number / 60 for number in range(len(episode.actions))], abs=1e-4)
        ends = row[f"videos/{key}/from_timestamp"], row[f"videos/{key}/to_timestamp"]
        assert ends == (0.0, len(episode.actions) / 60)
        pixels = np.array([frame.to_ndarray(format="rgb24") for frame in frames]).reshape(-1, 3) / 255
        for name in ("mean", "std", "min", "max"):
            there = np.array(row[f"stats/{key}/{name}"])
            assert there.shape == (3, 1, 1) and there.ravel() == pytest.approx(getattr(pixels, name)(axis=0), abs=1e-9)
        medians = np.array(row[f"stats/{key}/q50"]).ravel()
        assert medians == pytest.approx(np.quantile(pixels, 0.5, axis=0, method="inverted_cdf"), abs=1e-9)
        assert row[f"stats/{key}/count"] == [len(frames)]
        colors = np.concatenate([colors, pixels])
    stats = filmed.stats[key]
    assert np.array(stats["mean"]).ravel() == pytest.approx(colors.mean(axis=0), abs=1e-9)
    assert np.array(stats["std"]).ravel() == pytest.approx(colors.std(axis=0), abs=1e-9)
    assert run("export", proofs[0], "--to", "csv", "--videos")[0] == 2


# -- both -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["minari", "lerobot"])
def test_the_same_recordings_make_the_same_bytes(kind: str, proofs: list[Path], tmp_path: Path) -> None:
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
    assert run("export", *proofs, "--to", kind, "-o", tmp_path / "here" / "snake-v0")[0] == 0
    elsewhere = {"PYTHONHASHSEED": "77", "TZ": "Asia/Tokyo"}
    run_process("export", *proofs, "--to", kind, "-o", tmp_path / "there" / "snake-v0", **elsewhere)
    assert digests(tmp_path / "here") == digests(tmp_path / "there") != {}


@pytest.mark.parametrize("kind", ["minari", "lerobot"])
def test_what_cannot_be_a_dataset_leaves_nothing_behind(kind: str, proofs: list[Path], tmp_path: Path) -> None:
    record_driven(tmp_path / "short.mcap", Genome(snake(segments=3)), task(), 1, iter([np.zeros(2)] * 60))
    record_driven(tmp_path / "fast.mcap", Genome(snake()), task(world={"tick_rate": 30}), 1, iter([np.zeros(3)] * 60))
    record_driven(tmp_path / "idle.mcap", Genome(snake(None)), task(), 1, None)
    record_driven(tmp_path / "still.mcap", Genome(snake(None, segments=1)), task(), 1, iter([np.zeros(0)] * 60))
    (tmp_path / "cut.mcap").write_bytes(proofs[0].read_bytes()[:-3000])
    before, target = sorted(os.listdir(tmp_path)), tmp_path / "d-v0"
    for files, words in (
        ([proofs[0], tmp_path / "short.mcap"], "have different sensors: "),
        ([proofs[0], tmp_path / "fast.mcap"], "have different ticks a second: 30, and 60"),
        ([tmp_path / "idle.mcap"], "nobody drives the creature"),
        ([tmp_path / "still.mcap"], "0 motors"),
        ([proofs[0], tmp_path / "cut.mcap"], "cut"),
    ):
        code, output = run("export", *files, "--to", kind, "-o", target)
        assert code == 1 and words in output, output
        assert sorted(os.listdir(tmp_path)) == before


@pytest.mark.parametrize("kind", ["minari", "lerobot"])
def test_wrong_usage_is_explained(kind: str, proofs: list[Path], tmp_path: Path) -> None:
    (tmp_path / "full-v0").mkdir()
    (tmp_path / "full-v0" / "mine").write_text("kept")
    (tmp_path / "empty-v0").mkdir()
    for arguments, words in (
        (["--to", kind], "needs --output"),
        (["--to", kind, "-o", tmp_path / "d-v0", "--what", "states"], "are for tables"),
        (["--to", kind, "-o", tmp_path / "full-v0"], "already"),
        (["--to", "csv", "-o", tmp_path / "x.csv"], "made of one recording"),
    ):
        code, output = run("export", *proofs[:2], *arguments)
        assert code == 2 and words in output, output
    assert (tmp_path / "full-v0" / "mine").read_text() == "kept"
    assert sorted(os.listdir(tmp_path)) == ["empty-v0", "full-v0"]
    assert run("export", proofs[0], "--to", kind, "-o", tmp_path / "empty-v0")[0] == 0
    code, output = run("export", proofs[0], "--to", "minari", "-o", tmp_path / "no version")
    assert code == 1 and "is called like walker-v0" in output and not (tmp_path / "no version").exists()


def test_a_missing_package_is_named(proofs: list[Path], tmp_path: Path) -> None:
    program = "import sys; sys.modules[sys.argv[1]] = None\nfrom nmes.cli import main\nsys.argv[1:2] = []\nmain()"
    for package, kind, extra in (("pyarrow", "lerobot", "arrow"), ("minari", "minari", "gym")):
        arguments = ["export", str(proofs[0]), "--to", kind, "-o", str(tmp_path / "d-v0")]
        process = subprocess.run([sys.executable, "-c", program, package, *arguments], capture_output=True, text=True)
        assert process.returncode == 1 and f"nmes[{extra}]" in process.stderr, process.stderr
    assert not list(tmp_path.iterdir())


def test_the_tables_of_tasks_are_what_pandas_writes(loaded: Loaded) -> None:
    about = pyarrow.parquet.read_schema(loaded.folder / "meta/tasks.parquet").pandas_metadata
    assert about["index_columns"] == ["__index_level_0__"]
    assert [column["field_name"] for column in about["columns"]] == ["task_index", "__index_level_0__"]
    assert orjson.loads((loaded.folder / "meta/info.json").read_bytes())
