"""A recording in Rerun: run again, with its commands, the forces they applied, and where it diverges.

It hides how the clients' commands are brought in step with the ticks.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import orjson

from nmes.backend import Array, load_backend
from nmes.errors import ProofError, RecordingError
from nmes.evaluation import scores_so_far
from nmes.playback import ReplayReport, replay, watch
from nmes.playback.divergence import message_or_text
from nmes.playback.inputs import recorded_inputs
from nmes.recording import Kind, Recording
from nmes.recording.viewer_messages import Shape
from nmes.view.canvas import Canvas, load_rerun
from nmes.view.time_series import TimeSeries
from nmes.world import World
from nmes.world.scenery import scene_spec

if TYPE_CHECKING:
    import rerun as rr

__all__ = ["Places", "Showing", "show_drift", "show_recording"]

_TEXT = 300  # characters of a command that are shown
_ZERO = (0.0, 0.0, 0.0)
# Commands that come at every tick, or only ask: they can be shown too, but would hide the others.
_EVERY_TICK = frozenset({"step", "drive", "sense", "ping", "compute_reward"})

Json = Mapping[str, Any]


class Places(NamedTuple):
    """Where cubes were at a time.

    Attributes:
        time: s since the recording began.
        names: The cubes'.
        positions: Array (n, 3), m.
    """

    time: float
    names: Collection[str]
    positions: Array


class Showing(NamedTuple):
    """A recording that was drawn.

    Attributes:
        report: The verdict of its replay.
        canvas: Where it was drawn.
        places: Where all cubes were at the times that were drawn; empty where that was not asked for.
    """

    report: ReplayReport
    canvas: Canvas
    places: list[Places]


class _Sight(NamedTuple):
    """A world as it is drawn, after a tick."""

    seed: int
    shapes: dict[str, Shape]
    poses: Array
    joints: list[dict[str, Any]]
    points: Array
    forces: Array


class _Observer:
    """Looks at a world after every tick: notes its figures, and collects the data of the ticks that are drawn."""

    def __init__(self, every: int) -> None:
        self.series = TimeSeries()
        self._every = every
        self._version = -1
        self._shapes: dict[str, Shape] = {}

    def look(self, world: World) -> _Sight | None:
        """Returns the world as it is drawn; None after a tick that is not."""
        self.series.note(world)
        if world.frame % self._every:
            return None
        if world.structure_version != self._version:
            self._version = world.structure_version
            self._shapes = {name: world.cube_shape(name) for name in world.cubes()}
        contacts = world.contacts()
        return _Sight(
            world.seed,
            self._shapes,
            world.poses()[1][:, :7],
            world.joint_infos(),
            np.array([contact.position for contact in contacts]).reshape(-1, 3),
            np.array([np.multiply(contact.normal, contact.force) for contact in contacts]).reshape(-1, 3),
        )


def show_recording(
    recording: Recording,
    stream: rr.RecordingStream,
    root: str,
    *,
    fps: float = 30.0,
    keep_places: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Showing:
    """Runs a recording again and draws it, with its commands, the forces they applied, and where it diverges.

    Args:
        recording: The recording. Its engine must be installed.
        stream: The Rerun stream to draw to.
        root: The entity under which all of it stands.
        fps: How often cubes are drawn, in Hz of simulation time. Forces and commands are shown at their own ticks.
        keep_places: Whether to keep where all cubes were, for `show_drift`.
        progress: Called with how many ticks are done, and how many there are.
    """
    rate: int = recording.config["tick_rate"]
    canvas = Canvas(stream, root, load_backend(recording.config["backend"]).dims == 2)
    report = replay(recording)
    observer, inputs = _Observer(max(1, round(rate / fps))), _Inputs(recording, canvas, rate)
    places: list[Places] = []
    for time, sight in _draw(recording, canvas, observer, inputs, progress):
        if keep_places:
            places.append(Places(time, sight.shapes, sight.poses[:, :3].copy()))  # a view would keep all of the states
    for name, values in observer.series.curves().items():
        canvas.curve(name, observer.series.times, values)
    inputs.plot()
    _draw_score(recording, canvas)
    if report.divergence is not None:
        canvas.at(report.ticks / rate)
        canvas.say(f"diverged: {report.divergence.message}", "ERROR", "divergence")
    return Showing(report, canvas, places)


def _draw(
    recording: Recording, canvas: Canvas, observer: _Observer, inputs: _Inputs, progress: Callable[[int, int], None]
) -> Iterator[tuple[float, _Sight]]:
    """Draws the world tick by tick; yields the times that were drawn, s, and what was seen then."""
    rate: int = recording.config["tick_rate"]
    total = recording.summary().ticks
    seed, tick = None, 0
    for tick, sight in enumerate(watch(recording, observer.look, keep_going=True), start=1):
        progress(tick, total)
        inputs.show(tick)
        if sight is None:
            continue
        canvas.at(tick / rate)
        if sight.seed != seed:
            seed = sight.seed
            canvas.scenery(scene_spec(recording.config, seed))
        if canvas.cubes(sight.shapes, sight.poses):
            canvas.joints(sight.joints)
        canvas.contacts(sight.points, sight.forces)
        inputs.place(sight.shapes, sight.poses[:, :3])
        yield tick / rate, sight
    inputs.show(tick + 1)


def _draw_score(recording: Recording, canvas: Canvas) -> None:
    """Draws the score over time, where the recording is an evaluation's."""
    try:
        times, scores = scores_so_far(recording).T
        canvas.curve("score so far", times, scores)
    except (ProofError, RecordingError) as error:
        if error.code != "not_an_evaluation":
            canvas.say(f"no score: {error.message}", "WARN")


def show_drift(stream: rr.RecordingStream, first: Sequence[Places], second: Sequence[Places]) -> None:
    """Plots how far the cubes of two recordings are apart: those of the same name, at the same times."""
    others = {places.time: places for places in second}
    for time, names, positions in first:
        there = others.get(time)
        other = {} if there is None else dict(zip(there.names, there.positions, strict=True))
        both = zip(names, positions, strict=True)
        apart = [float(np.linalg.norm(at - other[name])) for name, at in both if name in other]
        if apart:
            stream.set_time("time", duration=time)
            stream.log(["drift", "at most (m)"], load_rerun().Scalars(max(apart)))
            stream.log(["drift", "mean (m)"], load_rerun().Scalars(sum(apart) / len(apart)))


class _Line(NamedTuple):
    """A line of the log: a command, a client that came or left, or a fault, and after how many ticks it was."""

    ticks: int
    text: str
    level: str
    pushes: Sequence[tuple[str, Array, Array | None]] = ()  # cube, force (N), point (m)
    rewards: Sequence[tuple[str, float]] = ()


class _Inputs:
    """The inputs of a recording, drawn in step with its ticks."""

    def __init__(self, recording: Recording, canvas: Canvas, rate: int) -> None:
        self._canvas, self._rate = canvas, rate
        self._lines = _lines(recording, rate)
        self._next = next(self._lines, None)
        self._places: dict[str, Array] = {}
        self._rewards: dict[str, list[tuple[float, float]]] = {}

    def place(self, names: Collection[str], positions: Array) -> None:
        """Notes where cubes are, for the forces that act at their middles."""
        self._places = dict(zip(names, positions, strict=True))

    def show(self, tick: int) -> None:
        """Writes the lines of the inputs before a tick, and draws the forces that acted in it."""
        pushes: list[tuple[str, Array, Array]] = []
        while self._next is not None and self._next.ticks < tick:
            line = self._next
            self._canvas.at(line.ticks / self._rate)
            self._canvas.say(line.text, line.level)
            for name, value in line.rewards:
                self._rewards.setdefault(name, []).append((line.ticks / self._rate, value))
            for name, force, point in line.pushes:
                at = point if point is not None else self._places.get(name)
                if at is not None:
                    pushes.append((name, at, force))
            self._next = next(self._lines, None)
        self._canvas.at(tick / self._rate)
        points, forces = (np.array([push[i] for push in pushes]).reshape(-1, 3) for i in (1, 2))
        self._canvas.forces(points, forces, [name for name, _, _ in pushes])

    def plot(self) -> None:
        """Draws the curves of the rewards that clients asked for."""
        for name, points in self._rewards.items():
            times, values = np.array(points).T
            self._canvas.curve(name, times, values)


def _lines(recording: Recording, rate: int) -> Iterator[_Line]:
    """Yields the lines of a recording's log, in order."""
    ticks = 0
    for record, effects in recorded_inputs(recording):
        reply = _object(effects[-1].data) if effects and effects[-1].kind is Kind.REPLY else {}
        match record.kind:
            case Kind.COMMAND:
                yield _command(ticks, record.client, _object(record.data), reply, rate)
            case Kind.REFUSED:
                text = f"client {record.client}: a frame that is no command: {reply.get('message')}"
                yield _Line(ticks, text, "WARN")
            case Kind.JOINED | Kind.LEFT:
                yield _Line(ticks, f"client {record.client} {record.kind}", "INFO")
            case Kind.HIBERNATED:
                yield _Line(ticks, "nobody was there, and the world slept until somebody came", "INFO")
        for other in (record, *effects):
            if other.kind is Kind.TICKS and other.about is not None:
                ticks += len(other.about["digests"])
            elif other.kind is Kind.FAULT and other.about is not None:
                yield _Line(ticks, f"fault: {other.about['message']}", "ERROR")


def _command(ticks: int, client: int | None, command: Json, reply: Json, rate: int) -> _Line:
    """Returns the line of a command, with the forces that it applied and the rewards that it asked for."""
    fields = [f"{name}={orjson.dumps(value).decode()}" for name, value in command.items() if name not in ("type", "id")]
    text = " ".join([f"client {client}: {command.get('type')}", *fields])
    text = text if len(text) <= _TEXT else text[:_TEXT] + "..."
    if reply.get("type") == "error":
        return _Line(ticks, f"{text} -> {reply.get('code')}: {reply.get('message')}", "WARN")
    try:
        pushes, rewards = _acts(client, command, reply, rate)
    except (AttributeError, KeyError, TypeError, ValueError):  # messages that somebody has edited
        pushes, rewards = [], []
    quiet = command.get("type") in _EVERY_TICK or str(command.get("type")).startswith("get_")
    return _Line(ticks, text, "TRACE" if quiet else "INFO", pushes, rewards)


def _acts(
    client: int | None, command: Json, reply: Json, rate: int
) -> tuple[list[tuple[str, Array, Array | None]], list[tuple[str, float]]]:
    """Returns the forces that a command applied, and the rewards that it asked for."""
    pushes: list[tuple[str, Array, Array | None]] = []
    rewards: list[tuple[str, float]] = []
    for part, answer in _parts(command, reply):
        if answer.get("type") == "physics_applied":
            # An impulse is the force that does the same in a tick.
            force = np.array(part.get("force", _ZERO), float) + np.array(part.get("impulse", _ZERO), float) * rate
            if force.any():
                point = part.get("at")
                pushes.append((answer["cube_name"], force, None if point is None else np.array(point, float)))
        elif answer.get("type") == "reward":
            rewards.append((f"reward of client {client}", float(answer["value"])))
    return pushes, rewards


def _object(data: bytes) -> Json:
    """Returns the JSON object of a message; an empty one where somebody has edited it to something else."""
    message = message_or_text(data)
    return message if isinstance(message, dict) else {}


def _parts(command: Json, reply: Json) -> Iterator[tuple[Json, Json]]:
    """Yields a command with its reply, or the parts of a batch with theirs."""
    if reply.get("type") == "batch_result":
        yield from zip(command["commands"], reply["results"], strict=True)
    else:
        yield command, reply
