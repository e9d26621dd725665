"""A recording run again for somebody who watches: whatever they want to see of the world, after every tick.

A recording holds inputs and digests, which is little; every pose, velocity and force follows from them. Here the inputs
are fed to a fresh world, and what a `look` sees of it after each tick is handed out.

Invariant: nothing is handed out of a tick whose digest is not the recorded one, unless that was asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Generic, NamedTuple, TypeVar

from nmes.backend import Array
from nmes.errors import RecordingError
from nmes.playback.inputs import apply_input, recorded_inputs
from nmes.playback.restore import make_world
from nmes.protocol import Request
from nmes.recording import Kind, Recording
from nmes.world import World

__all__ = ["States", "states", "watch"]

_Seen = TypeVar("_Seen")


class States(NamedTuple):
    """All cubes after one tick.

    Attributes:
        frame: The frame.
        time: Its simulation time, s.
        names: The cubes, in order of creation.
        values: An array (n, 13) of positions (m), quaternions, linear (m/s) and angular velocities (rad/s).
    """

    frame: int
    time: float
    names: list[str]
    values: Array


def watch(recording: Recording, look: Callable[[World], _Seen], *, anyway: bool = False) -> Iterator[_Seen]:
    """Runs a recording again and yields what `look` returns of the world after each of its ticks.

    Args:
        recording: The recording.
        look: Called after each tick. It may ask the world for anything that does not change it, and has to copy what
            it keeps. After a `reset`, frames begin at 1 again.
        anyway: Go on where a tick does not come out as it was recorded, as on another machine.

    Raises:
        RecordingError: The file cannot be read, or a tick does not come out as recorded (`diverged`).
        BackendNotFound: Its engine is not there.
    """
    watcher = _Watcher(look)
    world = watcher.world = make_world(recording, recording.start(), watcher)
    try:
        for recorded in recorded_inputs(recording):
            record = recorded.record
            match record.kind:
                case Kind.TICKS:
                    for digest in recorded.digests:
                        apply_input(world, record)
                        yield from watcher.take([digest], anyway)
                case _:
                    apply_input(world, record, recorded.reply)
                    yield from watcher.take(recorded.digests, anyway)
    finally:
        world.close()


def states(recording: Recording, *, anyway: bool = False) -> Iterator[States]:
    """Yields the states after each tick, made by running a recording again. After a `reset`, frames begin at 1 again.

    Args:
        recording: The recording.
        anyway: Go on where a tick does not come out as it was recorded, as on another machine.

    Raises:
        RecordingError: The file cannot be read, or a tick does not come out as recorded (`diverged`).
        BackendNotFound: Its engine is not there.
    """
    return watch(recording, lambda world: States(world.frame, world.time, *world.poses()), anyway=anyway)


class _Watcher(Generic[_Seen]):
    """The journal of a world that is run again: it keeps what was seen after each tick until that is taken."""

    world: World

    def __init__(self, look: Callable[[World], _Seen]) -> None:
        self._look = look
        self._seen: list[tuple[int, str, _Seen]] = []

    def take(self, digests: list[str], anyway: bool) -> Iterator[_Seen]:
        """Yields what was seen since the last time, which must be what was recorded."""
        waiting, self._seen = self._seen, []
        for digest, (frame, found, seen) in zip(digests, waiting, strict=False):
            if digest != found and not anyway:
                raise RecordingError("diverged", f"tick {frame} does not come out as recorded; see nmes replay")
            yield seen
        if len(waiting) < len(digests) and not anyway:
            raise RecordingError("diverged", f"after frame {self.world.frame} there are fewer ticks than recorded")

    def ticked(self, frame: int, digest: bytes) -> None:
        """The world reached a frame."""
        self._seen.append((frame, digest.hex(), self._look(self.world)))

    def joined(self, client: int) -> None:
        """A client came."""

    def left(self, client: int) -> None:
        """A client went."""

    def received(self, client: int, request: Request) -> None:
        """A frame is executed next."""

    def replied(self, client: int, request: Request, reply: bytes) -> None:
        """A frame was answered."""

    def keyframe(self, snapshot: bytes) -> None:
        """The world was saved."""

    def faulted(self, frame: int, code: str, message: str) -> None:
        """The world stopped."""
