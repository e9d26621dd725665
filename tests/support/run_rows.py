"""Candidates of made-up runs, without genomes."""

from __future__ import annotations

from dataclasses import dataclass

from nmes.evolution.history import History

__all__ = ["Row", "history"]


@dataclass(frozen=True, slots=True)
class Row:
    """A candidate as `nmes.evolution.history.Origin` says."""

    index: int
    score: float | None = None
    operator: str = "random"
    parents: tuple[int, ...] = ()
    generation: int = 0
    group: str = ""
    objectives: tuple[float, ...] = ()
    measures: tuple[float, ...] = ()


def history(*scores: float | None, **others: object) -> History:
    """Returns a history of candidates with these scores; `others` are fields that all of them have."""
    return History([Row(index, score, **others) for index, score in enumerate(scores)])  # type: ignore[arg-type]
