"""A recording run again to be watched: a look at the world after every tick.

A recording holds inputs and digests, which is little; every pose, velocity and force follows from them. Here the inputs
are fed to a fresh world, and the result of a `look` at it after each tick is handed out.

Invariant: nothing is handed out of a tick whose digest is not the recorded one, unless that was asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Generic, NamedTuple, TypeVar

from nmes.backend import Array
from nmes.playback.inputs import apply_input, recorded_inputs, walk
from nmes.playback.report import departure
from nmes.playback.restore import make_world
from nmes.recording import Kind, Recording, Start
from nmes.world import World
from nmes.world.journal import Journal

__all__ = ["States", "states", "watch"]

_Sight = TypeVar("_Sight")


class States(NamedTuple):
    """The states of all cubes after one tick.

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


def watch(
    recording: Recording, look: Callable[[World], _Sight], *, keep_going: bool = False, start: Start | None = None
) -> Iterator[_Sight]:
    """Runs a recording again and yields the result of a look at the world after each tick.

    Args:
        recording: The recording.
        look: Called after each tick. It may ask the world for anything that does not change it, and has to copy what
            it keeps. After a `reset`, frames begin at 1 again.
        keep_going: Go on where a tick does not come out as it was recorded, as on another machine.
        start: From where on, from `Recording.start`; None: from the beginning.

    Raises:
        RecordingError: The file cannot be read, or a tick does not come out as recorded (`diverged`, or
            `not_comparable` where the fingerprints differ).
        BackendNotFound: Its engine is not there.
    """
    watcher = _Watcher(recording, look)
    world = watcher.world = make_world(recording, start or recording.start(), watcher)
    try:
        for recorded in recorded_inputs(walk(recording, start)):
            record = recorded.record
            match record.kind:
                case Kind.TICKS:
                    for digest in recorded.digests:
                        apply_input(world, record)
                        yield from watcher.take([digest], keep_going)
                case _:
                    apply_input(world, record, recorded.reply)
                    yield from watcher.take(recorded.digests, keep_going)
    finally:
        world.close()


def states(recording: Recording, *, keep_going: bool = False) -> Iterator[States]:
    """Yields the states after each tick, made by running a recording again. After a `reset`, frames begin at 1 again.

    Args:
        recording: The recording.
        keep_going: Go on where a tick does not come out as it was recorded, as on another machine.

    Raises:
        RecordingError: The file cannot be read, or a tick does not come out as recorded (`diverged`, or
            `not_comparable` where the fingerprints differ).
        BackendNotFound: Its engine is not there.
    """
    return watch(recording, lambda world: States(world.frame, world.time, *world.poses()), keep_going=keep_going)


class _Watcher(Journal, Generic[_Sight]):
    """The journal of a world that is run again: it keeps each tick's digest and sight until they are taken."""

    world: World

    def __init__(self, recording: Recording, look: Callable[[World], _Sight]) -> None:
        self._recording = recording
        self._look = look
        self._ticks: list[tuple[int, str, _Sight]] = []

    def take(self, digests: list[str], keep_going: bool) -> Iterator[_Sight]:
        """Yields the sights of the ticks since the last time, whose digests must be the recorded ones."""
        ticks, self._ticks = self._ticks, []
        for recorded, (frame, digest, sight) in zip(digests, ticks, strict=False):
            if recorded != digest and not keep_going:
                raise departure(self._recording, f"tick {frame} does not come out as recorded; see nmes replay")
            yield sight
        if len(ticks) < len(digests) and not keep_going:
            raise departure(self._recording, f"after frame {self.world.frame} there are fewer ticks than recorded")

    def ticked(self, frame: int, digest: bytes) -> None:
        """The world reached a frame."""
        self._ticks.append((frame, digest.hex(), self._look(self.world)))
