"""Recordings: one world's history written down as it happens, and read again.

A recording is an MCAP file (docs/recording-format.md) that holds a world's inputs in order: who came and went, every
frame that clients sent, every tick with its digest, and the replies. A `Recorder` is the journal of a live world; a
`Recording` reads such a file.

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
import re
import struct
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice, zip_longest
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import jsonschema_rs
import orjson
from mcap.records import Channel

from nmes import protocol
from nmes.backend import Array
from nmes.errors import NmesError, RecordingError, WorldError
from nmes.feeding import advance
from nmes.journal import Journal
from nmes.mcapfile import (
    MESSAGE_OVERHEAD,
    Block,
    DamagedFile,
    Message,
    Reader,
    Skim,
    message_checksums,
    skim_chunk,
    split_chunk,
)
from nmes.playback import watch
from nmes.recorder import Recorder
from nmes.records import (
    BOXES,
    END,
    FORMAT,
    FORMATS,
    KEYFRAMES,
    PROFILE,
    REFUSED_LIMIT,
    SEQUENCE_MASK,
    Kind,
    Record,
    next_head,
)
from nmes.schemas import load
from nmes.snapshot import ticks_of
from nmes.world import World

__all__ = [
    "FORMAT",
    "PROFILE",
    "REFUSED_LIMIT",
    "Kind",
    "Record",
    "Recorder",
    "Recording",
    "Start",
    "States",
    "Summary",
]

_CLIENT_TOPIC = re.compile(r"client/(\d{1,9})/(commands|replies|refused)")
_CLIENT_KINDS = {"commands": Kind.COMMAND, "replies": Kind.REPLY, "refused": Kind.REFUSED}
_KINDS = {"clients": Kind.JOINED, "ticks": Kind.TICKS, "faults": Kind.FAULT, "/tf": Kind.POSES, "/scene": Kind.SCENE}
_KINDS[KEYFRAMES] = Kind.KEYFRAME
_SHAPES = {
    kind: jsonschema_rs.Draft202012Validator(load(f"recording/{topic}.json"))
    for topic, kind in _KINDS.items()
    if not topic.startswith("/") and topic != KEYFRAMES
}
_WRONG = (ValueError, KeyError, TypeError, IndexError)  # what a chunk that is not ours may lead to
_RECORD_START = struct.Struct("<BQ")
_LINK_SIZE = len('{"head":""}') + 64  # bytes of a message on `chain`
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


class States(NamedTuple):
    """All cubes after one tick.

    Attributes:
        frame: The frame.
        time: Its simulation time, s.
        names: The cubes, in order of creation.
        values: An array (n, 13) of positions (m), quaternions, linear (m/s) and angular velocities (rad/s).
    """

    frame: int
    time: float
    names: list[str]
    values: Array


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
            for _ in self._walk(_Chain.check):
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
        return self._walk(_Chain.records, start)

    def _walk(
        self, take: Callable[[_Chain, Block], _Taken], start: Start | None = None
    ) -> Iterator[tuple[int, _Taken]]:
        """Goes through the chunks, and notes where that ends."""
        chain = _Chain(self._head) if start is None else start._chain.copy()
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
        chain, snapshot = _Chain(self._head), None
        try:
            block = next((block for block in self._reader.blocks() if block.metadata is None), None)
            if block is not None:
                snapshot = chain.copy().keyframe(block)
        except DamagedFile:
            pass  # whoever reads from here will be told
        return Start(0 if snapshot is None else ticks_of(snapshot), snapshot, None, chain)

    def _indexed(self, frame: int) -> Start | None:
        """Finds the last keyframe before a frame by the file's summary; None where that is of no use."""
        summary = self._reader.summary()
        if summary is None:
            return None
        chain = _Chain(self._head)
        for channel in summary.channels:
            chain.define(channel)
        channels = {channel.id for channel in summary.channels if channel.topic == KEYFRAMES}
        places = [i for i, (_, held) in enumerate(summary.chunks) if held & channels]

        def found(i: int) -> Start:
            block = self._reader.block(summary.chunks[i][0])
            snapshot = chain.keyframe(block)
            if snapshot is None:
                raise DamagedFile(block.offset, "the summary does not fit the chunks")
            return Start(ticks_of(snapshot), snapshot, block.offset, chain)

        try:
            count = bisect_right(places, frame, key=lambda i: found(i).frame)
            if count == 0:
                return None
            chain.follow(self._reader.block(summary.chunks[places[count - 1] - 1][0]) if places[count - 1] else None)
            return found(places[count - 1])
        except (DamagedFile, WorldError):
            return None  # what the file is like will come out when it is read from its beginning

    def _scanned(self, frame: int) -> Start | None:
        """Finds the last keyframe before a frame by reading all that comes before."""
        chain, best = _Chain(self._head), None
        try:
            for block in self._reader.blocks():
                if block.metadata is None:
                    before = chain.copy()
                    chain.check(block)
                    snapshot = chain.keyframe(block)
                    if snapshot is not None:
                        ticks = ticks_of(snapshot)
                        if ticks > frame:
                            break
                        best = Start(ticks, snapshot, block.offset, before)
        except (DamagedFile, WorldError):
            pass  # what comes before the damage is sound
        return best

    @property
    def last_frame(self) -> int:
        """The frame to which it comes, counted on through resets; read from its last keyframe on."""
        start = self.start(_NEVER)
        return start.frame + _count_ticks(self.records(start))

    def begin(self, start: Start, journal: Journal | None = None) -> World:
        """Makes the world that the recording has at a start, to be fed what follows.

        Raises:
            RecordingError: The keyframe is no snapshot of such a world (`recording_damaged`).
            BackendNotFound: The engine is not there.
        """
        world = World(self.config, journal=journal)
        try:
            self._restore(world, start)
        except RecordingError:
            world.close()
            raise
        return world

    def require_beginning(self, who: str) -> None:
        """Refuses a recording that begins at a keyframe, on behalf of somebody who cannot take one up.

        Raises:
            RecordingError: It does (`unsupported`).
        """
        if self._first.snapshot is not None:
            begins = f"it begins at frame {self._first.frame}, in a running world of {self.config['backend']}"
            raise RecordingError("unsupported", f"{self.path} cannot be run on {who}: {begins}")

    def _restore(self, world: World, start: Start) -> None:
        if start.snapshot is not None:
            try:
                world.restore(start.snapshot)
            except WorldError as error:
                raise RecordingError(
                    "recording_damaged", f"the keyframe at frame {start.frame} cannot be used: {error.message}"
                ) from error

    def world_at(self, frame: int | None = None) -> World:
        """Returns the world as it was at a frame: all that was sent then has acted, and the next tick is to come.

        It is alive and may be driven on, by its clients as they were then or by others. Within a `batch` that ticks, no
        more of it has acted than stands before the next tick.

        Args:
            frame: The frame, counted on through resets; None: where the recording ends.

        Raises:
            RecordingError: There is no such frame (`no_such_frame`), or a tick does not come out as recorded, as on
                another machine (`diverged`).
            BackendNotFound: The engine is not there.
        """
        world = World(self.config)
        try:
            self.bring(world, self.last_frame if frame is None else frame)
        except NmesError:
            world.close()
            raise
        return world

    def bring(self, world: World, frame: int) -> None:
        """Does the same with a new world of this recording's config. Nobody is told the events on the way.

        Raises:
            RecordingError: As `world_at`.
        """
        start = self.start(frame)
        emit, world.emit = world.emit, None
        self._restore(world, start)
        advance(world, self.records(start), frame)
        world.emit = emit
        if world.ticks != frame:
            raise RecordingError("no_such_frame", f"{self.path} ends at frame {world.ticks}; it has no frame {frame}")

    def states(self, *, anyway: bool = False) -> Iterator[States]:
        """Yields the states after each tick, made by running it again. After a `reset`, frames begin at 1 again.

        Args:
            anyway: Go on where a tick does not come out as it was recorded, as on another machine.

        Raises:
            RecordingError: The file cannot be read, or a tick does not come out as recorded (`diverged`).
            BackendNotFound: Its engine is not there.
        """
        return watch(self, lambda world: States(world.frame, world.time, *world.poses()), anyway=anyway)

    def lineage(self, frame: int) -> dict[str, str]:
        """Returns what a recording that goes on from a frame of this one says of its parent (`nmes.parent`)."""
        start = self.start(frame)
        ticks, head = start.frame, start._chain.head

        def take(chain: _Chain, block: Block) -> tuple[list[Record], bytes]:
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
    _chain: _Chain

    @property
    def within(self) -> bool:
        """Whether something was recorded before it."""
        return self._offset is not None


class _Chain:
    """Reads chunk after chunk, each of which must continue the hash chain and the count of those before it."""

    def __init__(self, head: bytes) -> None:
        self.head = head
        self.sequence = 0
        self._kinds: dict[int, tuple[Kind | None, int | None]] = {}  # by channel; None: not known to this version
        self._boxes: dict[int, str] = {}  # by channel: whose

    def copy(self) -> _Chain:
        """Returns one that stands at the same place."""
        other = _Chain(self.head)
        other.sequence, other._kinds, other._boxes = self.sequence, dict(self._kinds), dict(self._boxes)
        return other

    def follow(self, block: Block | None) -> None:
        """Takes its place behind a chunk, by what that says of itself; None: at the beginning."""
        if block is None:
            return
        try:
            *_, last = split_chunk(block.content)
            if not isinstance(last, Message):
                raise ValueError("its last record is no message")
            self.head = bytes.fromhex(orjson.loads(last.data)["head"])
            self.sequence = last.sequence + 1
        except _WRONG as error:
            raise self._damage(block, error) from error

    def keyframe(self, block: Block) -> bytes | None:
        """Returns the keyframe with which a chunk begins, if it does; no more of it is looked at.

        Raises:
            DamagedFile: It does not consist of records.
        """
        try:
            for item in split_chunk(block.content):
                if isinstance(item, Message):
                    return item.data if self._kinds[item.channel][0] is Kind.KEYFRAME else None
                self.define(item)
        except _WRONG as error:
            raise self._damage(block, error) from error
        return None

    def records(self, block: Block) -> list[Record]:
        """Returns the records of the next chunk.

        Raises:
            DamagedFile: It is not what the recorder wrote after the chunks before it.
        """
        try:
            messages = self._messages(block.content)
            head = self._next(block.content, MESSAGE_OVERHEAD + len(messages[-1].data))
            records = [record for record in map(self._record, messages) if record is not None]
        except _WRONG as error:
            raise self._damage(block, error) from error
        self.head = head
        self.sequence += len(messages)
        return records

    def check(self, block: Block) -> None:
        """Does as `records`, but makes none, which is many times faster."""
        content = block.content
        try:
            skim = skim_chunk(content)
            count = len(skim.sequences)
            expected = [number & SEQUENCE_MASK for number in range(self.sequence, self.sequence + count)]
            if list(skim.sequences) != expected:
                wrong = next(one for one, other in zip(skim.sequences, expected, strict=True) if one != other)
                raise ValueError(f"record {wrong} is out of its place")
            done = 0
            for before, channel in skim.definitions:
                self._check_shapes(content, skim, done, before)
                self.define(channel)
                done = before
            self._check_shapes(content, skim, done, count)
            head = self._next(content, MESSAGE_OVERHEAD + len(skim.data(content, count - 1)))
        except _WRONG as error:
            raise self._damage(block, error) from error
        self.head = head
        self.sequence += count

    def _check_shapes(self, content: bytes, skim: Skim, begin: int, end: int) -> None:
        """Checks messages of our own against their schemas; raises ValueError or, for an unknown channel, KeyError."""
        channels = skim.channels[begin:end]
        kinds = {channel: self._kinds[channel][0] for channel in set(channels)}
        ours = {channel: _SHAPES[kind] for channel, kind in kinds.items() if kind in _SHAPES}
        for number in [n for n, channel in enumerate(channels, begin) if channel in ours]:
            channel = channels[number - begin]
            if not ours[channel].is_valid(orjson.loads(skim.data(content, number))):
                raise ValueError(f"record {skim.sequences[number]} does not have the shape of {kinds[channel]}")

    def first_bad(self, content: bytes) -> int | None:
        """Returns the number of the next chunk's first record that does not match its checksum, if one does not.

        The content may be anything. The checksums are looked for from its end; where they are not found, nothing is
        known.
        """
        link = len(content) - MESSAGE_OVERHEAD - _LINK_SIZE
        for count in range(link // 4):
            start = link - MESSAGE_OVERHEAD - 4 * count
            if start < 0:
                break
            if content.startswith(_RECORD_START.pack(5, MESSAGE_OVERHEAD - 9 + 4 * count), start):
                expected = struct.unpack_from(f"<{count}I", content, start + MESSAGE_OVERHEAD)
                found = list(islice(message_checksums(content), count))
                for i, (one, other) in enumerate(zip_longest(expected, found)):
                    if one != other:
                        return self.sequence + i
                break
        return None

    def _next(self, content: bytes, link: int) -> bytes:
        """Returns the head that a chunk leads to, which the last `link` bytes of it must state."""
        head = next_head(self.head, memoryview(content)[:-link])
        if orjson.loads(content[len(content) - link + MESSAGE_OVERHEAD :]) != {"head": head.hex()}:
            raise ValueError("it does not continue the hash chain")
        return head

    def _damage(self, block: Block, error: Exception) -> DamagedFile:
        message = f"the chunk at byte {block.offset} is not as it was recorded: {error}"
        return DamagedFile(block.offset, message, content=block.content)

    def _place(self, sequence: int, count: int) -> None:
        if sequence != (self.sequence + count) & SEQUENCE_MASK:
            raise ValueError(f"record {sequence} is out of its place")

    def define(self, channel: Channel) -> None:
        """Takes note of what a channel is for."""
        if match := _CLIENT_TOPIC.fullmatch(channel.topic):
            self._kinds[channel.id] = _CLIENT_KINDS[match[2]], int(match[1])
        elif channel.topic.startswith(BOXES):
            self._kinds[channel.id] = Kind.BOX, None
            self._boxes[channel.id] = channel.topic.removeprefix(BOXES)
        else:
            self._kinds[channel.id] = _KINDS.get(channel.topic), None

    def _messages(self, content: bytes) -> list[Message]:
        messages: list[Message] = []
        for item in split_chunk(content):
            if isinstance(item, Message):
                self._place(item.sequence, len(messages))
                messages.append(item)
            else:
                self.define(item)
        return messages

    def _record(self, message: Message) -> Record | None:
        number, sequence, log_time, publish_time, data = message
        kind, client = self._kinds[number]
        if kind is None:
            return None
        shape = _SHAPES.get(kind)
        if kind is Kind.BOX:
            return Record(kind, sequence, log_time, publish_time, None, data, {"cube": self._boxes[number]})
        if shape is None:
            return Record(kind, sequence, log_time, publish_time, client, data)
        about = orjson.loads(data)
        if not shape.is_valid(about):
            raise ValueError(f"record {sequence} does not have the shape of {kind}")
        if kind is Kind.JOINED:  # stands for its channel, on which clients leave too
            kind, client = Kind(about["event"]), about["client"]
        return Record(kind, sequence, log_time, publish_time, client, data, about)
