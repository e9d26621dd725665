"""The contents of a recording, counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

from nmes import protocol
from nmes.recording.records import Kind, Record

__all__ = ["Summary", "summarize"]

_ERROR = b'{"type":"error",'  # how the world's encoder begins an error


@dataclass(slots=True)
class Summary:
    """The contents of a recording, counted.

    Attributes:
        clients: How many came.
        commands: How many of each type were executed, also those that the world answered with an error.
        refused: How many frames were no valid command.
        errors: How many replies were errors.
        ticks: How many there were, over all resets.
        keyframes: How often the world was saved.
        faults: How often the world stopped.
        began: Wall clock of the first record, ns since 1970; 0 when there is none.
        ended: The same of the last.
    """

    clients: int = 0
    commands: Counter[str] = field(default_factory=Counter)
    refused: int = 0
    errors: int = 0
    ticks: int = 0
    keyframes: int = 0
    faults: int = 0
    began: int = 0
    ended: int = 0


def summarize(records: Iterable[Record]) -> Summary:
    """Counts records by what they say."""
    summary = Summary()
    for record in records:
        match record.kind:
            case Kind.JOINED:
                summary.clients += 1
            case Kind.COMMAND:
                summary.commands[protocol.parse(record.data).type or "invalid"] += 1
            case Kind.REFUSED:
                summary.refused += 1
            case Kind.REPLY:
                summary.errors += record.data.startswith(_ERROR)
            case Kind.TICKS:
                summary.ticks += len(record.digests)
            case Kind.KEYFRAME:
                summary.keyframes += 1
            case Kind.FAULT:
                summary.faults += 1
        summary.began = summary.began or record.wall
        summary.ended = record.wall
    return summary
