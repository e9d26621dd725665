"""How far two engines agree on the same experiment: a recording's inputs, run on another engine.

The commands and ticks of a recording are fed to a world on the other engine, and wherever the recording shows poses,
the cubes' distances from them are noted. It is not judged how large they are: two engines never agree bit for bit.

Invariant: what is compared stands after the same number of ticks on both sides; where the two worlds no longer tick
alike (one of them faulted), the comparison ends and says so.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

from nmes.backend.rotation import angle_between
from nmes.errors import RecordingError
from nmes.playback.divergence import message_or_text
from nmes.playback.inputs import Progress, RecordedInput, apply_input, recorded_inputs, walk
from nmes.playback.report import RunReport, fingerprint_differences
from nmes.playback.restore import make_world
from nmes.protocol import Request
from nmes.recording import Kind, Record, Recording
from nmes.recording.viewer_messages import Pose, decode_poses
from nmes.world import World
from nmes.world.journal import Journal

__all__ = ["Drift", "DriftReport", "measure_drift"]


class Drift(NamedTuple):
    """How far one cube is from where it was recorded: at a time (s), in place (m) and in rotation (rad)."""

    time: float
    distance: float
    angle: float


@dataclass(slots=True)
class DriftReport(RunReport):
    """The result of running a recording on another engine; `ticks` and `commands` are those that both executed.

    Attributes:
        verdict: `ran`, or `incomplete` where it ended before the recording does.
        recorded: The engine of the recording.
        backend: The other one.
        cubes: For each cube, in the order of their appearance, its drift over time. The poses of a recording are
            rounded to float32, so 1e-6 is nothing.
        refused: How many commands were answered with an error that were not when they were recorded, by code.
        ended: Why it ended before the recording does, if so.
        sim_seconds: The simulation time of the ticks, s.
    """

    recorded: str = ""
    backend: str = ""
    cubes: dict[str, list[Drift]] = field(default_factory=dict)
    refused: dict[str, int] = field(default_factory=dict)
    ended: str | None = None
    sim_seconds: float = 0.0


def measure_drift(
    recording: Recording | str | os.PathLike[str],
    backend: str,
    *,
    progress: Progress | None = None,
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
    run = _DriftMeasurement(recording, backend)
    try:
        run.play(recorded_inputs(walk(recording, progress=progress)))
    finally:
        run.world.close()
    report = run.report
    report.verdict = "ran" if report.ended is None else "incomplete"
    report.differences = fingerprint_differences(backend, recording.fingerprint)
    report.damage = None if recording.stopped is None else recording.stopped.message
    report.ticks = run.ticks
    report.sim_seconds = run.ticks / recording.config["tick_rate"]
    report.wall_seconds = time.perf_counter() - began
    return report


class _DriftMeasurement(Journal):
    """One comparison: it feeds a world, and is its journal, to look at the world in the midst of a `step`."""

    def __init__(self, recording: Recording, backend: str) -> None:
        config = recording.config
        self.report = DriftReport("ran", recorded=config["backend"], backend=backend)
        if backend == config["backend"]:
            self.world = make_world(recording, recording.start(), self)
        else:
            recording.require_beginning(backend)
            # The settings of one engine mean nothing to another.
            self.world = World({**config, "backend": backend, "engine": {}}, journal=self)
        self.ticks = 0  # of this world
        self._recorded = 0  # ticks of the recorded one
        self._path = recording.path
        self._shown: dict[int, dict[str, Pose]] = {}  # recorded poses that this world has not come to yet, by ticks
        self._rate = config["tick_rate"]
        self._answer = b""  # the last reply of this world

    def play(self, inputs: Iterable[RecordedInput]) -> None:
        """Feeds the world until the recording ends or the two part."""
        for recorded in inputs:
            # The ticks of a command, and what was shown between them, stand before its reply.
            for record in (recorded.record, *recorded.effects):
                self._note(record)
            self._apply(recorded)
            self.report.ended = self._end()
            if self.report.ended is not None:
                return

    def _apply(self, recorded: RecordedInput) -> None:
        match recorded.record.kind:
            case Kind.JOINED | Kind.LEFT | Kind.HIBERNATED:
                apply_input(self.world, recorded.record)
            case Kind.COMMAND:
                apply_input(self.world, recorded.record)
                self.report.commands += 1
                error, reply = _error(self._answer), recorded.reply
                if error is not None and reply is not None and _error(reply.data) is None:
                    self.report.refused[error] = self.report.refused.get(error, 0) + 1
            case Kind.TICKS | Kind.POSES:
                while self.ticks < self._recorded and self.world.fault is None:
                    self.world.tick()
                self._compare()

    def _end(self) -> str | None:
        """Tells why the comparison ends here, if it does."""
        fault, backend = self.world.fault, self.report.backend
        if fault is not None:
            return f"{backend} stopped at frame {fault.frame}: {fault.message}"
        if self.ticks != self._recorded:
            return f"after {self._recorded} recorded ticks, {backend} has made {self.ticks}"
        return None

    def _note(self, record: Record) -> None:
        """Counts the ticks of a record and keeps its poses, until this world has come as far."""
        self._recorded += len(record.digests)
        if record.kind is Kind.POSES:
            try:
                self._shown[self._recorded] = decode_poses(record.data)
            except ValueError as error:
                message = f"{self._path}: record {record.sequence}: {error}"
                raise RecordingError("recording_damaged", message) from error

    def _compare(self) -> None:
        """Compares the cubes with the poses that were recorded after as many ticks, if some were."""
        if (recorded := self._shown.pop(self.ticks, None)) is None:
            return
        names, rows = self.world.poses()
        here = dict(zip(names, rows[:, :7].tolist(), strict=True))
        now = self.ticks / self._rate
        for name, pose in recorded.items():
            if name in here:
                drift = Drift(now, math.dist(pose[:3], here[name][:3]), angle_between(pose[3:7], here[name][3:7]))
                self.report.cubes.setdefault(name, []).append(drift)

    # -- the journal -----------------------------------------------------------------------------------------------

    def replied(self, client: int, request: Request, reply: bytes) -> None:
        """A frame was answered."""
        self._answer = reply

    def ticked(self, frame: int, digest: bytes) -> None:
        """The world reached a frame."""
        self.ticks += 1
        self._compare()


def _error(reply: bytes) -> str | None:
    """Returns the code of a reply if it is an error, else None."""
    if b'"error"' not in reply:
        return None
    message = message_or_text(reply)
    return str(message.get("code")) if isinstance(message, dict) and message.get("type") == "error" else None
