"""The writer of recordings: one world's history written down as it happens.

It hides how little that costs a world (notes now, records later), when a chunk is written and the chain's next head
made, and what the file's end says. A `Recorder` is the journal of a live world; `nmes.recording.reader` reads its file.

Invariants:

- What was flushed is never changed; whatever keeps the file from being written is raised, and from then on.
- What a client sent is kept byte for byte; of the raw dialect, its translation. Passwords never get here: a client
  joins after it was authenticated.
- `flush` may be called by another thread than the one in which the world is, at any time: what was noted is written.
- Recording does not change what a world does: it only asks for poses and, of a world with a past, for one
  snapshot first. Keyframes are the world's own.
"""

from __future__ import annotations

import os
import struct
import threading
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from time import time_ns
from typing import TYPE_CHECKING, Any, NoReturn

import orjson

from nmes import protocol
from nmes.backend.fingerprint import VERSION, fingerprint
from nmes.errors import RecordingError, SimulationFault, WorldError
from nmes.protocol import Request
from nmes.recording.channels import (
    CHAIN,
    CHECKSUMS,
    CLIENTS,
    COMMAND,
    FAULTS,
    HIBERNATION,
    KEYFRAME,
    LIFE,
    POSES,
    REFUSED,
    REPLY,
    SCENE,
    TICKS,
    Channels,
)
from nmes.recording.mcap_writer import Writer
from nmes.recording.records import END, FORMAT, PROFILE, REFUSED_LIMIT, SEQUENCE_MASK, next_head, said_by
from nmes.recording.viewer_messages import Painter, Snapshot

if TYPE_CHECKING:
    from nmes.world import World

__all__ = ["Recorder"]

_NS = 1_000_000_000
_FLUSH_SIZE = 256 << 10  # bytes of records: about as many as the processor's caches still hold
_MANY = 512  # notes
_LARGE = 64 << 10  # bytes of a command and its reply that are packed at once
_LARGEST = 4 << 20  # bytes of a chunk before which a view begins a new one
_LONG_RUN = 4096  # ticks
_NEVER = -1  # when a recorder flushed that cannot: the next record of any kind then tries to, and meets the error

_MANY_BOXES = 8192  # cubes; a channel each, of which a file has no more than 65,535

# Channel, or 4 * client + channel; frame, wall time; data, or a tick's digest, or a snapshot to draw.
_Note = tuple[int, int, int, Any]


class Recorder:
    """Writes a world's history to a file; it becomes the world's journal with `world.journal = recorder`.

    Each call of the world is noted, and a few hundred notes at a time are made into records: code that has just run
    runs twice as fast. `flush` writes the records out. It happens when a second has gone by or 256 KiB are waiting; a
    host calls it too, for worlds in which nothing happens, and `commit` before it tells anybody anything. While the
    world is faulted, and after `close` or `rest`, the file has its end and every MCAP reader can read it.

    Args:
        path: A file that does not exist yet.
        world: The world to record. Where it has a past, the recording begins with a keyframe.
        pose_rate: How often the poses are kept for viewers, in Hz of simulation time; 0 for never.
        flush_interval: For how long (s) a record may wait while others come in. With 0, `commit` waits for the disk.
        about: Further metadata records by name: the purpose of the run.

    Raises:
        RecordingError: The file cannot be created, or the world has a past and cannot be saved. Every other method
            raises it when the file cannot be written (`recording_failed`), and from then on.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        world: World,
        *,
        pose_rate: float = 10.0,
        flush_interval: float = 1.0,
        about: Mapping[str, Mapping[str, str]] | None = None,
    ) -> None:
        past = None if world.untouched else _saved(world)
        self.path = Path(path)
        self._world = world
        self._rate: int = world.config["tick_rate"]
        self._pose_every = max(1, round(self._rate / pose_rate)) if pose_rate > 0 else 0
        self._painter = Painter(world)
        self._boxed = 0  # how many cubes have a channel for their box
        self._writer = Writer(path, profile=PROFILE, library=f"nmes {VERSION}")
        self._channels = Channels(self._writer)
        self._notes: list[_Note] = []
        self._lock = threading.RLock()  # over all but the notes: whoever holds it makes records
        self._run: list[bytes] = []  # digests of the ticks packed since the last record
        self._run_end = (0, 0)  # the frame and the wall time of the last of them
        self._frame = self._time = 0  # the last record's frame, and that in ns
        self._sequence = 0
        self._flushed = time_ns()
        self._durable = flush_interval == 0
        self._flush_after = _NS if self._durable else int(flush_interval * _NS)
        self._error: RecordingError | None = None
        try:
            metadata = {**_metadata(world), **(about or {})}
            begin = [self._writer.metadata(name, values) for name, values in metadata.items()]
            self._head = next_head(b"", b"".join(begin))
            if past is not None:
                self.keyframe(past)
                self.flush()  # a file that is there has its past: whoever goes on from it begins nowhere else
                self.commit()
        except BaseException:
            self._writer.close()
            self.path.unlink(missing_ok=True)  # nothing of the history is in it yet
            raise

    # -- the journal -----------------------------------------------------------------------------------------------

    def joined(self, client: int, role: str | None, player: int | None) -> None:
        """Records that a client came; in a world with roles, in a role and as a player."""
        about: dict[str, Any] = {"client": client, "event": "joined"}
        if role is not None:
            about.update(role=role, player=player)
        self._notes.append((CLIENTS, self._world.frame, time_ns(), orjson.dumps(about)))
        self._pack()

    def left(self, client: int) -> None:
        """Records that a client went."""
        self._notes.append((CLIENTS, self._world.frame, time_ns(), b'{"client":%d,"event":"left"}' % client))
        self._pack()

    # What happens for each command of each client is written for speed, and only notes.

    def received(self, client: int, request: Request) -> None:
        """Records a frame as its session read it; of a refused one no more than `REFUSED_LIMIT` bytes and a note."""
        key = 4 * client + (COMMAND if request.error is None else REFUSED)
        self._notes.append((key, self._world.frame, time_ns(), request.raw))

    def replied(self, client: int, request: Request, reply: bytes) -> None:
        """Records a reply."""
        wall = time_ns()
        self._notes.append((4 * client + REPLY, self._world.frame, wall, reply))
        large = len(request.raw) + len(reply) > _LARGE
        if not 0 <= wall - self._flushed < self._flush_after or len(self._notes) > _MANY or large:
            self._pack()

    def ticked(self, frame: int, digest: bytes) -> None:
        """Records a tick, and the poses when it is their turn."""
        wall = time_ns()
        self._notes.append((TICKS, frame, wall, digest))
        if self._pose_every and frame % self._pose_every == 0:
            self._notes.append((POSES, frame, wall, self._painter.look()))
        if not 0 <= wall - self._flushed < self._flush_after or len(self._notes) > _MANY:
            self._pack()

    def lived(self, frame: int, events: Sequence[Mapping[str, Any]]) -> None:
        """Records what happened in the ecosystem in the tick that led to a frame."""
        self._notes.append((LIFE, frame, time_ns(), orjson.dumps({"frame": frame, "events": events})))

    def keyframe(self, snapshot: bytes) -> None:
        """Records a snapshot of the world. It begins a chunk that defines all channels: a reader can begin there."""
        with self._lock:
            self.flush()
            self._writer.repeat_channels()
            self._notes.append((KEYFRAME, self._world.frame, time_ns(), snapshot))
            self._pack()

    def hibernated(self, frame: int) -> None:
        """Records that the world is saved, and its engine let go, until somebody comes."""
        self._notes.append((HIBERNATION, frame, time_ns(), b'{"frame":%d}' % frame))

    def faulted(self, frame: int, code: str, message: str) -> None:
        """Records that the world stopped, and gives the file its end."""
        fault = orjson.dumps({"frame": frame, "code": code, "message": message})
        self._notes.append((FAULTS, frame, time_ns(), fault))
        self.flush()

    def _pack(self) -> None:
        """Makes records of the notes, and flushes when it is time to."""
        with self._lock:
            if self._error is not None:
                raise self._error
            try:
                self._make_records()
            except RecordingError as error:
                self._fail(error)
            # The wall clock may be set back: that is a reason to flush, too.
            if len(self._writer.open_chunk) > _FLUSH_SIZE or not 0 <= time_ns() - self._flushed < self._flush_after:
                self.flush()

    def _make_records(self) -> None:
        notes = self._notes[:]
        del self._notes[: len(notes)]  # the world may note more meanwhile, in its own thread
        for key, frame, wall, content in notes:
            if key == TICKS:
                self._run.append(content)
                self._run_end = frame, wall
                continue
            if self._run:
                self._end_run()
            if key == POSES:
                if len(self._writer.open_chunk) > _LARGEST:
                    self._end_chunk()
                self._add_view(frame, wall, content)
                continue
            if key > 0:
                client, key = divmod(key, 4)
                content = _refused(client, content) if key == REFUSED else said_by(client, content)
            self._add(key, frame, wall, content)
        if len(self._run) > _LONG_RUN:
            self._end_run()

    def _add_view(self, frame: int, wall: int, snapshot: Snapshot) -> None:
        """Makes the records that show a snapshot to viewers: boxes and scene where they changed, and the poses."""
        view = self._painter.draw(snapshot)
        for name, box in view.boxes.items():
            new = name not in self._channels
            if not new or self._boxed < _MANY_BOXES:
                self._boxed += new
                self._add(name, frame, wall, box)
        if view.scene is not None:
            self._add(SCENE, frame, wall, view.scene)
        self._add(POSES, frame, wall, view.poses)

    def _end_run(self) -> None:
        """Makes a record of the ticks since the last one."""
        (frame, wall), digests = self._run_end, '","'.join([digest.hex() for digest in self._run])
        first = frame - len(self._run) + 1
        self._run = []
        self._add(TICKS, frame, wall, f'{{"frame":{first},"digests":["{digests}"]}}'.encode())

    def _add(self, key: int | str, frame: int, wall: int, data: bytes) -> None:
        if frame != self._frame:
            self._frame, self._time = frame, (frame * _NS + self._rate // 2) // self._rate
        # The wall clock may stand before 1970, for which the format has no number.
        self._writer.add(self._channels[key], self._sequence & SEQUENCE_MASK, self._time, max(wall, 0), data)
        self._sequence += 1

    # -- the file --------------------------------------------------------------------------------------------------

    @property
    def settled(self) -> bool:
        """Whether the system has all that was recorded: a `flush` has nothing to write, nor an error to tell."""
        return not (self._notes or self._run or self._writer.open_chunk or self._error)

    def flush(self) -> None:
        """Hands everything recorded so far to the operating system; may be called in any thread."""
        with self._lock:
            if self._error is not None:
                raise self._error
            self._flushed = time_ns()
            try:
                self._write_chunk()
                if self._world.fault is not None:
                    self._seal()
            except RecordingError as error:
                self._fail(error)

    def commit(self) -> None:
        """Where the flush interval is 0: returns when all that was recorded so far is on disk. Else does nothing."""
        if self._durable:
            self.flush()
            self.sync()

    def sync(self) -> None:
        """Returns when all that was flushed so far is on disk; may be called in any thread."""
        if self._error is not None:
            raise self._error
        try:
            self._writer.sync()  # without the lock: the world may note and write more meanwhile
        except RecordingError as error:
            with self._lock:
                self._fail(error)

    def rest(self) -> None:
        """Flushes, gives the file its end, and closes it until there is more to record: its world sleeps."""
        with self._lock:
            if self._error is not None:
                raise self._error
            try:
                self._write_chunk()
                self._seal()
                if self._durable:
                    self._writer.sync()
                self._writer.rest()
            except RecordingError as error:
                self._fail(error)

    def close(self) -> None:
        """Flushes and gives the file its end. A second time it does nothing.

        Raises:
            RecordingError: The end cannot be written; the file is closed all the same.
        """
        with self._lock:
            if self._error is None:
                try:
                    if not (self._writer.rests and self.settled):  # since it woke, there may be notes
                        self._write_chunk()
                        self._seal()
                        if self._durable:
                            self._writer.sync()
                except RecordingError as error:
                    self._fail(error)
                self._error = RecordingError("recording_closed", f"the recording {self.path} is closed")
                self._flushed = _NEVER
                self._writer.close()

    def _fail(self, error: RecordingError) -> NoReturn:
        self._error = error
        self._flushed = _NEVER
        self._writer.close()
        raise error

    def _write_chunk(self) -> None:
        self._make_records()
        if self._run:
            self._end_run()
        self._end_chunk()

    def _end_chunk(self) -> None:
        if self._writer.open_chunk:
            # Both channels first, so that nothing stands between the two messages.
            ends = (self._channels[CHECKSUMS], self._checksums), (self._channels[CHAIN], self._link)
            for channel, describe in ends:
                self._writer.add(channel, self._sequence & SEQUENCE_MASK, self._time, max(self._flushed, 0), describe())
                self._sequence += 1
            self._writer.flush()

    def _checksums(self) -> bytes:
        sums = self._writer.checksums
        return struct.pack(f"<{len(sums)}I", *sums)

    def _link(self) -> bytes:
        self._head = next_head(self._head, self._writer.open_chunk)
        return b'{"head":"%s"}' % self._head.hex().encode()

    def _seal(self) -> None:
        end = {"head": self._head.hex(), "records": str(self._sequence), "closed": _now()}
        self._writer.seal(END, end)


def _refused(client: int, frame: bytes) -> bytes:
    if len(frame) > REFUSED_LIMIT:
        frame = frame[:REFUSED_LIMIT] + b"... (%d bytes in all)" % len(frame)
    return client.to_bytes(4, "little") + frame


def _saved(world: World) -> bytes:
    try:
        return world.snapshot()
    except (WorldError, SimulationFault) as error:
        reason = f"this world has a past, and cannot be saved: {error.message}"
        raise RecordingError("recording_failed", reason) from error


def _metadata(world: World) -> dict[str, dict[str, str]]:
    return {
        "nmes.recording": {
            "format": FORMAT,
            "nmes": VERSION,
            "protocol": str(protocol.PROTOCOL_VERSION),
            "schemas": protocol.schema_hash(),
            "created": _now(),
        },
        "nmes.world": {"config": protocol.encode(world.config).decode(), "seed": str(world.seed)},
        "nmes.fingerprint": fingerprint(world.backend),
    }


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
