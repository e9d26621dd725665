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

import hashlib
import os
import re
import struct
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum
from importlib.metadata import version
from itertools import islice, zip_longest
from pathlib import Path
from time import time_ns
from typing import Any, NamedTuple, NoReturn, TypeVar

import jsonschema_rs
import orjson
from mcap.records import Channel

from nmes import protocol, scene
from nmes.errors import NmesError, RecordingError
from nmes.fingerprint import fingerprint
from nmes.mcapfile import (
    MESSAGE_OVERHEAD,
    Block,
    DamagedFile,
    Message,
    Reader,
    Skim,
    Writer,
    message_checksums,
    skim_chunk,
    split_chunk,
)
from nmes.protocol import Request
from nmes.schemas import load
from nmes.world import World

__all__ = ["FORMAT", "PROFILE", "REFUSED_LIMIT", "Kind", "Record", "Recorder", "Recording", "Summary"]

PROFILE = "nmes"
FORMAT = "1"
REFUSED_LIMIT = 64 << 10  # bytes of a refused frame that are kept
_NS = 1_000_000_000
_FLUSH_SIZE = 256 << 10  # bytes of records: about as many as the processor's caches still hold
_MANY = 512  # notes
_LONG_RUN = 4096  # ticks
_NEVER = -1  # when a recorder flushed that cannot: the next record of any kind then tries to, and meets the error

# What a client's records are kept under until they are packed: 4 * client + one of these. Our own are negative.
_COMMAND, _REPLY, _REFUSED = 0, 1, 2
_TICKS, _CLIENTS, _FAULTS, _POSES, _SCENE, _CHAIN, _CHECKSUMS = -1, -2, -3, -4, -5, -6, -7
_VIEWS = {_POSES: scene.POSES_SCHEMA, _SCENE: scene.SCENE_SCHEMA}
_BOXES = "/boxes/"  # how the topic of a cube's box begins; its key is its name
_MANY_BOXES = 8192  # cubes; a channel each, of which a file has no more than 65,535
_TOPICS = {_TICKS: "ticks", _CLIENTS: "clients", _FAULTS: "faults", _POSES: "/tf", _SCENE: "/scene", _CHAIN: "chain"}
_END = "nmes.end"  # the metadata record that closes a file
_SEQUENCE_MASK = 0xFFFFFFFF  # MCAP's sequence numbers have 32 bits
_CLIENT_TOPICS = {_COMMAND: "commands", _REPLY: "replies", _REFUSED: "refused"}


class Kind(StrEnum):
    """What a record tells."""

    JOINED = "joined"
    LEFT = "left"
    COMMAND = "command"
    REFUSED = "refused"
    REPLY = "reply"
    TICKS = "ticks"
    FAULT = "fault"
    POSES = "poses"
    SCENE = "scene"
    BOX = "box"


class Record(NamedTuple):
    """One message of a recording.

    Attributes:
        kind: What it tells.
        sequence: Its place in the world's history.
        time: Simulation time in ns.
        wall: The recorder's clock, ns since 1970.
        client: Whom it is about, if anybody.
        data: Its bytes: verbatim for a command, a refused frame and a reply.
        about: What those of our own say (who came or went, ticks, faults): their JSON, as its schema says. Of a box,
            whose it is (`cube`). Else None.
    """

    kind: Kind
    sequence: int
    time: int
    wall: int
    client: int | None
    data: bytes
    about: dict[str, Any] | None = None


# -- writing --------------------------------------------------------------------------------------------------------


class _Channels(dict[int | str, int]):
    """The numbers of a file's channels by key; one is registered when it is first asked for."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schemas: dict[str, int] = {}

    def __missing__(self, key: int | str) -> int:
        if isinstance(key, str):
            channel = self._view(_BOXES + key, scene.BOX_SCHEMA)
        elif key >= 0:
            client, kind = divmod(key, 4)
            topic = f"client/{client}/{_CLIENT_TOPICS[kind]}"
            channel = (
                self._writer.channel(topic, "application/octet-stream")
                if kind == _REFUSED
                else self._writer.channel(topic, "json", self._schema("command" if kind == _COMMAND else "reply"))
            )
        elif key == _CHECKSUMS:
            channel = self._writer.channel("checksums", "application/octet-stream")
        elif key in _VIEWS:
            channel = self._view(_TOPICS[key], _VIEWS[key])
        else:
            channel = self._writer.channel(_TOPICS[key], "json", self._schema(_TOPICS[key]))
        self[key] = channel
        return channel

    def _view(self, topic: str, name: str) -> int:
        """Registers a channel for viewers."""
        if name not in self._schemas:
            self._schemas[name] = self._writer.schema(name, "protobuf", scene.descriptors(name))
        return self._writer.channel(topic, "protobuf", self._schemas[name])

    def _schema(self, name: str) -> int:
        if name not in self._schemas:
            match name:
                case "command" | "reply":
                    schema = protocol.bundled_schema(name)
                case _:
                    schema = load(f"recording/{name}.json")
            self._schemas[name] = self._writer.schema(f"nmes.{name}", "jsonschema", protocol.encode(schema))
        return self._schemas[name]


_Note = tuple[int, int, int, Any]  # key, frame, wall time; data, or a tick's digest, or a snapshot to draw


class Recorder:
    """Writes a world's history to a file; it becomes the world's journal with `world.journal = recorder`.

    What the journal is told is noted, and a few hundred notes at a time are made into records: code that has just run
    runs twice as fast. `flush` writes the records out. It happens when a second has gone by or 256 KiB are waiting; a
    host calls it too, for worlds in which nothing happens, and `commit` before it tells anybody anything. While the
    world is faulted, and after `close`, the file has its end and every MCAP reader can read it.

    Args:
        path: A file that does not exist yet.
        world: The world to record, new and empty.
        pose_rate: How often the poses are kept for viewers, in Hz of simulation time; 0 for never.
        flush_interval: For how long (s) a record may wait while others come in. With 0, `commit` waits for the disk.
        about: Further metadata records by name: what the run was for.

    Raises:
        RecordingError: The file cannot be created, or the world is not new. Every other method raises it when the
            file cannot be written (`recording_failed`), and from then on.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        world: World,
        *,
        pose_rate: float = 10.0,
        flush_interval: float = 1.0,
        about: Mapping[str, Mapping[str, str]] | None = None,
    ) -> None:
        if world.frame or world.cubes():
            raise RecordingError("recording_failed", "a recording begins with its world; this one has a past")
        self.path = Path(path)
        self._world = world
        self._rate: int = world.config["tick_rate"]
        self._pose_every = max(1, round(self._rate / pose_rate)) if pose_rate > 0 else 0
        self._painter = scene.Painter(world)
        self._boxed = 0  # how many cubes have a channel for their box
        self._writer = Writer(path, profile=PROFILE, library=f"nmes {version('nmes')}")
        self._channels = _Channels(self._writer)
        self._notes: list[_Note] = []
        self._run: list[bytes] = []  # digests of the ticks packed since the last record
        self._run_end = (0, 0)  # the frame and the wall time of the last of them
        self._frame = self._time = 0  # the last record's frame, and that in ns
        self._sequence = 0
        self._flushed = time_ns()
        self._durable = flush_interval == 0
        self._flush_after = _NS if self._durable else int(flush_interval * _NS)
        self._error: RecordingError | None = None
        try:
            metadata = {**_metadata(world), **(about or {})}
            begin = [self._writer.metadata(name, values) for name, values in metadata.items()]
            self._head = _next_head(b"", b"".join(begin))
        except RecordingError:
            self._writer.close()
            raise

    # -- the journal -----------------------------------------------------------------------------------------------

    def joined(self, client: int) -> None:
        """Records that a client came."""
        self._notes.append((_CLIENTS, self._world.frame, time_ns(), b'{"client":%d,"event":"joined"}' % client))
        self._pack()

    def left(self, client: int) -> None:
        """Records that a client went."""
        self._notes.append((_CLIENTS, self._world.frame, time_ns(), b'{"client":%d,"event":"left"}' % client))
        self._pack()

    # What happens for each command of each client is written for speed, and only notes.

    def received(self, client: int, request: Request) -> None:
        """Records a frame as it came; of a refused one no more than `REFUSED_LIMIT` bytes and a note."""
        key = 4 * client + (_COMMAND if request.error is None else _REFUSED)
        self._notes.append((key, self._world.frame, time_ns(), request.raw))

    def replied(self, client: int, request: Request, reply: bytes) -> None:
        """Records a reply."""
        wall = time_ns()
        self._notes.append((4 * client + _REPLY, self._world.frame, wall, reply))
        if not 0 <= wall - self._flushed < self._flush_after or len(self._notes) > _MANY:
            self._pack()

    def ticked(self, frame: int, digest: bytes) -> None:
        """Records a tick, and the poses when it is their turn."""
        wall = time_ns()
        self._notes.append((_TICKS, frame, wall, digest))
        if self._pose_every and frame % self._pose_every == 0:
            self._notes.append((_POSES, frame, wall, self._painter.look()))
        if not 0 <= wall - self._flushed < self._flush_after or len(self._notes) > _MANY:
            self._pack()

    def keyframe(self, snapshot: bytes) -> None:
        """The world was saved."""

    def faulted(self, frame: int, code: str, message: str) -> None:
        """Records that the world stopped, and gives the file its end."""
        what = orjson.dumps({"frame": frame, "code": code, "message": message})
        self._notes.append((_FAULTS, frame, time_ns(), what))
        self.flush()

    def _pack(self) -> None:
        """Makes records of what was noted, and flushes when it is time to."""
        if self._error is not None:
            raise self._error
        try:
            self._make_records()
        except RecordingError as error:
            self._fail(error)
        # The wall clock may be set back: that is a reason to flush, too.
        if len(self._writer.open_chunk) > _FLUSH_SIZE or not 0 <= time_ns() - self._flushed < self._flush_after:
            self.flush()

    def _make_records(self) -> None:
        notes, self._notes = self._notes, []
        for key, frame, wall, what in notes:
            if key == _TICKS:
                self._run.append(what)
                self._run_end = frame, wall
                continue
            if self._run:
                self._end_run()
            if key == _POSES:
                view = self._painter.draw(what)
                for name, box in view.boxes.items():
                    new = name not in self._channels
                    if not new or self._boxed < _MANY_BOXES:
                        self._boxed += new
                        self._add(name, frame, wall, box)
                if view.scene is not None:
                    self._add(_SCENE, frame, wall, view.scene)
                what = view.poses
            elif key & 3 == _REFUSED and key > 0 and len(what) > REFUSED_LIMIT:
                what = what[:REFUSED_LIMIT] + b"... (%d bytes in all)" % len(what)
            self._add(key, frame, wall, what)
        if len(self._run) > _LONG_RUN:
            self._end_run()

    def _end_run(self) -> None:
        """Makes a record of the ticks since the last one."""
        (frame, wall), digests = self._run_end, '","'.join([digest.hex() for digest in self._run])
        first = frame - len(self._run) + 1
        self._run = []
        self._add(_TICKS, frame, wall, f'{{"frame":{first},"digests":["{digests}"]}}'.encode())

    def _add(self, key: int | str, frame: int, wall: int, data: bytes) -> None:
        if frame != self._frame:
            self._frame, self._time = frame, (frame * _NS + self._rate // 2) // self._rate
        self._writer.add(self._channels[key], self._sequence & _SEQUENCE_MASK, self._time, wall, data)
        self._sequence += 1

    # -- the file --------------------------------------------------------------------------------------------------

    def flush(self) -> None:
        """Hands everything recorded so far to the operating system."""
        if self._error is not None:
            raise self._error
        self._flushed = time_ns()
        try:
            self._write_chunk()
            if self._world.fault is not None:
                self._seal()
        except RecordingError as error:
            self._fail(error)

    def commit(self) -> None:
        """Where the flush interval is 0: returns when all that was recorded so far is on disk. Else does nothing."""
        if self._durable:
            self.flush()
            try:
                self._writer.sync()
            except RecordingError as error:
                self._fail(error)

    def close(self) -> None:
        """Flushes and gives the file its end. A second time it does nothing.

        Raises:
            RecordingError: The end cannot be written; the file is closed all the same.
        """
        if self._error is None:
            try:
                self._write_chunk()
                self._seal()
                if self._durable:
                    self._writer.sync()
            except RecordingError as error:
                self._fail(error)
            self._error = RecordingError("recording_closed", f"the recording {self.path} is closed")
            self._flushed = _NEVER
            self._writer.close()

    def _fail(self, error: RecordingError) -> NoReturn:
        self._error = error
        self._flushed = _NEVER
        self._writer.close()
        raise error

    def _write_chunk(self) -> None:
        self._make_records()
        if self._run:
            self._end_run()
        if self._writer.open_chunk:
            # Both channels first, so that nothing stands between the two messages.
            ends = (self._channels[_CHECKSUMS], self._checksums), (self._channels[_CHAIN], self._link)
            for channel, describe in ends:
                self._writer.add(channel, self._sequence & _SEQUENCE_MASK, self._time, self._flushed, describe())
                self._sequence += 1
            self._writer.flush()

    def _checksums(self) -> bytes:
        sums = list(message_checksums(self._writer.open_chunk))
        return struct.pack(f"<{len(sums)}I", *sums)

    def _link(self) -> bytes:
        self._head = _next_head(self._head, self._writer.open_chunk)
        return b'{"head":"%s"}' % self._head.hex().encode()

    def _seal(self) -> None:
        end = {"head": self._head.hex(), "records": str(self._sequence), "closed": _now()}
        self._writer.seal(_END, end)


def _metadata(world: World) -> dict[str, dict[str, str]]:
    return {
        "nmes.recording": {
            "format": FORMAT,
            "nmes": version("nmes"),
            "protocol": str(protocol.PROTOCOL_VERSION),
            "schemas": protocol.schema_hash(),
            "created": _now(),
        },
        "nmes.world": {"config": protocol.encode(world.config).decode(), "seed": str(world.config["seed"])},
        "nmes.fingerprint": fingerprint(world.backend),
    }


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def _next_head(head: bytes, content: bytes | bytearray | memoryview) -> bytes:
    chain = hashlib.sha256(head)
    chain.update(content)
    return chain.digest()


# -- reading --------------------------------------------------------------------------------------------------------

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
                if block.metadata is None or block.metadata.name == _END:
                    break
                self.metadata[block.metadata.name] = block.metadata.metadata
                beginning += block.content
        except DamagedFile as error:
            reason = f": {error.message}"
        self._head = _next_head(b"", beginning)
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
                elif block.metadata.name == _END:
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
            expected = [number & _SEQUENCE_MASK for number in range(self.sequence, self.sequence + count)]
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
        head = _next_head(self.head, memoryview(content)[:-link])
        if orjson.loads(content[len(content) - link + MESSAGE_OVERHEAD :]) != {"head": head.hex()}:
            raise ValueError("it does not continue the hash chain")
        return head

    def _damage(self, block: Block, error: Exception) -> DamagedFile:
        message = f"the chunk at byte {block.offset} is not as it was recorded: {error}"
        return DamagedFile(block.offset, message, content=block.content)

    def _place(self, sequence: int, count: int) -> None:
        if sequence != (self.sequence + count) & _SEQUENCE_MASK:
            raise ValueError(f"record {sequence} is out of its place")

    def _define(self, channel: Channel) -> None:
        if match := _CLIENT_TOPIC.fullmatch(channel.topic):
            self._kinds[channel.id] = _CLIENT_KINDS[match[2]], int(match[1])
        elif channel.topic.startswith(_BOXES):
            self._kinds[channel.id] = Kind.BOX, None
            self._boxes[channel.id] = channel.topic.removeprefix(_BOXES)
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
