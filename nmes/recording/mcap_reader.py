"""The reader of MCAP files: damage costs no more than it must.

Invariants: no length that a file states is believed before it was compared with the bytes that are there, no more than
`MAX_RECORD` bytes are held for one record, a file does not unpack to more than `MAX_PACKED` times its size and
`_UNPACKED_FREE` bytes, and whatever is wrong ends in `DamagedFile`. Of a whole file all that is said of the chunks is
compared with them: their times, the indexes of their messages, and the summary.
"""

from __future__ import annotations

import contextlib
import os
import stat
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, DataEnd, Header, Metadata

from nmes.errors import RecordingError
from nmes.recording.mcap_format import (
    FOOTER,
    MAGIC,
    MAX_PACKED,
    MAX_RECORD,
    PREFIX,
    DamagedFile,
    Skim,
    parse_record,
    skim_chunk,
)
from nmes.recording.mcap_summary import Contents, message_indexes

__all__ = ["Block", "Reader"]

_UNPACKED_FREE = 64 << 20  # bytes
_CHUNK = struct.Struct("<QQQII")  # of its body: times, size, checksum, length of the compression's name, which follows
_LENGTH = struct.Struct("<Q")
_INDEX = struct.Struct("<BQH")  # of an index of messages: what it is, its length, and the channel
_SLAB = 1 << 20  # bytes that are read at a time where only lengths matter


class Block(NamedTuple):
    """A part of a file's data section.

    Attributes:
        offset: Where its record begins.
        size: How many bytes that takes up in the file.
        metadata: The metadata record that it is, or None for a chunk.
        content: A chunk's records, unpacked, or the bytes of the metadata record.
        skim: A chunk's messages.
    """

    offset: int
    size: int
    metadata: Metadata | None
    content: bytes
    skim: Skim | None


class Reader:
    """Reads one file from its beginning, in file order, and checks all that it states.

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
                self.profile = parse_record(Header, body, len(MAGIC)).profile
                self._start = file.tell()
                self._places: dict[str, list[tuple[int | None, int]]] = {}  # what `chunks_with` has found
        except DamagedFile as error:
            raise RecordingError("not_a_recording", f"{self.path} is not a recording: {error}") from error
        except OSError as error:
            raise RecordingError("recording_unreadable", f"cannot read {self.path}: {error.strerror}") from error

    def chunks_with(self, topic: str) -> list[tuple[int | None, int]]:
        """Finds the chunks with messages of a topic by the file's summary, or by their indexes where it was cut.

        Neither is compared with the chunks, so it is no more than a place to look at.

        Returns:
            For each such chunk, in file order, where the chunk before it begins (None: it is the first) and where it
            begins itself.
        """
        if topic not in self._places:
            try:
                with open(self.path, "rb") as file:
                    places = self._summarized(file, topic)
                    self._places[topic] = self._indexed(file, topic) if places is None else places
            except OSError:
                return []
        return self._places[topic]

    def _summarized(self, file: BinaryIO, topic: str) -> list[tuple[int | None, int]] | None:
        """Returns the chunks with a topic by the summary; None: there is no sound one."""
        try:
            end = FOOTER.size + len(MAGIC)
            file.seek(max(self.size - end, 0))
            tail = file.read(end)
            start = FOOTER.unpack_from(tail)[2] if len(tail) == end else self.size
            if start >= self.size:
                return None
            file.seek(start)
            self._ending(file, start)
            return self._listed(file, start, topic)
        except DamagedFile:
            return None

    def _indexed(self, file: BinaryIO, topic: str) -> list[tuple[int | None, int]]:
        """Returns the chunks with a topic by the indexes behind them, as far as the file goes.

        Only chunks that use a channel first are unpacked, since they define it, until one defines that of the topic.
        It is fifty times as fast as to read all.
        """
        found: list[tuple[int | None, int]] = []
        known: set[int] = set()
        wanted: set[int] = set()
        before = None
        for offset, channels in self._skimmed(file):
            if not wanted and not channels <= known:
                with contextlib.suppress(DamagedFile):  # the next keyframe defines its channels again
                    skim = self.block(offset).skim
                    defined = [] if skim is None else [channel for _, channel in skim.definitions]
                    known.update(channel.id for channel in defined)
                    wanted.update(channel.id for channel in defined if channel.topic == topic)
            if not wanted.isdisjoint(channels):
                found.append((before, offset))
            before = offset
        return found

    def _skimmed(self, file: BinaryIO) -> Iterator[tuple[int, set[int]]]:
        """Yields where each chunk begins, and the channels of its messages, until something else comes, or the end."""
        chunk, channels = None, set[int]()
        slab, begin, offset = b"", self._start, self._start
        while True:
            place = offset - begin
            if place + _INDEX.size > len(slab):
                file.seek(offset)
                slab, begin, place = file.read(_SLAB), offset, 0
            if place + _INDEX.size > len(slab):
                break
            opcode, length, channel = _INDEX.unpack_from(slab, place)
            offset += PREFIX.size + length
            if offset > self.size:
                break
            if opcode == Opcode.MESSAGE_INDEX:
                channels.add(channel)
                continue
            if chunk is not None:
                yield chunk, channels
            chunk, channels = None, set()
            if opcode == Opcode.CHUNK:
                chunk = begin + place
            elif opcode != Opcode.METADATA:
                break
        if chunk is not None:
            yield chunk, channels

    def _listed(self, file: BinaryIO, offset: int, topic: str) -> list[tuple[int | None, int]]:
        numbers: set[int] = set()
        found: list[tuple[int | None, int]] = []
        last: int | None = None
        file.seek(offset)
        while True:
            opcode, body = self._record(file, offset)
            if opcode == Opcode.FOOTER:
                return found
            if opcode == Opcode.CHANNEL:
                channel = parse_record(Channel, body, offset)
                if channel.topic == topic:
                    numbers.add(channel.id)
            elif opcode == Opcode.CHUNK_INDEX:
                index = parse_record(ChunkIndex, body, offset)
                if last is not None and index.chunk_start_offset <= last:
                    raise DamagedFile(offset, "the summary lists the chunks out of order")
                if not numbers.isdisjoint(index.message_index_offsets):
                    found.append((last, index.chunk_start_offset))
                last = index.chunk_start_offset
            offset += PREFIX.size + len(body)

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
            return block
        raise DamagedFile(offset, f"no chunk begins at byte {offset}")

    def _blocks(self, file: BinaryIO, start: int | None) -> Iterator[Block]:
        decompressor = zstandard.ZstdDecompressor()  # as costly to make as a small chunk is to unpack
        offset = self._start if start is None else start
        contents, unpacked = Contents(), 0
        crc = zlib.crc32(file.read(self._start))
        file.seek(offset)
        while True:
            opcode, body = self._record(file, offset)
            if opcode == Opcode.DATA_END:
                if parse_record(DataEnd, body, offset).data_section_crc != crc and start is None:
                    raise DamagedFile(offset, "the checksum of the data section does not match")
                break
            size, indexes = PREFIX.size + len(body), b""
            if opcode == Opcode.METADATA:
                metadata = parse_record(Metadata, body, offset)
                contents.add_metadata(metadata.name, offset, size)
                yield Block(offset, size, metadata, PREFIX.pack(opcode, len(body)) + body, None)
            elif opcode == Opcode.CHUNK:
                packed = _PackedChunk(body, offset)
                unpacked += packed.size
                if unpacked > _UNPACKED_FREE + MAX_PACKED * (offset + size):
                    raise DamagedFile(offset, f"the chunk at byte {offset} unpacks to more than a reader takes")
                content = packed.unpacked(decompressor)
                skim, indexes = packed.listed(content, contents)
                yield Block(offset, size, None, content, skim)
            else:
                raise DamagedFile(offset, f"a record of type {opcode} at byte {offset} does not belong there")
            self._check_indexes(file, offset + size, indexes)
            if start is None:
                crc = zlib.crc32(indexes, zlib.crc32(body, zlib.crc32(PREFIX.pack(opcode, len(body)), crc)))
            offset += size + len(indexes)
        offset = file.tell()
        if self._ending(file, offset) != contents.ending(offset) and start is None:
            raise DamagedFile(offset, "the summary does not say what is in the file")

    def _check_indexes(self, file: BinaryIO, offset: int, indexes: bytes) -> None:
        """Compares the message indexes behind a chunk, at `offset`, where the file stands, with what they must be."""
        if file.read(len(indexes)) == indexes:
            return
        file.seek(offset)
        begin = 0
        while begin < len(indexes):
            opcode, body = self._record(file, offset + begin)
            end = begin + PREFIX.size + len(body)
            if indexes[begin:end] != PREFIX.pack(opcode, len(body)) + body:
                break
            begin = end
        where = offset + begin
        raise DamagedFile(where, f"the record at byte {where} is not the index of the messages of the chunk before it")

    def _ending(self, file: BinaryIO, offset: int) -> bytes:
        """Returns the bytes behind the data section, from `offset` to the file's end, if its checksum matches."""
        if self.size - offset > MAX_RECORD:
            raise DamagedFile(offset, f"the summary at byte {offset} is too long")
        end = file.read(self.size - offset)
        footer = len(end) - FOOTER.size - len(MAGIC)
        if footer < 0 or not end.endswith(MAGIC):
            raise DamagedFile(offset, f"the file ends in its summary, at byte {offset + len(end)}", cut=True)
        opcode, length, start, _, crc = FOOTER.unpack_from(end, footer)
        if (opcode, length) != (Opcode.FOOTER, FOOTER.size - PREFIX.size) or start != offset:
            raise DamagedFile(offset + footer, "the footer is damaged")
        if crc != zlib.crc32(end[: footer + FOOTER.size - 4]):
            raise DamagedFile(offset, "the checksum of the summary does not match")
        return end

    def _record(self, file: BinaryIO, offset: int) -> tuple[int, bytes]:
        """Reads the record at `offset`, which is where the file stands."""
        prefix = file.read(PREFIX.size)
        if len(prefix) < PREFIX.size:
            raise self._cut(file, offset)
        opcode, length = PREFIX.unpack(prefix)
        if length > self.size - offset - PREFIX.size:
            raise self._cut(file, offset)
        if length > MAX_RECORD:
            raise DamagedFile(offset, f"the record at byte {offset} says that it is {length} bytes long")
        body = file.read(length)
        if len(body) < length:  # it has become shorter since it was opened
            raise self._cut(file, offset)
        return opcode, body

    def _cut(self, file: BinaryIO, offset: int) -> DamagedFile:
        """Makes the error for a record that goes on beyond the end: a file cut short, or a wrong length."""
        file.seek(max(0, self.size - len(MAGIC)))
        if file.read() == MAGIC:
            return DamagedFile(offset, f"the record at byte {offset} says that it goes on beyond the end of the file")
        where = "after its last whole record" if offset == self.size else f"in the record that begins at byte {offset}"
        return DamagedFile(offset, f"the file ends at byte {self.size}, {where}", cut=True)


class _PackedChunk:
    """A chunk's record, not unpacked yet.

    Not read by the `mcap` package: there are thousands of them in a file, and to read one took as long as to unpack it.

    Args:
        body: The record.
        offset: Where it begins in the file.

    Raises:
        DamagedFile: It does not have its form, or says that it is too large.
    """

    def __init__(self, body: bytes, offset: int) -> None:
        self._offset = offset
        self._length = PREFIX.size + len(body)
        try:
            self._first, self._last, self.size, self._crc, length = _CHUNK.unpack_from(body)
            begin = _CHUNK.size + length + _LENGTH.size
            self._packed, self._compression = body[begin:], body[_CHUNK.size : _CHUNK.size + length]
            if _LENGTH.unpack_from(body, begin - _LENGTH.size) != (len(self._packed),):
                raise struct.error("it is of another length than it says")
        except struct.error as error:
            raise DamagedFile(offset, f"the chunk record at byte {offset} cannot be read") from error
        if self.size > MAX_RECORD:
            raise DamagedFile(offset, f"the chunk at byte {offset} says that it holds {self.size} bytes")

    def unpacked(self, decompressor: zstandard.ZstdDecompressor) -> bytes:
        """Returns its content; raises DamagedFile where that does not match its checksum."""
        content: bytes | None = None
        try:
            # The packed data state their size too, and it is that which the library makes room for.
            if self._compression == b"zstd" and zstandard.frame_content_size(self._packed) == self.size:
                content = decompressor.decompress(self._packed)
            elif self._compression == b"" and len(self._packed) == self.size:
                content = self._packed
        except zstandard.ZstdError:
            pass
        if content is None or zlib.crc32(content) != self._crc:
            message = f"the chunk at byte {self._offset} does not match its checksum"
            raise DamagedFile(self._offset, message, content=content)
        return content

    def listed(self, content: bytes, contents: Contents) -> tuple[Skim, bytes]:
        """Adds it to the contents of its file; returns its messages, and the indexes that must follow it.

        Raises:
            DamagedFile: Its content has no form, or it is not of the times that it says.
        """
        try:
            skim = skim_chunk(content)
            if (self._first, self._last) != (min(skim.times), max(skim.times)):
                raise ValueError("its messages are of other times than it says")
            for schema in skim.schemas:
                contents.define(schema)
            for _, channel in skim.definitions:
                contents.define(channel)
        except (ValueError, DamagedFile) as error:
            message = f"the chunk at byte {self._offset} is not as it was recorded: {error}"
            raise DamagedFile(self._offset, message, content=content) from error
        indexes, offsets, counts = message_indexes(skim, self._offset + self._length)
        index = ChunkIndex(
            message_start_time=self._first,
            message_end_time=self._last,
            chunk_start_offset=self._offset,
            chunk_length=self._length,
            message_index_offsets=offsets,
            message_index_length=len(indexes),
            compression=self._compression.decode(),
            compressed_size=len(self._packed),
            uncompressed_size=self.size,
        )
        contents.add_chunk(index, counts)
        return skim, indexes
