"""What the writer, the readers and the feeders of recordings share: the kinds of records, the hash chain, the format.

See `nmes.recording`, of which this is a part.
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
]

PROFILE: Final = "nmes"
FORMAT: Final = "2"
FORMATS: Final = frozenset({"1", FORMAT})  # that can be read: version 1 had no keyframes
REFUSED_LIMIT: Final = 64 << 10  # bytes of a refused frame that are kept
PARENT: Final = "nmes.parent"  # the metadata record that says of which recording this one is a branch
END: Final = "nmes.end"  # the metadata record that closes a file
KEYFRAMES: Final = "keyframes"  # their topic
BOXES: Final = "/boxes/"  # how the topic of a cube's box begins
SEQUENCE_MASK: Final = 0xFFFFFFFF  # MCAP's sequence numbers have 32 bits


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
    KEYFRAME = "keyframe"


class Record(NamedTuple):
    """One message of a recording.

    Attributes:
        kind: What it tells.
        sequence: Its place in the world's history.
        time: Simulation time in ns.
        wall: The recorder's clock, ns since 1970.
        client: Whom it is about, if anybody.
        data: Its bytes: verbatim for a command, a refused frame and a reply; of a keyframe a snapshot of the world.
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


def next_head(head: bytes, content: bytes | bytearray | memoryview) -> bytes:
    """Returns the head of the chain after a chunk, or, with no head, after the metadata at the beginning."""
    chain = hashlib.sha256(head)
    chain.update(content)
    return chain.digest()
