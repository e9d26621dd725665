"""Forks: new recordings that go on from a frame of another, and name it.

Where its engine can save a world, a fork begins with a keyframe. Where it cannot, all that came before is fed to the
world again, and is recorded in the fork too. Either way the fork replays by itself, without its parent.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from nmes.errors import RecordingError
from nmes.playback.restore import restore_into
from nmes.recording import Recorder, Recording
from nmes.recording.records import PARENT
from nmes.world import World

__all__ = ["fork"]


def fork(
    recording: Recording,
    world: World,
    path: str | os.PathLike[str],
    frame: int | None = None,
    *,
    about: Mapping[str, Mapping[str, str]] | None = None,
    **options: Any,
) -> Recorder:
    """Brings a world to a frame of a recording, and begins a new recording there as its journal.

    The clients of that frame are still in it.

    Args:
        recording: The parent.
        world: A new world of the parent's config.
        path: The new recording, a file that does not exist yet.
        frame: The frame, counted on through resets; None: where the parent ends.
        about: Further metadata of the new recording, as of the `Recorder`.
        options: Further arguments of it.

    Raises:
        RecordingError: There is no such frame (`no_such_frame`), a tick on the way does not come out as recorded
            (`diverged`), the world has stopped there, or the new file cannot be written (`recording_failed`).
    """
    frame = recording.last_frame if frame is None else frame
    about = {**(about or {}), PARENT: recording.lineage(frame)}
    if "snapshot" in world.backend.capabilities:
        restore_into(world, recording, frame)
        world.journal = recorder = Recorder(path, world, about=about, **options)
        return recorder
    world.journal = recorder = Recorder(path, world, about=about, **options)
    try:
        restore_into(world, recording, frame)
        recorder.flush()
        recorder.commit()
    except BaseException:
        with suppress(RecordingError):
            recorder.close()
        recorder.path.unlink(missing_ok=True)  # half of a new file is of no use
        raise
    return recorder
