"""A run of learning in words, curves and a page: what its log says, leg by leg."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from nmes.evaluation.identity import task_title
from nmes.genome.preview import render_cutout
from nmes.learning.run import LearningRun
from nmes.objective.means import mean
from nmes.view.chart import Chart, Picture, number, png_source
from nmes.view.run_page import facts_list, figure, page

__all__ = ["curves", "facts", "settings", "title", "to_json", "write_learning_page"]

_POINTS = 400  # of a line, at most
_WIDE, _HIGH = 400, 300  # of the portrait, pixels

Point = tuple[float, float]


def title(run: LearningRun) -> str:
    """Returns the run's name, and what it is about."""
    given = run.settings
    task = task_title(given.task.name, given.task.hash)
    return f"{run.folder.resolve().name}: {given.genome.name} learns {task} by {given.algorithm}"


def facts(run: LearningRun) -> list[tuple[str, str]]:
    """Returns the state of the run and its outcome, as names and values."""
    told = [("steps", run.progress), ("legs", f"{len(run.legs):,}")]
    if run.best is not None:
        told.append(("best", f"{number(run.best.score)} (after leg {run.best.leg}, {run.best.steps:,} steps)"))
    returned = [leg.returned for leg in run.legs if leg.returned is not None]
    if returned:
        told.append(("mean return of the last leg", number(returned[-1])))
    return [*told, ("digest", run.digest)]


def settings(run: LearningRun) -> list[tuple[str, str]]:
    """Returns the settings that it was begun with, as names and values."""
    given = run.settings
    told = [
        ("algorithm", given.algorithm),
        ("options", ", ".join(f"{name}={value}" for name, value in given.options.items()) or "none"),
        ("task", f"{given.task.name} ({given.task.hash[:16]})"),
        ("creature", f"{given.genome.name} ({given.genome.hash[:16]})"),
        ("seed", str(given.seed)),
        ("reward", given.reward or "by how much the task's objective grew"),
    ]
    if given.recordings:
        told[-1] = ("recordings", f"{len(given.recordings):,} ({given.episodes})")
    return told


def to_json(run: LearningRun) -> dict[str, Any]:
    """Returns all of it as plain data."""
    best = run.best
    return {
        "settings": run.settings.document,
        "legs": [leg.content for leg in run.legs],
        "finished": run.finished,
        "best": None if best is None else {"leg": best.leg, "score": best.score},
        "digest": run.digest,
    }


def curves(run: LearningRun) -> Iterator[Picture]:
    """Yields the pictures that there are of a run: scores, returns, and each figure of the learner."""
    scored = [(float(leg.steps), leg.score) for leg in run.legs if leg.score is not None]
    yield from _curve("score", f"Score on {run.settings.task.name}", scored)
    returned = [(float(leg.steps), leg.returned) for leg in run.legs if leg.returned is not None]
    yield from _curve("return", "Mean return of the episodes of a leg", returned)
    for name in dict.fromkeys(name for leg in run.legs for name in leg.content["figures"]):
        found = ((float(leg.steps), leg.content["figures"].get(name)) for leg in run.legs)
        yield from _curve(name.replace(" ", "-"), name.capitalize(), [(x, y) for x, y in found if y is not None])


def _curve(name: str, title: str, points: Sequence[Point]) -> Iterator[Picture]:
    """Yields a picture of a quantity over steps, if there is anything to see."""
    if not points:
        return
    shown = _thinned(points)
    values = [value for _, value in shown]
    chart = Chart((0.0, points[-1][0]), (min(values), max(values)), height=220)
    parts = list(chart.axes("steps learned from", title))
    parts.append(f'<polyline class="s0" stroke-width="2" points="{chart.path(shown)}"/>')
    x, y = shown[-1]
    parts.append(f'<circle class="f0" cx="{chart.x(x):.1f}" cy="{chart.y(y):.1f}" r="4"/>')
    told = f"From {number(points[0][1])} at first to {number(points[-1][1])} at {points[-1][0]:,.0f} steps."
    yield Picture(name, title, told, chart.width, chart.height, "\n".join(parts))


def _thinned(points: Sequence[Point]) -> list[Point]:
    """Returns points, or the means of as many neighbours as leave few enough."""
    many = -(-len(points) // _POINTS)
    groups = [points[begin : begin + many] for begin in range(0, len(points), many)]
    return [(group[-1][0], mean([y for _, y in group])) for group in groups]


def write_learning_page(run: LearningRun, path: Path, pictures: Sequence[Picture]) -> None:
    """Writes a page of a run: one file with all its pictures, and nothing to fetch.

    Args:
        run: The run.
        path: The file.
        pictures: The run's, as `curves` gives them.
    """
    source = png_source(render_cutout(run.settings.genome.body, 2 * _WIDE, 2 * _HIGH))
    portrait = f'<p><img width="{_WIDE}" height="{_HIGH}" alt="The creature" src="{source}"></p>'
    parts = [facts_list(facts(run)), portrait, *map(figure, pictures), "<h2>Settings</h2>", facts_list(settings(run))]
    path.write_text(page(title(run), parts), encoding="utf-8")
