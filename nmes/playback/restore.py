"""Worlds restored from recordings as they were at a frame.

A world is made of the recording's config, restored from its keyframe, and brought further by its inputs.
"""

from __future__ import annotations

from nmes.errors import NmesError, RecordingError, WorldError
from nmes.playback.inputs import advance, walk
from nmes.playback.report import departure
from nmes.recording import Recording, Start
from nmes.world import World
from nmes.world.journal import Journal
from nmes.world.snapshot import renamed

__all__ = ["make_world", "restore_into", "world_at"]


def make_world(recording: Recording, start: Start, journal: Journal | None = None) -> World:
    """Makes the world that a recording has at a start.

    Args:
        recording: The recording.
        start: A place of it, from `Recording.start`.
        journal: The listener to the world's history from there on.

    Raises:
        RecordingError: The keyframe is no snapshot of such a world (`recording_damaged`, or `not_comparable` where the
            fingerprints differ).
        BackendNotFound: The engine is not there.
    """
    world = World(recording.config, journal=journal)
    try:
        _restore(world, recording, start)
    except RecordingError:
        world.close()
        raise
    return world


def _restore(world: World, recording: Recording, start: Start) -> None:
    if start.snapshot is not None:
        name, snapshot = world.config["name"], start.snapshot
        try:
            if name != recording.config["name"]:
                snapshot = renamed(snapshot, recording.config, name)
            world.restore(snapshot)
        except WorldError as error:
            message = f"the keyframe at frame {start.frame} cannot be used: {error.message}"
            elsewhere = departure(recording, message)
            if elsewhere.code == "not_comparable":
                raise elsewhere from error
            raise RecordingError("recording_damaged", message) from error


def world_at(recording: Recording, frame: int | None = None) -> World:
    """Makes the world as it was at a frame: all that was sent then has acted, and the next tick is to come.

    It is alive and may be driven on, by its clients as they were then or by others. Within a `batch` that ticks, no
    more of it has acted than stands before the next tick.

    Args:
        recording: The recording.
        frame: The frame, counted on through resets; None: where the recording ends.

    Raises:
        RecordingError: There is no such frame (`no_such_frame`), or a tick does not come out as recorded (`diverged`,
            or `not_comparable` where the fingerprints differ).
        BackendNotFound: The engine is not there.
    """
    world = World(recording.config)
    try:
        restore_into(world, recording, recording.last_frame if frame is None else frame)
    except NmesError:
        world.close()
        raise
    return world


def restore_into(world: World, recording: Recording, frame: int) -> None:
    """Brings a new world of a recording's config to a frame of it. No events are emitted on the way.

    Args:
        world: The world, in which nothing has happened; it may have another name.
        recording: The recording.
        frame: The frame, counted on through resets.

    Raises:
        RecordingError: As `world_at`.
    """
    start = recording.start(frame)
    emit, world.emit = world.emit, None
    _restore(world, recording, start)
    advance(world, recording, walk(recording, start), frame)
    world.emit = emit
    if world.ticks != frame:
        raise RecordingError("no_such_frame", f"{recording.path} ends at frame {world.ticks}; it has no frame {frame}")
