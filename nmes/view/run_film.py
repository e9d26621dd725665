"""A film of a run: the champions of its eras, side by side."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from nmes.errors import RunError
from nmes.evaluation import MatchTask
from nmes.evolution.champions import evenly, halls_of_fame, meet
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
    is run again for it, and its figures are compared with the log's. Of several populations they are the champions of
    some eras, who play each other; a population that is alone plays the champion of its last era.

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
        RunError: None has a score (`no_score`), the task of several populations has not two roles (`no_film`), or as
            `record_candidate`.
        FilmError, WorldError, MissingPackage: As `film`.
    """
    check_path(path)
    with TemporaryDirectory() as folder:
        shots = (_matches if run.settings.populations else _episodes)(run, Path(folder), progress)
        begin = min(shot.begin for shot in shots)
        film(
            [Recording(shot.recording) for shot in shots],
            path,
            Cut(begin=begin, end=begin + seconds),
            titles=[shot.title for shot in shots],
            fps=fps,
            size=size,
            progress=progress,
        )
    return list(dict.fromkeys(index for shot in shots for index in shot.candidates))


class _Shot(NamedTuple):
    """One recording of the film: who is in it, the line over it, and when it begins to count, s."""

    candidates: tuple[int, ...]
    title: str
    recording: str
    begin: float


def _shot(run: Run, candidates: tuple[int, ...], title: str, recording: str, ticks: int) -> _Shot:
    """Returns a shot of a recording whose last ticks, so many, count."""
    settled = Recording(recording).summary().ticks - ticks
    return _Shot(candidates, title, recording, settled / run.settings.task.tick_rate)


def _episodes(run: Run, folder: Path, progress: Callable[[str, int, int], None]) -> list[_Shot]:
    """Runs those who were the best in their time again.

    Raises:
        RunError: None has a score (`no_score`), or as `record_candidate`.
    """
    champions = History(run.records).champions()
    if not champions:
        raise RunError("no_score", f"no candidate of {run.folder} has a score: there is nothing to film")
    shown, shots = milestones(champions, _ERAS), []
    for done, row in enumerate(shown, start=1):
        again = record_candidate(run, row.index, folder, run.settings.seeds[:1])
        title = f"score {number(row.score)}, #{row.index}, generation {row.generation}"
        shots.append(_shot(run, (row.index,), title, again.recordings[0], again.results[0].ticks))
        progress("running the champions", done, len(shown))
    return shots


def _matches(run: Run, folder: Path, progress: Callable[[str, int, int], None]) -> list[_Shot]:
    """Has the champions of some eras play each other.

    Raises:
        RunError: The task has not two roles (`no_film`), or in no era has each population a champion (`no_score`).
    """
    task = run.settings.task
    if not isinstance(task, MatchTask) or len(task.roles) != 2:
        raise RunError(
            "no_film", f"{task.name} has not two roles: `nmes evolve best` records matches for `nmes render`"
        )
    halls = list(halls_of_fame(run).values())
    if len(halls) == 1:
        pairs = [(champion, halls[0][-1]) for champion in halls[0]]
    else:
        pairs = [(one, other) for one in halls[0] for other in halls[1] if one.era == other.era]
    if not pairs:
        raise RunError("no_score", f"{run.folder} has no era with a champion of each population: nobody to film")
    shown, shots = evenly(pairs, _ERAS), []
    for done, (one, other) in enumerate(shown, start=1):
        meeting = meet(run, one.record, other.record, folder)
        assert meeting.recording is not None
        scored = zip((one.record, other.record), meeting.scores, strict=True)
        players = ", ".join(f"{each.group} #{each.index} ({number(score)})" for each, score in scored)
        indices = one.record.index, other.record.index
        shots.append(_shot(run, indices, f"era {one.era}: {players}", meeting.recording, meeting.ticks))
        progress("having champions meet", done, len(shown))
    return shots
