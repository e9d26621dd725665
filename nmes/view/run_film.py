"""A film of a run: the champions of its eras, side by side."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory

from nmes.errors import RunError
from nmes.evolution.history import History, milestones
from nmes.evolution.rerun import record_candidate
from nmes.evolution.run import Run
from nmes.recording import Recording
from nmes.view.chart import number
from nmes.view.film import Cut, check_path, film

__all__ = ["film_run"]

_ERAS = 6  # champions, at most


def film_run(
    run: Run, path: Path, *, seconds: float, fps: int, size: tuple[int, int], progress: Callable[[str, int, int], None]
) -> list[int]:
    """Makes a film of those who were the best of a run in their time, each in the first of its episodes.

    They are the first and the last of those that beat all before them, and between them those that gained most; each
    is run again for it, and its figures are compared with the log's.

    Args:
        run: The run.
        path: The film (`.mp4`, `.gif`), or a picture of its end (`.png`).
        seconds: How much of each episode is shown, from when the first of them begins to count.
        fps: Pictures a second.
        size: Width and height of the whole picture, pixels.
        progress: Called with what is being done, how much of it is done, and how much there is.

    Returns:
        The indices of the candidates that are shown.

    Raises:
        RunError: None has a score (`no_score`), or as `record_candidate`.
        FilmError, WorldError, MissingPackage: As `film`.
    """
    check_path(path)
    champions = History(run.records).champions()
    if not champions:
        raise RunError("no_score", f"no candidate of {run.folder} has a score: there is nothing to film")
    shown = milestones(champions, _ERAS)
    titles = [f"score {number(row.score)}, #{row.index}, generation {row.generation}" for row in shown]
    begin = inf
    with TemporaryDirectory() as folder:
        recordings = []
        for done, row in enumerate(shown, start=1):
            again = record_candidate(run, row.index, Path(folder), run.settings.seeds[:1])
            recordings.append(Recording(again.recordings[0]))
            settled = recordings[-1].summary().ticks - again.results[0].ticks
            begin = min(begin, settled / run.settings.task.tick_rate)
            progress("running the champions", done, len(shown))
        film(
            recordings,
            path,
            Cut(begin=begin, end=begin + seconds),
            titles=titles,
            fps=fps,
            size=size,
            progress=progress,
        )
    return [row.index for row in shown]
