"""The places from which a recording can be read: its beginning and its keyframes, and how the last one is found."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

import jsonschema_rs
import orjson

from nmes.errors import RecordingError
from nmes.recording.chain import Chain
from nmes.recording.mcap_format import DamagedFile
from nmes.recording.mcap_reader import FileIndex, Reader
from nmes.recording.records import KEYFRAMES
from nmes.schemas import load

__all__ = ["Start", "beginning", "last_keyframe"]

_SNAPSHOT_VERSION = 1
_KEYFRAME = jsonschema_rs.Draft202012Validator(load("recording/keyframes.json"))


@dataclass(frozen=True, slots=True)
class Start:
    """A place from which a recording can be read.

    Attributes:
        frame: The frame there, counted on through resets.
        snapshot: The world there, as `World.restore` takes it; None: a new world.
        offset: The byte of the file where its chunk begins; None: the beginning of the recording.
        chain: The hash chain up to there. It is not to be changed: readers copy it.
    """

    frame: int
    snapshot: bytes | None
    offset: int | None
    chain: Chain

    @property
    def within(self) -> bool:
        """Whether something was recorded before it."""
        return self.offset is not None


def beginning(reader: Reader, head: bytes) -> Start:
    """Finds the beginning of a recording, which may be a keyframe.

    Args:
        reader: The file.
        head: The head of the chain over its metadata.

    Raises:
        RecordingError: The keyframe is no snapshot of a world (`recording_damaged`).
    """
    chain, snapshot = Chain(head), None
    try:
        block = next((block for block in reader.blocks() if block.metadata is None), None)
        if block is not None:
            snapshot = chain.copy().keyframe(block)
    except DamagedFile:
        pass  # whoever reads from here meets the damage
    return Start(0 if snapshot is None else _ticks_before(snapshot), snapshot, None, chain)


def last_keyframe(reader: Reader, head: bytes, frame: int) -> Start | None:
    """Finds the last keyframe up to a frame, counted on through resets; None where there is none.

    A whole file states where its keyframes are; of one that was cut, all that comes before is read.
    """
    return _keyframe_by_summary(reader, head, frame) or _keyframe_by_reading(reader, head, frame)


def _keyframe_by_summary(reader: Reader, head: bytes, frame: int) -> Start | None:
    """Finds the last keyframe by the file's summary; None where that is of no use."""
    summary = reader.summary()
    if summary is None:
        return None
    chain = Chain(head)
    for channel in summary.channels:
        chain.define(channel)
    offsets = [offset for offset, _ in summary.chunks]
    places = _keyframe_chunks(summary)
    try:
        count = bisect_right(places, frame, key=lambda place: _at_keyframe(reader, chain, offsets[place]).frame)
        if count == 0:
            return None
        place = places[count - 1]
        chain.follow(reader.block(offsets[place - 1]) if place else None)
        return _at_keyframe(reader, chain, offsets[place])
    except RecordingError:
        return None  # what is wrong comes out when the file is read from its beginning


def _keyframe_chunks(summary: FileIndex) -> list[int]:
    """Returns which of the chunks hold keyframes, by their number."""
    channels = {channel.id for channel in summary.channels if channel.topic == KEYFRAMES}
    return [number for number, (_, used) in enumerate(summary.chunks) if used & channels]


def _at_keyframe(reader: Reader, chain: Chain, offset: int) -> Start:
    block = reader.block(offset)
    snapshot = chain.keyframe(block)
    if snapshot is None:
        raise DamagedFile(block.offset, "the summary does not fit the chunks")
    return Start(_ticks_before(snapshot), snapshot, block.offset, chain)


def _keyframe_by_reading(reader: Reader, head: bytes, frame: int) -> Start | None:
    """Finds the last keyframe by reading all that comes before."""
    chain, last = Chain(head), None
    try:
        for block in reader.blocks():
            if block.metadata is None:
                before = chain.copy()
                chain.check(block)
                snapshot = chain.keyframe(block)
                if snapshot is not None:
                    ticks = _ticks_before(snapshot)
                    if ticks > frame:
                        break
                    last = Start(ticks, snapshot, block.offset, before)
    except RecordingError:
        pass  # what comes before the damage is sound
    return last


def _ticks_before(snapshot: bytes) -> int:
    """Counts the ticks before a keyframe, by the line of JSON with which its snapshot begins.

    Raises:
        RecordingError: It is no snapshot of a world (`recording_damaged`), or of a newer version (`unknown_format`).
    """
    try:
        state = orjson.loads(snapshot.partition(b"\n")[0])
    except ValueError:
        state = None
    version = state.get("version") if isinstance(state, dict) else None
    if isinstance(version, int) and version > _SNAPSHOT_VERSION:
        text = f"a keyframe has a snapshot of version {version}; this nmes knows version {_SNAPSHOT_VERSION}"
        raise RecordingError("unknown_format", text)
    if not _KEYFRAME.is_valid(state):
        raise RecordingError("recording_damaged", "a keyframe is no snapshot of a world")
    return int(state["ticks"])
