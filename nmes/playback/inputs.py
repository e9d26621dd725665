"""The walk over a recorded history, and how its records become inputs of a world again.

Whatever runs a history again goes through here: replays of recordings and of logs, replays on other servers and other
engines, watchers, and worlds restored in the midst of a recording.

Invariants:

- A record that follows from others is never fed. The effects of a command (the ticks of a `step`, the poses shown in
  between, a fault, its reply) stand between it and its reply, and are handed out with it.
- A world is never fed beyond the recording's end: of a command in the midst of which it ends (the host was killed, or
  told to stop), only as much is handed out as was recorded.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import zip_longest
from typing import Any, Generic, NamedTuple, TypeVar

from nmes import protocol
from nmes.errors import RejectedMessage, WorldError
from nmes.playback.divergence import message_or_text
from nmes.playback.report import departure
from nmes.protocol import NO_ID, Request
from nmes.recording import REFUSED_LIMIT, Kind, Record, Recording, Start
from nmes.world import World

__all__ = ["Progress", "RecordedInput", "Walk", "advance", "apply_input", "recorded_inputs", "walk"]

_FRAMES = (Kind.COMMAND, Kind.REFUSED)
_TICKING = ("step", "batch")  # the commands in which a world may tick

Progress = Callable[[int, int], None]
"""Called now and then with how many bytes of the file are done, and its size."""
_Item = TypeVar("_Item")


class Walk(Generic[_Item]):
    """One pass over a history in order, with a look ahead: over the records of a recording, or the lines of a log."""

    def __init__(self, chunks: Iterable[tuple[int, Sequence[_Item]]], size: int, progress: Progress | None) -> None:
        """Begins before the first item.

        Args:
            chunks: The items, some at a time, each with how many bytes of the file that reaches.
            size: The size of the file in bytes.
            progress: Called after each chunk was read.
        """
        self._chunks = iter(chunks)
        self._size = size
        self._progress = progress
        self._queue: deque[_Item] = deque()

    def __iter__(self) -> Iterator[_Item]:
        return self

    def __next__(self) -> _Item:
        if not self._queue and self.peek() is None:
            raise StopIteration
        return self._queue.popleft()

    def peek(self, ahead: int = 0) -> _Item | None:
        """Returns the next item, or one so many further on, without going on; None beyond the end."""
        while len(self._queue) <= ahead:
            chunk = next(self._chunks, None)
            if chunk is None:
                return None
            reached, items = chunk
            self._queue.extend(items)
            if self._progress is not None:
                self._progress(reached, self._size)
        return self._queue[ahead]


def walk(recording: Recording, start: Start | None = None, progress: Progress | None = None) -> Walk[Record]:
    """Begins a walk over the records of a recording, from a start or the beginning on."""
    return Walk(recording.chunks(start), recording.size, progress)


class RecordedInput(NamedTuple):
    """An input and its effects.

    Attributes:
        record: Who came or went, a client's frame, or ticks of the clock. Records that are no inputs stand here too,
            where they follow from a tick of the clock: poses, keyframes, a fault.
        effects: Of a client's frame, all records up to its reply (the last); else empty.
    """

    record: Record
    effects: list[Record]

    @property
    def digests(self) -> list[str]:
        """The digests of its ticks, in hexadecimal."""
        return [digest for record in (self.record, *self.effects) for digest in record.digests]

    @property
    def reply(self) -> Record | None:
        """The reply to the frame; None where the recording was cut before, or it is no frame."""
        return self.effects[-1] if self.effects and self.effects[-1].kind is Kind.REPLY else None

    @property
    def faults(self) -> bool:
        """Whether the world stopped in it."""
        return any(record.kind is Kind.FAULT for record in (self.record, *self.effects))


def recorded_inputs(records: Iterable[Record]) -> Iterator[RecordedInput]:
    """Yields the records in order, each frame of a client with its effects; a last command without reply cut short."""
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
            command = _shortened(recorded, len(recorded.digests) + recorded.faults)
            if command is None:
                return
            recorded = recorded._replace(record=record._replace(data=protocol.encode(command)))
        yield recorded


def apply_input(world: World, record: Record, reply: Record | None = None) -> None:
    """Repeats one recorded input in a world: a client that comes or goes, a frame, one tick of the clock, hibernation.

    A fault that stands by itself came from such a tick. Records that are no inputs are passed over.

    Args:
        world: The world; `clients` of the recording are its own, by number.
        record: The record. One of several ticks is to be applied as often as it has ticks.
        reply: The reply to a refused frame: the frame was not kept whole if it was long, and its reply stands for
            why it was refused.
    """
    match record.kind:
        case Kind.TICKS | Kind.FAULT:
            world.tick()
        case Kind.HIBERNATED if "snapshot" in world.backend.capabilities and not world.clients() and not world.fault:
            world.hibernate()
            if world.asleep:
                world.wake()
        case Kind.JOINED:
            _join(world, record)
        case Kind.LEFT if record.client in world.clients():
            world.leave(record.client)
        case Kind.COMMAND | Kind.REFUSED if record.client in world.clients():
            world.handle(record.client, _request(record, reply))


def _join(world: World, record: Record) -> None:
    about = record.about or {}
    try:
        world.join(about.get("role"), about.get("player"))
    except WorldError:
        pass  # no world lets such a client in: somebody has edited the file, as what is missing now will show


def advance(world: World, recording: Recording, records: Iterable[Record], frame: int) -> None:
    """Applies recorded inputs to a world until a frame is over: the next thing to come is a tick, or nothing.

    Of a command that ticks beyond it, only that much is executed. A fault counts as such a tick, unless the world was
    reset after it: then all that came from there on belongs to the frame.

    Args:
        world: The world, at the place where the records begin.
        recording: The recording.
        records: Its records from there on.
        frame: The frame, counted on through resets (`World.ticks`).

    Raises:
        RecordingError: A tick does not come out as recorded (`diverged`, or `not_comparable` where the fingerprints
            differ).
    """
    last_reset: int | None = None  # unknown until a fault asks for it
    for recorded in recorded_inputs(records):
        ticks = frame - world.ticks
        count = len(recorded.digests)
        last = count > ticks
        if recorded.faults and count == ticks:
            if last_reset is None:
                last_reset = _last_reset(recording, recorded, frame)
            last = last_reset < recorded.record.sequence
        if not _advance_by(world, recorded, ticks, last) or world.ticks > frame:
            raise departure(recording, f"frame {world.ticks} does not come out as recorded; see nmes replay")
        if last:
            return


def _last_reset(recording: Recording, faulty: RecordedInput, frame: int) -> int:
    """Returns the sequence number of the last reset between a fault and the next tick; -1 where there is none.

    It lifts all faults before it: in a stopped world nothing else does, and nothing ticks before. It is looked for in
    a pass of its own, for a stopped world may be asked things for days; in one for all faults of a frame, for a client
    may stop and reset a world for days.
    """
    found = -1
    for recorded in recorded_inputs(recording.records(recording.start(frame))):
        sequence = recorded.record.sequence
        if sequence < faulty.record.sequence:
            continue
        if _ends_with_a_reset(recorded):
            found = sequence
        if sequence > faulty.record.sequence and recorded.digests:
            break
    return found


def _ends_with_a_reset(recorded: RecordedInput) -> bool:
    """Whether a command resets the world, and nothing of it stops the world after that."""
    command = protocol.parse(recorded.record.data).command if recorded.record.kind is Kind.COMMAND else None
    if command is None or recorded.reply is None:
        return False
    if command["type"] == "batch":
        outcomes = zip(command["commands"], _results(recorded.reply), strict=False)
    else:
        outcomes = zip([command], [_content(recorded.reply)], strict=True)
    reset = False
    for part, result in outcomes:
        if result.get("type") == "error":
            reset = reset and result.get("code") not in ("world_faulted", "internal")
        else:
            reset = reset or part["type"] == "reset"
    return reset


def _advance_by(world: World, recorded: RecordedInput, ticks: int, last: bool) -> bool:
    """Applies an input, but no more than so many ticks of it; tells whether the last has the recorded digest.

    Args:
        world: The world.
        recorded: The input.
        ticks: How many ticks the world may make.
        last: Whether the input has more than that, or a fault right after them.
    """
    record, digests = recorded.record, recorded.digests[:ticks]
    if digests and record.kind is Kind.COMMAND and protocol.parse(record.data).type not in _TICKING:
        return False  # no such command ticks: somebody has edited the file
    if record.kind is Kind.TICKS:
        for _ in digests:
            apply_input(world, record)
    elif not last:
        apply_input(world, record, recorded.reply)
    elif record.kind is Kind.COMMAND and record.client in world.clients():
        command = _shortened(recorded, ticks)
        if command is not None:
            world.execute(record.client, command)
    # A digest is of the moment after its tick; what comes later in a batch may be an edit.
    comparable = world.fault is None and (record.kind is Kind.TICKS or _is_step(record))
    return not (digests and comparable) or world.digest().hex() == digests[-1]


def _shortened(recorded: RecordedInput, ticks: int) -> dict[str, Any] | None:
    """Returns as much of a command that ticks as comes before its tick after so many; None: nothing of it."""
    command = protocol.parse(recorded.record.data).command
    if command is None:
        return None  # no command, so that it made no tick
    if command["type"] == "step":
        return {**command, "ticks": ticks} if ticks else None
    if command["type"] not in _TICKING:
        return command  # the world stopped at it
    codes = [result.get("code") for result in _results(recorded.reply)]
    parts = []
    for part, code in zip_longest(command["commands"], codes[: len(command["commands"])]):
        # Where the reply is missing, all its steps are taken to have ticked; if not, the digests will show it.
        request = protocol.request_from(part)
        if request.type == "step" and request.error is None and code in (None, "world_faulted"):
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
    if record.kind is Kind.COMMAND or (0 < len(record.data) <= REFUSED_LIMIT and record.data != protocol.REDACTED):
        return protocol.parse(record.data)
    content = _content(reply)
    error = RejectedMessage(str(content.get("code", "")), str(content.get("message", "")), content.get("field"))
    return Request(record.data, None, error, content.get("command"), content.get("id", NO_ID))


def _results(reply: Record | None) -> list[dict[str, Any]]:
    """Returns the replies in a reply to a batch, each an object as `_content`."""
    results = _content(reply).get("results")
    return [one if isinstance(one, dict) else {} for one in results] if isinstance(results, list) else []


def _content(reply: Record | None) -> dict[str, Any]:
    """Returns the JSON object of a reply; an empty one where it is none, which a comparison of replies will find."""
    content = message_or_text(reply.data) if reply is not None and reply.kind is Kind.REPLY else {}
    return content if isinstance(content, dict) else {}
