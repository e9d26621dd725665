"""Pictures and films of recordings, drawn off screen on a machine without a display.

It hides how pictures become a file. Only poses and shapes are needed, so every recording can be filmed, whatever its
engine.

Invariants: a picture shows the last tick at or before its time; a file is there whole or not at all.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from math import ceil, sqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from nmes.backend import CameraSpec
from nmes.backend import Image as Pixels
from nmes.errors import FilmError, MissingPackage
from nmes.recording import Recording
from nmes.view.camera import Way, cameras
from nmes.view.caption import Caption
from nmes.view.moments import Moment, moments
from nmes.view.stage import Stage

__all__ = ["Cut", "check_path", "film"]

Progress = Callable[[str, int, int], None]

_COLORS = 128  # of a GIF
_ROUNDING = 1e-9  # s
_GIF_CLOCK = 100  # Hz: the times of a GIF's pictures are whole hundredths of a second


@dataclass(frozen=True, slots=True)
class Cut:
    """The part of a recording that is shown, and how the camera moves.

    Attributes:
        camera: `follow` keeps the middle of what moves in view, `orbit` goes round it as well, `fixed` stands where all
            of the way can be seen.
        target: The cube to look at, or the beginning of the names of several; None for all that move and what stands
            beside them.
        begin: Where it begins, in s of simulation since the recording began.
        end: Where it ends, likewise; None for the recording's end.
        speed: How many seconds of simulation a second of film shows.
    """

    camera: Way = "follow"
    target: str | None = None
    begin: float = 0.0
    end: float | None = None
    speed: float = 1.0


def film(
    recordings: Sequence[Recording],
    path: str | os.PathLike[str],
    cut: Cut = Cut(),
    *,
    titles: Sequence[str] | None = None,
    fps: int = 30,
    size: tuple[int, int] = (640, 480),
    progress: Progress = lambda doing, done, total: None,
) -> None:
    """Makes a film (`.mp4`, `.gif`) of recordings, or a picture (`.png`) of their last moments.

    Several recordings are shown side by side in a grid; one that ends earlier stands still. A line over each says what
    it is.

    Args:
        recordings: The recordings.
        path: The file; its ending decides the format.
        cut: The part of each that is shown, and how the camera moves.
        titles: One a recording, told beside its time; None: the genome, task, seed and score of an episode, else the
            name of the file. An empty one leaves the picture as it is.
        fps: Pictures a second, of an `.mp4` or `.gif`.
        size: Width and height of the whole picture, pixels.
        progress: Called with what is being done, how much of it is done, and how much there is.

    Raises:
        RecordingError: A tick does not come out as recorded (`diverged`), or recorded poses are none
            (`recording_damaged`).
        FilmError: There is nothing to show (`nothing_to_see`), the ending is not known (`unknown_format`), the file
            cannot be written (`cannot_write`), or `target` names no cube (`cube_not_found`).
        WorldError: `unsupported`: no OpenGL works here.
        MissingPackage: An `.mp4` needs PyAV, which is not installed.
    """
    path = Path(path)
    check_path(path)
    if path.suffix == ".gif":
        fps = min(fps, _GIF_CLOCK // 2)
    columns = ceil(sqrt(len(recordings)))
    rows = ceil(len(recordings) / columns)
    tile = (size[0] // columns // 2 * 2, size[1] // rows // 2 * 2)  # in whole pixels of half resolution, for mp4
    captions = [Caption.of(recording) for recording in recordings] if titles is None else map(Caption, titles)
    takes = [
        _take(recording, caption, cut, fps, tile, progress)
        for recording, caption in zip(recordings, captions, strict=True)
    ]
    if path.suffix == ".png":
        takes = [_Take(take.caption, take.config, take.moments[-1:], take.cameras[-1:]) for take in takes]
    with _whole(path) as unfinished, closing(_ahead(_pictures(takes, columns, rows, tile, progress))) as pictures:
        _WRITERS[path.suffix](pictures, unfinished, fps)


def check_path(path: Path) -> None:
    """Refuses a path that no film can have: for who would find it out after much work.

    Raises:
        FilmError: The ending is not known (`unknown_format`), or there is no such folder (`cannot_write`).
    """
    if path.suffix not in _WRITERS:
        raise FilmError("unknown_format", f"{path}: a film ends in .mp4 or .gif, a picture in .png")
    if not path.parent.is_dir():
        raise FilmError("cannot_write", f"cannot write {path}: there is no folder {path.parent}")


class _Take(NamedTuple):
    """One recording of a film: its moments, and a camera for each."""

    caption: Caption
    config: dict[str, Any]
    moments: list[Moment]
    cameras: list[CameraSpec]


def _take(
    recording: Recording, caption: Caption, cut: Cut, fps: int, size: tuple[int, int], progress: Progress
) -> _Take:
    """Runs a recording and chooses its moments and cameras; `size` is that of its tile, pixels."""
    parts = _choose(recording, cut, cut.speed / fps, partial(progress, f"running {recording.path.name}"))
    return _Take(caption, recording.config, parts, cameras(parts, cut.camera, cut.target, fps, size))


def _choose(recording: Recording, cut: Cut, step: float, progress: Callable[[int, int], None]) -> list[Moment]:
    """Returns the moments of a cut, one every `step` s of simulation, and the last.

    Raises:
        FilmError: `nothing_to_see`: the recording ends before the cut begins, or cannot be shown at all.
    """
    cut_moments: list[Moment] = []
    last: Moment | None = None
    ticks, rate = recording.summary().ticks, recording.config["tick_rate"]
    total = ticks if cut.end is None else min(ticks, ceil(cut.end * rate))
    for moment in moments(recording, cut.begin):
        progress(round(moment.time * rate), total)
        while moment.time > cut.begin + len(cut_moments) * step + _ROUNDING:
            cut_moments.append(last or moment)
        last = moment
        if cut.end is not None and moment.time >= cut.end:
            break
    if last is None or last.time < cut.begin:
        end = f"ends at {last.time:.2f} s" if last is not None else "has no ticks"
        raise FilmError("nothing_to_see", f"{recording.path} {end}")
    return [*cut_moments, last]


def _pictures(
    takes: Sequence[_Take], columns: int, rows: int, tile: tuple[int, int], progress: Progress
) -> Generator[Pixels]:
    """Yields the pictures of a film: arrays (height, width, 3) of bytes, with the takes as tiles of `tile` pixels."""
    count = max(len(take.moments) for take in takes)
    width, height = tile
    stages = [Stage(take.config) for take in takes]
    try:
        for i in range(count):
            sheet = np.zeros((height * rows, width * columns, 3), np.uint8)
            for place, (stage, take) in enumerate(zip(stages, takes, strict=True)):
                at = min(i, len(take.moments) - 1)
                stage.show(take.moments[at])
                pixels = stage.draw(take.cameras[at])
                pixels = take.caption.draw(pixels, take.moments[at].time)
                y, x = place // columns * height, place % columns * width
                sheet[y : y + height, x : x + width] = pixels
            progress("drawing", i + 1, count)
            yield sheet
    finally:
        for stage in stages:
            stage.close()


def _ahead(pictures: Generator[Pixels]) -> Generator[Pixels]:
    """Yields pictures while the next one is drawn in another thread, so that it need not wait for the encoder."""
    with closing(pictures), ThreadPoolExecutor(1, "drawing") as thread:
        coming = thread.submit(next, pictures, None)
        while (picture := coming.result()) is not None:
            coming = thread.submit(next, pictures, None)
            yield picture


@contextmanager
def _whole(path: Path) -> Iterator[Path]:
    """Gives the path of a file beside `path`, which takes its place once it is whole."""
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
        raise MissingPackage("an .mp4 needs PyAV: pip install 'nmes[film]'; a .gif does not") from error
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
