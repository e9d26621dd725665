"""A recording's world tick by tick: its cubes and where they are, from running it again or from its recorded poses.

It hides which of the two is possible on this machine.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from nmes.backend import Array, Vector
from nmes.errors import FilmError, RecordingError
from nmes.playback import replay, watch
from nmes.playback.report import fingerprint_differences
from nmes.recording import Kind, Recording
from nmes.recording.viewer_messages import Pose, Shape, decode_poses, decode_shapes
from nmes.world import World

__all__ = ["Moment", "moments"]

_FARTHEST = float(np.finfo(np.float32).max)  # of the numbers of a recorded pose: they are float32
_SHORTEST = 1e-3  # length of a quaternion, which is 1 but for rounding: one that is near 0 is no rotation


class Moment(NamedTuple):
    """The cubes of a world after one tick.

    Attributes:
        time: s since the recording began; a `reset` does not set it back.
        seed: The world's seed, from which scenery may be drawn.
        shapes: The cubes in order of creation: edge lengths (m), colour and shape.
        poses: Array (n, 7): their positions (m) and quaternions (x, y, z, w).
        targets: The points that creatures have as their targets, m; none where poses were recorded.
        food: The points where an ecosystem has food, m; none where poses were recorded.
    """

    time: float
    seed: int
    shapes: dict[str, Shape]
    poses: Array
    targets: tuple[Vector, ...] = ()
    food: tuple[Vector, ...] = ()


def moments(recording: Recording, begin: float = 0.0) -> Iterator[Moment]:
    """Yields the cubes of a recording's world after each tick, from a time on or from some time before.

    Where it comes out the same, the recording is run again; elsewhere its recorded poses are shown, and what lies
    between two of them is drawn between them. What is run again begins at the last keyframe before.

    Args:
        recording: The recording.
        begin: The time of the first moment that is wanted, s since the recording began.

    Raises:
        RecordingError: A tick does not come out as recorded (`diverged`), or what the file holds for viewers is no
            scene or no pose (`recording_damaged`).
        FilmError: There is neither the engine nor poses (`nothing_to_see`).
    """
    differences = fingerprint_differences(recording.config["backend"], recording.fingerprint)
    elsewhere = bool(differences) and replay(recording).verdict != "reproduced"
    return _recorded(recording) if elsewhere else _run_again(recording, begin)


def _run_again(recording: Recording, begin: float) -> Iterator[Moment]:
    """Yields the cubes of the world in which the recording is run again."""
    rate, version, shapes = recording.config["tick_rate"], -1, dict[str, Shape]()

    def look(world: World) -> tuple[int, dict[str, Shape], Array, tuple[Vector, ...], tuple[Vector, ...]]:
        nonlocal version, shapes
        if world.structure_version != version:
            version, shapes = world.structure_version, {name: world.cube_shape(name) for name in world.cubes()}
        aims = [world.all_creatures.find(name).target for name in world.all_creatures.names()]
        targets = tuple(dict.fromkeys(aim for aim in aims if aim is not None and not isinstance(aim, str)))
        food = tuple((x, y, z) for x, y, z in world.entities.food.tolist())
        poses = world.poses()[1][:, :7].copy()  # a view would keep all of the states
        return world.seed, shapes, poses, targets, food

    first = recording.start().frame
    start = recording.start(max(min(first + int(begin * rate), recording.last_frame) - 1, first))
    for tick, cubes in enumerate(watch(recording, look, start=start), start=start.frame - first + 1):
        yield Moment(tick / rate, *cubes)


def _recorded(recording: Recording) -> Iterator[Moment]:
    """Yields the recorded poses, and one moment a tick between two of them."""
    rate: int = recording.config["tick_rate"]
    ticks = 0
    shapes: dict[str, Shape] = {}
    last: Moment | None = None
    for record in recording:
        ticks += len(record.digests)
        try:
            poses = decode_poses(record.data) if record.kind is Kind.POSES else {}
            shapes = decode_shapes(record.data, shapes) if record.kind is Kind.SCENE else shapes
            cubes = {name: shapes[name] for name in poses if name in shapes}
            rows = _rows({name: poses[name] for name in cubes})
        except ValueError as error:
            raise RecordingError("recording_damaged", f"{recording.path}: record {record.sequence}: {error}") from error
        if record.kind is Kind.POSES:
            now = Moment(ticks / rate, recording.config["seed"], cubes, rows)
            if last is not None:
                yield from _between(last, now, rate)
            yield now
            last = now
    if last is None:
        raise FilmError(
            "nothing_to_see",
            f"{recording.path} was made by another engine or machine, so it cannot be run again here exactly, and it "
            "holds no poses",
        )


def _rows(poses: Mapping[str, Pose]) -> Array:
    """Returns poses as an array (n, 7).

    Raises:
        ValueError: One has a number that no recorder writes, or a quaternion that is no rotation.
    """
    rows = np.array([*poses.values()], float).reshape(-1, 7)
    sound = (np.abs(rows) <= _FARTHEST).all(axis=1)
    sound[sound] = np.linalg.norm(rows[sound, 3:], axis=1) > _SHORTEST
    if not sound.all():
        raise ValueError(f"the pose of cube {[*poses][int(sound.argmin())]!r} is no position and rotation")
    return rows


def _between(first: Moment, second: Moment, rate: int) -> Iterator[Moment]:
    """Yields the moments of the ticks between two, with poses on the straight way from one to the other."""
    places = {name: row for row, name in enumerate(second.shapes)}
    rows = [row for row, name in enumerate(first.shapes) if name in places]
    begin = first.poses[rows]
    end = second.poses[[places[name] for name in first.shapes if name in places]]
    # q and -q are the same rotation: the shorter way.
    end[(begin[:, 3:] * end[:, 3:]).sum(axis=1) < 0.0, 3:] *= -1.0
    count = round((second.time - first.time) * rate)
    for i in range(1, count):
        poses = first.poses.copy()
        poses[rows] += (end - begin) * (i / count)
        yield first._replace(time=first.time + i / rate, poses=poses)
