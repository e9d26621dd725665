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
from nmes.playback.drift import Drift
from nmes.playback.export import COLUMNS
from nmes.playback.watch import States, states
from nmes.recording import Kind, Recording

__all__ = ["Comparison", "InputsPart", "StatesPart", "compare"]

_INPUTS = {Kind.JOINED, Kind.LEFT, Kind.COMMAND, Kind.REFUSED}
_SAMPLES = 10  # Hz: how often the distance of cubes is noted
_SHOWN = 300  # characters of an input


@dataclass(frozen=True, slots=True)
class InputsPart:
    """The first inputs that are not the same: after how many ticks, and what each recording has there."""

    ticks: int
    first: str
    second: str


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
    """What two recordings have in common and what not; `drifts` has, for each cube of both, how far it is apart."""

    ticks: tuple[int, int]
    inputs: InputsPart | None
    states: StatesPart | None
    drifts: dict[str, list[Drift]] = field(default_factory=dict)

    @property
    def same(self) -> bool:
        """Whether nothing differs."""
        return self.inputs is None and self.states is None

    def to_json(self) -> dict[str, Any]:
        """Returns it as plain data."""
        drifts = {name: [drift._asdict() for drift in line] for name, line in self.drifts.items()}
        return {
            "same": self.same,
            "ticks": list(self.ticks),
            "inputs": None if self.inputs is None else asdict(self.inputs),
            "states": None if self.states is None else asdict(self.states),
            "drifts": drifts,
        }


def compare(first: Recording, second: Recording, *, anyway: bool = False) -> Comparison:
    """Compares two recordings.

    Where states part, both are run again to see how.

    Args:
        first: One of them.
        second: The other.
        anyway: Go on where a tick does not come out as it was recorded, as on another machine.

    Raises:
        RecordingError: A tick does not come out as recorded.
        BackendNotFound: An engine is not there.
    """
    begins = first.start().frame, second.start().frame
    begin = max(begins)
    skip = begin - begins[0], begin - begins[1]
    one, other = list(islice(_digests(first), skip[0], None)), list(islice(_digests(second), skip[1], None))
    tick = next((i for i, (a, b) in enumerate(zip_longest(one, other), begin + 1) if a != b), None)
    inputs = _inputs_part(_inputs(first, skip[0]), _inputs(second, skip[1]), begin)
    comparison = Comparison((len(one), len(other)), inputs, None)
    if tick is not None:
        comparison.states = StatesPart(tick)
        pairs = zip(
            islice(states(first, anyway=anyway), skip[0], None),
            islice(states(second, anyway=anyway), skip[1], None),
            strict=False,
        )
        every = max(1, round(first.config["tick_rate"] / _SAMPLES))
        for number, (a, b) in enumerate(pairs, begin + 1):
            if number == tick:
                comparison.states = _part(tick, a, b)
            if number % every == 0 or number == tick:
                _note(comparison.drifts, number / first.config["tick_rate"], a, b)
    return comparison


def _digests(recording: Recording) -> Iterator[str]:
    for record in recording:
        if record.kind is Kind.TICKS and record.about is not None:
            yield from record.about["digests"]


_Input = tuple[str, int | None, bytes]


def _inputs(recording: Recording, skip: int) -> Iterator[_Input]:
    """Yields what was done to the world; with ticks to skip, from the tick after those on."""
    ticks = 0
    for record in recording:
        if record.kind is Kind.TICKS and record.about is not None:
            for _ in record.about["digests"]:
                ticks += 1
                if ticks > skip:
                    yield "tick", None, b""
        elif record.kind in _INPUTS and (ticks > skip or skip == 0):
            yield str(record.kind), record.client, record.data


def _inputs_part(first: Iterator[_Input], second: Iterator[_Input], ticks: int) -> InputsPart | None:
    for one, other in zip_longest(first, second):
        if one != other:
            return InputsPart(ticks, _told(one), _told(other))
        ticks += one is not None and one[0] == "tick"
    return None


def _told(told: tuple[str, int | None, bytes] | None) -> str:
    if told is None:
        return "the end"
    kind, client, data = told
    if kind == "tick":
        return "a tick"
    text = data.decode(errors="replace")
    return f"client {client} {kind}" + (f" {text[:_SHOWN]}" if kind in ("command", "refused") else "")


def _part(tick: int, one: States, other: States) -> StatesPart:
    """Returns the value that differs most."""
    if one.names != other.names:
        return StatesPart(tick, None, "cubes", one.names, other.names)
    gaps = abs(one.values - other.values)
    if not gaps.size or not gaps.any():
        return StatesPart(tick)  # it lies in what is not a pose: a motor's target, the state of a generator
    row, column = divmod(int(gaps.argmax()), len(COLUMNS))
    return StatesPart(
        tick, one.names[row], COLUMNS[column], float(one.values[row, column]), float(other.values[row, column])
    )


def _note(drifts: dict[str, list[Drift]], time: float, one: States, other: States) -> None:
    there = dict(zip(other.names, other.values.tolist(), strict=True))
    for name, pose in zip(one.names, one.values.tolist(), strict=True):
        if name in there:
            angle = angle_between(pose[3:7], there[name][3:7])
            drifts.setdefault(name, []).append(Drift(time, math.dist(pose[:3], there[name][:3]), angle))
