"""Two recordings side by side: where their inputs part, where their states part, and how far their cubes come apart.

The inputs are compared as they were recorded, the states by their digests; the values behind those come from running
both again. There is no verdict on which is right.

Ticks are counted over all resets, and on from where a recording begins that goes on from another: what comes before the
later of the two beginnings is left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from itertools import islice, zip_longest
from typing import Any

from nmes.backend.rotation import angle_between
from nmes.playback.divergence import json_difference, message_or_text
from nmes.playback.drift import Drift
from nmes.playback.export import COLUMNS
from nmes.playback.watch import States, states
from nmes.recording import Kind, Recording

__all__ = ["Comparison", "InputsPart", "StatesPart", "compare", "excerpts"]

_INPUTS = {Kind.JOINED, Kind.LEFT, Kind.COMMAND, Kind.REFUSED, Kind.HIBERNATED}
_SAMPLES = 10  # Hz: how often the distance of cubes is noted
_SHOWN, _HEAD, _BEFORE = 300, 60, 60  # characters of an input: in all, its first, and those before a difference


@dataclass(frozen=True, slots=True)
class InputsPart:
    """The first inputs that are not the same.

    Attributes:
        ticks: After how many ticks.
        first: The input of the first recording in words; of a long one what stands around the difference.
        second: That of the second.
        field: Of two commands of one client, the path of the first field in which they differ.
        values: That field's value in each; None where it is not there.
    """

    ticks: int
    first: str
    second: str
    field: str | None = None
    values: tuple[Any, Any] = (None, None)


@dataclass(frozen=True, slots=True)
class StatesPart:
    """The first tick whose digests differ, counted from 1 over all resets, and the value that differs most there.

    The value is None where one recording ends; the cube is None where the two do not have the same cubes.
    """

    tick: int
    cube: str | None = None
    field: str | None = None
    first: Any = None
    second: Any = None


@dataclass(slots=True)
class Comparison:
    """The result of a comparison.

    Attributes:
        ticks: How many ticks each recording has, from the later of the two beginnings on.
        inputs: The first inputs that differ, if any do.
        states: The first tick after which the states differ, if they do.
        drifts: How far each cube of both is apart, over time.
    """

    ticks: tuple[int, int]
    inputs: InputsPart | None
    states: StatesPart | None
    drifts: dict[str, list[Drift]] = field(default_factory=dict)

    @property
    def same(self) -> bool:
        """Whether nothing differs."""
        return self.inputs is None and self.states is None

    def to_json(self) -> dict[str, Any]:
        """Makes a dict of it for JSON."""
        drifts = {name: [drift._asdict() for drift in line] for name, line in self.drifts.items()}
        return {
            "same": self.same,
            "ticks": list(self.ticks),
            "inputs": None if self.inputs is None else asdict(self.inputs),
            "states": None if self.states is None else asdict(self.states),
            "drifts": drifts,
        }


def compare(first: Recording, second: Recording, *, keep_going: bool = False) -> Comparison:
    """Compares two recordings.

    Where states part, both are run again to see how.

    Args:
        first: One of them.
        second: The other.
        keep_going: Go on where a tick does not come out as it was recorded, as on another machine.

    Raises:
        RecordingError: A tick does not come out as recorded.
        BackendNotFound: An engine is not there.
    """
    begins = first.start().frame, second.start().frame
    begin = max(begins)
    skip = begin - begins[0], begin - begins[1]
    digests = [list(islice(_digests(recording), n, None)) for recording, n in zip((first, second), skip, strict=True)]
    inputs = _inputs_part(_inputs(first, skip[0]), _inputs(second, skip[1]), begin)
    comparison = Comparison((len(digests[0]), len(digests[1])), inputs, None)
    tick = next((i for i, (one, other) in enumerate(zip_longest(*digests), begin + 1) if one != other), None)
    if tick is None:
        return comparison
    comparison.states = StatesPart(tick)
    pairs = zip(
        islice(states(first, keep_going=keep_going), skip[0], None),
        islice(states(second, keep_going=keep_going), skip[1], None),
        strict=False,
    )
    rate: int = first.config["tick_rate"]
    for number, (one, other) in enumerate(pairs, begin + 1):
        if number == tick:
            comparison.states = _states_part(tick, one, other)
        if number % max(1, round(rate / _SAMPLES)) == 0 or number == tick:
            _add_distances(comparison.drifts, number / rate, one, other)
    return comparison


def _digests(recording: Recording) -> Iterator[str]:
    for record in recording:
        yield from record.digests


_Input = tuple[str, int | None, bytes]


def _inputs(recording: Recording, skip: int) -> Iterator[_Input]:
    """Yields the inputs of the world as kind, client and data; with ticks to skip, from the tick after those on."""
    ticks = 0
    for record in recording:
        for _ in record.digests:
            ticks += 1
            if ticks > skip:
                yield "tick", None, b""
        if record.kind in _INPUTS and (ticks > skip or skip == 0):
            yield str(record.kind), record.client, record.data


def _inputs_part(first: Iterator[_Input], second: Iterator[_Input], ticks: int) -> InputsPart | None:
    for one, other in zip_longest(first, second):
        if one != other:
            return InputsPart(ticks, *excerpts(_described(one), _described(other)), *_field(one, other))
        ticks += one is not None and one[0] == "tick"
    return None


def _described(item: _Input | None) -> str:
    if item is None:
        return "the end"
    kind, client, data = item
    if kind == "tick":
        return "a tick"
    if kind == Kind.HIBERNATED:
        return "that the world was put to sleep"
    text = data.decode(errors="replace")
    return f"client {client} {kind}" + (f" {text}" if kind in ("command", "refused") else "")


def _field(one: _Input | None, other: _Input | None) -> tuple[str | None, tuple[Any, Any]]:
    """Returns the path of the first field in which two commands differ, and its values."""
    if one is None or other is None or one[:2] != other[:2] or one[0] != Kind.COMMAND:
        return None, (None, None)
    difference = json_difference(message_or_text(one[2]), message_or_text(other[2]))
    if difference is None or not difference.field:
        return None, (None, None)  # they are written otherwise, and mean the same; or one is no object
    return difference.field, (difference.expected, difference.actual)


def excerpts(first: str, second: str) -> tuple[str, str]:
    """Cuts two texts that differ down to what stands around their first difference, where they are long."""
    if max(len(first), len(second)) <= _SHOWN:
        return first, second
    same = next((i for i, (one, other) in enumerate(zip(first, second, strict=False)) if one != other), None)
    start = max(0, (min(len(first), len(second)) if same is None else same) - _BEFORE)
    head = min(_HEAD, start)  # by which it is known what it is
    return _cut(first, head, start), _cut(second, head, start)


def _cut(text: str, head: int, start: int) -> str:
    end = start + _SHOWN - head
    between = "" if head == start else "..."
    return f"{text[:head]}{between}{text[start:end]}{'...' if end < len(text) else ''}"


def _states_part(tick: int, one: States, other: States) -> StatesPart:
    """Finds the value that differs most after a tick."""
    if one.names != other.names:
        return StatesPart(tick, None, "cubes", one.names, other.names)
    gaps = abs(one.values - other.values)
    if not gaps.size or not gaps.any():
        return StatesPart(tick)  # it lies in what is not a pose: a motor's target, the state of a generator
    row, column = divmod(int(gaps.argmax()), len(COLUMNS))
    return StatesPart(
        tick, one.names[row], COLUMNS[column], float(one.values[row, column]), float(other.values[row, column])
    )


def _add_distances(drifts: dict[str, list[Drift]], time: float, one: States, other: States) -> None:
    """Adds to each cube's drifts how far it is apart now."""
    others = dict(zip(other.names, other.values.tolist(), strict=True))
    for name, pose in zip(one.names, one.values.tolist(), strict=True):
        if name in others:
            angle = angle_between(pose[3:7], others[name][3:7])
            drifts.setdefault(name, []).append(Drift(time, math.dist(pose[:3], others[name][:3]), angle))
