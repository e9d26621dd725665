"""The end of an MCAP file: what the summary lists of the data section before it.

The writer writes it, and the reader of a whole file makes it once more of what it has read and compares, so that a
summary that says anything else is found: those who seek in a file go by it.
"""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from collections.abc import Mapping
from typing import Any

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, MetadataIndex, Schema, Statistics, SummaryOffset

from nmes.recording.mcap_format import FOOTER, MAGIC, PREFIX, Skim, encode_records

__all__ = ["MESSAGE_INDEX", "Contents", "message_indexes"]

MESSAGE_INDEX = struct.Struct("<BQHI")  # opcode, length, channel, bytes of entries: log time and offset of each message


class Contents:
    """What a data section holds, as it is listed in the summary behind it."""

    def __init__(self) -> None:
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._metadata: list[MetadataIndex] = []
        self._chunks: list[ChunkIndex] = []
        self._counts: dict[int, int] = {}

    def define(self, record: Schema | Channel) -> None:
        """Adds a schema or a channel; one that is there may be said again.

        Raises:
            ValueError: It was another when it was said before.
        """
        known: dict[int, Any] = self._schemas if isinstance(record, Schema) else self._channels
        first = known.setdefault(record.id, record)
        if first is record:  # what is read twice is the same record
            if known is self._channels:
                self._counts.setdefault(record.id, 0)
        elif first != record:
            raise ValueError(f"{type(record).__name__.lower()} {record.id} is defined in two ways")

    def add_metadata(self, name: str, offset: int, size: int) -> None:
        """Adds a metadata record: its name, where it begins and how many bytes it takes up."""
        self._metadata.append(MetadataIndex(offset=offset, length=size, name=name))

    def drop_last_metadata(self) -> None:
        """Takes off the last metadata record."""
        self._metadata.pop()

    def add_chunk(self, chunk: ChunkIndex, counts: Mapping[int, int]) -> None:
        """Adds a chunk, with how many messages of each channel it holds."""
        self._chunks.append(chunk)
        for channel, count in counts.items():
            self._counts[channel] = self._counts.get(channel, 0) + count

    def ending(self, start: int) -> bytes:
        """Returns the summary, which begins at `start`, and the footer: all behind the data section."""
        statistics = Statistics(
            message_count=sum(self._counts.values()),
            schema_count=len(self._schemas),
            channel_count=len(self._channels),
            attachment_count=0,
            metadata_count=len(self._metadata),
            chunk_count=len(self._chunks),
            message_start_time=min((chunk.message_start_time for chunk in self._chunks), default=0),
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            channel_message_counts=self._counts,
        )
        begin = start
        groups: list[bytes] = []
        offsets: list[SummaryOffset] = []
        for opcode, records in (
            (Opcode.SCHEMA, self._schemas.values()),
            (Opcode.CHANNEL, self._channels.values()),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.METADATA_INDEX, self._metadata),
        ):
            group = encode_records(*records)
            if group:
                groups.append(group)
                offsets.append(SummaryOffset(group_opcode=opcode, group_start=start, group_length=len(group)))
                start += len(group)
        # The summary's checksum covers the footer too, up to the checksum itself.
        footer = FOOTER.pack(Opcode.FOOTER, FOOTER.size - PREFIX.size, begin, start, 0)[:-4]
        end = b"".join((*groups, encode_records(*offsets), footer))
        return end + struct.pack("<I", zlib.crc32(end)) + MAGIC


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
