"""The writer of MCAP files: a crash costs one chunk at most.

Invariants of a written file:

- What `flush` wrote stays as it is: later flushes append. `seal` writes the end (summary, footer) that ordinary MCAP
  readers ask for behind it; the next flush removes that end again and goes on.
- Every message lies in a chunk, and every chunk is followed by one message index for each channel in it.
- Every byte of a sealed file is covered by a checksum: chunk, data section and summary.
"""

from __future__ import annotations

import os
import sys
from array import array
from collections.abc import Mapping
from errno import EIO, ENOENT
from pathlib import Path
from zlib import crc32

import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, DataEnd, Header, Metadata, Schema

from nmes.errors import RecordingError
from nmes.recording.mcap_format import (
    MAGIC,
    MAX_PACKED,
    MAX_RECORD,
    MAX_RECORDS,
    MESSAGE,
    MESSAGE_FIELDS,
    OPCODE_MESSAGE,
    encode_definition,
    encode_records,
)
from nmes.recording.mcap_summary import MESSAGE_INDEX, Contents

__all__ = ["MAX_CHANNELS", "Writer"]

MAX_CHANNELS = 0xFFFF
_pack = MESSAGE.pack
_LEVEL = 1  # of zstd: digests do not compress, and what does is already small at the fastest level
_compressors: list[zstandard.ZstdCompressor] = []  # not in use: all writers share them, for each has half a megabyte


def _compress(data: bytearray) -> bytes:
    try:
        compressor = _compressors.pop()
    except IndexError:  # others, in other threads, have them all
        compressor = zstandard.ZstdCompressor(level=_LEVEL)
    packed = bytes(compressor.compress(data))
    _compressors.append(compressor)
    return packed


class Writer:
    """Writes one file. Every failure of the operating system becomes a RecordingError (`recording_failed`).

    Messages, schemas and channels gather in an open chunk until `flush`. There is no thread and no timer in here.

    Attributes:
        open_chunk: The bytes of the open chunk so far; others may read them.
        checksums: The CRC-32 of each of its messages' records.
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
        self._size_at_rest: int | None = None  # of the file, while it is closed until there is more to write
        self._contents = Contents()
        self._schemas = 0
        self._channels: list[bytes] = []
        self._defined: list[Schema | Channel] = []  # in the open chunk
        self.open_chunk = bytearray()
        self.checksums: list[int] = []
        self._index: dict[int, array[int]] = {}  # its messages by channel: log time, offset, log time, offset...
        self._end = 0  # where the data section ends so far, and its checksum
        self._crc = 0
        self._sealed = False
        self._synced = 0  # how much was written when the disk last had all of it; and how much has been
        self._written = 0
        try:
            self._append(MAGIC + encode_records(Header(profile=profile, library=library)))
        except RecordingError:
            self._file.close()
            self.path.unlink()
            raise

    @property
    def size(self) -> int:
        """Bytes in the file, the end that `seal` wrote not counted."""
        return self._end

    def metadata(self, name: str, values: Mapping[str, str]) -> bytes:
        """Writes a metadata record at once (ahead of the open chunk) and returns its bytes."""
        record = encode_records(Metadata(name=name, metadata=dict(values)))
        self._contents.add_metadata(name, self._end, len(record))
        self._append(record)
        return record

    def schema(self, name: str, encoding: str, data: bytes) -> int:
        """Adds a schema to the open chunk and returns its number."""
        self._schemas += 1
        self._define(Schema(id=self._schemas, name=name, encoding=encoding, data=data))
        return self._schemas

    def channel(self, topic: str, encoding: str, schema: int = 0) -> int:
        """Adds a channel to the open chunk and returns its number."""
        channel = Channel(
            id=len(self._channels) + 1, topic=topic, message_encoding=encoding, schema_id=schema, metadata={}
        )
        if channel.id > MAX_CHANNELS:
            raise RecordingError("recording_failed", f"a file holds at most {MAX_CHANNELS:,} channels; begin a new one")
        self._channels.append(self._define(channel))
        return channel.id

    def repeat_channels(self) -> None:
        """Defines all channels again in the open chunk, for those who begin to read there."""
        self.open_chunk += b"".join(self._channels)

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
        record = _pack(OPCODE_MESSAGE, len(data) + MESSAGE_FIELDS, channel, sequence, log_time, publish_time) + data
        self.checksums.append(crc32(record))
        chunk += record

    def flush(self) -> None:
        """Hands the open chunk to the operating system; nothing to do when it has no message."""
        if not self._index:
            return
        counts = {channel: len(entries) // 2 for channel, entries in self._index.items()}
        size, records = len(self.open_chunk), sum(counts.values()) + self._schemas + 2 * len(self._channels)
        if size > MAX_RECORD or records > MAX_RECORDS:
            reason = f"a chunk of {size} bytes and {records} records is more than a reader takes"
            raise RecordingError("recording_failed", reason)
        first = min(min(entries[::2]) for entries in self._index.values())
        last = max(max(entries[::2]) for entries in self._index.values())
        compression, data = "zstd", _compress(self.open_chunk)
        if len(self.open_chunk) > MAX_PACKED * len(data):
            compression, data = "", bytes(self.open_chunk)
        chunk = encode_records(
            Chunk(
                message_start_time=first,
                message_end_time=last,
                uncompressed_size=len(self.open_chunk),
                uncompressed_crc=crc32(self.open_chunk),
                compression=compression,
                data=data,
            )
        )
        offsets, indexes = self._message_indexes(self._end + len(chunk))
        index = ChunkIndex(
            message_start_time=first,
            message_end_time=last,
            chunk_start_offset=self._end,
            chunk_length=len(chunk),
            message_index_offsets=offsets,
            message_index_length=len(indexes),
            compression=compression,
            compressed_size=len(data),
            uncompressed_size=len(self.open_chunk),
        )
        self._append(chunk + indexes)
        for record in self._defined:
            self._contents.define(record)
        self._contents.add_chunk(index, counts)
        self._defined.clear()
        self.open_chunk, self.checksums, self._index = bytearray(), [], {}

    def _message_indexes(self, offset: int) -> tuple[dict[int, int], bytes]:
        """Returns the index of the open chunk's messages, one record a channel, and where each is if they begin so."""
        indexes: list[bytes] = []
        offsets: dict[int, int] = {}
        for channel, entries in self._index.items():
            offsets[channel] = offset
            size = 8 * len(entries)
            if sys.byteorder == "big":  # pragma: no cover - MCAP is little-endian
                entries.byteswap()
            indexes.append(MESSAGE_INDEX.pack(Opcode.MESSAGE_INDEX, size + 6, channel, size) + entries.tobytes())
            offset += len(indexes[-1])
        return offsets, b"".join(indexes)

    def seal(self, name: str, values: Mapping[str, str]) -> None:
        """Flushes, then writes one last metadata record and the file's end, so that every MCAP reader can read it."""
        self.flush()
        self._unseal()
        last = encode_records(Metadata(name=name, metadata=dict(values)))
        data_end = encode_records(DataEnd(data_section_crc=crc32(last, self._crc)))
        self._contents.add_metadata(name, self._end, len(last))
        self._sealed = True
        self._write(last + data_end + self._contents.ending(self._end + len(last) + len(data_end)))

    def sync(self) -> None:
        """Waits until the disk has all written bytes, and the first time until the folder has the file."""
        written = self._written  # more may be written meanwhile, by another thread
        try:
            if written != self._synced:
                os.fsync(self._file.fileno())
                if not self._synced and hasattr(os, "O_DIRECTORY"):
                    folder = os.open(self.path.parent, os.O_RDONLY | os.O_DIRECTORY)
                    try:
                        os.fsync(folder)
                    finally:
                        os.close(folder)
                self._synced = written
        except OSError as error:
            raise self._failure(error) from error
        except ValueError as error:  # another thread could not write, and has closed it
            raise RecordingError("recording_failed", f"cannot write {self.path}: it is closed") from error

    @property
    def rests(self) -> bool:
        """Whether the file was closed by `rest`, and nothing was written since."""
        return self._size_at_rest is not None

    def rest(self) -> None:
        """Closes the flushed file until there is more to write, so that a writer at rest takes no descriptor."""
        try:
            self._size_at_rest = os.fstat(self._file.fileno()).st_size
            self._file.close()
        except OSError as error:
            raise self._failure(error) from error

    def _open_again(self) -> None:
        try:
            self._file = open(self.path, "r+b", buffering=0)
            if self._file.seek(0, os.SEEK_END) != self._size_at_rest:
                raise OSError(EIO, "it was changed while it was not open")
        except OSError as error:
            raise self._failure(error) from error
        self._size_at_rest = None

    def close(self) -> None:
        """Closes the file as it is: without `seal` it stays without an end."""
        self._file.close()

    def _define(self, record: Schema | Channel) -> bytes:
        self._defined.append(record)
        definition = encode_definition(record)
        self.open_chunk += definition
        return definition

    def _append(self, data: bytes) -> None:
        self._unseal()
        self._write(data)
        self._end += len(data)
        self._crc = crc32(data, self._crc)

    def _unseal(self) -> None:
        if self.rests:
            self._open_again()
        if self._sealed:
            try:
                self._file.seek(self._end)
                self._file.truncate()
            except OSError as error:
                raise self._failure(error) from error
            self._contents.drop_last_metadata()
            self._sealed = False

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
            self._written += len(data)
            if os.fstat(self._file.fileno()).st_nlink == 0:  # the system would go on taking what nobody can read
                raise FileNotFoundError(ENOENT, "it was removed while it was written")
        except OSError as error:
            raise self._failure(error) from error

    def _failure(self, error: OSError) -> RecordingError:
        return RecordingError("recording_failed", f"cannot write {self.path}: {error.strerror}")
