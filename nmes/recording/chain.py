"""The hash chain of a recording: chunks become records, each continuing those before it.

It hides which channel has which kind of records, where the checksums of single records stand, and how a chunk ends.
"""

from __future__ import annotations

import re
import struct
from itertools import islice, zip_longest
from typing import Any

import jsonschema_rs
import orjson
from mcap.records import Channel

from nmes.errors import RecordingError
from nmes.recording.mcap_format import (
    MAX_RECORDS,
    MESSAGE_OVERHEAD,
    DamagedFile,
    Message,
    Skim,
    message_checksums,
    split_chunk,
)
from nmes.recording.mcap_reader import Block
from nmes.recording.records import BOXES, KEYFRAMES, SEQUENCE_MASK, Kind, Record, next_head, who_said
from nmes.schemas import load

__all__ = ["Chain", "ticks_before"]

_CLIENT_TOPIC = re.compile(r"client/(\d{1,9})/(commands|replies|refused)")  # until version 3 of the format
_CLIENT_KINDS = {"commands": Kind.COMMAND, "replies": Kind.REPLY, "refused": Kind.REFUSED}
_KINDS = {"clients": Kind.JOINED, "ticks": Kind.TICKS, "faults": Kind.FAULT, "/tf": Kind.POSES, "/scene": Kind.SCENE}
_SAID = (Kind.COMMAND, Kind.REPLY)
_KINDS |= {KEYFRAMES: Kind.KEYFRAME, "life": Kind.LIFE, "hibernation": Kind.HIBERNATED}
_SHAPES = {
    kind: jsonschema_rs.Draft202012Validator(load(f"recording/{topic}.json"))
    for topic, kind in _KINDS.items()
    if not topic.startswith("/") and topic != KEYFRAMES
}
_WRONG = (ValueError, KeyError, TypeError, IndexError)  # the errors that the bytes of a damaged chunk may lead to
_KEYFRAME = jsonschema_rs.Draft202012Validator(load("recording/keyframes.json"))
_SNAPSHOT_VERSION = 1
_LONGEST = 1 << 20  # bytes of the JSON of a record of our own that is not a keyframe
_LONGEST_KEYFRAME = 64 << 20  # bytes of the line of JSON with which one begins
_RECORD_START = struct.Struct("<BQ")
_LINK_SIZE = len('{"head":""}') + 64  # bytes of a message on `chain`


class Chain:
    """Reads chunk after chunk, each of which must continue the hash chain and the counts of those before it.

    Attributes:
        head: The head of the chain so far.
        sequence: How many messages there were.
        ticks: How many ticks there were, over all resets; None where that is not known.
    """

    def __init__(self, head: bytes) -> None:
        self.head = head
        self.sequence = 0
        self.ticks: int | None = 0
        self._kinds: dict[int, tuple[Kind | None, int | None]] = {}  # by channel; None: not known to this version
        self._boxes: dict[int, str] = {}  # by channel: the name of the cube
        self._topics: dict[int, str] = {}

    def copy(self) -> Chain:
        """Makes a chain that stands at the same place."""
        other = Chain(self.head)
        other.sequence, other.ticks = self.sequence, self.ticks
        other._kinds, other._boxes = dict(self._kinds), dict(self._boxes)
        other._topics = dict(self._topics)
        return other

    def follow(self, block: Block) -> None:
        """Goes on behind a chunk, whose own head and count are believed.

        What channels there are and how many ticks there were is not known then: a keyframe says so again.

        Raises:
            DamagedFile: The chunk does not end with a head.
        """
        try:
            *_, last = split_chunk(block.content)
            if not isinstance(last, Message):
                raise ValueError("its last record is no message")
            self.head = bytes.fromhex(orjson.loads(last.data)["head"])
            self.sequence, self.ticks = last.sequence + 1, None
        except _WRONG as error:
            raise self._damage(block, error) from error

    def keyframe(self, block: Block) -> bytes | None:
        """Returns the snapshot with which a chunk begins; None where it begins otherwise. The rest of it is not read.

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
            DamagedFile: The chunk does not go on from those before it, or its records do not have their shape.
        """
        try:
            skim = self._in_place(block)
            for _, channel in skim.definitions:
                self.define(channel)
            messages = list(skim.messages(block.content))
            head = self._next(block.content, MESSAGE_OVERHEAD + len(messages[-1].data))
            records = [record for record in map(self._record, messages) if record is not None]
        except _WRONG as error:
            raise self._damage(block, error) from error
        self.head = head
        self.sequence += len(messages)
        return records

    def check(self, block: Block) -> None:
        """Checks the next chunk as `records` does, but makes no records, which is many times faster."""
        content = block.content
        try:
            skim = self._in_place(block)
            count, done = len(skim.sequences), 0
            for before, channel in skim.definitions:
                if done < before:
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
        ours = {channel for channel, kind in kinds.items() if kind in _SHAPES or kind is Kind.KEYFRAME}
        for number in [n for n, channel in enumerate(channels, begin) if channel in ours]:
            kind = kinds[channels[number - begin]]
            if kind is not None:
                self._own(kind, skim.sequences[number], skim.data(content, number))

    def first_bad(self, content: bytes) -> int | None:
        """Finds the first record of the next chunk that does not match its checksum, and returns its number.

        The content may be any bytes. The checksums are searched from its end; None where there are none, or all match.
        """
        link = len(content) - MESSAGE_OVERHEAD - _LINK_SIZE
        for count in range(min(link // 4, MAX_RECORDS)):
            start = link - MESSAGE_OVERHEAD - 4 * count
            if start < 0:
                break
            if content.startswith(_RECORD_START.pack(5, MESSAGE_OVERHEAD - 9 + 4 * count), start):
                expected = struct.unpack_from(f"<{count}I", content, start + MESSAGE_OVERHEAD)
                actual = islice(message_checksums(content), count)
                for i, (one, other) in enumerate(zip_longest(expected, actual)):
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

    def _in_place(self, block: Block) -> Skim:
        """Returns the messages of the next chunk; raises ValueError unless they are numbered on from those before."""
        if block.skim is None:
            raise ValueError("it is no chunk")
        sequences = block.skim.sequences
        expected = [number & SEQUENCE_MASK for number in range(self.sequence, self.sequence + len(sequences))]
        if list(sequences) != expected:
            wrong = next(one for one, other in zip(sequences, expected, strict=True) if one != other)
            raise ValueError(f"record {wrong} is out of its place")
        return block.skim

    def define(self, channel: Channel) -> None:
        """Learns the kind of records that a channel has, and whose they are, from its topic.

        Raises:
            ValueError: It was another channel's number.
        """
        if self._topics.setdefault(channel.id, channel.topic) != channel.topic:
            raise ValueError(f"channel {channel.id} is defined in two ways")
        if channel.id in self._kinds:  # most chunks with keyframes define all channels again
            return
        if match := _CLIENT_TOPIC.fullmatch(channel.topic):
            self._kinds[channel.id] = _CLIENT_KINDS[match[2]], int(match[1])
        elif channel.topic.startswith(BOXES):
            self._kinds[channel.id] = Kind.BOX, None
            self._boxes[channel.id] = channel.topic.removeprefix(BOXES)
        else:
            self._kinds[channel.id] = {**_KINDS, **_CLIENT_KINDS}.get(channel.topic), None

    def _record(self, message: Message) -> Record | None:
        number, sequence, log_time, publish_time, data = message
        kind, client = self._kinds[number]
        if kind is None:
            return None
        if kind is Kind.BOX:
            return Record(kind, sequence, log_time, publish_time, None, data, {"cube": self._boxes[number]})
        if client is None and kind in _SAID:
            client, data = who_said(data)
        elif client is None and kind is Kind.REFUSED:
            client, data = int.from_bytes(data[:4], "little"), data[4:]
        about = self._own(kind, sequence, data) if kind in _SHAPES or kind is Kind.KEYFRAME else None
        if about is None:
            return Record(kind, sequence, log_time, publish_time, client, data)
        if kind is Kind.JOINED:  # stands for its channel, on which clients leave too
            kind, client = Kind(about["event"]), about["client"]
        return Record(kind, sequence, log_time, publish_time, client, data, about)

    def _own(self, kind: Kind, sequence: int, data: bytes) -> dict[str, Any] | None:
        """Checks a record of the recorder's own.

        Returns:
            Its JSON; None of a keyframe.

        Raises:
            ValueError: It does not have its shape, or does not go on from those before it.
        """
        if kind is Kind.KEYFRAME:
            ticks = ticks_before(data)
            begins = self.ticks is None or sequence == self.sequence == 0
            if not begins and ticks != self.ticks:
                raise ValueError(f"the keyframe in record {sequence} is of tick {ticks}, not of {self.ticks}")
            self.ticks = ticks
            return None
        about: Any = orjson.loads(data) if len(data) <= _LONGEST else None
        if not _SHAPES[kind].is_valid(about):
            raise ValueError(f"record {sequence} does not have the shape of {kind}")
        if kind is Kind.TICKS and self.ticks is not None:
            self.ticks += len(about["digests"])
        return dict(about)


def ticks_before(snapshot: bytes) -> int:
    """Counts the ticks before a keyframe, by the line of JSON with which its snapshot begins.

    Raises:
        RecordingError: It is one of a newer version (`unknown_format`).
        ValueError: It is no snapshot of a world.
    """
    end = snapshot.find(b"\n", 0, _LONGEST_KEYFRAME)
    try:
        state: Any = orjson.loads(snapshot[:end]) if end >= 0 else None
    except ValueError:
        state = None
    version = state.get("version") if isinstance(state, dict) else None
    if isinstance(version, int) and version > _SNAPSHOT_VERSION:
        text = f"a keyframe has a snapshot of version {version}; this nmes knows version {_SNAPSHOT_VERSION}"
        raise RecordingError("unknown_format", text)
    if not _KEYFRAME.is_valid(state):
        raise ValueError("a keyframe is no snapshot of a world")
    return int(state["ticks"])
