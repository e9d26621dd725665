"""The end of an MCAP file: what the summary lists of the data section before it.

The writer writes it, and the reader of a whole file makes it once more of what it has read and compares, so that a
summary that says anything else is found: those who seek in a file go by it.
"""

from __future__ import annotations

import itertools
import struct
import zlib
from collections import defaultdict
from collections.abc import Mapping

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, MetadataIndex, Schema, Statistics, SummaryOffset

from nmes.recording.mcap_format import FOOTER, MAGIC, PREFIX, Skim, encode_definition, encode_records

__all__ = ["MESSAGE_INDEX", "Contents", "message_indexes"]

MESSAGE_INDEX = struct.Struct("<BQHI")  # opcode, length, channel, bytes of entries: log time and offset of each message

# A chunk's index: its first and last time, where it is and how long; bytes of the offsets; those; bytes of the message
# indexes; the compression's name; and its sizes.
_SPAN, _OFFSET, _SIZES, _PACKING = (struct.Struct(form) for form in ("<QQQQI", "<HQ", "<QI", "<QQ"))


class Contents:
    """What a data section holds, as it is listed in the summary behind it.

    Kept are the bytes that the summary will have: a host holds one of these for each of its worlds, also those asleep.
    """

    def __init__(self) -> None:
        self._schemas: dict[int, bytes] = {}
        self._channels: dict[int, bytes] = {}
        self._metadata: list[bytes] = []
        self._chunks: list[bytes] = []
        self._counts: dict[int, int] = {}
        self._times: tuple[int, int] | None = None  # of the first and the last message; None: there are no chunks

    def define(self, record: Schema | Channel) -> None:
        """Adds a schema or a channel; one that is there may be said again.

        Raises:
            ValueError: It was another when it was said before.
        """
        data = encode_definition(record)
        if isinstance(record, Schema):
            known = self._schemas.setdefault(record.id, data)
        else:
            known = self._channels.setdefault(record.id, data)
            self._counts.setdefault(record.id, 0)
        if known != data:
            raise ValueError(f"{type(record).__name__.lower()} {record.id} is defined in two ways")

    def add_metadata(self, name: str, offset: int, size: int) -> None:
        """Adds a metadata record: its name, where it begins and how many bytes it takes up."""
        self._metadata.append(encode_records(MetadataIndex(offset=offset, length=size, name=name)))

    def drop_last_metadata(self) -> None:
        """Takes off the last metadata record."""
        self._metadata.pop()

    def add_chunk(self, chunk: ChunkIndex, counts: Mapping[int, int]) -> None:
        """Adds a chunk, with how many messages of each channel it holds."""
        self._chunks.append(_chunk_index(chunk))
        for channel, count in counts.items():
            self._counts[channel] = self._counts.get(channel, 0) + count
        first, last = chunk.message_start_time, chunk.message_end_time
        if self._times is not None:
            first, last = min(first, self._times[0]), max(last, self._times[1])
        self._times = first, last

    def ending(self, start: int) -> bytes:
        """Returns the summary, which begins at `start`, and the footer: all behind the data section."""
        first, last = self._times or (0, 0)
        statistics = Statistics(
            message_count=sum(self._counts.values()),
            schema_count=len(self._schemas),
            channel_count=len(self._channels),
            attachment_count=0,
            metadata_count=len(self._metadata),
            chunk_count=len(self._chunks),
            message_start_time=first,
            message_end_time=last,
            channel_message_counts=self._counts,
        )
        begin = start
        groups: list[bytes] = []
        offsets: list[SummaryOffset] = []
        for opcode, records in (
            (Opcode.SCHEMA, self._schemas.values()),
            (Opcode.CHANNEL, self._channels.values()),
            (Opcode.STATISTICS, [encode_records(statistics)]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.METADATA_INDEX, self._metadata),
        ):
            group = b"".join(records)
            if group:
                groups.append(group)
                offsets.append(SummaryOffset(group_opcode=opcode, group_start=start, group_length=len(group)))
                start += len(group)
        # The summary's checksum covers the footer too, up to the checksum itself.
        footer = FOOTER.pack(Opcode.FOOTER, FOOTER.size - PREFIX.size, begin, start, 0)[:-4]
        end = b"".join((*groups, encode_records(*offsets), footer))
        return end + struct.pack("<I", zlib.crc32(end)) + MAGIC


def _chunk_index(chunk: ChunkIndex) -> bytes:
    """Returns the bytes of a chunk's index: every flush of every world makes one, and the package takes its time."""
    offsets = b"".join(itertools.starmap(_OFFSET.pack, chunk.message_index_offsets.items()))
    compression = chunk.compression.encode()
    body = b"".join(
        (
            _SPAN.pack(
                chunk.message_start_time,
                chunk.message_end_time,
                chunk.chunk_start_offset,
                chunk.chunk_length,
                len(offsets),
            ),
            offsets,
            _SIZES.pack(chunk.message_index_length, len(compression)),
            compression,
            _PACKING.pack(chunk.compressed_size, chunk.uncompressed_size),
        )
    )
    return PREFIX.pack(Opcode.CHUNK_INDEX, len(body)) + body


def message_indexes(skim: Skim, offset: int) -> tuple[bytes, dict[int, int], dict[int, int]]:
    """Makes the message indexes that stand behind a chunk, one a channel.

    Args:
        skim: The chunk's messages.
        offset: Where the first index stands in the file.

    Returns:
        The indexes; where each begins, by channel; and how many messages each channel has in the chunk.
    """
    entries: defaultdict[int, list[int]] = defaultdict(list)  # in the order in which channels are first used
    for channel, time, end, length in zip(skim.channels, skim.times, skim.ends, skim.lengths, strict=True):
        entries[channel] += time, end - length - PREFIX.size
    indexes: list[bytes] = []
    offsets: dict[int, int] = {}
    for channel, numbers in entries.items():
        size = 8 * len(numbers)
        offsets[channel] = offset
        head = MESSAGE_INDEX.pack(Opcode.MESSAGE_INDEX, size + 6, channel, size)
        indexes.append(head + struct.pack(f"<{len(numbers)}Q", *numbers))
        offset += len(indexes[-1])
    return b"".join(indexes), offsets, {channel: len(numbers) // 2 for channel, numbers in entries.items()}
