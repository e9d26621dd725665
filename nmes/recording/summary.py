"""The contents of a recording, counted."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from nmes import protocol
from nmes.protocol import Request
from nmes.recording.records import Kind, Record

__all__ = ["Summary", "summarize"]

_MOST_NAMES, _OTHERS = 100, "others"  # a stranger may think of any number of fields
_ERROR = b'{"type":"error",'  # how the world's encoder begins an error


@dataclass(slots=True)
class Summary:
    """The contents of a recording, counted.

    Attributes:
        clients: How many came.
        commands: How many of each type were executed, also those that the world answered with an error.
        refused: How many frames were no valid command.
        errors: How many replies were errors.
        ignored: How often a field was not understood, by command and path.
        without_effect: How often a joint was given a note, by command and name: the original's parameters are kept so.
        ticks: How many there were, over all resets.
        keyframes: How often the world was saved.
        hibernations: How often of these it was, to sleep while nobody was in it.
        faults: How often the world stopped.
        life: What happened in its ecosystem: how often, by the type of the event.
        census: The last census of its ecosystem, if there is one.
        began: Wall clock of the first record, ns since 1970; 0 when there is none.
        ended: The same of the last.
    """

    clients: int = 0
    commands: Counter[str] = field(default_factory=Counter)
    refused: int = 0
    errors: int = 0
    ignored: Counter[str] = field(default_factory=Counter)
    without_effect: Counter[str] = field(default_factory=Counter)
    ticks: int = 0
    keyframes: int = 0
    hibernations: int = 0
    faults: int = 0
    life: Counter[str] = field(default_factory=Counter)
    census: dict[str, Any] | None = None
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
                _count_command(summary, protocol.parse(record.data))
            case Kind.REFUSED:
                summary.refused += 1
            case Kind.REPLY:
                summary.errors += record.data.startswith(_ERROR)
            case Kind.TICKS:
                summary.ticks += len(record.digests)
            case Kind.KEYFRAME:
                summary.keyframes += 1
            case Kind.HIBERNATED:
                summary.hibernations += 1
            case Kind.FAULT:
                summary.faults += 1
            case Kind.LIFE if record.about is not None:
                summary.life.update(event["type"] for event in record.about["events"])
                censuses = [event for event in record.about["events"] if event["type"] == "census"]
                summary.census = censuses[-1] if censuses else summary.census
        summary.began = summary.began or record.wall
        summary.ended = record.wall
    return summary


def _count_command(summary: Summary, request: Request) -> None:
    kind = request.type or "invalid"
    summary.commands[kind] += 1
    for path in request.ignored:
        # The places in batches and lists would make many fields of one.
        _count(summary.ignored, f"{kind} {re.sub(r'/[0-9]+/', '/*/', path)}")
    for command in (request.command or {}).get("commands", [request.command or {}]):
        for name in command.get("notes", ()):
            _count(summary.without_effect, f"{command['type']} {name}")


def _count(counts: Counter[str], name: str) -> None:
    counts[name if name in counts or len(counts) < _MOST_NAMES else _OTHERS] += 1
