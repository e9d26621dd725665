"""The records of a recording: their kinds, their hash chain, and the names that its format fixes.

The reader, the writer and whoever runs a recording again share them.
"""

from __future__ import annotations

import hashlib
from enum import StrEnum
from typing import Any, Final, NamedTuple

__all__ = [
    "BOXES",
    "END",
    "FORMAT",
    "FORMATS",
    "KEYFRAMES",
    "PARENT",
    "PROFILE",
    "REFUSED_LIMIT",
    "SEQUENCE_MASK",
    "Kind",
    "Record",
    "next_head",
    "numbered_ticks",
    "said_by",
    "who_said",
]

PROFILE: Final = "nmes"
FORMAT: Final = "3"
# Those that can be read: version 1 had no keyframes, and until 3 each client had channels of its own.
FORMATS: Final = frozenset({"1", "2", FORMAT})
REFUSED_LIMIT: Final = 64 << 10  # bytes of a refused frame that are kept
PARENT: Final = "nmes.parent"  # the metadata record that says of which recording this one is a fork
END: Final = "nmes.end"  # the metadata record that closes a file
KEYFRAMES: Final = "keyframes"  # their topic
BOXES: Final = "/boxes/"  # how the topic of a cube's box begins
SEQUENCE_MASK: Final = 0xFFFFFFFF  # MCAP's sequence numbers have 32 bits


class Kind(StrEnum):
    """The kinds of records."""

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
    KEYFRAME = "keyframe"
    LIFE = "life"
    HIBERNATED = "hibernated"


class Record(NamedTuple):
    """One message of a recording.

    Attributes:
        kind: Its kind.
        sequence: Its place in the world's history.
        time: Simulation time in ns.
        wall: The recorder's clock, ns since 1970.
        client: The number of the client that it is about, if it is about one.
        data: Its bytes: verbatim for a command, a refused frame and a reply; of a keyframe a snapshot of the world.
        about: The JSON of the recorder's own records (clients, ticks, faults, life, hibernation), as its schema says.
            Of a box, the name of its `cube`. Else None.
    """

    kind: Kind
    sequence: int
    time: int
    wall: int
    client: int | None
    data: bytes
    about: dict[str, Any] | None = None

    @property
    def digests(self) -> list[str]:
        """The digests of its ticks in hexadecimal; empty for a record of another kind."""
        return self.about["digests"] if self.kind is Kind.TICKS and self.about is not None else []

    @property
    def ticks(self) -> list[tuple[int, str]]:
        """Its ticks, each with the frame that it led to and its digest; empty for a record of another kind."""
        return numbered_ticks(self.about) if self.kind is Kind.TICKS and self.about is not None else []

    @property
    def last_frame(self) -> int:
        """The frame that the last of its ticks led to.

        Raises:
            ValueError: It is no record of ticks.
        """
        if self.kind is not Kind.TICKS or self.about is None:
            raise ValueError(f"record {self.sequence} is of kind {self.kind}, which has no ticks")
        return int(self.about["frame"]) + len(self.digests) - 1


def numbered_ticks(about: dict[str, Any]) -> list[tuple[int, str]]:
    """Returns the ticks in the JSON of a record of ticks, each with the frame that it led to and its digest."""
    return list(enumerate(about["digests"], about["frame"]))


def said_by(client: int, message: bytes) -> bytes:
    """Returns the data of a message on `commands` or `replies`: JSON that holds the client's number and its message."""
    return b'{"client":%d,"message":%b}' % (client, message)


def who_said(data: bytes) -> tuple[int, bytes]:
    """Returns the client's number and its message, byte for byte, out of what `said_by` made.

    Raises:
        ValueError: The data is nothing of the kind.
    """
    begin, separator, message = data.partition(b',"message":')
    if not (separator and begin.startswith(b'{"client":') and message.endswith(b"}")):
        raise ValueError("a message does not say whose it is")
    return int(begin[len(b'{"client":') :]), message[:-1]


def next_head(head: bytes, content: bytes | bytearray | memoryview) -> bytes:
    """Returns the head of the chain after a chunk, or, with no head, after the metadata at the beginning."""
    chain = hashlib.sha256(head)
    chain.update(content)
    return chain.digest()
