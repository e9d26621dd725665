"""The recording of one hosted world: where it lies, and when it was last brought to disk."""

from __future__ import annotations

from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple, Self

from nmes.errors import RecordingError
from nmes.playback.fork import fork
from nmes.recording import Recorder, Recording
from nmes.server.kept_worlds import about_maker, new_recording_path
from nmes.world import World

__all__ = ["Origin", "WorldRecorder"]


class Origin(NamedTuple):
    """The frame of a recording, counted on through resets, from which a hosted world goes on."""

    recording: Recording
    frame: int

    @classmethod
    def end(cls, path: Path) -> Self:
        """Returns the place where a recording ends.

        Raises:
            RecordingError: It cannot be read.
        """
        recording = Recording(path)
        return cls(recording, recording.last_frame)


_POSES = 10.0  # Hz: poses that are kept for viewers
_POSES_OF_LIFE = 2.0  # Hz: those of an ecosystem, which is hundreds of cubes for hours


class WorldRecorder:
    """Writes a world's recording until the world is closed, or has lost it because it cannot be written.

    Attributes:
        path: The recording, a new file that is named after the world and the time.
    """

    def __init__(
        self, world: World, directory: Path, flush_interval: float, origin: Origin | None, maker: str | None = None
    ) -> None:
        """Begins a recording in the directory, which is made if need be.

        Args:
            world: A new world; the recorder becomes its journal.
            directory: Where the file is to be.
            flush_interval: How much (s) of the recording a crash may lose; 0: nothing that was committed.
            origin: Where the world is brought to first; None: it is new.
            maker: Who created the world over the wire; None: the host.

        Raises:
            RecordingError: The file cannot be written, or the world cannot be brought to that frame.
        """
        try:
            directory.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordingError("recording_failed", f"cannot make {directory}: {error.strerror}") from error
        self._world = world
        self.path = new_recording_path(directory, world.config["name"])
        options: dict[str, Any] = {
            "pose_rate": _POSES if world.life is None else _POSES_OF_LIFE,
            "flush_interval": flush_interval,
            "about": about_maker(maker),
        }
        if origin is None:
            self._recorder = world.journal = Recorder(self.path, world, **options)
        else:
            self._recorder = fork(origin.recording, world, self.path, origin.frame, **options)
        self._flushed = monotonic()

    @property
    def lag(self) -> float:
        """How old (s) the oldest record may be that is not written yet."""
        return 0.0 if self._recorder.settled else monotonic() - self._flushed

    def settle(self) -> bool:
        """Tells whether there is nothing to flush; then what comes next is no older than this."""
        if settled := self._recorder.settled:
            self._flushed = monotonic()
        return settled

    def flush(self) -> None:
        """Hands the recording to the system, as far as the world has gone.

        Raises:
            RecordingError: It cannot be written.
        """
        if self._world.journal is not None:
            self._recorder.flush()
            self._flushed = monotonic()

    def sync(self) -> None:
        """Waits until the disk has all that was flushed; may be called in any thread.

        Raises:
            RecordingError: It cannot be written, so what is about to be told may be of what is lost.
        """
        self._recorder.sync()

    def commit(self) -> None:
        """Flushes and waits for the disk where the flush interval is 0; may be called in any thread.

        Raises:
            RecordingError: It cannot be written, so what is about to be told may be of what is lost.
        """
        self._recorder.commit()

    def rest(self) -> None:
        """Completes the recording, and closes its file until there is more to record; may be called in any thread.

        Raises:
            RecordingError: It cannot be written.
        """
        self._recorder.rest()

    def close(self) -> None:
        """Completes the recording; what the world does after that is not recorded.

        Raises:
            RecordingError: It cannot be written; the file is closed all the same.
        """
        self._world.journal = None
        self._recorder.close()
