"""MCAP files: written so that a crash costs one chunk at most, read so that damage costs no more than it must.

The `mcap` package's writer keeps a chunk in memory for as long as it likes and its readers meet damage with whatever
exception comes first. This module hides the container behind two small classes over that package's record types. It
knows nothing of worlds: topics, metadata and what the messages mean are `nmes.recording`'s.

Invariants of a written file:

- What `flush` wrote stays as it is: later flushes append. `seal` writes the end (summary, footer) that ordinary MCAP
  readers ask for behind it; the next flush removes that end again and goes on.
- Every message lies in a chunk, and every chunk is followed by one message index for each channel in it.
- Every byte of a sealed file is covered by a checksum: chunk, data section and summary.

Invariants of reading: no length that a file states is believed before it was compared with the bytes that are there,
no more than `MAX_RECORD` bytes are held for one record, and whatever is wrong ends in `DamagedFile`.
"""

from __future__ import annotations

import os
import stat
import struct
import sys
import zlib
from array import array
from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple, TypeVar

import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from nmes.errors import RecordingError

__all__ = [
    "MAGIC",
    "MAX_RECORD",
    "MESSAGE_OVERHEAD",
    "Block",
    "DamagedFile",
    "Message",
    "Reader",
    "Skim",
    "Summary",
    "Writer",
    "message_checksums",
    "skim_chunk",
    "split_chunk",
]

MAGIC = b"\x89MCAP0\r\n"
MAX_CHANNELS = 0xFFFF
MAX_RECORD = 256 << 20  # bytes; also of a chunk when unpacked
_PREFIX = struct.Struct("<BQ")  # opcode, length of what follows
_MESSAGE = struct.Struct("<BQHIQQ")  # the same, then channel, sequence, log time, publish time
_SKIMMED = struct.Struct("<BQHI")  # as much of it as tells whose it is
_INDEX = struct.Struct("<BQHI")  # opcode, length, channel, bytes of entries
_OPCODE_MESSAGE = int(Opcode.MESSAGE)
MESSAGE_OVERHEAD = _MESSAGE.size  # bytes of a message record beside its data
_MESSAGE_FIELDS = _MESSAGE.size - _PREFIX.size
_CHUNK = struct.Struct("<QQQII")  # of its body: times, size, checksum, length of the compression's name, which follows
_LENGTH = struct.Struct("<Q")
_FOOTER = struct.Struct("<BQQQI")  # opcode, length, start of the summary, of its offsets, checksum
_LEVEL = 1  # of zstd: digests do not compress, and what does is already small at the fastest level

_Record = TypeVar("_Record", Header, Metadata, ChunkIndex, Channel, DataEnd)


class Message(NamedTuple):
    """One message of a channel; the times are in ns."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


class DamagedFile(RecordingError):
    """The place where a file can no longer be read.

    Attributes:
        offset: Where in the file the first unreadable byte or record is.
        cut: Whether the file simply ends there, as it does when its writer was killed; everything before is whole.
        content: Of a chunk that does not match its checksum: what it holds all the same, if it could be unpacked.
        record: The number of the first message that is not as it was written, where that can be told.
    """

    def __init__(self, offset: int, message: str, *, cut: bool = False, content: bytes | None = None) -> None:
        """Takes the place and what is wrong there."""
        super().__init__("recording_cut" if cut else "recording_damaged", message)
        self.offset = offset
        self.cut = cut
        self.content = content
        self.record: int | None = None


def _encoded(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


class Writer:
    """Writes one file. Every failure of the operating system becomes a RecordingError (`recording_failed`).

    Messages, schemas and channels gather in an open chunk until `flush`. There is no thread and no timer in here.

    Attributes:
        open_chunk: What the open chunk holds so far, for others to look at.
    """

    def __init__(self, path: str | os.PathLike[str], *, profile: str, library: str) -> None:
        """Creates the file; one that exists already is never overwritten."""
        self.path = Path(path)
        try:
            self._file = open(self.path, "xb", buffering=0)
        except FileExistsError:
            raise RecordingError("recording_failed", f"{self.path} exists already") from None
        except OSError as error:
            raise RecordingError("recording_failed", f"cannot create {self.path}: {error.strerror}") from error
        self._compressor = zstandard.ZstdCompressor(level=_LEVEL)
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._metadata: list[MetadataIndex] = []
        self._chunks: list[ChunkIndex] = []
        self._counts: dict[int, int] = {}
        self.open_chunk = bytearray()
        self._index: dict[int, array[int]] = {}  # its messages by channel: log time, offset, log time, offset...
        self._end = 0  # where the data section ends so far, and its checksum
        self._crc = 0
        self._sealed = False
        self._synced = 0  # how much was written when the disk last had all of it; and how much has been
        self._written = 0
        self._append(MAGIC + _encoded(Header(profile=profile, library=library)))

    @property
    def size(self) -> int:
        """Bytes in the file, the end that `seal` wrote not counted."""
        return self._end

    def metadata(self, name: str, values: Mapping[str, str]) -> bytes:
        """Writes a metadata record at once (ahead of the open chunk) and returns its bytes."""
        record = _encoded(Metadata(name=name, metadata=dict(values)))
        self._metadata.append(MetadataIndex(offset=self._end, length=len(record), name=name))
        self._append(record)
        return record

    def schema(self, name: str, encoding: str, data: bytes) -> int:
        """Adds a schema to the open chunk and returns its number."""
        schema = Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        self._schemas.append(schema)
        self._add_definition(schema)
        return schema.id

    def channel(self, topic: str, encoding: str, schema: int = 0) -> int:
        """Adds a channel to the open chunk and returns its number."""
        channel = Channel(
            id=len(self._channels) + 1, topic=topic, message_encoding=encoding, schema_id=schema, metadata={}
        )
        if channel.id > MAX_CHANNELS:
            raise RecordingError("recording_failed", f"a file holds at most {MAX_CHANNELS:,} channels; begin a new one")
        self._channels.append(channel)
        self._counts[channel.id] = 0
        self._add_definition(channel)
        return channel.id

    def add(self, channel: int, sequence: int, log_time: int, publish_time: int, data: bytes) -> None:
        """Adds a message to the open chunk; the fields are those of `Message`."""
        # The hot path of every recording. The message is packed at once, while it is in the processor's caches, and
        # nothing of it is kept but bytes.
        chunk = self.open_chunk
        index = self._index.get(channel)
        if index is None:
            index = self._index[channel] = array("Q")
        index.append(log_time)
        index.append(len(chunk))
        chunk += _MESSAGE.pack(_OPCODE_MESSAGE, len(data) + _MESSAGE_FIELDS, channel, sequence, log_time, publish_time)
        chunk += data

    def flush(self) -> None:
        """Hands the open chunk to the operating system; nothing to do when it has no message."""
        if not self._index:
            return
        content = self.open_chunk
        if len(content) > MAX_RECORD:
            raise RecordingError("recording_failed", f"a chunk of {len(content)} bytes is more than a reader takes")
        first = min(min(entries[::2]) for entries in self._index.values())
        last = max(max(entries[::2]) for entries in self._index.values())
        compressed = self._compressor.compress(content)
        chunk = _encoded(
            Chunk(
                message_start_time=first,
                message_end_time=last,
                uncompressed_size=len(content),
                uncompressed_crc=zlib.crc32(content),
                compression="zstd",
                data=compressed,
            )
        )
        indexes: list[bytes] = []
        offsets: dict[int, int] = {}
        index_length = 0
        for channel, entries in self._index.items():
            offsets[channel] = self._end + len(chunk) + index_length
            size = 8 * len(entries)
            if sys.byteorder == "big":  # pragma: no cover - MCAP is little-endian
                entries.byteswap()
            indexes.append(_INDEX.pack(Opcode.MESSAGE_INDEX, size + 6, channel, size) + entries.tobytes())
            index_length += len(indexes[-1])
        written = ChunkIndex(
            message_start_time=first,
            message_end_time=last,
            chunk_start_offset=self._end,
            chunk_length=len(chunk),
            message_index_offsets=offsets,
            message_index_length=index_length,
            compression="zstd",
            compressed_size=len(compressed),
            uncompressed_size=len(content),
        )
        self._append(b"".join((chunk, *indexes)))
        self._chunks.append(written)
        for channel, entries in self._index.items():
            self._counts[channel] += len(entries) // 2
        self.open_chunk, self._index = bytearray(), {}

    def seal(self, name: str, values: Mapping[str, str]) -> None:
        """Flushes, then writes one last metadata record and the file's end, so that every MCAP reader can read it."""
        self.flush()
        self._unseal()
        last = _encoded(Metadata(name=name, metadata=dict(values)))
        indexes = [*self._metadata, MetadataIndex(offset=self._end, length=len(last), name=name)]
        data_end = _encoded(DataEnd(data_section_crc=zlib.crc32(last, self._crc)))
        statistics = Statistics(
            message_count=sum(self._counts.values()),
            schema_count=len(self._schemas),
            channel_count=len(self._channels),
            attachment_count=0,
            metadata_count=len(indexes),
            chunk_count=len(self._chunks),
            message_start_time=min((chunk.message_start_time for chunk in self._chunks), default=0),
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            channel_message_counts=self._counts,
        )
        start = offset = self._end + len(last) + len(data_end)
        groups: list[bytes] = []
        offsets: list[SummaryOffset] = []
        for opcode, records in (
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.METADATA_INDEX, indexes),
        ):
            group = _encoded(*records)
            if group:
                groups.append(group)
                offsets.append(SummaryOffset(group_opcode=opcode, group_start=offset, group_length=len(group)))
                offset += len(group)
        summary = b"".join((*groups, _encoded(*offsets)))
        # The summary's checksum covers the footer too, up to the checksum itself.
        footer = _FOOTER.pack(Opcode.FOOTER, _FOOTER.size - _PREFIX.size, start, offset, 0)[:-4]
        crc = struct.pack("<I", zlib.crc32(footer, zlib.crc32(summary)))
        self._write(b"".join((last, data_end, summary, footer, crc, MAGIC)))
        self._sealed = True

    def sync(self) -> None:
        """Waits until the disk has what was written, and the first time until the folder has the file."""
        try:
            if self._written != self._synced:
                os.fsync(self._file.fileno())
                if not self._synced and hasattr(os, "O_DIRECTORY"):
                    folder = os.open(self.path.parent, os.O_RDONLY | os.O_DIRECTORY)
                    try:
                        os.fsync(folder)
                    finally:
                        os.close(folder)
                self._synced = self._written
        except OSError as error:
            raise self._failure(error) from error

    def close(self) -> None:
        """Closes the file as it is: without `seal` it stays without an end."""
        self._file.close()

    def _add_definition(self, record: Schema | Channel) -> None:
        self.open_chunk += _encoded(record)

    def _append(self, data: bytes) -> None:
        self._unseal()
        self._write(data)
        self._end += len(data)
        self._crc = zlib.crc32(data, self._crc)

    def _unseal(self) -> None:
        if self._sealed:
            try:
                self._file.seek(self._end)
                self._file.truncate()
            except OSError as error:
                raise self._failure(error) from error
            self._sealed = False

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
            self._written += len(data)
        except OSError as error:
            raise self._failure(error) from error

    def _failure(self, error: OSError) -> RecordingError:
        return RecordingError("recording_failed", f"cannot write {self.path}: {error.strerror}")


class Block(NamedTuple):
    """A part of a file's data section.

    Attributes:
        offset: Where its record begins.
        size: How many bytes that takes up in the file.
        metadata: The metadata record that it is, or None for a chunk.
        content: A chunk's records, unpacked, or the bytes of the metadata record.
    """

    offset: int
    size: int
    metadata: Metadata | None
    content: bytes


class Summary(NamedTuple):
    """What a file that has its end says of itself there.

    Attributes:
        channels: All channels.
        chunks: Of each chunk, in file order, where it begins and which channels have messages in it.
    """

    channels: list[Channel]
    chunks: list[tuple[int, frozenset[int]]]


class Reader:
    """Reads one file from its beginning, in file order, believing nothing.

    Attributes:
        size: Of the file in bytes when it was opened; what is appended later is not read.
        profile: The profile that the header states.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Reads the header.

        Raises:
            RecordingError: It cannot be opened, or it is no MCAP file.
        """
        self.path = Path(path)
        try:
            # Opening a pipe or a device could wait for ever.
            if not stat.S_ISREG(os.stat(self.path).st_mode):
                raise RecordingError("not_a_recording", f"{self.path} is not a regular file")
            with open(self.path, "rb") as file:
                self.size = os.fstat(file.fileno()).st_size
                start = file.read(len(MAGIC))
                if start != MAGIC:
                    what = "empty" if not start else "cut short" if MAGIC.startswith(start) else "no MCAP file"
                    raise RecordingError("not_a_recording", f"{self.path} is not a recording: it is {what}")
                opcode, body = self._record(file, len(MAGIC))
                if opcode != Opcode.HEADER:
                    raise DamagedFile(len(MAGIC), "it does not begin with a header")
                self.profile = _parsed(Header, body, len(MAGIC)).profile
                self._start = file.tell()
        except DamagedFile as error:
            raise RecordingError("not_a_recording", f"{self.path} is not a recording: {error}") from error
        except OSError as error:
            raise RecordingError("recording_unreadable", f"cannot read {self.path}: {error.strerror}") from error

    def summary(self) -> Summary | None:
        """Returns the file's summary, or None where there is no sound one. What it says of the rest is not checked."""
        try:
            with open(self.path, "rb") as file:
                end = _FOOTER.size + len(MAGIC)
                file.seek(max(self.size - end, 0))
                tail = file.read(end)
                start = _FOOTER.unpack_from(tail)[2] if len(tail) == end else self.size
                if start >= self.size:
                    return None
                file.seek(start)
                self._check_end(file, start)
                return self._summary(file, start)
        except (DamagedFile, OSError):
            return None

    def _summary(self, file: BinaryIO, offset: int) -> Summary:
        summary = Summary([], [])
        file.seek(offset)
        while True:
            opcode, body = self._record(file, offset)
            if opcode == Opcode.FOOTER:
                return summary
            if opcode == Opcode.CHANNEL:
                summary.channels.append(_parsed(Channel, body, offset))
            elif opcode == Opcode.CHUNK_INDEX:
                index = _parsed(ChunkIndex, body, offset)
                summary.chunks.append((index.chunk_start_offset, frozenset(index.message_index_offsets)))
            offset += _PREFIX.size + len(body)

    def blocks(self, start: int | None = None) -> Iterator[Block]:
        """Yields metadata and chunks in file order; ends when the whole file was read and is sound.

        Args:
            start: Where the first of them begins; None: at the beginning. What stands before is not read, and so the
                checksum over all of the data section not checked.

        Raises:
            DamagedFile: Where the file is cut or damaged.
        """
        try:
            with open(self.path, "rb") as file:
                yield from self._blocks(file, start)
        except OSError as error:
            raise DamagedFile(0, f"{self.path} can no longer be read: {error.strerror}") from error

    def block(self, offset: int) -> Block:
        """Returns the chunk or metadata that begins at `offset`.

        Raises:
            DamagedFile: It is cut or damaged.
        """
        for block in self.blocks(offset):
            if block.offset == offset:
                return block
            break
        raise DamagedFile(offset, f"no chunk begins at byte {offset}")

    def _blocks(self, file: BinaryIO, start: int | None) -> Iterator[Block]:
        decompressor = zstandard.ZstdDecompressor()  # as costly to make as a small chunk is to unpack
        offset = self._start if start is None else start
        crc = zlib.crc32(file.read(self._start))
        file.seek(offset)
        while True:
            opcode, body = self._record(file, offset)
            if opcode == Opcode.DATA_END:
                if _parsed(DataEnd, body, offset).data_section_crc != crc and start is None:
                    raise DamagedFile(offset, "the checksum of the data section does not match")
                break
            size = _PREFIX.size + len(body)
            if opcode == Opcode.METADATA:
                yield Block(offset, size, _parsed(Metadata, body, offset), _PREFIX.pack(opcode, len(body)) + body)
            elif opcode == Opcode.CHUNK:
                yield Block(offset, size, None, _unpacked(body, decompressor, offset))
            elif opcode != Opcode.MESSAGE_INDEX:
                raise DamagedFile(offset, f"a record of type {opcode} at byte {offset} does not belong there")
            if start is None:
                crc = zlib.crc32(body, zlib.crc32(_PREFIX.pack(opcode, len(body)), crc))
            offset += size
        self._check_end(file, file.tell())

    def _check_end(self, file: BinaryIO, offset: int) -> None:
        """Checks the summary, from `offset` to the end of the file."""
        if self.size - offset > MAX_RECORD:
            raise DamagedFile(offset, f"the summary at byte {offset} is too long")
        end = file.read(self.size - offset)
        footer = len(end) - _FOOTER.size - len(MAGIC)
        if footer < 0 or not end.endswith(MAGIC):
            raise DamagedFile(offset, f"the file ends in its summary, at byte {offset + len(end)}", cut=True)
        opcode, length, start, _, crc = _FOOTER.unpack_from(end, footer)
        if (opcode, length) != (Opcode.FOOTER, _FOOTER.size - _PREFIX.size) or start != offset:
            raise DamagedFile(offset + footer, "the footer is damaged")
        if crc != zlib.crc32(end[: footer + _FOOTER.size - 4]):
            raise DamagedFile(offset, "the checksum of the summary does not match")

    def _record(self, file: BinaryIO, offset: int) -> tuple[int, bytes]:
        """Reads the record at `offset`, which is where the file stands."""
        prefix = file.read(_PREFIX.size)
        if len(prefix) < _PREFIX.size:
            raise self._cut(file, offset)
        opcode, length = _PREFIX.unpack(prefix)
        if length > self.size - offset - _PREFIX.size:
            raise self._cut(file, offset)
        if length > MAX_RECORD:
            raise DamagedFile(offset, f"the record at byte {offset} says that it is {length} bytes long")
        body = file.read(length)
        if len(body) < length:  # it has become shorter since it was opened
            raise self._cut(file, offset)
        return opcode, body

    def _cut(self, file: BinaryIO, offset: int) -> DamagedFile:
        """Tells a file that ends early from one with a wrong length in it: that one has its end."""
        file.seek(max(0, self.size - len(MAGIC)))
        if file.read() == MAGIC:
            return DamagedFile(offset, f"the record at byte {offset} says that it goes on beyond the end of the file")
        where = "after its last whole record" if offset == self.size else f"in the record that begins at byte {offset}"
        return DamagedFile(offset, f"the file ends at byte {self.size}, {where}", cut=True)


def _parsed(kind: type[_Record], body: bytes, offset: int) -> _Record:
    """Reads one of the `mcap` package's records, which may meet anything in damaged bytes."""
    try:
        record: _Record = kind.read(ReadDataStream(BytesIO(body)))
        return record
    except (McapError, ValueError, struct.error) as error:
        name = kind.__name__.lower()
        raise DamagedFile(offset, f"the {name} record at byte {offset} cannot be read") from error


def _unpacked(body: bytes, decompressor: zstandard.ZstdDecompressor, offset: int) -> bytes:
    """Decompresses a chunk record and checks it against its checksum."""
    # Not by the `mcap` package: there are thousands of them in a file, and to read one took as long as to unpack it.
    try:
        _, _, size, crc, length = _CHUNK.unpack_from(body)
        begin = _CHUNK.size + length + _LENGTH.size
        packed, compression = body[begin:], body[_CHUNK.size : _CHUNK.size + length]
        if _LENGTH.unpack_from(body, begin - _LENGTH.size) != (len(packed),):
            raise struct.error("it is of another length than it says")
    except struct.error as error:
        raise DamagedFile(offset, f"the chunk record at byte {offset} cannot be read") from error
    if size > MAX_RECORD:
        raise DamagedFile(offset, f"the chunk at byte {offset} says that it holds {size} bytes")
    content: bytes | None = None
    try:
        # The packed data state their size too, and it is that which the library makes room for.
        if compression == b"zstd" and zstandard.frame_content_size(packed) == size:
            content = decompressor.decompress(packed)
    except zstandard.ZstdError:
        pass
    if content is None or zlib.crc32(content) != crc:
        raise DamagedFile(offset, f"the chunk at byte {offset} does not match its checksum", content=content)
    return content


def split_chunk(content: bytes) -> Iterator[Message | Channel]:
    """Yields a chunk's messages and channels in order; the schemas are for other readers.

    Raises:
        ValueError: It does not consist of whole records.
    """
    position, size = 0, len(content)
    unpack, prefix, header = _MESSAGE.unpack_from, _PREFIX.size, _MESSAGE.size
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
            opcode, length = _PREFIX.unpack_from(content, position)
            end = position + prefix + length
            if end > size:
                raise ValueError("a record does not fit into its chunk")
            if opcode == Opcode.CHANNEL:
                yield _parsed(Channel, content[position + prefix : end], position)
        position = end


class Skim(NamedTuple):
    """What a chunk holds, its messages not looked into.

    Attributes:
        channels: Of each message, in order.
        sequences: Of each message.
        lengths: Of each message's record, in bytes, but for its type and length.
        ends: Where each message's record ends in the chunk.
        definitions: The channels that are defined in it, each with how many messages stand before it.
    """

    channels: Sequence[int]
    sequences: Sequence[int]
    lengths: Sequence[int]
    ends: Sequence[int]
    definitions: list[tuple[int, Channel]]

    def data(self, content: bytes, number: int) -> bytes:
        """Returns the data of one of its messages."""
        end = self.ends[number]
        return content[end - self.lengths[number] + _MESSAGE_FIELDS : end]


def skim_chunk(content: bytes) -> Skim:
    """Does as `split_chunk`, many times faster; raises the same."""
    records: list[tuple[int, int, int, int]] = []
    ends: list[int] = []
    # A chunk has thousands of messages. This loop does what must be done for each; the rest is done for all at once.
    add, end, unpack, prefix = records.append, ends.append, _SKIMMED.unpack_from, _PREFIX.size
    position, size = 0, len(content)
    try:
        while position < size:
            record = unpack(content, position)
            add(record)
            position += prefix + record[1]
            end(position)
    except struct.error:
        position = -1
    if position != size:
        raise ValueError("a record does not fit into its chunk")
    definitions: list[tuple[int, Channel]] = []
    if [record[0] for record in records].count(_OPCODE_MESSAGE) < len(records):
        messages: list[tuple[tuple[int, int, int, int], int]] = []
        for record, stop in zip(records, ends, strict=True):
            if record[0] == _OPCODE_MESSAGE:
                messages.append((record, stop))
            elif record[0] == Opcode.CHANNEL:
                start = stop - record[1]
                definitions.append((len(messages), _parsed(Channel, content[start:stop], start - prefix)))
        records, ends = [record for record, _ in messages], [stop for _, stop in messages]
    if not records:
        return Skim((), (), (), (), definitions)
    _, lengths, channels, sequences = zip(*records, strict=True)
    if min(lengths) < _MESSAGE_FIELDS:
        raise ValueError("a message does not fit into its chunk")
    return Skim(channels, sequences, lengths, ends, definitions)


def message_checksums(content: bytes | bytearray) -> Iterator[int]:
    """Yields the CRC-32 of each of a chunk's message records, until something is no record."""
    position, size, view = 0, len(content), memoryview(content)
    while position + _PREFIX.size <= size:
        opcode, length = _PREFIX.unpack_from(content, position)
        end = position + _PREFIX.size + length
        if end > size:
            return
        if opcode == _OPCODE_MESSAGE:
            yield zlib.crc32(view[position:end])
        position = end
