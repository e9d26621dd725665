"""Recordings as data: tables of messages, and of what there was after every tick.

It hides the formats of the tables. What a tick left is not in a recording: the rows come of running it again.
"""

from __future__ import annotations

import base64
import csv
import importlib
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from itertools import chain, islice
from typing import TYPE_CHECKING, Any, Final

import orjson

from nmes.errors import MissingPackage, RecordingError
from nmes.playback.divergence import message_or_text
from nmes.playback.watch import States, watch
from nmes.recording import Kind, Record, Recording
from nmes.world import World

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

__all__ = [
    "COLUMNS",
    "TABLES",
    "arrow_table",
    "control_rows",
    "joint_rows",
    "messages",
    "sensor_rows",
    "state_rows",
    "write_csv",
    "write_jsonl",
    "write_parquet",
]

COLUMNS = tuple(
    f"{name}_{axis}"
    for name, axes in (("position", "xyz"), ("quaternion", "xyzw"), ("linear", "xyz"), ("angular", "xyz"))
    for axis in axes
)
TABLES: Final[Mapping[str, tuple[str, ...]]] = {
    "messages": ("record", "kind", "t", "wall_ns", "client", "message"),
    "states": ("frame", "t", "cube_name", *COLUMNS),
    "joints": ("frame", "t", "joint_name", "position", "velocity", "effort", "target"),
    "controls": ("frame", "t", "creature", "motor", "control"),
    "sensors": ("frame", "t", "creature", "sensor", "value"),
    "scores": ("frame", "t", "score"),
}
"""The tables that a recording can be written as, each with its columns; docs/cli.md says what they are."""
_WHOLE = ("record", "wall_ns", "client", "frame")
_NUMBERS = ("t", *COLUMNS, "position", "velocity", "effort", "target", "control", "value", "score")
_BATCH = 50_000  # rows of a Parquet group

Row = Mapping[str, Any]


def messages(recording: Recording) -> Iterator[Row]:
    """Yields a row for each message and event: commands, replies, who came and went, ticks, faults.

    The first row says how the world began: the recording's metadata. Where a recording begins at a keyframe, because
    its world has a past, the second row holds that, in base64. What is not JSON, or too
    deep to be written, stands as text.
    """
    beginning = {"record": None, "kind": "recording", "t": 0.0, "wall_ns": None, "client": None}
    yield {**beginning, "message": recording.metadata}
    for record in recording:
        if record.kind in (Kind.POSES, Kind.SCENE, Kind.BOX) or (record.kind is Kind.KEYFRAME and record.sequence > 0):
            continue
        yield {
            "record": record.sequence,
            "kind": str(record.kind),
            "t": record.time / 1e9,
            "wall_ns": record.wall,
            "client": record.client,
            "message": _message(record),
        }


def _message(record: Record) -> Any:
    if record.about is not None:
        return record.about
    if record.kind is Kind.KEYFRAME:
        return {"snapshot": base64.b64encode(record.data).decode()}
    return message_or_text(record.data)


def state_rows(ticks: Iterable[States]) -> Iterator[Row]:
    """Yields a row for each cube after each tick."""
    for frame, time, names, values in ticks:
        for name, value in zip(names, values.tolist(), strict=True):
            yield {"frame": frame, "t": time, "cube_name": name, **dict(zip(COLUMNS, value, strict=True))}


def joint_rows(recording: Recording, *, keep_going: bool = False) -> Iterator[Row]:
    """Yields a row for each hinge and slide after each tick; see `watch` for what is raised.

    Positions, velocities and efforts are as `get_joint_info` has them. The target is that of the motor: an angle (rad)
    or a way (m) of a servo, else a speed (rad/s, m/s); None where no motor is on.
    """
    for frame, time, joints in watch(recording, _joints, keep_going=keep_going):
        for name, target, reading in joints:
            position, velocity, effort = reading
            numbers = {"position": position, "velocity": velocity, "effort": effort, "target": target}
            yield {"frame": frame, "t": time, "joint_name": name, **numbers}


def _joints(world: World) -> tuple[int, float, list[tuple[str, float | None, list[float]]]]:
    joints = [joint for joint in world.entities.joints.values() if joint.kind in ("hinge", "slide")]
    readings = world.simulation.joint_readings([joint.number for joint in joints]).tolist() if joints else []
    named = zip(joints, readings, strict=True)
    return world.frame, world.time, [(joint.name, _target(joint.params), reading) for joint, reading in named]


def _target(params: Mapping[str, Any]) -> float | None:
    if not params["motor_enabled"]:
        return None
    servo: float | None = params["target_position"]
    speed: float = params["motor_target_velocity"]
    return speed if servo is None else servo


def control_rows(recording: Recording, *, keep_going: bool = False) -> Iterator[Row]:
    """Yields a row for each motor and voice of each creature after each tick: what it was driven with last.

    That is from -1 to 1. It is None before the creature is driven; see `watch` for what is raised.
    """
    for frame, time, creatures in watch(recording, _controls, keep_going=keep_going):
        for creature, motors, controls in creatures:
            for motor, control in zip(motors, controls, strict=True):
                yield {"frame": frame, "t": time, "creature": creature, "motor": motor, "control": control}


def _controls(world: World) -> tuple[int, float, list[tuple[str, list[str], list[float | None]]]]:
    found: list[tuple[str, list[str], list[float | None]]] = []
    for name in world.creatures():
        creature = world.creature(name)
        motors = list(creature.body.outputs)
        controls = creature.controls
        found.append((name, motors, [None] * len(motors) if controls is None else controls.tolist()))
    return world.frame, world.time, found


def sensor_rows(recording: Recording, *, keep_going: bool = False) -> Iterator[Row]:
    """Yields a row for each sensor of each creature after each tick; units are those of `schemas/genome.json`.

    See `watch` for what is raised.
    """
    for frame, time, creatures in watch(recording, _senses, keep_going=keep_going):
        for creature, sensors, values in creatures:
            for sensor, value in zip(sensors, values, strict=True):
                yield {"frame": frame, "t": time, "creature": creature, "sensor": sensor, "value": value}


def _senses(world: World) -> tuple[int, float, list[tuple[str, list[str], list[float]]]]:
    creatures = [world.creature(name) for name in world.creatures()]
    felt = [(one.name, [sensor.id for sensor in one.sensors], one.sense().tolist()) for one in creatures]
    return world.frame, world.time, felt


def write_jsonl(rows: Iterable[Row], file: SupportsWrite[str]) -> None:
    """Writes each row as a line of JSON."""
    for row in rows:
        file.write(orjson.dumps(row, option=orjson.OPT_APPEND_NEWLINE).decode())


def write_csv(rows: Iterable[Row], file: SupportsWrite[str]) -> None:
    """Writes a table with a header; messages stand in it as JSON."""
    rows = iter(rows)
    for first in islice(rows, 1):
        writer = csv.DictWriter(file, list(first), lineterminator="\n")
        writer.writeheader()
        writer.writerows(map(_flat, chain([first], rows)))


def write_parquet(rows: Iterable[Row], what: str, path: str | os.PathLike[str]) -> None:
    """Writes a table as Parquet, a few thousand rows at a time; messages stand in it as JSON.

    Args:
        rows: The rows.
        what: Which of the `TABLES`.
        path: The file.

    Raises:
        MissingPackage: pyarrow is not installed.
        RecordingError: There are no rows (`nothing_to_export`).
    """
    parquet = _arrow("pyarrow.parquet")
    writer = None
    with ExitStack() as opened:
        for batch in _batches(rows, what):
            if writer is None:
                file = opened.enter_context(open(path, "wb"))
                writer = opened.enter_context(parquet.ParquetWriter(file, batch.schema))
            writer.write_table(batch)
    if writer is None:
        raise RecordingError("nothing_to_export", "the recording holds no such rows")


def arrow_table(rows: Iterable[Row], what: str) -> Any:
    """Returns a table as a `pyarrow.Table`, which may have no rows; messages stand in it as JSON.

    Raises:
        MissingPackage: pyarrow is not installed.
    """
    batches = list(_batches(rows, what))
    return _arrow("pyarrow").concat_tables(batches) if batches else _schema(what).empty_table()


def _batches(rows: Iterable[Row], what: str) -> Iterator[Any]:
    """Yields tables of arrow, a few thousand rows each."""
    arrow, schema, flat = _arrow("pyarrow"), _schema(what), map(_flat, rows)
    while batch := list(islice(flat, _BATCH)):
        yield arrow.Table.from_pylist(batch, schema=schema)


def _schema(what: str) -> Any:
    arrow = _arrow("pyarrow")
    kinds = dict.fromkeys(_WHOLE, arrow.int64()) | dict.fromkeys(_NUMBERS, arrow.float64())
    return arrow.schema([(name, kinds.get(name, arrow.string())) for name in TABLES[what]])


def _arrow(module: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingPackage("tables of arrow need pyarrow: pip install 'nmes[arrow]'") from error


def _flat(row: Row) -> Row:
    return {**row, "message": orjson.dumps(row["message"]).decode()} if "message" in row else row
