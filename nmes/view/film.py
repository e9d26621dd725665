"""Pictures and films of recordings, drawn off screen on a machine without a display.

It hides the stage, on which an engine that can draw shows cubes at poses that any engine found, the ways of a camera,
and how pictures become a file. Only poses and shapes are needed, so every recording can be filmed, whatever its engine.

Invariants: a picture shows the last tick at or before its time; a file is there whole or not at all.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from math import ceil, cos, hypot, pi, radians, sin, sqrt
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from nmes.backend import Array, BodySpec, BodyState, CameraSpec, Simulation, Vector, load_backend
from nmes.backend import Image as Pixels
from nmes.backend.fingerprint import differences, fingerprint
from nmes.backend.rotation import normalize, quaternion_from_euler
from nmes.errors import BackendNotFound, FilmError, NmesError
from nmes.playback.watch import watch
from nmes.recording import Kind, Recording
from nmes.recording.viewer_messages import Shape, decode_poses, decode_shapes
from nmes.world import World
from nmes.world.scenery import scene_spec

__all__ = ["Cut", "Moment", "Stage", "Way", "film", "moments"]

Way = Literal["follow", "orbit", "fixed"]
Progress = Callable[[int, int], None]

_DRAWN_BY = "mujoco"
_STILL = 1e-6  # s: one step of the stage, in which nothing gets anywhere
_FOV = radians(40.0)
_ELEVATION, _AZIMUTH = radians(20.0), radians(30.0)  # from where one looks; a planar world is looked at from its front
_FRONT = radians(4.0)
_CALM = 0.4  # s: over how long before and after a camera that follows evens out what it follows
_ROUND = 24.0  # s: how long an orbit takes
_NEAREST = 1.0  # m: how little is looked at
_MOVES, _BESIDE = 0.02, 1.5  # m: what gets farther than the one is what one came to see, with what stands beside it
_COLORS = 128  # of a GIF
_ZERO: Vector = (0.0, 0.0, 0.0)
_ROUNDING = 1e-9  # s
_GIF_CLOCK = 100  # Hz: the times of a GIF's pictures are whole hundredths of a second


class Moment(NamedTuple):
    """All there is to see after one tick.

    Attributes:
        time: s since the recording began; a `reset` does not set it back.
        seed: The world's: scenery may follow from it.
        shapes: The cubes in order of creation: edge lengths (m) and colour.
        poses: Array (n, 7): their positions (m) and quaternions (x, y, z, w).
    """

    time: float
    seed: int
    shapes: dict[str, Shape]
    poses: Array


@dataclass(frozen=True, slots=True)
class Cut:
    """What of a recording is shown, and from where.

    Attributes:
        camera: `follow` keeps the middle of what moves in view, `orbit` goes round it as well, `fixed` stands so that
            all of the way can be seen.
        target: The cube to look at, or the beginning that the names of several have; None for all that move and what
            stands beside them.
        begin: s of simulation since the recording began.
        end: The same; None for the recording's end.
        speed: How many seconds of simulation a second of film shows.
    """

    camera: Way = "follow"
    target: str | None = None
    begin: float = 0.0
    end: float | None = None
    speed: float = 1.0


# -- what is shown -----------------------------------------------------------------------------------------------------


def moments(recording: Recording) -> Iterator[Moment]:
    """Yields what there is to see after each tick.

    On the machine and the engine that made it, the recording is run again; elsewhere its recorded poses are shown, and
    what lies between two of them is drawn between them.

    Raises:
        RecordingError: A tick does not come out as recorded (`diverged`).
        FilmError: There is neither the engine nor poses (`nothing_to_see`).
    """
    try:
        alien = differences(recording.fingerprint, fingerprint(load_backend(recording.config["backend"])))
    except BackendNotFound:
        alien = {"backend": ("", "")}
    return _recorded(recording) if alien else _again(recording)


def _again(recording: Recording) -> Iterator[Moment]:
    rate, version, shapes = recording.config["tick_rate"], -1, dict[str, Shape]()

    def look(world: World) -> tuple[int, dict[str, Shape], Array]:
        nonlocal version, shapes
        if world.structure_version != version:
            version, shapes = world.structure_version, {name: world.cube_shape(name) for name in world.cubes()}
        return world.seed, shapes, world.poses()[1][:, :7]

    for tick, seen in enumerate(watch(recording, look), start=1):
        yield Moment(tick / rate, *seen)


def _recorded(recording: Recording) -> Iterator[Moment]:
    """Yields the recorded poses, and one moment a tick between two of them."""
    rate: int = recording.config["tick_rate"]
    before = frame = 0  # ticks before the last reset, and since
    shapes: dict[str, Shape] = {}
    last: Moment | None = None
    for record in recording:
        now_at = round(record.time * rate / 1e9)
        if now_at < frame:
            before += frame
        frame = now_at
        match record.kind:
            case Kind.SCENE:
                shapes = decode_shapes(record.data, shapes)
            case Kind.POSES:
                poses = decode_poses(record.data)
                known = {name: shapes[name] for name in poses if name in shapes}
                found = np.array([poses[name] for name in known], float).reshape(-1, 7)
                now = Moment((before + frame) / rate, recording.config["seed"], known, found)
                if last is not None:
                    yield from _between(last, now, rate)
                yield now
                last = now
    if last is None:
        raise FilmError(
            "nothing_to_see",
            f"{recording.path} was made by another engine or machine, so it cannot be run again here exactly, and it "
            "holds no poses",
        )


def _between(first: Moment, second: Moment, rate: int) -> Iterator[Moment]:
    places = {name: row for row, name in enumerate(second.shapes)}
    rows = [row for row, name in enumerate(first.shapes) if name in places]
    begin = first.poses[rows]
    end = second.poses[[places[name] for name in first.shapes if name in places]]
    # q and -q are the same rotation: the shorter way.
    end[(begin[:, 3:] * end[:, 3:]).sum(axis=1) < 0.0, 3:] *= -1.0
    count = round((second.time - first.time) * rate)
    for i in range(1, count):
        poses = first.poses.copy()
        poses[rows] += (end - begin) * (i / count)
        yield first._replace(time=first.time + i / rate, poses=poses)


def _chosen(recording: Recording, cut: Cut, step: float, progress: Progress) -> list[Moment]:
    """Returns what is shown every `step` s of simulation. `progress` is told how many ticks are done, of how many."""
    found: list[Moment] = []
    last: Moment | None = None
    ticks, rate = recording.summary().ticks, recording.config["tick_rate"]
    total = ticks if cut.end is None else min(ticks, ceil(cut.end * rate))
    for tick, moment in enumerate(moments(recording), start=1):
        progress(tick, total)
        while moment.time > cut.begin + len(found) * step + _ROUNDING:
            found.append(last or moment)
        last = moment
        if cut.end is not None and moment.time >= cut.end:
            break
    if last is None or last.time < cut.begin:
        end = f"ends at {last.time:.2f} s" if last is not None else "has no ticks"
        raise FilmError("nothing_to_see", f"{recording.path} {end}")
    return [*found, last]


# -- the stage ---------------------------------------------------------------------------------------------------------


class Stage:
    """Cubes at any poses, in the scenery of a world.

    Args:
        config: The world's complete config.

    Raises:
        BackendNotFound: The engine that draws is not there.
    """

    def __init__(self, config: dict[str, Any]) -> None:
        self._config = config
        self._build(config["seed"])

    def _build(self, seed: int) -> None:
        scene = replace(scene_spec(self._config, seed), timestep=_STILL, gravity=(0.0, 0.0, 0.0), options={})
        self._simulation: Simulation = load_backend(_DRAWN_BY).create(scene)
        self._bodies: dict[str, tuple[int, Shape]] = {}
        self._made, self._seed = 0, seed

    def show(self, moment: Moment) -> None:
        """Puts all cubes where they are at a moment."""
        if moment.seed != self._seed:
            self.close()
            self._build(moment.seed)
        simulation, bodies = self._simulation, self._bodies
        for name, (body, shape) in list(bodies.items()):
            if moment.shapes.get(name) != shape:
                simulation.remove_body(body)
                del bodies[name]
        for (name, shape), pose in zip(moment.shapes.items(), moment.poses.tolist(), strict=True):
            x, y, z, *turn = pose
            position, quaternion = (x, y, z), normalize((turn[0], turn[1], turn[2], turn[3]))
            if name in bodies:
                simulation.set_body_state(bodies[name][0], BodyState(position, quaternion, _ZERO, _ZERO))
            else:
                self._made += 1
                bodies[name] = (self._made, shape)
                simulation.add_body(self._made, BodySpec(shape[0], 1.0, 0.0, 0.0, position, quaternion))
        simulation.step(1)

    def draw(self, camera: CameraSpec) -> Pixels:
        """Returns the picture, an array (height, width, 3) of bytes.

        Raises:
            WorldError: `unsupported`: no OpenGL works here; the message says what to install.
        """
        return self._simulation.draw(camera, {body: color for body, (_, color) in self._bodies.values()})

    def close(self) -> None:
        """Gives back what drawing took."""
        self._simulation.close()


# -- the camera --------------------------------------------------------------------------------------------------------


def _cameras(shown: Sequence[Moment], cut: Cut, fps: float, size: tuple[int, int]) -> list[CameraSpec]:
    """Returns from where each moment is seen."""
    planar = all(np.abs(moment.poses[:, (2, 3, 4)]).max(initial=0.0) < _ROUNDING for moment in shown)
    names = _looked_at(shown, cut.target)
    middles, radii = _middles(shown, names)
    if cut.camera == "fixed":
        low, high = middles.min(axis=0), middles.max(axis=0)
        radii[:] = np.linalg.norm(high - low) / 2.0 + radii.max()
        middles[:] = (low + high) / 2.0
    else:
        middles, radii = _smooth(middles, fps), _smooth(radii[:, None], fps)[:, 0]
    elevation, azimuth = (_FRONT, 0.0) if planar else (_ELEVATION, _AZIMUTH)
    width, height = size
    found = []
    for i, (middle, radius) in enumerate(zip(middles, radii.tolist(), strict=True)):
        turn = azimuth + (2.0 * pi * i / (_ROUND * fps) if cut.camera == "orbit" else 0.0)
        distance = max(radius, _NEAREST) / sin(_FOV / 2.0) * max(1.0, 0.75 * height / width)
        away = (cos(elevation) * sin(turn), sin(elevation), cos(elevation) * cos(turn))
        x, y, z = (float(m) + distance * a for m, a in zip(middle, away, strict=True))
        found.append(CameraSpec(width, height, _FOV, (x, y, z), quaternion_from_euler(-elevation, turn, 0.0), True))
    return found


def _smooth(values: Array, fps: float) -> Array:
    """Returns the running mean of an array (n, k) over the time before and after, without lag."""
    reach = round(_CALM * fps)
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="edge")
    smooth: Array = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=0).mean(axis=-1)
    return smooth


def _looked_at(shown: Sequence[Moment], target: str | None) -> set[str]:
    if target is not None:
        names = {name for moment in shown for name in moment.shapes if name.startswith(target)}
        if not names:
            known = ", ".join(list(shown[-1].shapes)[:8]) or "none"
            raise FilmError("cube_not_found", f"no cube's name begins with {target!r} (there are: {known})")
        return names
    first: dict[str, Array] = {}
    moved: dict[str, None] = {}
    for moment in shown:
        for name, pose in zip(moment.shapes, moment.poses, strict=True):
            if np.abs(pose[:3] - first.setdefault(name, pose[:3])).max() > _MOVES:
                moved[name] = None
    starts = np.array([first[name] for name in moved]).reshape(-1, 3)
    beside = {name for name, at in first.items() if np.linalg.norm(starts - at, axis=1).min(initial=np.inf) < _BESIDE}
    return beside or set(first)


def _middles(shown: Sequence[Moment], names: set[str]) -> tuple[Array, Array]:
    """Returns the middle of some cubes at each moment, and how far they reach from there; where none is, as before."""
    middles, radii = np.zeros((len(shown), 3)), np.full(len(shown), _NEAREST)
    known = -1
    for i, moment in enumerate(shown):
        rows = [row for row, name in enumerate(moment.shapes) if name in names]
        if rows:
            places = moment.poses[rows, :3]
            halves = [hypot(*size) / 2.0 for name, (size, _) in moment.shapes.items() if name in names]
            middles[i] = (places.min(axis=0) + places.max(axis=0)) / 2.0
            radii[i] = (np.linalg.norm(places - middles[i], axis=1) + halves).max()
            if known < 0:
                middles[:i], radii[:i] = middles[i], radii[i]
            known = i
        elif known >= 0:
            middles[i], radii[i] = middles[known], radii[known]
    return middles, radii


# -- files -------------------------------------------------------------------------------------------------------------


def film(
    recordings: Sequence[Recording],
    path: str | os.PathLike[str],
    cut: Cut = Cut(),
    *,
    fps: int = 30,
    size: tuple[int, int] = (640, 480),
    progress: Callable[[str, int, int], None] = lambda doing, done, total: None,
) -> None:
    """Makes a film (`.mp4`, `.gif`) of recordings, or a picture (`.png`) of their last moments.

    Several recordings are shown side by side in a grid, each with its file's name; one that ends earlier stands still.

    Args:
        recordings: What to show.
        path: The file; its ending says what it becomes.
        cut: What of each is shown, and from where.
        fps: Pictures a second, of an `.mp4` or `.gif`.
        size: Width and height of the whole picture, pixels.
        progress: Told what is being done, and how much of it, of how much, is done.

    Raises:
        RecordingError: A tick does not come out as recorded (`diverged`).
        FilmError: There is nothing to show (`nothing_to_see`), the ending is not known (`unknown_format`), `target` is
            nowhere (`cube_not_found`), or the file cannot be written (`cannot_write`).
        WorldError: `unsupported`: no OpenGL works here.
        NmesError: A package is missing (`missing_package`).
    """
    path = Path(path)
    if path.suffix not in (".mp4", ".gif", ".png"):
        raise FilmError("unknown_format", f"{path}: a film ends in .mp4 or .gif, a picture in .png")
    if not path.parent.is_dir():  # said before the work, not after it
        raise FilmError("cannot_write", f"cannot write {path}: there is no folder {path.parent}")
    if path.suffix == ".gif":
        fps = min(fps, _GIF_CLOCK // 2)
    columns = ceil(sqrt(len(recordings)))
    rows = ceil(len(recordings) / columns)
    tile = (size[0] // columns // 2 * 2, size[1] // rows // 2 * 2)  # in whole pixels of half resolution, for mp4
    plays = []
    for recording in recordings:
        shown = _chosen(recording, cut, cut.speed / fps, partial(progress, f"running {recording.path.name}"))
        cameras = _cameras(shown, cut, fps, tile)
        kept = slice(-1, None) if path.suffix == ".png" else slice(None)
        plays.append((recording, shown[kept], cameras[kept]))
    count = max(len(shown) for _, shown, _ in plays)

    def pictures() -> Generator[Pixels]:
        stages = [Stage(recording.config) for recording, _, _ in plays]
        try:
            for i in range(count):
                sheet = np.zeros((tile[1] * rows, tile[0] * columns, 3), np.uint8)
                for place, (stage, (recording, shown, cameras)) in enumerate(zip(stages, plays, strict=True)):
                    at = min(i, len(shown) - 1)
                    stage.show(shown[at])
                    drawn = stage.draw(cameras[at])
                    if len(plays) > 1:
                        drawn = _titled(drawn, recording.path.stem)
                    y, x = place // columns * tile[1], place % columns * tile[0]
                    sheet[y : y + tile[1], x : x + tile[0]] = drawn
                progress("drawing", i + 1, count)
                yield sheet
        finally:
            for stage in stages:
                stage.close()

    with _whole(path) as unfinished, closing(pictures()) as drawn:
        _WRITERS[path.suffix](drawn, unfinished, fps)


def _titled(drawn: Pixels, title: str) -> Pixels:
    image = Image.fromarray(np.ascontiguousarray(drawn))
    font = ImageFont.load_default(max(10, drawn.shape[0] // 24))
    ImageDraw.Draw(image).text((8, 6), title, fill=(20, 24, 30), font=font)
    return np.asarray(image)


@contextmanager
def _whole(path: Path) -> Iterator[Path]:
    """Gives a file beside the one that is wanted, which takes that one's place once it is whole."""
    unfinished = path.with_name(f".{path.stem}.unfinished{path.suffix}")
    try:
        yield unfinished
        unfinished.replace(path)
    except OSError as error:
        raise FilmError("cannot_write", f"cannot write {path}: {error.strerror or error}") from error
    finally:
        unfinished.unlink(missing_ok=True)


def _write_mp4(pictures: Iterator[Pixels], path: Path, fps: int) -> None:
    try:
        import av
    except ImportError as error:
        raise NmesError("missing_package", "an .mp4 needs PyAV: pip install 'nmes[film]'; a .gif does not") from error
    with av.open(str(path), "w", format="mp4", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("libx264", rate=fps, options={"crf": "20", "preset": "veryfast"})
        stream.pix_fmt = "yuv420p"  # what every player knows
        for pixels in pictures:
            if not stream.codec_context.is_open:
                stream.height, stream.width = pixels.shape[:2]
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        container.mux(stream.encode(None))


def _write_gif(pictures: Iterator[Pixels], path: Path, fps: int) -> None:
    first = Image.fromarray(next(pictures)).quantize(_COLORS)
    # One palette for all: with one each, what stands still would flicker.
    rest = (Image.fromarray(pixels).quantize(palette=first, dither=Image.Dither.NONE) for pixels in pictures)
    with path.open("wb") as file:
        first.save(file, "GIF", save_all=True, append_images=rest, duration=10 * round(_GIF_CLOCK / fps), loop=0)


def _write_png(pictures: Iterator[Pixels], path: Path, fps: int) -> None:
    Image.fromarray(next(pictures)).save(path)


_WRITERS = {".mp4": _write_mp4, ".gif": _write_gif, ".png": _write_png}
