"""The champions of a run of several populations: who led each era, and how they fare against each other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from nmes.evaluation import MatchTask
from nmes.evaluation.contest import pairings, play_pairing
from nmes.evolution.run import Run
from nmes.evolution.run_index import Record
from nmes.objective.means import mean_of_all

__all__ = ["Champion", "Meeting", "evenly", "halls_of_fame", "meet", "meet_all"]

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Champion:
    """The best of a population in an era.

    Attributes:
        era: Which, from 0 on.
        record: The candidate.
    """

    era: int
    record: Record


@dataclass(frozen=True, slots=True)
class Meeting:
    """How two champions fared against each other.

    Attributes:
        scores: Of the first and of the second, the mean over their matches; None where a match was lost by rule.
        recording: Of the last match; None where none was made.
        ticks: How many that was scored for.
    """

    scores: tuple[float | None, float | None]
    recording: str | None
    ticks: int


def halls_of_fame(run: Run) -> dict[str, list[Champion]]:
    """Returns the champions of each population by its role, the first era first; none where nobody has a score."""
    length = int(run.settings.options["era"]) * len(run.settings.populations)
    halls: dict[str, list[Champion]] = {each.role: [] for each in run.settings.populations}
    for index in reversed(run.elites()):
        record = run.records[index]
        halls[record.group].append(Champion(index // length, record))
    return halls


def evenly(values: Sequence[T], count: int) -> list[T]:
    """Returns so many of some values, at most, at equal distances from the first to the last; two or more."""
    last = len(values) - 1
    places = range(len(values)) if last < count else [round(last * step / (count - 1)) for step in range(count)]
    return [values[place] for place in places]


def meet(run: Run, first: Record, second: Record, record: Path | None = None) -> Meeting:
    """Has two candidates of a run whose task has two roles play each other on the first of its seeds.

    Args:
        run: The run.
        first: A candidate, in the role of its population.
        second: Another, in the other role; where roles are interchangeable, they play once on each side.
        record: An existing folder, in which recordings are left.

    Raises:
        NmesError: They cannot be set down, or a recording cannot be written.
    """
    task, cast = run.settings.task, (run.genome(first.index), run.genome(second.index))
    assert isinstance(task, MatchTask)
    scores: tuple[list[float | None], list[float | None]] = ([], [])
    for pairing in pairings(task, first.group, 1, run.settings.seeds[:1]):
        match = play_pairing(task, cast, pairing, record)
        for place, column in enumerate(scores):
            column.append(match.results[pairing.role(place)].score)
    ticks = match.results[first.group].ticks
    return Meeting((mean_of_all(scores[0]), mean_of_all(scores[1])), match.recording, ticks)


def meet_all(
    run: Run, rows: Sequence[Champion], columns: Sequence[Champion], progress: Callable[[int, int], None]
) -> dict[tuple[int, int], Meeting]:
    """Has champions meet those of another population, or of their own.

    Args:
        run: The run, whose task has two roles.
        rows: Some.
        columns: The others; of one population the same, who then meet but once.
        progress: Called with how many meetings are over, and how many there are.

    Returns:
        The meetings, by the indices of the two candidates, of `rows` and of `columns`.
    """
    pairs = [(one.record, other.record) for one in rows for other in columns]
    meetings: dict[tuple[int, int], Meeting] = {}
    for done, (one, other) in enumerate(pairs, 1):
        back = meetings.get((other.index, one.index))
        meetings[one.index, other.index] = (
            meet(run, one, other) if back is None else Meeting(back.scores[::-1], back.recording, back.ticks)
        )
        progress(done, len(pairs))
    return meetings
