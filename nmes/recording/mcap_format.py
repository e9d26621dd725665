"""The bytes of an MCAP file that its reader and its writer share: records, the messages of a chunk, checksums.

MCAP is a container format (mcap.dev) with a Python package. That package's writer keeps a chunk in memory for as long
as it likes and its readers meet damage with whatever exception comes first; so here, and in `mcap_writer` and
`mcap_reader`, the container is written and read over that package's record types. Nothing of it knows of worlds:
topics, metadata and what the messages mean are in `channels`, `records` and `chain`.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from io import BytesIO
from typing import Any, NamedTuple, TypeVar

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, DataEnd, Header, McapRecord, Metadata, Schema

from nmes.errors import RecordingError

__all__ = [
    "FOOTER",
    "MAGIC",
    "MAX_PACKED",
    "MAX_RECORD",
    "MAX_RECORDS",
    "MESSAGE",
    "MESSAGE_FIELDS",
    "MESSAGE_OVERHEAD",
    "OPCODE_MESSAGE",
    "PREFIX",
    "DamagedFile",
    "Message",
    "Skim",
    "encode_definition",
    "encode_records",
    "message_checksums",
    "parse_record",
    "skim_chunk",
    "split_chunk",
]

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD = 256 << 20  # bytes; also of a chunk when unpacked
MAX_RECORDS = 1 << 18  # of a chunk: a reader holds some hundred bytes for each
MAX_PACKED = 128  # times: a chunk that packs better than that is not packed, so that a small file is read in no time
PREFIX = struct.Struct("<BQ")  # opcode, length of what follows
MESSAGE = struct.Struct("<BQHIQQ")  # the same, then channel, sequence, log time, publish time
FOOTER = struct.Struct("<BQQQI")  # opcode, length, start of the summary, of its offsets, checksum
OPCODE_MESSAGE = int(Opcode.MESSAGE)
MESSAGE_OVERHEAD = MESSAGE.size  # bytes of a message record beside its data
MESSAGE_FIELDS = MESSAGE.size - PREFIX.size
_SHORT = 4096  # bytes of a record that is kept when it was read: most chunks define the channels of others again

_Record = TypeVar("_Record", Header, Metadata, ChunkIndex, Channel, DataEnd, Schema)


class DamagedFile(RecordingError):
    """A file can no longer be read from some place on.

    Attributes:
        offset: Where in the file the first unreadable byte or record is.
        cut: Whether the file simply ends there, as it does when its writer was killed; everything before is whole.
        content: Of a chunk that does not match its checksum: what it holds all the same, if it could be unpacked.
        record: The number of the first message that is not as it was written, where that can be told.
    """

    def __init__(self, offset: int, message: str, *, cut: bool = False, content: bytes | None = None) -> None:
        """Makes an error about the byte at `offset`; the attributes are those of the class."""
        super().__init__("recording_cut" if cut else "recording_damaged", message)
        self.offset = offset
        self.cut = cut
        self.content = content
        self.record: int | None = None


class Message(NamedTuple):
    """One message of a channel; the times are in ns."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


def encode_records(*records: McapRecord) -> bytes:
    """Returns the bytes of records of the `mcap` package, one behind the other."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def encode_definition(record: Schema | Channel) -> bytes:
    """Returns the bytes of a schema or a channel; most of those of one file are in others, too, and are kept."""
    if isinstance(record, Schema):
        return _encode_once(Schema, record.id, record.name, record.encoding, record.data)
    about = record.id, record.topic, record.message_encoding, tuple(record.metadata.items()), record.schema_id
    return _encode_once(Channel, *about)


@lru_cache(maxsize=1024)
def _encode_once(kind: Any, *fields: Any) -> bytes:
    if kind is Channel:
        number, topic, encoding, metadata, schema = fields
        return encode_records(Channel(number, topic, encoding, dict(metadata), schema))
    number, name, encoding, data = fields
    return encode_records(Schema(id=number, name=name, encoding=encoding, data=data))


def parse_record(kind: type[_Record], body: bytes, offset: int) -> _Record:
    """Reads one of the `mcap` package's records from its body.

    Raises:
        DamagedFile: The bytes are no such record; `offset` is where it stands.
    """
    try:
        record: _Record = (_read_once if len(body) <= _SHORT else _read)(kind, body)
        return record
    except (McapError, ValueError, struct.error) as error:
        name = kind.__name__.lower()
        raise DamagedFile(offset, f"the {name} record at byte {offset} cannot be read") from error


def _read(kind: Any, body: bytes) -> Any:
    return kind.read(ReadDataStream(BytesIO(body)))


_read_once: Callable[[Any, bytes], Any] = lru_cache(maxsize=1024)(_read)  # nobody changes a record that was read


def split_chunk(content: bytes) -> Iterator[Message | Channel]:
    """Yields a chunk's messages and channels in order; the schemas are for other readers.

    Raises:
        ValueError: It does not consist of whole records.
    """
    position, size = 0, len(content)
    unpack, prefix, header = MESSAGE.unpack_from, PREFIX.size, MESSAGE.size
    while position < size:
        if content[position] == Opcode.MESSAGE and position + header <= size:
            _, length, channel, sequence, log_time, publish_time = unpack(content, position)
            end = position + prefix + length
            if length < header - prefix or end > size:
                raise ValueError("a message does not fit into its chunk")
            yield Message(channel, sequence, log_time, publish_time, content[position + header : end])
        else:
            if position + prefix > size:
                raise ValueError("a record does not fit into its chunk")
            opcode, length = PREFIX.unpack_from(content, position)
            end = position + prefix + length
            if end > size:
                raise ValueError("a record does not fit into its chunk")
            if opcode == Opcode.CHANNEL:
                yield parse_record(Channel, content[position + prefix : end], position)
        position = end


class Skim(NamedTuple):
    """The messages of a chunk as columns, their data not copied.

    Attributes:
        channels: The channel of each message, in order.
        sequences: The sequence number of each message.
        times: The log time of each message, ns.
        walls: The publish time of each message, ns.
        lengths: The length of each message's record in bytes, without its type and length.
        ends: Where each message's record ends in the chunk.
        definitions: The channels that are defined in it, each with how many messages stand before it.
        schemas: The schemas that are defined in it.
    """

    channels: Sequence[int]
    sequences: Sequence[int]
    times: Sequence[int]
    walls: Sequence[int]
    lengths: Sequence[int]
    ends: Sequence[int]
    definitions: list[tuple[int, Channel]]
    schemas: list[Schema]

    def data(self, content: bytes, number: int) -> bytes:
        """Returns the data of one of its messages."""
        end = self.ends[number]
        return content[end - self.lengths[number] + MESSAGE_FIELDS : end]

    def messages(self, content: bytes) -> Iterator[Message]:
        """Yields its messages."""
        spans = zip(self.lengths, self.ends, strict=True)
        data = (content[end - length + MESSAGE_FIELDS : end] for length, end in spans)
        return map(Message, self.channels, self.sequences, self.times, self.walls, data)


def skim_chunk(content: bytes) -> Skim:
    """Returns the columns of a chunk, many times faster than `split_chunk`.

    Raises:
        ValueError: It does not consist of whole messages, channels and schemas, or of too many.
    """
    records: list[tuple[int, int, int, int, int, int]] = []
    ends: list[int] = []
    # A chunk has thousands of messages. This loop does what must be done for each; the rest is done for all at once.
    add, end, unpack, prefix = records.append, ends.append, MESSAGE.unpack_from, PREFIX.size
    position, size = 0, len(content)
    try:
        for _ in range(MAX_RECORDS):
            if position >= size:
                break
            record = unpack(content, position)
            add(record)
            position += prefix + record[1]
            end(position)
    except struct.error:
        position = -1
    if position != size:
        raise ValueError("a record does not fit into its chunk")
    definitions: list[tuple[int, Channel]] = []
    schemas: list[Schema] = []
    columns = list(zip(*records, strict=True))
    if columns and columns[0].count(OPCODE_MESSAGE) < len(records):
        messages: list[tuple[tuple[int, int, int, int, int, int], int]] = []
        for record, stop in zip(records, ends, strict=True):
            opcode, body = record[0], content[stop - record[1] : stop]
            if opcode == OPCODE_MESSAGE:
                messages.append((record, stop))
            elif opcode == Opcode.CHANNEL:
                definitions.append((len(messages), parse_record(Channel, body, stop - record[1] - prefix)))
            elif opcode == Opcode.SCHEMA:
                schemas.append(parse_record(Schema, body, stop - record[1] - prefix))
            else:
                raise ValueError(f"a record of type {opcode} does not belong into a chunk")
        columns, ends = list(zip(*[record for record, _ in messages], strict=True)), [stop for _, stop in messages]
    if not columns:
        raise ValueError("it has no messages")
    _, lengths, channels, sequences, times, walls = columns
    if min(lengths) < MESSAGE_FIELDS:
        raise ValueError("a message does not fit into its chunk")
    return Skim(channels, sequences, times, walls, lengths, ends, definitions, schemas)


def message_checksums(content: bytes | bytearray) -> Iterator[int]:
    """Yields the CRC-32 of each of a chunk's message records, until something is no record."""
    position, size, view = 0, len(content), memoryview(content)
    while position + PREFIX.size <= size:
        opcode, length = PREFIX.unpack_from(content, position)
        end = position + PREFIX.size + length
        if end > size:
            return
        if opcode == OPCODE_MESSAGE:
            yield zlib.crc32(view[position:end])
        position = end
