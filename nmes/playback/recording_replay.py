"""Running a recording again, and finding the first thing that comes out differently.

A fresh world is fed the recorded inputs in file order. Its journal is not a recorder but a checker: each of its calls
must be the next record of the file, byte for byte for replies, digest for digest for ticks. A `step` ticks inside its
command, as it did when it was recorded; a tick that the file holds and no command makes is the clock's, and is made
here. So there is one list of expectations, and the world walks through it.

Invariants:

- Everything recorded is either fed or compared, but for what the schemas call volatile; nothing is skipped in silence.
- Equal digests decide: a recording that comes out the same is `reproduced`, wherever. Only what differs is called
  `not_comparable` where the fingerprints differ too, else `diverged`.
- What is reported as divergence is the first one; nothing after it is compared but to show its effect.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from nmes.errors import BackendNotFound, RecordingError
from nmes.playback.divergence import (
    Difference,
    Divergence,
    equal_replies,
    pose_difference,
    reply_difference,
)
from nmes.playback.inputs import Progress, apply_input, walk
from nmes.playback.report import RunReport, fingerprint_differences
from nmes.playback.restore import make_world
from nmes.protocol import Request
from nmes.recording import Kind, Record, Recording, Start
from nmes.recording.viewer_messages import Painter
from nmes.schemas.documents import JsonObject
from nmes.world import World
from nmes.world.journal import Journal

__all__ = ["ReplayReport", "replay"]

Watch = Callable[[World, Request | Kind | None], None]


@dataclass(slots=True)
class ReplayReport(RunReport):
    """The result of a replay.

    Attributes:
        verdict: `reproduced`; `diverged`; or `not_comparable`, where something came out differently, or the engine is
            not there at all, and the fingerprints differ. Their items that do are the `differences`, also where all
            came out the same.
        frames: From which frame to which it was run, counted on through resets.
        part: Whether only a part was asked for.
        sim_seconds: The simulation time of the ticks that came out the same, s.
        divergence: The first difference, if there is any.
        cut: Whether the recording just ends where it is damaged, as after a crash.
    """

    frames: tuple[int, int] = (0, 0)
    part: bool = False
    sim_seconds: float = 0.0
    divergence: Divergence | None = None
    cut: bool = False

    @property
    def speed(self) -> float:
        """How many times faster than real time it was."""
        return self.sim_seconds / self.wall_seconds if self.wall_seconds else 0.0

    def to_json(self) -> dict[str, Any]:
        """Makes a dict of it for JSON: its attributes but for `part`, and `speed`."""
        plain = RunReport.to_json(self) | {"speed": self.speed}
        del plain["part"]
        return plain


def replay(
    recording: Recording | str | os.PathLike[str],
    *,
    progress: Progress | None = None,
    watch: Watch | None = None,
    first: int | None = None,
    last: int | None = None,
) -> ReplayReport:
    """Runs a recording again in a fresh world, or a part of it.

    Args:
        recording: The recording, or its file.
        progress: Called now and then with how many bytes of the file are done, and its size.
        watch: Called with the world after each frame of a client that was answered as recorded, with that frame; after
            each tick that came out as recorded, a fault among them, with None; after a client came or left, and before
            the world sleeps, with the kind of the record. What it raises ends the replay.
        first: From which frame on, counted on through resets. The replay begins at the last keyframe before it, or at
            the beginning; what stands before is not read. None: from the beginning.
        last: Up to which frame, with what was sent then, or to the end of the command that ticks beyond it; None: to
            the end.

    Raises:
        RecordingError: The file cannot be read as a recording, has no frame `first`, or begins after `last`.
    """
    if not isinstance(recording, Recording):
        recording = Recording(recording)
    differences = fingerprint_differences(recording.config["backend"], recording.fingerprint)
    began = time.perf_counter()
    start = recording.start(first)
    begins = recording.start().frame
    if last is not None and last < begins:  # else it would be said of nothing that it was reproduced
        raise RecordingError("no_such_frame", f"{recording.path} begins at frame {begins}; it has no frame {last}")
    try:
        run = _RecordingReplay(recording, start, last, progress, watch)
    except BackendNotFound:
        return ReplayReport("not_comparable", differences=differences)
    run.play()
    wall_seconds = time.perf_counter() - began
    if first is not None and run.frame < first and run.divergence is None:
        raise RecordingError("no_such_frame", f"{recording.path} ends at frame {run.frame}; it has no frame {first}")
    damage = recording.stopped if start.within or last is not None else recording.damage
    return ReplayReport(
        verdict="reproduced" if run.divergence is None else "not_comparable" if differences else "diverged",
        frames=(start.frame, run.frame),
        part=(first, last) != (None, None),
        ticks=run.ticks,
        commands=run.commands,
        sim_seconds=run.ticks / recording.config["tick_rate"],
        wall_seconds=wall_seconds,
        divergence=run.divergence,
        differences=differences,
        damage=damage.message if damage else None,
        cut=damage.cut if damage else False,
    )


class _Ended(BaseException):
    """The recording ends in the midst of a command: the world must not go on."""


class _RecordingReplay(Journal):
    """One replay: it feeds a world, and it is that world's journal, which compares."""

    def __init__(
        self, recording: Recording, start: Start, until: int | None, progress: Progress | None, watch: Watch | None
    ) -> None:
        self.frame = start.frame
        self.ticks = 0
        self.commands = 0
        self.divergence: Divergence | None = None
        self._watch = watch
        self._walk = walk(recording, start, progress)
        self._world = make_world(recording, start, self)
        self._world.between = self._between
        self._until = until
        self._painter = Painter(self._world)
        self._unseen = start.within  # whether viewers were shown things before that this painter has not drawn
        self._ticks: deque[tuple[int, str]] = deque()  # of the record of ticks at hand, those still to come
        self._over = False  # whether there is nothing more to be learnt
        self._mistake: Exception | None = None
        self._calls = 0  # of the journal: there must be one, whatever the world is fed

    def play(self) -> None:
        """Feeds the world the whole recording, or as much as it takes to see where it parts."""
        world, records = self._world, self._walk
        try:
            if (record := records.peek()) is not None and record.kind is Kind.KEYFRAME:
                next(records)  # with which the world began
            while not self._over and (record := records.peek()) is not None and not self._reached(record):
                if record.kind in (Kind.COMMAND, Kind.REFUSED) and records.peek(1) is None:
                    break  # the file was cut behind it: nothing says what came of it, which nothing would compare
                calls = self._calls
                apply_input(world, record, records.peek(1) if record.kind is Kind.REFUSED else None)
                if self._mistake is not None:
                    raise self._mistake
                if calls == self._calls:
                    self._diverge("order", record, f"the recording has {_describe(record)}; nothing such happens now")
                    self._over = True
        except _Ended:
            if self._mistake is not None:
                raise self._mistake from None
        finally:
            self.frame = world.ticks
            world.close()

    def _between(self) -> None:
        """Ends a command where the recording ends, or nothing more is to be learnt."""
        if self._over or self._walk.peek() is None:
            raise _Ended

    def _reached(self, record: Record) -> bool:
        """Tells whether the next tick, which comes now, is beyond the frame that was asked for."""
        if self._until is None or self._world.ticks < self._until:
            return False
        following = self._walk.peek(1) if record.kind is Kind.COMMAND else record
        return self._world.ticks > self._until or following is None or following.kind in (Kind.TICKS, Kind.FAULT)

    # -- the journal -----------------------------------------------------------------------------------------------

    def joined(self, client: int, role: str | None, player: int | None) -> None:
        """A client came."""
        record = self._client(Kind.JOINED, client)
        about = {} if record is None else record.about or {}
        if record is not None and (about.get("role"), about.get("player")) != (role, player):
            self._diverge("client", record, f"client {client} joined otherwise; now as {role}, player {player}")
            self._over = True
        elif record is not None:
            self._show_to_watch(Kind.JOINED)

    def left(self, client: int) -> None:
        """A client went."""
        if self._client(Kind.LEFT, client) is not None:
            self._show_to_watch(Kind.LEFT)

    def _client(self, kind: Kind, client: int) -> Record | None:
        record = self._expect(kind)
        if record is not None and record.client != client:
            self._diverge("client", record, f"client {record.client} {kind}; now it has number {client}")
            self._over = True
            return None
        return record

    def received(self, client: int, request: Request) -> None:
        """A frame is executed next: the one that was just fed."""
        self._calls += 1
        record = next(self._walk)
        if (record.kind is Kind.REFUSED) != (request.error is not None):
            good, bad = "a command", "no command"
            was, now = (bad, good) if record.kind is Kind.REFUSED else (good, bad)
            message = f"client {client}'s frame (record {record.sequence}) was {was}, and is {now} now"
            self._diverge("order", record, message, client, request.type)

    def replied(self, client: int, request: Request, reply: bytes) -> None:
        """A frame was answered."""
        record = self._expect(Kind.REPLY)
        if record is None:
            return
        if record.client == client and equal_replies(record.data, reply):
            if self.divergence is None:
                self.commands += 1
                self._show_to_watch(request)
            return
        value = reply_difference(record.data, reply)
        if self.divergence is not None:
            self._show(value)
            return
        message = f"client {client}'s {request.type or 'refused frame'} is answered differently"
        self._diverge("reply", record, message, client, request.type)
        self._show(value or Difference(None, "", record.data.decode(errors="replace"), reply.decode(errors="replace")))

    def ticked(self, frame: int, digest: bytes) -> None:
        """The world reached a frame."""
        try:
            self._compare_tick(frame, digest)
        except Exception as error:
            # In a `step` the world takes it for a fault of its own; it is one of ours, and no divergence.
            self._mistake = error
            raise

    def _compare_tick(self, frame: int, digest: bytes) -> None:
        self._calls += 1
        record = self._walk.peek()
        if record is None or self._over:
            return
        if record.kind is not Kind.TICKS or record.about is None:
            self._diverge("order", record, f"the recording has {_describe(record)}; now the world ticks")
            self._over = True
            return
        if not self._ticks:
            self._ticks = deque(record.ticks)
        expected, recorded = self._ticks.popleft()
        if not self._ticks:
            next(self._walk)
        if (expected, recorded) == (frame, digest.hex()):
            if self.divergence is None:
                self.ticks += 1
                self._show_to_watch(None)
        elif self.divergence is None:
            reason = "its digest differs" if expected == frame else f"it was tick {expected}"
            self._diverge("digest", record, f"tick {frame} does not come out as recorded: {reason}")
        if not self._ticks:
            self._compare_poses()

    def _show_to_watch(self, happened: Request | Kind | None) -> None:
        if self._watch is not None and self._mistake is None and self.divergence is None:
            try:
                self._watch(self._world, happened)
            except Exception as error:
                self._mistake = error

    def lived(self, frame: int, events: Sequence[JsonObject]) -> None:
        """The ecosystem's events of a tick."""
        record = self._expect(Kind.LIFE)
        if record is not None and record.about != {"frame": frame, "events": list(events)}:
            self._diverge("life", record, f"at frame {frame} something else happens in the ecosystem")

    def keyframe(self, snapshot: bytes) -> None:
        """The world was saved."""
        record = self._expect(Kind.KEYFRAME)
        if record is not None and record.data != snapshot:
            frame = self._world.frame
            self._diverge(
                "keyframe", record, f"the world that was saved at frame {frame} does not come out as recorded"
            )

    def hibernated(self, frame: int) -> None:
        """The world is saved next, to sleep."""
        record = self._expect(Kind.HIBERNATED)
        if record is not None and record.about != {"frame": frame}:
            self._diverge("order", record, f"the recording has {_describe(record)}; now it is at frame {frame}")
        elif record is not None:
            self._show_to_watch(Kind.HIBERNATED)

    def faulted(self, frame: int, code: str, message: str) -> None:
        """The world stopped."""
        record = self._expect(Kind.FAULT)
        if record is not None and record.about != {"frame": frame, "code": code, "message": message}:
            self._diverge("fault", record, f"the recording has {_describe(record)}; now: {code}: {message}")
            self._over = True
        elif record is not None and self.divergence is None:
            self._show_to_watch(None)

    def _expect(self, kind: Kind) -> Record | None:
        """Takes the next record, which must be of a kind; None where there is nothing to compare with."""
        self._calls += 1
        record = self._walk.peek()
        if record is None or self._over:
            return None
        if record.kind is not kind:
            self._diverge("order", record, f"the recording has {_describe(record)}; now comes: {kind}")
            self._over = True
            return None
        next(self._walk)
        return record

    def _compare_poses(self) -> None:
        """Compares the recorded poses and shapes of this frame, if there are any."""
        if (first := self._walk.peek()) is None or first.kind not in (Kind.SCENE, Kind.BOX, Kind.POSES):
            return
        boxes = self._recorded_boxes()
        scene = self._recorded_view(Kind.SCENE)
        poses = self._recorded_view(Kind.POSES)
        if poses is None and self._walk.peek() is None:
            return  # cut between the two
        view = self._painter.draw(self._painter.look())
        if self._unseen:
            self._unseen = False
            scene, boxes = view.scene, {}
        # Not every cube has a box of its own in the file, nor has every file: the scene has them all.
        if (scene, poses) != (view.scene, view.poses) or not boxes.items() <= view.boxes.items():
            self._diverge("poses", first, f"at frame {self._world.frame} viewers are shown something else")
            self._show(None if poses is None else pose_difference(poses, view.poses))

    def _recorded_boxes(self) -> dict[str, bytes]:
        boxes: dict[str, bytes] = {}
        while (record := self._walk.peek()) is not None and record.kind is Kind.BOX and record.about is not None:
            boxes[record.about["cube"]] = record.data
            next(self._walk)
        return boxes

    def _recorded_view(self, kind: Kind) -> bytes | None:
        """Takes the next record if it is of a kind for viewers, and returns its data."""
        record = self._walk.peek()
        return next(self._walk).data if record is not None and record.kind is kind else None

    # -- differences -----------------------------------------------------------------------------------------------

    def _diverge(
        self, kind: str, record: Record, message: str, client: int | None = None, command: str | None = None
    ) -> None:
        if self.divergence is None:
            self.divergence = Divergence(kind, self._world.frame, record.sequence, message, client, command)

    def _show(self, value: Difference | None) -> None:
        """Shows the divergence by a value; there is nothing more to be learnt then."""
        if value is not None and self.divergence is not None:
            self.divergence.value, self.divergence.seen = value, self._world.frame
            self._over = True


def _describe(record: Record) -> str:
    about = record.about or {}
    match record.kind:
        case Kind.JOINED | Kind.LEFT:
            return f"that client {record.client} {record.kind}"
        case Kind.TICKS:
            return f"ticks from frame {about['frame']} on"
        case Kind.FAULT:
            return f"a fault at frame {about['frame']} ({about['code']}: {about['message']})"
        case Kind.COMMAND | Kind.REFUSED | Kind.REPLY:
            return f"client {record.client}'s {record.kind} (record {record.sequence})"
        case Kind.HIBERNATED:
            return f"that the world was put to sleep at frame {about['frame']}"
        case Kind.KEYFRAME:
            return f"a keyframe (record {record.sequence})"
    return f"a picture of the scene (record {record.sequence})"
