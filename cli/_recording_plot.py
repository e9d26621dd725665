"""Recordings plotted over time: score, height, speed, work, and contacts; of ecosystems, who lives and how."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from nmes.backend import Array
from nmes.cli._plot import Bars, Curves, write_plot
from nmes.cli._progress import progress_bars
from nmes.errors import ProofError
from nmes.evaluation import scores_so_far
from nmes.evaluation.match_proof import is_match, match_scores_so_far
from nmes.playback import watch
from nmes.recording import Recording
from nmes.view.life_curves import life_curves
from nmes.view.time_series import TimeSeries

__all__ = ["plot_recordings"]

STEP = 3  # ticks between two points of a curve, which a plot of this size cannot show


def plot_recordings(recordings: Sequence[Recording], path: Path) -> None:
    """Runs recordings again and writes their curves, and the gait diagram of the first, to an SVG or PNG.

    Of one with life, the curves are those of its ecosystem.

    Raises:
        RecordingError, ProofError: One of them does not come out as recorded.
        BackendNotFound: Its engine is not there.
    """
    curves: dict[str, dict[str, list[tuple[float, float]]]] = {}
    gait: Bars | None = None
    with progress_bars() as progress:
        for recording in recordings:
            name = recording.path.stem
            if "life" in recording.config:
                _add_life(curves, recording, "" if len(recordings) == 1 else f", {name}")
                continue
            series = TimeSeries()
            total = recording.summary().ticks
            for tick, _ in enumerate(watch(recording, series.note), start=1):
                progress(f"running {recording.path.name}", tick, total)
            for title, scores in _scores(recording).items():
                curves.setdefault("score so far", {})[title] = list(map(tuple, scores[::STEP].tolist()))
            for title, values in series.curves().items():
                points = np.stack([series.times, values], axis=1)[::STEP]
                curves.setdefault(title, {})[name] = list(map(tuple, points.tolist()))
            gait = gait or Bars(f"contacts of each cube in {name}", series.gait())
    title = recordings[0].path.stem if len(recordings) == 1 else f"{len(recordings)} recordings"
    panels = [Curves(title, lines) for title, lines in curves.items()]
    write_plot(path, title, panels if gait is None else [*panels, gait])


def _add_life(curves: dict[str, dict[str, list[tuple[float, float]]]], recording: Recording, whose: str) -> None:
    """Adds the curves of an ecosystem, which its recording tells without being run again."""
    for title, lines in life_curves(recording).items():
        for name, points in lines.items():
            curves.setdefault(title, {})[name + whose] = points


def _scores(recording: Recording) -> dict[str, Array]:
    """Returns the scores so far of an episode, or of each role of a match, by what to call them; none of others."""
    name = recording.path.stem
    if is_match(recording):
        return {f"{role}, {name}": scores for role, scores in match_scores_so_far(recording).items()}
    try:
        return {name: scores_so_far(recording)}
    except ProofError as error:
        if error.code != "not_an_evaluation":
            raise
        return {}
