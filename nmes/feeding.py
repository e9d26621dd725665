"""Feeding a world what a recording holds: the one place that knows how its records become inputs again.

Replays, the drift between engines, states made again and worlds taken up in the midst of a recording all go through
here.

Invariant: a record that follows from others is never fed. What a command led to (the ticks of a `step`, what viewers
were shown in between, a fault, its reply) stands between it and its reply, and is handed out with it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import orjson

from nmes import protocol
from nmes.errors import RejectedMessage
from nmes.protocol import NO_ID, Request
from nmes.records import REFUSED_LIMIT, Kind, Record
from nmes.world import World

__all__ = ["Happening", "feed", "happenings"]

_FRAMES = (Kind.COMMAND, Kind.REFUSED)


class Happening(NamedTuple):
    """A record, and what it led to: of a client's frame all up to its reply (the last), of another nothing."""

    record: Record
    effects: list[Record]

    @property
    def digests(self) -> list[str]:
        """The digests of its ticks, in hexadecimal."""
        return [digest for record in (self.record, *self.effects) for digest in (record.about or {}).get("digests", ())]

    @property
    def reply(self) -> Record | None:
        """What the frame was answered; None where the recording was cut before, or it is no frame."""
        return self.effects[-1] if self.effects and self.effects[-1].kind is Kind.REPLY else None


def happenings(records: Iterable[Record]) -> Iterator[Happening]:
    """Yields records in order, those that a client's frame led to with it."""
    records = iter(records)
    for record in records:
        effects: list[Record] = []
        if record.kind in _FRAMES:
            for effect in records:
                effects.append(effect)
                if effect.kind is Kind.REPLY:
                    break
        yield Happening(record, effects)


def feed(world: World, record: Record, reply: Record | None = None) -> None:
    """Does to a world what a record says was done to it: who came and went, a frame, one tick of the clock.

    A fault that stands by itself came from such a tick. What is no input is passed over.

    Args:
        world: The world; `clients` of the recording are its own, by number.
        record: The record. One of several ticks is to be fed as often as it has ticks.
        reply: What followed on a refused frame: the frame was not kept whole if it was long, and its reply stands for
            why it was refused.
    """
    match record.kind:
        case Kind.TICKS | Kind.FAULT:
            world.tick()
        case Kind.JOINED:
            world.join()
        case Kind.LEFT if record.client in world.clients():
            world.leave(record.client)
        case Kind.COMMAND | Kind.REFUSED if record.client in world.clients():
            world.handle(record.client, _request(record, reply))


def _request(record: Record, reply: Record | None) -> Request:
    if record.kind is Kind.COMMAND or 0 < len(record.data) <= REFUSED_LIMIT:
        return protocol.parse(record.data)
    told = _told(reply)
    error = RejectedMessage(str(told.get("code", "")), str(told.get("message", "")), told.get("field"))
    return Request(record.data, None, error, told.get("command"), told.get("id", NO_ID))


def _told(reply: Record | None) -> dict[str, Any]:
    """Returns what a reply says; nothing where it is none, which whoever compares replies will find."""
    try:
        told = orjson.loads(reply.data) if reply is not None and reply.kind is Kind.REPLY else {}
    except ValueError:
        return {}
    return told if isinstance(told, dict) else {}
