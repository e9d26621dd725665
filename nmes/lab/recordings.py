"""Recordings: what happened when, and the poses of any moment that a page asks for.

Hides that a recording holds inputs alone: it is run again from its last keyframe before the moment, or on from where
the last answer left it, in a thread. Invariant: what a page asks for costs no more than `PATIENCE` at once.
"""

from __future__ import annotations

import asyncio
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from time import monotonic
from typing import Any, Final, NamedTuple, cast

import numpy as np
from starlette.websockets import WebSocket, WebSocketDisconnect

from nmes.backend import Array
from nmes.errors import NmesError, RecordingError, RejectedMessage
from nmes.lab.folder import LabError
from nmes.lab.lab import Lab
from nmes.lab.scene import FORCES, food_text, force_text, frame_bytes, scene_text
from nmes.playback.restore import world_at
from nmes.playback.watch import watch
from nmes.protocol import parse
from nmes.recording import Kind, Recording
from nmes.schemas.documents import JsonObject, parse_json, write_json
from nmes.world import World

__all__ = ["about_recording", "show_recording"]

PATIENCE: Final = 5.0  # s that a moment, or a list of marks, may take
MOST: Final = 2000  # marks of a recording
_BIRTHS: Final = {"creature_born": "birth", "creature_died": "death"}  # the marks of an ecosystem's events
_NOT_FOUND: Final = 4404  # the code with which a WebSocket is closed
_FURTHEST: Final = 1 << 53
_KEPT: Final = 32 << 20  # bytes of what is seen in one step from the wanted frame on, after which no more is looked at
_EVERYDAY: Final = ("get_", "ping", "step", "subscribe", "unsubscribe", "compute_reward", "apply_")
"""How commands begin of which there are too many to be marks."""


def about_recording(path: Path) -> JsonObject:
    """Returns a recording's world, frames and keyframes, and marks of its commands, faults and births.

    Raises:
        RecordingError: It is none.
    """
    recording = Recording(path)
    start = recording.start()
    marks: list[JsonObject] = []
    keyframes: list[int] = []
    frame, until, whole = start.frame, monotonic() + PATIENCE, True
    for record in recording:
        frame += len(record.digests)
        if record.kind is Kind.KEYFRAME:
            keyframes.append(frame)
        elif record.kind is not Kind.TICKS:
            for mark in _marks(record.kind, record):
                last = marks[-1] if marks else None
                if last is not None and {**last, "count": 1} == {**mark, "frame": frame, "count": 1}:
                    last["count"] += 1
                elif len(marks) < MOST:
                    marks.append({**mark, "frame": frame, "count": 1})
                else:
                    whole = False
        if monotonic() > until:
            whole = False
            break
    config = recording.config
    return {
        "size": recording.size,
        "world": config["name"],
        **{field: config[field] for field in ("backend", "seed", "mode", "tick_rate")},
        "first": start.frame,
        "last": frame if whole else recording.last_frame,
        "keyframes": keyframes,
        "marks": marks,
        "marks_whole": whole,
        "complete": recording.stopped is None,
        "fingerprint": dict(recording.fingerprint),
        "parent": recording.metadata.get("nmes.parent"),
        "evaluation": recording.metadata.get("nmes.evaluation"),
    }


def _marks(kind: Kind, record: Any) -> Iterator[JsonObject]:
    """Yields what a record tells of what happened."""
    match kind:
        case Kind.JOINED | Kind.LEFT:
            yield {"kind": str(kind), "what": f"client {record.client}"}
        case Kind.COMMAND:
            what = parse(record.data).type or "invalid"
            if not what.startswith(_EVERYDAY):
                yield {"kind": "command", "what": what, "client": record.client}
        case Kind.FAULT:
            yield {"kind": "fault", "what": (record.about or {}).get("code", "fault")}
        case Kind.LIFE:
            for event in (record.about or {}).get("events", ()):
                if event["type"] in _BIRTHS:
                    yield {"kind": _BIRTHS[event["type"]], "what": event["creature"]}


class _Sight(NamedTuple):
    """A moment of a recording: its scene by number and as text, its food, the poses, and the forces asked for."""

    scene: int
    text: str
    food: str | None
    poses: bytes
    kinds: Sequence[str]
    forces: Sequence[str]


class _Wanted(NamedTuple):
    """What a page asks for: a frame, and kinds of forces."""

    frame: int
    kinds: Sequence[str]


_Tick = tuple[int, _Sight | None]  # a frame, and what is seen of it


class _Player:
    """A recording that is run again for one page; it is used by one thread at a time."""

    def __init__(self, path: Path) -> None:
        self._recording = Recording(path)
        self._first = self._recording.start().frame
        self._last = self._recording.last_frame
        self._ticks: Generator[_Tick, None, None] | None = None
        self._at = -1  # the frame to which it was run
        self._number, self._version, self._scene = 0, -1, ""  # of the newest scene
        self._wanted = _Wanted(0, ())
        self._food: tuple[Array, str | None] | None = None  # where it was last, also as text
        self._kept = 0  # bytes of what was seen in the step that is run

    def header(self) -> str:
        """Returns the frame that a page is sent first."""
        config = self._recording.config
        about = {"type": "recording", "first": self._first, "last": self._last, "tick_rate": config["tick_rate"]}
        return write_json({**about, "world": config["name"]}).decode()

    def seek(self, wanted: _Wanted) -> _Sight | None:
        """Returns the moment of a frame; None where that takes too long: who asks again goes on from there.

        Raises:
            RecordingError: A tick on the way does not come out as recorded.
        """
        frame = min(max(wanted.frame, self._first), self._last)
        self._wanted = wanted._replace(frame=frame)
        if frame == self._first:
            with closing(world_at(self._recording, frame)) as world:
                return self._see(world)
        start = self._recording.start(frame - 1)
        if self._ticks is None or not max(start.frame, 0) <= self._at < frame:
            self.close()
            self._ticks = cast(Generator[_Tick, None, None], watch(self._recording, self._look, start=start))
            self._at, self._kept = start.frame, 0
        until = monotonic() + PATIENCE
        try:
            for at, sight in self._ticks:
                self._at, self._kept = at, 0  # a step's ticks come when all of them have been looked at
                if at >= frame:
                    as_wanted = sight is not None and sight.kinds == wanted.kinds
                    return sight if as_wanted else self.seek(wanted)  # which begins anew, since this frame was passed
                if monotonic() > until:
                    return None
        except NmesError:
            self.close()  # what has failed yields nothing any more
            raise
        self.close()
        raise RecordingError("recording_damaged", f"the recording ends before frame {frame}")

    def _look(self, world: World) -> _Tick:
        """Returns the frame after a tick, and what is to be seen of it where it is near the one that is wanted.

        One step may have very many ticks, and all are run before the first can be shown: they are looked at up to some
        bytes, which bounds the time, too.
        """
        near = world.ticks == self._wanted.frame or (world.ticks > self._wanted.frame and self._kept < _KEPT)
        return world.ticks, self._see(world) if near else None

    def _see(self, world: World) -> _Sight:
        if world.structure_version != self._version:  # of one history: equal numbers, equal cubes
            self._version, self._number = world.structure_version, self._number + 1
            self._scene = scene_text(world, self._number)
            self._kept += len(self._scene)
        if self._food is None or not np.array_equal(self._food[0], world.entities.food):
            self._food = world.entities.food.copy(), food_text(world)
            self._kept += len(self._food[1] or "")
        kinds, number = self._wanted.kinds, self._number
        forces = [text for kind in kinds if (text := force_text(kind, world, number)) is not None]
        poses = frame_bytes(world, number, world.ticks)
        self._kept += len(poses) + sum(map(len, forces))
        return _Sight(number, self._scene, self._food[1], poses, kinds, forces)

    def close(self) -> None:
        """Ends what is run."""
        if self._ticks is not None:
            self._ticks.close()
        self._ticks = None


async def show_recording(lab: Lab, websocket: WebSocket) -> None:
    """Answers `{"frame": N}` with the poses of that frame, the last of those that wait, until the page hangs up.

    With `"show": ["contacts"]`, of `FORCES`, these come before the poses.
    """
    await websocket.accept()
    try:
        player = await lab.do(_Player, lab.folder.find("recordings", websocket.query_params.get("name", "")))
    except (NmesError, OSError) as error:
        await websocket.send_text(_failure(error))
        await websocket.close(_NOT_FOUND)
        return
    wanted: asyncio.Queue[_Wanted | None] = asyncio.Queue()
    listener = asyncio.create_task(_listen(websocket, wanted))
    try:
        await websocket.send_text(player.header())
        await _play(lab, websocket, player, wanted)
    except WebSocketDisconnect:
        pass
    finally:
        listener.cancel()
        await asyncio.gather(listener, return_exceptions=True)
        await lab.do(player.close)


async def _listen(websocket: WebSocket, wanted: asyncio.Queue[_Wanted | None]) -> None:
    """Puts whatever a page asks for into a queue, and None when it has hung up."""
    while (message := await websocket.receive())["type"] != "websocket.disconnect":
        try:
            asked = parse_json((message.get("text") or "").encode())
        except RejectedMessage:
            asked = None
        frame, show = (asked.get("frame"), asked.get("show", [])) if isinstance(asked, dict) else (None, [])
        if not isinstance(frame, int) or isinstance(frame, bool):
            await websocket.send_text(_failure(LabError("invalid", 'say {"frame": N}', "frame")))
        elif not isinstance(show, list) or not all(kind in FORCES for kind in show):
            reason = f"there is nothing else to show than {', '.join(FORCES)}"
            await websocket.send_text(_failure(LabError("invalid", reason, "show")))
        else:
            wanted.put_nowait(_Wanted(max(0, min(frame, _FURTHEST)), [kind for kind in FORCES if kind in show]))
    wanted.put_nowait(None)


async def _play(lab: Lab, websocket: WebSocket, player: _Player, wanted: asyncio.Queue[_Wanted | None]) -> None:
    """Answers the last of the frames that wait, again and again."""
    told, food = 0, None
    while (asked := await wanted.get()) is not None:
        if not wanted.empty():
            continue
        try:
            sight = await lab.do(player.seek, asked)
        except NmesError as error:
            await websocket.send_text(_failure(error))
            continue
        if sight is None:
            reason = f"frame {asked.frame} is far behind the last keyframe: ask again to go on"
            await websocket.send_text(_failure(LabError("not_yet", reason, "frame")))
            continue
        if sight.scene != told:
            told = sight.scene
            await websocket.send_text(sight.text)
        if sight.food is not None and sight.food != food:
            food = sight.food
            await websocket.send_text(sight.food)
        for text in sight.forces:
            await websocket.send_text(text)
        await websocket.send_bytes(sight.poses)


def _failure(error: Exception) -> str:
    """Returns the frame in which a page is told of a failure."""
    code, message = "recording_unreadable", str(error)
    if isinstance(error, NmesError):
        code, message = error.code, error.message
    return write_json({"type": "error", "code": code, "message": message}).decode()
