"""How far two engines agree on the same experiment: a recording's inputs, run on another engine.

The commands and ticks of a recording are fed to a world on the other engine, and wherever the recording shows poses,
the cubes' distances from them are noted. There is no verdict: two engines never agree bit for bit.

Invariant: what is compared stands after the same number of ticks on both sides; where the two worlds no longer tick
alike (one of them faulted), the comparison ends and says so.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import orjson

from nmes.backend.rotation import angle_between
from nmes.playback.inputs import apply_input, recorded_inputs
from nmes.playback.restore import make_world
from nmes.protocol import Request
from nmes.recording import Kind, Record, Recording
from nmes.recording.viewer_messages import decode_poses
from nmes.world import World

__all__ = ["Drift", "DriftReport", "measure_drift"]


class Drift(NamedTuple):
    """How far one cube is from where it was recorded: at a time (s), in place (m) and in rotation (rad)."""

    time: float
    distance: float
    angle: float


@dataclass(slots=True)
class DriftReport:
    """What the comparison came to.

    Attributes:
        recorded: The engine of the recording.
        backend: The other one.
        cubes: For each cube, in the order of their appearance, its drift over time. The poses of a recording are
            rounded to float32, so 1e-6 is nothing.
        refused: How many commands were answered with an error that were not when they were recorded, by code.
        ticks: How many ticks both took.
        commands: How many commands were executed.
        ended: Why it ended before the recording does, if so.
        sim_seconds: The simulation time of those ticks, s.
        wall_seconds: How long it took, s.
    """

    recorded: str
    backend: str
    cubes: dict[str, list[Drift]] = field(default_factory=dict)
    refused: dict[str, int] = field(default_factory=dict)
    ticks: int = 0
    commands: int = 0
    ended: str | None = None
    sim_seconds: float = 0.0
    wall_seconds: float = 0.0

    def to_json(self) -> dict[str, Any]:
        """Returns it as plain data."""
        plain: dict[str, Any] = {name: getattr(self, name) for name in self.__slots__}
        return plain | {"cubes": {name: [drift._asdict() for drift in drifts] for name, drifts in self.cubes.items()}}


def measure_drift(
    recording: Recording | str | os.PathLike[str],
    backend: str,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> DriftReport:
    """Runs a recording's inputs on another engine and measures how far its cubes drift from where they were.

    Args:
        recording: The recording, or its file.
        backend: Name of the engine.
        progress: Called now and then with how many bytes of the file are done, and its size.

    Raises:
        RecordingError: The file cannot be read as a recording, or begins at a keyframe, which is of another engine.
        BackendNotFound: There is no such engine.
        RejectedMessage: The engine cannot make a world of this config.
    """
    if not isinstance(recording, Recording):
        recording = Recording(recording)
    began = time.perf_counter()
    run = _Run(recording, backend)
    try:
        run.play(_records(recording, progress))
    finally:
        run.world.close()
    report = run.report
    report.ticks = run.ticks
    report.sim_seconds = run.ticks / recording.config["tick_rate"]
    report.wall_seconds = time.perf_counter() - began
    return report


def _records(recording: Recording, progress: Callable[[int, int], None] | None) -> Iterator[Record]:
    for reached, records in recording.chunks():
        yield from records
        if progress is not None:
            progress(reached, recording.size)


class _Run:
    """One comparison: it feeds a world, and is its journal, to look at the world in the midst of a `step`."""

    def __init__(self, recording: Recording, backend: str) -> None:
        config = recording.config
        self.report = DriftReport(config["backend"], backend)
        if backend == config["backend"]:
            self.world = make_world(recording, recording.start(), self)
        else:
            recording.require_beginning(backend)
            # The settings of one engine mean nothing to another.
            self.world = World({**config, "backend": backend, "engine": {}}, journal=self)
        self.ticks = 0  # of our world
        self._recorded = 0  # ticks of the recorded one
        self._shown: dict[int, bytes] = {}  # recorded poses that our world has not come to yet, by ticks
        self._rate = config["tick_rate"]
        self._answer = b""  # the last one that our world gave

    def play(self, records: Iterator[Record]) -> None:
        """Feeds the world until the recording ends or the two part."""
        world, report = self.world, self.report
        for recorded in recorded_inputs(records):
            record = recorded.record
            # The ticks of a command, and what was shown between them, stand before its reply.
            for each in (record, *recorded.effects):
                self._note(each)
            match record.kind:
                case Kind.JOINED | Kind.LEFT:
                    apply_input(world, record)
                case Kind.COMMAND:
                    apply_input(world, record)
                    report.commands += 1
                    error, reply = _error(self._answer), recorded.reply
                    if error is not None and reply is not None and _error(reply.data) is None:
                        report.refused[error] = report.refused.get(error, 0) + 1
                case Kind.TICKS | Kind.POSES:
                    while self.ticks < self._recorded and world.fault is None:
                        world.tick()
                    self._compare()
            if world.fault is not None:
                frame, what = world.fault.frame, world.fault.message
                report.ended = f"{report.backend} stopped at frame {frame}: {what}"
            elif self.ticks != self._recorded:
                report.ended = f"after {self._recorded} recorded ticks, {report.backend} has made {self.ticks}"
            if report.ended is not None:
                return

    def _note(self, record: Record) -> None:
        """Notes what a record says of the recorded world."""
        if record.kind is Kind.TICKS and record.about is not None:
            self._recorded += len(record.about["digests"])
        elif record.kind is Kind.POSES:
            self._shown[self._recorded] = record.data

    def _compare(self) -> None:
        """Compares the cubes with what the recording shows after as many ticks, if it does."""
        if (data := self._shown.pop(self.ticks, None)) is None:
            return
        recorded = decode_poses(data)
        names, rows = self.world.poses()
        here = dict(zip(names, rows[:, :7].tolist(), strict=True))
        now = self.ticks / self._rate
        for name, pose in recorded.items():
            if name in here:
                drift = Drift(now, math.dist(pose[:3], here[name][:3]), angle_between(pose[3:7], here[name][3:7]))
                self.report.cubes.setdefault(name, []).append(drift)

    # -- the journal -----------------------------------------------------------------------------------------------

    def joined(self, client: int) -> None:
        """A client came."""

    def left(self, client: int) -> None:
        """A client went."""

    def received(self, client: int, request: Request) -> None:
        """A frame is executed next."""

    def replied(self, client: int, request: Request, reply: bytes) -> None:
        """A frame was answered."""
        self._answer = reply

    def ticked(self, frame: int, digest: bytes) -> None:
        """The world reached a frame."""
        self.ticks += 1
        self._compare()

    def keyframe(self, snapshot: bytes) -> None:
        """The world was saved."""

    def faulted(self, frame: int, code: str, message: str) -> None:
        """The world stopped."""


def _error(reply: bytes) -> str | None:
    """Returns the code of an error reply."""
    if b'"error"' not in reply:
        return None
    message = orjson.loads(reply)
    return message["code"] if message["type"] == "error" else None
