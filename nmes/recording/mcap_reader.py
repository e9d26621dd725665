"""The reader of MCAP files: damage costs no more than it must.

Invariants: no length that a file states is believed before it was compared with the bytes that are there, no more than
`MAX_RECORD` bytes are held for one record, and whatever is wrong ends in `DamagedFile`.
"""

from __future__ import annotations

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
from nmes.recording.mcap_format import FOOTER, MAGIC, MAX_RECORD, PREFIX, DamagedFile, parse_record

__all__ = ["Block", "FileIndex", "Reader"]

_CHUNK = struct.Struct("<QQQII")  # of its body: times, size, checksum, length of the compression's name, which follows
_LENGTH = struct.Struct("<Q")


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


class FileIndex(NamedTuple):
    """The summary at the end of a file.

    Attributes:
        channels: All channels.
        chunks: The offset of each chunk, in file order, and the channels with messages in it.
    """

    channels: list[Channel]
    chunks: list[tuple[int, frozenset[int]]]


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
        except DamagedFile as error:
            raise RecordingError("not_a_recording", f"{self.path} is not a recording: {error}") from error
        except OSError as error:
            raise RecordingError("recording_unreadable", f"cannot read {self.path}: {error.strerror}") from error

    def summary(self) -> FileIndex | None:
        """Returns the file's summary, or None where there is no sound one. What it says of the rest is not checked."""
        try:
            with open(self.path, "rb") as file:
                end = FOOTER.size + len(MAGIC)
                file.seek(max(self.size - end, 0))
                tail = file.read(end)
                start = FOOTER.unpack_from(tail)[2] if len(tail) == end else self.size
                if start >= self.size:
                    return None
                file.seek(start)
                self._check_end(file, start)
                return self._summary(file, start)
        except (DamagedFile, OSError):
            return None

    def _summary(self, file: BinaryIO, offset: int) -> FileIndex:
        summary = FileIndex([], [])
        file.seek(offset)
        while True:
            opcode, body = self._record(file, offset)
            if opcode == Opcode.FOOTER:
                return summary
            if opcode == Opcode.CHANNEL:
                summary.channels.append(parse_record(Channel, body, offset))
            elif opcode == Opcode.CHUNK_INDEX:
                index = parse_record(ChunkIndex, body, offset)
                summary.chunks.append((index.chunk_start_offset, frozenset(index.message_index_offsets)))
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
                if parse_record(DataEnd, body, offset).data_section_crc != crc and start is None:
                    raise DamagedFile(offset, "the checksum of the data section does not match")
                break
            size = PREFIX.size + len(body)
            if opcode == Opcode.METADATA:
                yield Block(offset, size, parse_record(Metadata, body, offset), PREFIX.pack(opcode, len(body)) + body)
            elif opcode == Opcode.CHUNK:
                yield Block(offset, size, None, _unpacked(body, decompressor, offset))
            elif opcode != Opcode.MESSAGE_INDEX:
                raise DamagedFile(offset, f"a record of type {opcode} at byte {offset} does not belong there")
            if start is None:
                crc = zlib.crc32(body, zlib.crc32(PREFIX.pack(opcode, len(body)), crc))
            offset += size
        self._check_end(file, file.tell())

    def _check_end(self, file: BinaryIO, offset: int) -> None:
        """Checks the summary, from `offset` to the end of the file."""
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
