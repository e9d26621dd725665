"""The places from which a recording can be read: its beginning and its keyframes, and how the last one is found.

A whole file's summary says where its keyframes are; in a file that was cut, the indexes behind its chunks do. That is
no more than a place to look at: what is found there must be a keyframe whose chunk goes on from the chunk before it in
the file, and defines the channels that it uses.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from itertools import islice

from nmes.errors import RecordingError
from nmes.recording.chain import Chain, ticks_before
from nmes.recording.mcap_format import DamagedFile
from nmes.recording.mcap_reader import Block, Reader
from nmes.recording.records import KEYFRAMES

__all__ = ["Start", "beginning", "last_keyframe"]


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
        RecordingError: The keyframe is of a newer version (`unknown_format`).
    """
    chain = Chain(head)
    try:
        block = next((block for block in reader.blocks() if block.metadata is None), None)
        start = None if block is None else _keyframe(block, chain, None)
    except DamagedFile:
        start = None  # whoever reads from here meets the damage
    return start or Start(0, None, None, chain)


def last_keyframe(reader: Reader, head: bytes, frame: int) -> Start | None:
    """Finds the last keyframe up to a frame, counted on through resets; None where there is none.

    Of a file of a version in which the chunks of keyframes do not define their channels again, all that comes before is
    read, as where there is none.
    """
    return _keyframe_by_index(reader, head, frame) or _keyframe_by_reading(reader, head, frame)


def _keyframe_by_index(reader: Reader, head: bytes, frame: int) -> Start | None:
    """Finds the last keyframe by the file's summary or indexes; None where they are of no use."""
    places = reader.chunks_with(KEYFRAMES)
    try:
        count = bisect_right(places, frame, key=lambda place: _frame_at(reader, head, place[1]))
        if count == 0:
            return None
        before, offset = places[count - 1]
        chain = Chain(head)
        *earlier, block = islice(reader.blocks(offset if before is None else before), 1 if before is None else 2)
        if before is not None:
            chain.follow(earlier[0])
        if block.offset != offset:
            return None
        start = _keyframe(block, chain, offset)
        return start if start is not None and start.frame <= frame else None
    except (RecordingError, ValueError):
        return None  # what is wrong comes out when the file is read from its beginning


def _frame_at(reader: Reader, head: bytes, offset: int) -> int:
    snapshot = Chain(head).keyframe(reader.block(offset))
    if snapshot is None:
        raise DamagedFile(offset, "the summary or an index does not fit the chunks")
    return ticks_before(snapshot)


def _keyframe(block: Block, chain: Chain, offset: int | None) -> Start | None:
    """Returns the start at a chunk that begins with a keyframe; None where it does not.

    Args:
        block: The chunk, all of which is checked.
        chain: The chain before it.
        offset: Of the start.

    Raises:
        DamagedFile: The chunk does not go on from those before it.
    """
    snapshot = chain.copy().keyframe(block)
    if snapshot is None:
        return None
    chain.copy().check(block)
    return Start(ticks_before(snapshot), snapshot, offset, chain)


def _keyframe_by_reading(reader: Reader, head: bytes, frame: int) -> Start | None:
    """Finds the last keyframe by reading all that comes before."""
    chain, last = Chain(head), None
    try:
        for block in reader.blocks():
            if block.metadata is None:
                before = chain.copy()
                chain.check(block)
                snapshot = before.copy().keyframe(block)
                if snapshot is not None:
                    ticks = ticks_before(snapshot)
                    if ticks > frame:
                        break
                    last = Start(ticks, snapshot, block.offset, before)
    except RecordingError:
        pass  # what comes before the damage is sound
    return last
