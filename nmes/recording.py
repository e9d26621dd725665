"""Recordings: one world's history written down as it happens, and read again.

A recording is an MCAP file (docs/recording-format.md) that holds a world's inputs in order: who came and went, every
frame that clients sent, every tick with its digest, and the replies. A `Recorder` is the journal of a live world; a
`Recording` reads such a file.

Invariants:

- File order is the order of the history, and a message's sequence number is its place in it.
- What a client sent is kept byte for byte. Passwords never get here: a client joins after it was authenticated.
- Recording does not change what a world does: it only asks for poses.
- A SHA-256 chain runs over the metadata and every chunk, each chunk ending with its head, so that no byte of the
  history can be changed, dropped or moved without breaking it. Checksums of the single records stand before the head:
  the chain shows whether a chunk is as it was written, they show which record is not.
- A reader returns what comes before the first damage, and says where and what that is. It never guesses beyond it.
"""

from __future__ import annotations

import os
import re
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import islice, zip_longest
from pathlib import Path
from typing import Any, TypeVar

import jsonschema_rs
import orjson
from mcap.records import Channel

from nmes import protocol
from nmes.errors import NmesError, RecordingError
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
from nmes.recorder import Recorder
from nmes.records import BOXES, END, FORMAT, PROFILE, REFUSED_LIMIT, SEQUENCE_MASK, Kind, Record, next_head
from nmes.schemas import load

__all__ = ["FORMAT", "PROFILE", "REFUSED_LIMIT", "Kind", "Record", "Recorder", "Recording", "Summary"]

_CLIENT_TOPIC = re.compile(r"client/(\d{1,9})/(commands|replies|refused)")
_CLIENT_KINDS = {"commands": Kind.COMMAND, "replies": Kind.REPLY, "refused": Kind.REFUSED}
_KINDS = {"clients": Kind.JOINED, "ticks": Kind.TICKS, "faults": Kind.FAULT, "/tf": Kind.POSES, "/scene": Kind.SCENE}
_SHAPES = {
    kind: jsonschema_rs.Draft202012Validator(load(f"recording/{topic}.json"))
    for topic, kind in _KINDS.items()
    if not topic.startswith("/")
}
_WRONG = (ValueError, KeyError, TypeError, IndexError)  # what a chunk that is not ours may lead to
_RECORD_START = struct.Struct("<BQ")
_LINK_SIZE = len('{"head":""}') + 64  # bytes of a message on `chain`
_Taken = TypeVar("_Taken")
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
        faults: How often the world stopped.
        began: Wall clock of the first record, ns since 1970; 0 when there is none.
        ended: The same of the last.
    """

    clients: int = 0
    commands: Counter[str] = field(default_factory=Counter)
    refused: int = 0
    errors: int = 0
    ticks: int = 0
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
        if written != FORMAT:
            raise RecordingError(
                "unknown_format", f"{path} is a recording of format {written}; this nmes reads format {FORMAT}"
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
        for _, records in self.chunks():
            yield from records

    def chunks(self) -> Iterator[tuple[int, list[Record]]]:
        """Yields the records in file order, a chunk at a time, with how far into the file (in bytes) that reaches."""
        return self._walk(_Chain.records)

    def _walk(self, take: Callable[[_Chain, Block], _Taken]) -> Iterator[tuple[int, _Taken]]:
        """Goes through the chunks, and notes where that ends."""
        chain = _Chain(self._head)
        end: dict[str, str] = {}
        try:
            for block in self._reader.blocks():
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
            self._damage = DamagedFile(error.offset, f"{error.message}{told}; {read}", cut=error.cut)
            self._damage.record = which
        self._checked = True

    def summary(self) -> Summary:
        """Counts what is in the recording, by reading all of it."""
        result = Summary()
        for record in self:
            result._count(record)
        return result


class _Chain:
    """Reads chunk after chunk, each of which must continue the hash chain and the count of those before it."""

    def __init__(self, head: bytes) -> None:
        self.head = head
        self.sequence = 0
        self._kinds: dict[int, tuple[Kind | None, int | None]] = {}  # by channel; None: not known to this version
        self._boxes: dict[int, str] = {}  # by channel: whose

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
            for number, other in zip(skim.sequences, expected, strict=True):
                if number != other:
                    raise ValueError(f"record {number} is out of its place")
            done = 0
            for before, channel in skim.definitions:
                self._check_shapes(content, skim, done, before)
                self._define(channel)
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

    def _define(self, channel: Channel) -> None:
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
                self._define(item)
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
