"""All pictures of a run: which it has, and the portraits in them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial

from nmes.evaluation import MatchTask
from nmes.evolution.archive import cell
from nmes.evolution.champions import evenly, halls_of_fame, meet_all
from nmes.evolution.run import Run
from nmes.genome.body import Body
from nmes.genome.preview import render_cutout
from nmes.view.chart import Picture, png_source
from nmes.view.run_archive import archive_map
from nmes.view.run_curves import fitness_curves, groups_over_time
from nmes.view.run_eras import ancestors_map, era_curves
from nmes.view.run_front import front_plot
from nmes.view.run_summary import RunSummary
from nmes.view.run_tree import lineage_tree

__all__ = ["Portraits", "draw_run"]

_ERAS = 10  # of which champions are shown against each other, at most: a hundred matches
_SHARP = 2  # pixels of a portrait for each of the page, across and down


class Portraits:
    """The portraits of a run's candidates; each is drawn when it is first asked for.

    Args:
        run: The run.
    """

    def __init__(self, run: Run) -> None:
        self._run = run
        self.body = cache(self._body)
        self._sources = cache(self._source)

    def __call__(self, index: int, width: int, height: int) -> str:
        """Returns a candidate's picture, as wide and high as told on a page, as an address that holds all of it."""
        return self._sources(index, width, height)

    def _body(self, index: int) -> Body:
        return self._run.genome(index).body

    def _source(self, index: int, width: int, height: int) -> str:
        return png_source(render_cutout(self.body(index), _SHARP * width, _SHARP * height))


def draw_run(
    run: Run, summary: RunSummary, portraits: Portraits, progress: Callable[[str, int, int], None]
) -> Iterator[Picture]:
    """Yields the pictures that there are of a run: of one without a score, none of scores; and so on."""
    history, settings = summary.history, run.settings
    if settings.populations:
        yield from _draw_populations(run, summary, portraits, progress)
        return
    if summary.best is None:
        return
    yield fitness_curves(history, f"score on {settings.task.name}")
    yield lineage_tree(history, summary.best.index, portraits)
    elites = [history.rows[index] for index in summary.elites]
    if settings.measures and elites:
        draw = partial(progress, "drawing the archive")
        yield archive_map(elites, settings.measures, partial(cell, settings.measures), portraits.body, draw)
    if len(settings.objectives) > 1 and elites:
        yield front_plot(history, elites, settings.objectives, portraits)
    groups = groups_over_time(history)
    if groups is not None:
        yield groups


def _draw_populations(
    run: Run, summary: RunSummary, portraits: Portraits, progress: Callable[[str, int, int], None]
) -> Iterator[Picture]:
    """Yields the pictures of a run of several populations; of a task with two roles, which champions beat which."""
    task, halls = run.settings.task, {role: hall for role, hall in halls_of_fame(run).items() if hall}
    if not halls:
        return
    yield era_curves(summary.history.rows, halls, int(run.settings.options["era"]), f"score on {task.name}")
    if isinstance(task, MatchTask) and len(task.roles) == 2 and len(halls) == len(run.settings.populations):
        (one, first), *others = [(role, evenly(hall, _ERAS)) for role, hall in halls.items()]
        other, second = others[0] if others else (one, first)
        meetings = meet_all(run, first, second, partial(progress, "having champions meet"))
        scores = {pair: meeting.scores[0] for pair, meeting in meetings.items()}
        yield ancestors_map(f"eras-{one}", (one, first), (other, second), scores)
        if other != one:
            scores = {pair[::-1]: meeting.scores[1] for pair, meeting in meetings.items()}
            yield ancestors_map(f"eras-{other}", (other, second), (one, first), scores)
    for role, champion in summary.champions.items():
        tree = lineage_tree(summary.history, champion.index, portraits)
        yield replace(tree, name=f"lineage-{role}", title=f"Where the champion of {role} comes from")
