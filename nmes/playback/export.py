"""Recordings as data: tables of messages, and of the states after every tick.

It hides the formats of the tables.
"""

from __future__ import annotations

import base64
import csv
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from itertools import chain, islice
from typing import TYPE_CHECKING, Any

import orjson

from nmes.errors import MissingPackage, RecordingError
from nmes.playback.divergence import message_or_text
from nmes.playback.watch import States
from nmes.recording import Kind, Record, Recording

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

__all__ = ["COLUMNS", "messages", "state_rows", "write_csv", "write_jsonl", "write_parquet"]

COLUMNS = tuple(
    f"{name}_{axis}"
    for name, axes in (("position", "xyz"), ("quaternion", "xyzw"), ("linear", "xyz"), ("angular", "xyz"))
    for axis in axes
)
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


def write_parquet(rows: Iterable[Row], path: str | os.PathLike[str]) -> None:
    """Writes a table as Parquet, a few thousand rows at a time; messages stand in it as JSON.

    Raises:
        MissingPackage: pyarrow is not installed.
        RecordingError: There are no rows (`nothing_to_export`).
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise MissingPackage("Parquet needs pyarrow: pip install 'nmes[arrow]'") from error
    flat = map(_flat, rows)
    writer = None
    with ExitStack() as opened:
        while batch := list(islice(flat, _BATCH)):
            if writer is None:
                kinds = {"frame": pyarrow.int64(), "record": pyarrow.int64(), "wall_ns": pyarrow.int64()}
                kinds |= {"client": pyarrow.int64(), "t": pyarrow.float64()}
                kinds |= {name: pyarrow.float64() for name in COLUMNS}
                schema = pyarrow.schema([(name, kinds.get(name, pyarrow.string())) for name in batch[0]])
                file = opened.enter_context(open(path, "wb"))
                writer = opened.enter_context(pyarrow.parquet.ParquetWriter(file, schema))
            writer.write_table(pyarrow.Table.from_pylist(batch, schema=schema))
    if writer is None:
        raise RecordingError("nothing_to_export", "the recording holds no such rows")


def _flat(row: Row) -> Row:
    return {**row, "message": orjson.dumps(row["message"]).decode()} if "message" in row else row
