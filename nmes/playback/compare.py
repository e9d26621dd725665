"""Running a recording again, and finding the first thing that comes out differently.

A fresh world is fed the recorded inputs in file order. Its journal is not a recorder but a checker: whatever the world
tells it must be the next record of the file, byte for byte for replies, digest for digest for ticks. A `step` ticks
inside its command, as it did when it was recorded; a tick that the file holds and no command makes is the clock's,
and is made here. So there is one list of expectations, and the world walks through it.

Invariants:

- Everything recorded is either fed or compared, but for what the schemas call volatile; nothing is skipped in silence.
- The verdict `reproduced` is only given on an equal fingerprint.
- What is reported as divergence is the first one; nothing after it is compared but to show its effect.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import orjson

from nmes import protocol
from nmes.backend import load_backend
from nmes.backend.fingerprint import differences, fingerprint
from nmes.errors import BackendNotFound, RecordingError
from nmes.playback.inputs import apply_input
from nmes.playback.restore import make_world
from nmes.protocol import Request
from nmes.recording import Kind, Record, Recording, Start
from nmes.recording.viewer_messages import POSE_FIELDS, Painter, decode_poses
from nmes.world import World

__all__ = ["Difference", "Divergence", "ReplayReport", "difference", "replay"]

# Replies of which the content may differ between machines that agree on everything else: pictures. Where one of them
# could be made, and where none could, is not a divergence either.
_VOLATILE = {kind for kind, reply in protocol.REPLIES.items() if reply.schema.get("x-volatile")}

Progress = Callable[[int, int], None]
Watch = Callable[[World, Request | None], None]
Verdict = Literal["reproduced", "diverged", "not_comparable"]


@dataclass(frozen=True, slots=True)
class Difference:
    """One value that differs: where it is, what was recorded, what came out now, and by how much if it is a number."""

    cube: str | None
    field: str
    expected: Any
    actual: Any

    @property
    def amount(self) -> float | None:
        """The distance between two numbers."""
        values = (self.expected, self.actual)
        if any(isinstance(value, bool) or not isinstance(value, int | float) for value in values):
            return None
        return abs(float(self.actual) - float(self.expected))


@dataclass(slots=True)
class Divergence:
    """The first difference between a recording and its replay.

    Attributes:
        kind: What differs: a tick's `digest`, a `reply`, the `poses`, a `keyframe`, a `fault`, a `client`'s number, or
            the `order` in which things happen.
        frame: Where the world was.
        record: The number of the record in the recording.
        message: All of it in a sentence.
        client: Whose command it was, of a reply.
        command: That command's type.
        value: The first value that shows it, if any does. Digests do not: for them it is the first recorded reply or
            pose that comes out differently from then on.
        seen: The frame at which that value was seen.
    """

    kind: str
    frame: int
    record: int
    message: str
    client: int | None = None
    command: str | None = None
    value: Difference | None = None
    seen: int | None = None

    def to_json(self) -> dict[str, Any]:
        """Returns it as plain data, with the fields of the value among the others."""
        plain = asdict(self)
        del plain["value"]
        if self.value is not None:
            plain |= {**asdict(self.value), "difference": self.value.amount}
        return plain


@dataclass(slots=True)
class ReplayReport:
    """What a replay came to.

    Attributes:
        verdict: `not_comparable` stands whenever the fingerprints differ, whatever came out.
        frames: From which frame to which it was run, counted on through resets.
        part: Whether only a part was asked for.
        ticks: How many ticks were compared and equal.
        commands: How many frames of clients were executed and answered the same.
        sim_seconds: The simulation time of those ticks, s.
        wall_seconds: How long it took, s.
        divergence: The first difference, if there is any.
        differences: The items of the fingerprint that differ: recorded, here.
        damage: Why the recording ends early, if it does; of a part, why that does.
        cut: Whether it just ends there, as after a crash, rather than being damaged.
    """

    verdict: Verdict
    frames: tuple[int, int] = (0, 0)
    part: bool = False
    ticks: int = 0
    commands: int = 0
    sim_seconds: float = 0.0
    wall_seconds: float = 0.0
    divergence: Divergence | None = None
    differences: dict[str, tuple[str, str]] = field(default_factory=dict)
    damage: str | None = None
    cut: bool = False

    @property
    def speed(self) -> float:
        """How many times faster than real time it was."""
        return self.sim_seconds / self.wall_seconds if self.wall_seconds else 0.0

    def to_json(self) -> dict[str, Any]:
        """Returns it as plain data."""
        return {
            "verdict": self.verdict,
            "frames": list(self.frames),
            "ticks": self.ticks,
            "commands": self.commands,
            "sim_seconds": self.sim_seconds,
            "wall_seconds": self.wall_seconds,
            "speed": self.speed,
            "divergence": None if self.divergence is None else self.divergence.to_json(),
            "differences": self.differences,
            "damage": self.damage,
            "cut": self.cut,
        }


def replay(
    recording: Recording | str | os.PathLike[str],
    *,
    anyway: bool = False,
    progress: Progress | None = None,
    watch: Watch | None = None,
    first: int | None = None,
    last: int | None = None,
) -> ReplayReport:
    """Runs a recording again in a fresh world, or a part of it.

    Args:
        recording: The recording, or its file.
        anyway: Run it also where the fingerprint differs, to see how far it agrees.
        progress: Called now and then with how many bytes of the file are done, and its size.
        watch: Called with the world after each frame of a client that was answered as recorded, with that frame, and
            after each tick that came out as recorded, a fault among them, with None. What it raises ends the replay.
        first: From which frame on, counted on through resets. The replay begins at the last keyframe before it, or at
            the beginning; what stands before is not read. None: from the beginning.
        last: Up to which frame, with what was sent then, or to the end of the command that ticks beyond it; None: to
            the end.

    Raises:
        RecordingError: The file cannot be read as a recording, or has no frame `first`.
        BackendNotFound: Its engine is not there, and it was to be run `anyway`.
    """
    if not isinstance(recording, Recording):
        recording = Recording(recording)
    unlike = _differences(recording)
    if unlike and not anyway:
        return ReplayReport("not_comparable", differences=unlike)
    began = time.perf_counter()
    start = recording.start(first)
    run = _Run(recording, start, last, progress, watch)
    run.play()
    took = time.perf_counter() - began
    if first is not None and run.frame < first and run.divergence is None:
        raise RecordingError("no_such_frame", f"{recording.path} ends at frame {run.frame}; it has no frame {first}")
    damage = recording.stopped if start.within or last is not None else recording.damage
    return ReplayReport(
        verdict="not_comparable" if unlike else "diverged" if run.divergence else "reproduced",
        frames=(start.frame, run.frame),
        part=(first, last) != (None, None),
        ticks=run.ticks,
        commands=run.commands,
        sim_seconds=run.ticks / recording.config["tick_rate"],
        wall_seconds=took,
        divergence=run.divergence,
        differences=unlike,
        damage=damage.message if damage else None,
        cut=damage.cut if damage else False,
    )


def _differences(recording: Recording) -> dict[str, tuple[str, str]]:
    try:
        backend = load_backend(recording.config["backend"])
    except BackendNotFound:
        return {"backend": (recording.config["backend"], "not installed")}
    return differences(recording.fingerprint, fingerprint(backend))


class _Ended(BaseException):
    """The recording ends in the midst of a command: the world must not go on."""


class _Tape:
    """The recorded history, record by record, with a look ahead; it ends where the recording does."""

    def __init__(self, recording: Recording, start: Start, progress: Progress | None) -> None:
        self._queue: deque[Record] = deque()
        self._chunks = self._read(recording, start, progress)

    def _read(self, recording: Recording, start: Start, progress: Progress | None) -> Iterator[None]:
        for reached, records in recording.chunks(start):
            self._queue.extend(records)
            if progress is not None:
                progress(reached, recording.size)
            yield

    def peek(self, ahead: int = 0) -> Record | None:
        """Returns the next record, or a later one, without taking it."""
        while len(self._queue) <= ahead:
            try:
                next(self._chunks)
            except StopIteration:
                return None
        return self._queue[ahead]

    def take(self) -> None:
        """Goes on to the next record."""
        self._queue.popleft()


class _Run:
    """One replay: it feeds a world, and it is that world's journal, which compares."""

    def __init__(
        self, recording: Recording, start: Start, until: int | None, progress: Progress | None, watch: Watch | None
    ) -> None:
        self.frame = start.frame
        self.ticks = 0
        self.commands = 0
        self.divergence: Divergence | None = None
        self._watch = watch
        self._tape = _Tape(recording, start, progress)
        self._world = make_world(recording, start, self)
        self._world.between = self._between
        self._until = until
        self._painter = Painter(self._world)
        self._unseen = start.within  # whether viewers were shown things before that this painter has not drawn
        self._digests: list[str] = []  # of the run of ticks at hand, the next one last
        self._over = False  # whether there is nothing more to be learnt
        self._mistake: Exception | None = None
        self._told = 0  # how often the world told us something: it must, whatever it is fed

    def play(self) -> None:
        """Feeds the world the whole recording, or as much as it takes to see where it parts."""
        world, tape = self._world, self._tape
        try:
            if (record := tape.peek()) is not None and record.kind is Kind.KEYFRAME:
                tape.take()  # with which the world began
            while not self._over and (record := tape.peek()) is not None and not self._reached(record):
                told = self._told
                apply_input(world, record, tape.peek(1) if record.kind is Kind.REFUSED else None)
                if self._mistake is not None:
                    raise self._mistake
                if told == self._told:
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
        if self._over or self._tape.peek() is None:
            raise _Ended

    def _reached(self, record: Record) -> bool:
        """Whether the next tick, which comes now, is beyond what was asked for."""
        if self._until is None or self._world.ticks < self._until:
            return False
        following = self._tape.peek(1) if record.kind is Kind.COMMAND else record
        return self._world.ticks > self._until or following is None or following.kind in (Kind.TICKS, Kind.FAULT)

    # -- the journal -----------------------------------------------------------------------------------------------

    def joined(self, client: int) -> None:
        """A client came."""
        self._client(Kind.JOINED, client)

    def left(self, client: int) -> None:
        """A client went."""
        self._client(Kind.LEFT, client)

    def _client(self, kind: Kind, client: int) -> None:
        record = self._expect(kind)
        if record is not None and record.client != client:
            self._diverge("client", record, f"client {record.client} {kind}; now it has number {client}")
            self._over = True

    def received(self, client: int, request: Request) -> None:
        """A frame is executed next: the one that was just fed."""
        self._told += 1
        self._tape.take()

    def replied(self, client: int, request: Request, reply: bytes) -> None:
        """A frame was answered."""
        record = self._expect(Kind.REPLY)
        if record is None:
            return
        if record.client == client and (record.data == reply or _alike(record.data, reply)):
            if self.divergence is None:
                self.commands += 1
                self._show_to_watch(request)
            return
        shown = difference(_json(record.data), _json(reply))
        if self.divergence is not None:
            self._show(shown)
            return
        message = f"client {client}'s {request.type or 'refused frame'} is answered differently"
        self._diverge("reply", record, message, client, request.type)
        self._show(shown or Difference(None, "", record.data.decode(errors="replace"), reply.decode(errors="replace")))

    def ticked(self, frame: int, digest: bytes) -> None:
        """The world reached a frame."""
        try:
            self._compare_tick(frame, digest)
        except Exception as error:
            # In a `step` the world takes it for a fault of its own; it is one of ours, and no divergence.
            self._mistake = error
            raise

    def _compare_tick(self, frame: int, digest: bytes) -> None:
        self._told += 1
        record = self._tape.peek()
        if record is None or self._over:
            return
        if record.kind is not Kind.TICKS or record.about is None:
            self._diverge("order", record, f"the recording has {_describe(record)}; now the world ticks")
            self._over = True
            return
        if not self._digests:
            self._digests = record.about["digests"][::-1]
        expected = record.about["frame"] + len(record.about["digests"]) - len(self._digests)
        same = self._digests.pop() == digest.hex() and expected == frame
        if not self._digests:
            self._tape.take()
        if same:
            if self.divergence is None:
                self.ticks += 1
                self._show_to_watch(None)
        elif self.divergence is None:
            what = "its digest differs" if expected == frame else f"it was tick {expected}"
            self._diverge("digest", record, f"tick {frame} does not come out as recorded: {what}")
        if not self._digests:
            self._look()

    def _show_to_watch(self, request: Request | None) -> None:
        if self._watch is not None and self._mistake is None:
            try:
                self._watch(self._world, request)
            except Exception as error:
                self._mistake = error

    def keyframe(self, snapshot: bytes) -> None:
        """The world was saved."""
        record = self._expect(Kind.KEYFRAME)
        if record is not None and record.data != snapshot:
            frame = self._world.frame
            self._diverge(
                "keyframe", record, f"the world that was saved at frame {frame} does not come out as recorded"
            )

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
        self._told += 1
        record = self._tape.peek()
        if record is None or self._over:
            return None
        if record.kind is not kind:
            self._diverge("order", record, f"the recording has {_describe(record)}; now comes: {kind}")
            self._over = True
            return None
        self._tape.take()
        return record

    def _look(self) -> None:
        """Compares what the recording shows to viewers at this frame, if anything."""
        if (first := self._tape.peek()) is None or first.kind not in (Kind.SCENE, Kind.BOX, Kind.POSES):
            return
        boxes: dict[str, bytes] = {}
        while (record := self._tape.peek()) is not None and record.kind is Kind.BOX and record.about is not None:
            boxes[record.about["cube"]] = record.data
            self._tape.take()
        recorded: dict[Kind, bytes | None] = {}
        for kind in (Kind.SCENE, Kind.POSES):
            record = self._tape.peek()
            if record is not None and record.kind is kind:
                recorded[kind] = record.data
                self._tape.take()
        if Kind.POSES not in recorded:
            return  # cut between the two
        view = self._painter.draw(self._painter.look())
        if self._unseen:
            self._unseen = False
            recorded[Kind.SCENE], boxes = view.scene, {}
        # Not every cube has a box of its own in the file, nor has every file: the scene has them all.
        same = (recorded.get(Kind.SCENE), recorded[Kind.POSES]) == (view.scene, view.poses)
        if not same or not boxes.items() <= view.boxes.items():
            self._diverge("poses", first, f"at frame {self._world.frame} viewers are shown something else")
            self._show(_pose_difference(recorded[Kind.POSES] or b"", view.poses))

    # -- what differs ----------------------------------------------------------------------------------------------

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
        case Kind.KEYFRAME:
            return f"a keyframe (record {record.sequence})"
    return f"a picture of the scene (record {record.sequence})"


def _alike(expected: bytes, actual: bytes) -> bool:
    """Whether two replies differ only in what is volatile, alone or in a batch."""
    volatile = any(f'"type":"{kind}"'.encode() in reply for kind in _VOLATILE for reply in (expected, actual))
    return volatile and difference(_json(expected), _json(actual)) is None


def _json(data: bytes) -> Any:
    try:
        return orjson.loads(data)
    except ValueError:
        return None


def difference(expected: Any, actual: Any, cube: str | None = None, path: str = "") -> Difference | None:
    """Returns the first value in which two JSON documents differ; its path begins at the cube that it is about."""
    if isinstance(expected, dict) and isinstance(actual, dict):
        if expected.get("type") in _VOLATILE or actual.get("type") in _VOLATILE:
            return None
        name = expected.get("cube_name")
        if isinstance(name, str) and name == actual.get("cube_name"):
            cube, path = name, ""
        for key in {**expected, **actual}:
            if key not in expected or key not in actual:
                return Difference(cube, f"{path}{key}", expected.get(key), actual.get(key))
            if found := difference(expected[key], actual[key], cube, f"{path}{key}/"):
                return found
        return None
    if isinstance(expected, list) and isinstance(actual, list):
        for i, (one, other) in enumerate(zip(expected, actual, strict=False)):
            if found := difference(one, other, cube, f"{path}{i}/"):
                return found
        if len(expected) == len(actual):
            return None
        return Difference(cube, path.rstrip("/"), f"{len(expected)} items", f"{len(actual)} items")
    # As text, so that 0.0 and -0.0 are two things, as they are to the engine.
    if orjson.dumps(expected) == orjson.dumps(actual):
        return None
    return Difference(cube, path.rstrip("/"), expected, actual)


def _pose_difference(recorded: bytes, now: bytes) -> Difference | None:
    """Returns the value in which the poses of two transforms messages differ most."""
    expected, actual = decode_poses(recorded), decode_poses(now)
    if list(expected) != list(actual):
        return Difference(None, "cubes", list(expected), list(actual))
    found = [
        Difference(cube, name, one, other)
        for cube in expected
        for name, one, other in zip(POSE_FIELDS, expected[cube], actual[cube], strict=True)
        if one != other
    ]
    return max(found, key=lambda difference: difference.amount or 0.0, default=None)
