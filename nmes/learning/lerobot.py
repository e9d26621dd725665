"""Datasets of LeRobot: recorded episodes in the format v3.0, written without its package.

Hides the folders, tables and statistics of that format. A frame of the dataset is a tick: what the sensors read before
it (`observation.state`), what was done (`action`), and what it earned (`next.reward`, `next.done`, `next.truncated`),
as floats of 32 bits, which is what is learned from. What is sensed after the last tick has no place in the format.
The same recordings make the same bytes, but for videos, which depend on what draws them.

Source: R. Cadene et al., "LeRobot" (2024), its dataset format v3.0: `meta/info.json`, `meta/stats.json`,
`meta/tasks.parquet`, and tables of episodes and frames in files of at most about 100 MB, 1,000 of which are a folder.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import orjson

from nmes.errors import MissingPackage, RecordingError
from nmes.learning.episodes import RecordedEpisode, read_episodes

__all__ = ["write_lerobot"]

_FRAMES: Final = 100_000_000  # bytes of numbers in a file of frames, about: it ends with an episode
_FILES: Final = 1000  # in a folder
_PLACE: Final = "chunk-{chunk_index:03d}/file-{file_index:03d}"
_QUANTILES: Final = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}

_CAMERA: Final = "observation.images.follow"
_SEEN: Final = 100  # pictures of an episode of which the statistics are

Numbers = npt.NDArray[Any]
Film = Callable[[RecordedEpisode, Path], None]
"""Writes an .mp4 of an episode: for each tick, in its turn, a picture of what was before it."""
Stats = Mapping[str, Mapping[str, Numbers]]


def write_lerobot(
    recordings: Iterable[str | os.PathLike[str]], folder: str | os.PathLike[str], film: Film | None = None
) -> tuple[int, int]:
    """Writes recordings of episodes as a dataset.

    Args:
        recordings: The files, of creatures with the same sensors and motors; each becomes an episode, in their order.
        folder: Where to write it: an empty folder, or one that is not there yet.
        film: Called for a video of each episode; None: there are none.

    Returns:
        How many episodes and how many ticks there are.

    Raises:
        MissingPackage: pyarrow is not installed; or PyAV, where there are videos.
        RecordingError, ProofError, DocumentError: As by `nmes.learning.read_episodes`; or there are no recordings
            (`nothing_to_export`).
    """
    try:
        import pyarrow.parquet  # noqa: F401 (before the work, not after it)
    except ImportError as error:
        raise MissingPackage("datasets of LeRobot need pyarrow: pip install 'nmes[arrow]'") from error
    dataset = _Dataset(Path(folder), film)
    for episode in read_episodes(recordings):
        dataset.add(episode)
    return dataset.close()


class _Dataset:
    """A dataset that is being written, an episode at a time."""

    def __init__(self, folder: Path, film: Film | None) -> None:
        self._folder, self._film = folder, film
        self._video: dict[str, Any] = {}  # what the feature is, if there is one
        self._first: RecordedEpisode | None = None
        self._tasks: dict[str, int] = {}
        self._rows: list[dict[str, Any]] = []  # of the table of episodes
        self._stats: list[Stats] = []
        self._frames: list[dict[str, Numbers]] = []  # of episodes that are in no file yet
        self._file = self._bytes = self._ticks = 0

    def add(self, episode: RecordedEpisode) -> None:
        """Takes the next episode."""
        self._first = self._first or episode
        frames = self._table(episode)
        stats = {key: _describe(values) for key, values in frames.items()}
        size = sum(values.nbytes for values in frames.values())
        if self._frames and self._bytes + size > _FRAMES:
            self._flush()
        self._frames.append(frames)
        self._bytes += size
        video: dict[str, Any] = {}
        if self._film is not None:
            video, stats[_CAMERA] = self._shoot(self._film, episode)
        self._rows.append(self._row(episode, video, stats))
        self._stats.append(stats)
        self._ticks += len(episode.actions)

    def _shoot(self, film: Film, episode: RecordedEpisode) -> tuple[dict[str, Any], dict[str, Numbers]]:
        """Films an episode; returns the columns that say where the video is, and its statistics."""
        number, rate = len(self._rows), episode.task.tick_rate
        path = self._folder / "videos" / _CAMERA / _at(number, "mp4")
        path.parent.mkdir(parents=True, exist_ok=True)
        film(episode, path)
        self._video, stats = _watch(path, rate)
        what = f"videos/{_CAMERA}"
        ends = {f"{what}/from_timestamp": 0.0, f"{what}/to_timestamp": len(episode.actions) / rate}
        return {**_place(what, number), **ends}, stats

    def _row(self, episode: RecordedEpisode, video: Mapping[str, Any], stats: Stats) -> dict[str, Any]:
        """Returns the row of the table of episodes."""
        ticks, result = len(episode.actions), episode.result
        return {
            "episode_index": len(self._rows),
            "tasks": [episode.task.document["description"]],
            "length": ticks,
            **_place("data", self._file),
            "dataset_from_index": self._ticks,
            "dataset_to_index": self._ticks + ticks,
            **video,
            "nmes/recording": Path(episode.path).name,
            "nmes/task": episode.task.hash,
            "nmes/genome": episode.genome.hash,
            "nmes/seed": result.seed,
            "nmes/score": result.score,
            **{f"stats/{key}/{name}": value for key, each in stats.items() for name, value in each.items()},
            **_place("meta/episodes", 0),
        }

    def _table(self, episode: RecordedEpisode) -> dict[str, Numbers]:
        """Returns the columns of an episode's frames."""
        ticks = len(episode.actions)
        numbers = np.arange(ticks)
        task = self._tasks.setdefault(episode.task.document["description"], len(self._tasks))
        return {
            "observation.state": episode.observations[:-1].astype(np.float32),
            "action": episode.actions.astype(np.float32),
            "next.reward": episode.rewards.astype(np.float32)[:, np.newaxis],
            "next.done": (episode.terminated | episode.truncated)[:, np.newaxis],
            "next.truncated": episode.truncated[:, np.newaxis],
            "timestamp": (numbers / episode.task.tick_rate).astype(np.float32)[:, np.newaxis],
            "frame_index": numbers[:, np.newaxis],
            "episode_index": np.full((ticks, 1), len(self._rows)),
            "index": self._ticks + numbers[:, np.newaxis],
            "task_index": np.full((ticks, 1), task),
        }

    def _flush(self) -> None:
        """Writes the frames that are in no file yet."""
        columns = {key: np.concatenate([frames[key] for frames in self._frames]) for key in self._frames[0]}
        _write_table(self._folder / "data" / _at(self._file), {key: _column(each) for key, each in columns.items()})
        self._frames, self._bytes, self._file = [], 0, self._file + 1

    def close(self) -> tuple[int, int]:
        """Writes what is left, and what is told of the whole; returns how many episodes and ticks there are."""
        if self._first is None:
            raise RecordingError("nothing_to_export", "there are no recordings")
        features = _features(self._first, self._frames[0]) | ({_CAMERA: self._video} if self._video else {})
        self._flush()
        meta = self._folder / "meta"
        columns = {key: [_plain(row[key]) for row in self._rows] for key in self._rows[0]}
        _write_table(meta / "episodes" / _at(0), columns)
        _write_tasks(meta / "tasks.parquet", list(self._tasks))
        stats = {
            key: {name: value.tolist() for name, value in _aggregate([each[key] for each in self._stats]).items()}
            for key in features
        }
        _write_json(meta / "stats.json", stats)
        _write_json(meta / "info.json", self._info(self._first, features))
        return len(self._rows), self._ticks

    def _info(self, first: RecordedEpisode, features: Mapping[str, Any]) -> dict[str, Any]:
        return {
            "codebase_version": "v3.0",
            "robot_type": first.genome.name,
            "total_episodes": len(self._rows),
            "total_frames": self._ticks,
            "total_tasks": len(self._tasks),
            "chunks_size": _FILES,
            "data_files_size_in_mb": _FRAMES // 1_000_000,
            "video_files_size_in_mb": 200,
            "fps": first.task.tick_rate,
            "splits": {"train": f"0:{len(self._rows)}"},
            "data_path": f"data/{_PLACE}.parquet",
            "video_path": f"videos/{{video_key}}/{_PLACE}.mp4" if self._video else None,
            "features": features,
        }


def _features(episode: RecordedEpisode, frames: Mapping[str, Numbers]) -> dict[str, Any]:
    """Returns the description of each column of the frames."""
    names = {"observation.state": episode.sensors, "action": episode.motors}
    return {
        key: {"dtype": str(values.dtype), "shape": [values.shape[1]], "names": names.get(key)}
        for key, values in frames.items()
    }


# -- statistics -------------------------------------------------------------------------------------------------------


def _describe(values: Numbers) -> dict[str, Numbers]:
    """Returns the statistics of a column, array (n, k): `count` (1,), all others (k,)."""
    numbers = values.astype(np.float64)
    stats: dict[str, Numbers] = {
        "min": values.min(axis=0),
        "max": values.max(axis=0),
        "mean": numbers.mean(axis=0),
        "std": numbers.std(axis=0),
        "count": np.array([len(values)]),
    }
    quantiles = np.quantile(numbers, list(_QUANTILES.values()), axis=0)
    return stats | dict(zip(_QUANTILES, quantiles, strict=True))


def _watch(path: Path, rate: int) -> tuple[dict[str, Any], dict[str, Numbers]]:
    """Returns a video's description, and the statistics of its colours, 0 to 1: `count` (1,), all others (3, 1, 1)."""
    import av

    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        every = max(1, stream.frames // _SEEN)
        seen = np.zeros((3, 256), np.int64)
        for number, frame in enumerate(container.decode(stream)):
            if number % every == 0:
                pixels = frame.to_ndarray(format="rgb24")
                seen += [np.bincount(pixels[:, :, color].ravel(), minlength=256) for color in range(3)]
        height, width, _ = pixels.shape
        about = {"height": height, "width": width, "codec": "h264", "pix_fmt": "yuv420p", "is_depth_map": False}
        about |= {"fps": rate, "channels": 3}
        info = {f"video.{name}": value for name, value in about.items()} | {"has_audio": False}
        feature = {
            "dtype": "video",
            "shape": [height, width, 3],
            "names": ["height", "width", "channels"],
            "info": info,
        }
        return feature, _describe_colors(seen, -(-stream.frames // every))


def _describe_colors(seen: Numbers, pictures: int) -> dict[str, Numbers]:
    """Returns the statistics of colours, given how often each value was there: array (3, 256)."""
    values = np.arange(256) / 255.0
    total = seen.sum(axis=1)
    mean = (seen * values).sum(axis=1) / total
    below = seen.cumsum(axis=1)
    there = [values[np.flatnonzero(each)] for each in seen]
    stats = {
        "min": np.array([each[0] for each in there]),
        "max": np.array([each[-1] for each in there]),
        "mean": mean,
        "std": np.sqrt((seen * (values - mean[:, np.newaxis]) ** 2).sum(axis=1) / total),
    }
    for name, part in _QUANTILES.items():
        stats[name] = values[(below >= part * total[:, np.newaxis]).argmax(axis=1)]
    return {name: value.reshape(3, 1, 1) for name, value in stats.items()} | {"count": np.array([pictures])}


def _aggregate(parts: Sequence[Mapping[str, Numbers]]) -> dict[str, Numbers]:
    """Returns the statistics of a dataset; its quantiles are, as LeRobot's own, the means of those of its episodes."""
    counts = np.array([part["count"] for part in parts], float).reshape(-1, *[1] * parts[0]["mean"].ndim)
    total = counts.sum(axis=0)

    def mean(values: Iterator[Numbers]) -> Numbers:
        weighted: Numbers = (np.array(list(values)) * counts).sum(axis=0) / total
        return weighted

    middle = mean(part["mean"] for part in parts)
    spread = mean(part["std"] ** 2 + (part["mean"] - middle) ** 2 for part in parts)
    return {
        "min": np.min([part["min"] for part in parts], axis=0),
        "max": np.max([part["max"] for part in parts], axis=0),
        "mean": middle,
        "std": np.sqrt(spread),
        "count": np.array([int(counts.sum())]),
        **{name: mean(part[name] for part in parts) for name in _QUANTILES},
    }


# -- files ------------------------------------------------------------------------------------------------------------


def _place(what: str, file: int) -> dict[str, int]:
    """Returns the columns that say in which file something is."""
    return {f"{what}/chunk_index": file // _FILES, f"{what}/file_index": file % _FILES}


def _at(file: int, ending: str = "parquet") -> str:
    return f"{_PLACE.format(chunk_index=file // _FILES, file_index=file % _FILES)}.{ending}"


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value


def _column(values: Numbers) -> Any:
    """Returns an array (n, k) as a column: of numbers where k is 1, else of lists of k of them."""
    import pyarrow

    flat = pyarrow.array(values.reshape(-1))
    return flat if values.shape[1] == 1 else pyarrow.FixedSizeListArray.from_arrays(flat, values.shape[1])


def _write_table(path: Path, columns: Mapping[str, Any], metadata: Mapping[str, str] | None = None) -> None:
    import pyarrow
    import pyarrow.parquet

    path.parent.mkdir(parents=True, exist_ok=True)
    table = pyarrow.table(dict(columns)).replace_schema_metadata(metadata)
    pyarrow.parquet.write_table(table, path)


def _write_tasks(path: Path, tasks: Sequence[str]) -> None:
    """Writes the table of tasks, whose texts are what pandas calls its index."""
    index = "__index_level_0__"

    def column(name: str | None, field: str, kind: str, stored: str) -> dict[str, Any]:
        return {"name": name, "field_name": field, "pandas_type": kind, "numpy_type": stored, "metadata": None}

    about = {
        "index_columns": [index],
        "column_indexes": [],
        "columns": [column("task_index", "task_index", "int64", "int64"), column(None, index, "unicode", "object")],
        "creator": {"library": "pyarrow", "version": ""},
        "pandas_version": "",
    }
    columns = {"task_index": list(range(len(tasks))), index: list(tasks)}
    _write_table(path, columns, {"pandas": orjson.dumps(about).decode()})


def _write_json(path: Path, value: Any) -> None:
    path.write_bytes(orjson.dumps(value, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE))
