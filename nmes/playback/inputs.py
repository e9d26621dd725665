"""Feeding a world what a recording holds: the one place that knows how its records become inputs again.

Replays, the drift between engines, states made again and worlds taken up in the midst of a recording all go through
here.

Invariants:

- A record that follows from others is never fed. What a command led to (the ticks of a `step`, what viewers were shown
  in between, a fault, its reply) stands between it and its reply, and is handed out with it.
- A world is never fed beyond the recording's end: of a command in the midst of which it ends (the host was killed, or
  told to stop), only as much is handed out as was recorded.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import zip_longest
from typing import Any, NamedTuple

import orjson

from nmes import protocol
from nmes.errors import RecordingError, RejectedMessage
from nmes.protocol import NO_ID, Request
from nmes.recording.records import REFUSED_LIMIT, Kind, Record
from nmes.world import World

__all__ = ["RecordedInput", "advance", "apply_input", "recorded_inputs"]

_FRAMES = (Kind.COMMAND, Kind.REFUSED)
_TICKING = ("step", "batch")  # the commands in which a world may tick


class RecordedInput(NamedTuple):
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


def recorded_inputs(records: Iterable[Record]) -> Iterator[RecordedInput]:
    """Yields records in order, those that a client's frame led to with it; a last command without reply cut short."""
    records = iter(records)
    for record in records:
        effects: list[Record] = []
        if record.kind in _FRAMES:
            for effect in records:
                effects.append(effect)
                if effect.kind is Kind.REPLY:
                    break
        recorded = RecordedInput(record, effects)
        if recorded.reply is None and record.kind is Kind.COMMAND and protocol.parse(record.data).type in _TICKING:
            # A tick that stopped the world has no digest.
            part = _part(recorded, len(recorded.digests) + any(effect.kind is Kind.FAULT for effect in effects))
            if part is None:
                return
            recorded = recorded._replace(record=record._replace(data=protocol.encode(part)))
        yield recorded


def apply_input(world: World, record: Record, reply: Record | None = None) -> None:
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


def advance(world: World, records: Iterable[Record], frame: int) -> None:
    """Feeds a world what was recorded until a frame is over: the next thing to come is a tick, or nothing.

    Of a command that ticks beyond it, only that much is executed.

    Args:
        world: The world, at the place where the records begin.
        records: What was recorded from there on.
        frame: The frame, counted on through resets (`World.ticks`).

    Raises:
        RecordingError: A tick does not come out as recorded (`diverged`).
    """
    for recorded in recorded_inputs(records):
        record, digests, left = recorded.record, recorded.digests, frame - world.ticks
        faults = any(each.kind is Kind.FAULT for each in (record, *recorded.effects))
        enough = len(digests) > left or (faults and len(digests) == left)
        if not enough or record.kind is Kind.TICKS:
            for _ in digests[:left] if record.kind is Kind.TICKS else (None,):
                apply_input(world, record, recorded.reply)
        elif record.kind is Kind.COMMAND and record.client in world.clients():
            command = _part(recorded, left)
            if command is not None:
                world.execute(record.client, command)
        # A digest is of the moment after its tick; what comes later in a batch may be an edit.
        last = digests[:left][-1:]
        told = bool(last) and world.fault is None and (record.kind is Kind.TICKS or _is_step(record))
        if told and world.digest().hex() != last[0]:
            raise RecordingError("diverged", f"frame {world.ticks} does not come out as recorded; see nmes replay")
        if enough:
            return


def _part(recorded: RecordedInput, ticks: int) -> dict[str, Any] | None:
    """Returns as much of a command that ticks as comes before its tick after so many; None: nothing of it."""
    command = protocol.parse(recorded.record.data).command or {}
    if command["type"] == "step":
        return {**command, "ticks": ticks} if ticks else None
    results = _told(recorded.reply).get("results", ())
    parts = []
    for part, result in zip_longest(command.get("commands", ()), results):
        # Where the reply is missing, all its steps are taken to have ticked; if not, the digests will tell.
        if part["type"] == "step" and (result is None or result.get("code", "world_faulted") == "world_faulted"):
            count = part.get("ticks", 1)
            if count > ticks:
                parts += [{**part, "ticks": ticks}] if ticks else []
                break
            ticks -= count
        parts.append(part)
    return {**command, "commands": parts} if parts else None


def _is_step(record: Record) -> bool:
    return record.kind is Kind.COMMAND and protocol.parse(record.data).type == "step"


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
