"""Recordings: one world's history written down as it happens, and read again.

A recording is an MCAP file (docs/recording-format.md) that holds a world's inputs in order: who came and went, every
frame that clients sent, every tick with its digest, and the replies. A `Recorder` is the journal of a live world; a
`Recording` reads such a file, and needs no world and no engine for that: `nmes.playback` runs it again.

Invariants:

- File order is the order of the history, and a message's sequence number is its place in it.
- What a client sent is kept byte for byte. Passwords never get here: a client joins after it was authenticated.
- Recording does not change what a world does: it only asks for poses. Keyframes are the world's own.
- A SHA-256 chain runs over the metadata and every chunk, each chunk ending with its head, so that no byte of the
  history can be changed, dropped or moved without breaking it. Checksums of the single records stand before the head:
  the chain shows whether a chunk is as it was written, they show which record is not.
- A reader returns what comes before the first damage, and says where and what that is. It never guesses beyond it.
- One that begins at a keyframe has not read what stands before it, and says nothing of that.
"""

from __future__ import annotations

import os
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import orjson

from nmes import protocol
from nmes.errors import NmesError, RecordingError
from nmes.recording.chain import Chain, keyframe_ticks
from nmes.recording.mcapfile import (
    Block,
    DamagedFile,
    Reader,
)
from nmes.recording.recorder import Recorder
from nmes.recording.records import (
    END,
    FORMAT,
    FORMATS,
    KEYFRAMES,
    PROFILE,
    REFUSED_LIMIT,
    Kind,
    Record,
    next_head,
)

__all__ = [
    "FORMAT",
    "PROFILE",
    "REFUSED_LIMIT",
    "Kind",
    "Record",
    "Recorder",
    "Recording",
    "Start",
    "Summary",
]

_Taken = TypeVar("_Taken")
_NEVER = 2**63  # a frame that no world comes to
_ERROR = b'{"type":"error",'  # how the world's encoder begins an error


@dataclass(slots=True)
class Summary:
    """What a recording holds, counted.

    Attributes:
        clients: How many came.
        commands: How many of each type were executed, also those that the world answered with an error.
        refused: How many frames were no valid command.
        errors: How many replies were errors.
        ticks: How many there were, over all resets.
        keyframes: How often the world was saved.
        faults: How often the world stopped.
        began: Wall clock of the first record, ns since 1970; 0 when there is none.
        ended: The same of the last.
    """

    clients: int = 0
    commands: Counter[str] = field(default_factory=Counter)
    refused: int = 0
    errors: int = 0
    ticks: int = 0
    keyframes: int = 0
    faults: int = 0
    began: int = 0
    ended: int = 0

    def _count(self, record: Record) -> None:
        match record:
            case Record(kind=Kind.JOINED):
                self.clients += 1
            case Record(kind=Kind.COMMAND):
                self.commands[protocol.parse(record.data).type or "invalid"] += 1
            case Record(kind=Kind.REFUSED):
                self.refused += 1
            case Record(kind=Kind.REPLY):
                self.errors += record.data.startswith(_ERROR)
            case Record(kind=Kind.TICKS, about={"digests": digests}):
                self.ticks += len(digests)
            case Record(kind=Kind.KEYFRAME):
                self.keyframes += 1
            case Record(kind=Kind.FAULT):
                self.faults += 1
        self.began = self.began or record.wall
        self.ended = record.wall


class Recording:
    """A recording to read.

    Iterating yields its records in file order, as often as one likes, up to the damage if there is any.

    Attributes:
        path: The file.
        metadata: Its metadata records by name (schemas/recording_metadata.json).
        config: The world's complete config, seed included.
        fingerprint: What the run's numbers depended on.
        size: Of the file, in bytes.
        end: What it states of itself at its end (`nmes.end`); empty until all of it was read and is sound.
        stopped: Why the last reading ended before the file does, if it did.

    Raises:
        RecordingError: The file cannot be read as a recording at all: it is not one, or it is damaged before the
            first record, or it is of a format that this version does not know.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._reader = Reader(path)
        self.size = self._reader.size
        if self._reader.profile != PROFILE:
            raise RecordingError(
                "not_a_recording", f"{path} is an MCAP file of profile {self._reader.profile!r}, not {PROFILE!r}"
            )
        self.stopped: DamagedFile | None = None
        self._damage: DamagedFile | None = None
        self._checked = False
        self.end: dict[str, str] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        beginning, reason = b"", ""
        try:
            for block in self._reader.blocks():
                if block.metadata is None or block.metadata.name == END:
                    break
                self.metadata[block.metadata.name] = block.metadata.metadata
                beginning += block.content
        except DamagedFile as error:
            reason = f": {error.message}"
        self._head = next_head(b"", beginning)
        written = self.metadata.get("nmes.recording", {}).get("format", FORMAT)
        if written not in FORMATS:
            known = " and ".join(sorted(FORMATS))
            raise RecordingError(
                "unknown_format", f"{path} is a recording of format {written}; this nmes reads formats {known}"
            )
        try:
            protocol.validate_metadata(self.metadata)
            self.config: dict[str, Any] = protocol.complete_config(orjson.loads(self.metadata["nmes.world"]["config"]))
        except (NmesError, ValueError) as error:
            reason = reason or f": {error}"
            raise RecordingError("not_a_recording", f"{path} does not say how its world began{reason}") from None
        self.fingerprint = self.metadata["nmes.fingerprint"]

    @property
    def damage(self) -> DamagedFile | None:
        """Where the recording ends early and why, or None. Checks the whole file when nothing has read it yet."""
        if not self._checked:
            for _ in self._walk(Chain.check):
                pass
        return self._damage

    @property
    def complete(self) -> bool:
        """Whether the recording was closed properly and all of it is sound."""
        return self.damage is None

    def __iter__(self) -> Iterator[Record]:
        return self.records()

    def records(self, start: Start | None = None) -> Iterator[Record]:
        """Yields the records in file order, from a `start` or the beginning on."""
        for _, records in self.chunks(start):
            yield from records

    def chunks(self, start: Start | None = None) -> Iterator[tuple[int, list[Record]]]:
        """Yields the records in file order, a chunk at a time, with how far into the file (in bytes) that reaches.

        Args:
            start: Where to begin, from `start`; None: at the beginning.
        """
        return self._walk(Chain.records, start)

    def _walk(self, take: Callable[[Chain, Block], _Taken], start: Start | None = None) -> Iterator[tuple[int, _Taken]]:
        """Goes through the chunks, and notes where that ends."""
        chain = Chain(self._head) if start is None else start._chain.copy()
        offset = None if start is None else start._offset
        self.stopped = None
        end: dict[str, str] = {}
        try:
            for block in self._reader.blocks(offset):
                if block.metadata is None:
                    yield block.offset + block.size, take(chain, block)
                elif block.metadata.name == END:
                    end = block.metadata.metadata
            if (end.get("head"), end.get("records")) != (chain.head.hex(), str(chain.sequence)):
                raise DamagedFile(self.size, "the file's closing metadata do not belong to its records")
            self.end = end
        except DamagedFile as error:
            read = f"read up to record {chain.sequence - 1}" if chain.sequence else "no record can be read"
            which = None if error.content is None else chain.first_bad(error.content)
            told = "" if which is None else f"; record {which} is not as it was written"
            self.stopped = DamagedFile(error.offset, f"{error.message}{told}; {read}", cut=error.cut)
            self.stopped.record = which
        if offset is None:
            self._damage, self._checked = self.stopped, True

    # -- seeking ---------------------------------------------------------------------------------------------------

    def start(self, frame: int | None = None) -> Start:
        """Finds where to begin reading in order to come to a frame: at the last keyframe before it, or the beginning.

        A whole file says where its keyframes are; of one that was cut, all that comes before is read.

        Args:
            frame: The frame, counted on through resets; None: that with which the recording begins.

        Raises:
            RecordingError: The recording begins after that frame (`no_such_frame`).
        """
        first = self._first
        if frame is None:
            return first
        if frame < first.frame:
            raise RecordingError("no_such_frame", f"{self.path} begins at frame {first.frame}; it has no frame {frame}")
        if frame == first.frame or not self.config.get("keyframes"):
            return first
        return self._indexed(frame) or self._scanned(frame) or first

    @cached_property
    def _first(self) -> Start:
        """The beginning."""
        chain, snapshot = Chain(self._head), None
        try:
            block = next((block for block in self._reader.blocks() if block.metadata is None), None)
            if block is not None:
                snapshot = chain.copy().keyframe(block)
        except DamagedFile:
            pass  # whoever reads from here will be told
        return Start(0 if snapshot is None else keyframe_ticks(snapshot), snapshot, None, chain)

    def _indexed(self, frame: int) -> Start | None:
        """Finds the last keyframe before a frame by the file's summary; None where that is of no use."""
        summary = self._reader.summary()
        if summary is None:
            return None
        chain = Chain(self._head)
        for channel in summary.channels:
            chain.define(channel)
        channels = {channel.id for channel in summary.channels if channel.topic == KEYFRAMES}
        places = [i for i, (_, held) in enumerate(summary.chunks) if held & channels]

        def found(i: int) -> Start:
            block = self._reader.block(summary.chunks[i][0])
            snapshot = chain.keyframe(block)
            if snapshot is None:
                raise DamagedFile(block.offset, "the summary does not fit the chunks")
            return Start(keyframe_ticks(snapshot), snapshot, block.offset, chain)

        try:
            count = bisect_right(places, frame, key=lambda i: found(i).frame)
            if count == 0:
                return None
            chain.follow(self._reader.block(summary.chunks[places[count - 1] - 1][0]) if places[count - 1] else None)
            return found(places[count - 1])
        except (DamagedFile, RecordingError):
            return None  # what the file is like will come out when it is read from its beginning

    def _scanned(self, frame: int) -> Start | None:
        """Finds the last keyframe before a frame by reading all that comes before."""
        chain, best = Chain(self._head), None
        try:
            for block in self._reader.blocks():
                if block.metadata is None:
                    before = chain.copy()
                    chain.check(block)
                    snapshot = chain.keyframe(block)
                    if snapshot is not None:
                        ticks = keyframe_ticks(snapshot)
                        if ticks > frame:
                            break
                        best = Start(ticks, snapshot, block.offset, before)
        except (DamagedFile, RecordingError):
            pass  # what comes before the damage is sound
        return best

    @property
    def last_frame(self) -> int:
        """The frame to which it comes, counted on through resets; read from its last keyframe on."""
        start = self.start(_NEVER)
        return start.frame + _count_ticks(self.records(start))

    def require_beginning(self, who: str) -> None:
        """Refuses a recording that begins at a keyframe, on behalf of somebody who cannot take one up.

        Raises:
            RecordingError: It does (`unsupported`).
        """
        if self._first.snapshot is not None:
            begins = f"it begins at frame {self._first.frame}, in a running world of {self.config['backend']}"
            raise RecordingError("unsupported", f"{self.path} cannot be run on {who}: {begins}")

    def lineage(self, frame: int) -> dict[str, str]:
        """Returns what a recording that goes on from a frame of this one says of its parent (`nmes.parent`)."""
        start = self.start(frame)
        ticks, head = start.frame, start._chain.head

        def take(chain: Chain, block: Block) -> tuple[list[Record], bytes]:
            return chain.records(block), chain.head

        for _, (records, after) in self._walk(take, start):
            ticks, head = ticks + _count_ticks(records), after
            if ticks > frame:
                break
        return {"recording": self._head.hex(), "head": head.hex(), "frame": str(frame), "file": self.path.name}

    def summary(self) -> Summary:
        """Counts what is in the recording, by reading all of it."""
        result = Summary()
        for record in self:
            result._count(record)
        return result


def _count_ticks(records: Iterable[Record]) -> int:
    return sum(len(record.about["digests"]) for record in records if record.kind is Kind.TICKS and record.about)


@dataclass(frozen=True, slots=True)
class Start:
    """A place from which a recording can be read.

    Attributes:
        frame: Which frame it is, counted on through resets.
        snapshot: What the world is there; None: a new one.
    """

    frame: int
    snapshot: bytes | None
    _offset: int | None
    _chain: Chain

    @property
    def within(self) -> bool:
        """Whether something was recorded before it."""
        return self._offset is not None
