"""A run in words and numbers, for people and as plain data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import cached_property
from typing import Any

from nmes.evaluation.identity import task_title
from nmes.evolution.history import History, Origin
from nmes.evolution.run import Run
from nmes.genome import Genome
from nmes.view.chart import number

__all__ = ["RunSummary"]

_TOP = 10


class RunSummary:
    """A run in words and numbers, as far as it is.

    Args:
        run: The run.

    Attributes:
        history: Its candidates.
        elites: The indices of those that count as its outcome, the best first.
        top: The candidates with the highest scores, the best first; of several populations, the champions of the last
            eras.
        champions: The champion of each of several populations, by its role.
    """

    def __init__(self, run: Run) -> None:
        self._run = run
        self.history = History(run.records)
        self.elites = run.elites()
        self.champions = run.champions()
        self.top = self._top()

    def _top(self) -> list[Origin]:
        if self._run.settings.populations:
            return [self.history.rows[index] for index in self.elites[:_TOP]]
        return self.history.top(_TOP)

    @property
    def outcome(self) -> str:
        """What the candidates of `top` are, in words."""
        return "the last champions" if self._run.settings.populations else "the best"

    @property
    def title(self) -> str:
        """The run's name, and what it is about."""
        settings = self._run.settings
        name, task = self._run.folder.resolve().name, settings.task
        return f"{name}: {settings.algorithm} on {task_title(task.name, task.hash)}, seed {settings.seed}"

    @property
    def best(self) -> Origin | None:
        """The candidate with the highest score; None where none has one, and of several populations."""
        return self.top[0] if self.top and not self._run.settings.populations else None

    @cached_property
    def without_score(self) -> int:
        """The number of candidates without a score."""
        return len([row for row in self.history.rows if row.score is None])

    def facts(self) -> list[tuple[str, str]]:
        """Returns the state of the run and its outcome, as names and values."""
        count = f"{len(self.history.rows):,} of {self._run.settings.budget:,}"
        facts = [("candidates", count + (f", {self.without_score:,} without a score" if self.without_score else ""))]
        if self.best is not None:
            origin = f"{self.best.operator}, generation {self.best.generation}"
            facts.append(("best", f"{number(self.best.score)} (candidate {self.best.index}: {origin})"))
        for role, each in self.champions.items():
            origin = f"{each.operator}, generation {each.generation}"
            facts.append((f"champion of {role}", f"{number(each.score)} (candidate {each.index}: {origin})"))
        facts.append(("elites", f"{len(self.elites):,}"))
        facts += [(name, number(value, 6)) for name, value in self._run.figures().items()]
        return [*facts, ("digest", self._run.digest)]

    def settings(self) -> list[tuple[str, str]]:
        """Returns the settings that it was begun with, as names and values."""
        given = self._run.settings
        facts = [
            ("algorithm", given.algorithm),
            ("options", ", ".join(f"{name}={value}" for name, value in given.options.items()) or "none"),
            ("task", f"{given.task.name} ({given.task.hash[:16]})"),
            ("seeds of the task", ", ".join(map(str, given.seeds))),
            ("seed", str(given.seed)),
            ("budget", f"{given.budget:,}"),
        ]
        if given.populations:
            facts += [(f"{each.role} begins with", _begins(each.starts)) for each in given.populations]
        else:
            facts.append(("begins with", _begins(given.starts)))
        facts += [("objective", expression) for expression in given.objectives]
        for measure in given.measures:
            facts.append(
                ("measure", f"{measure.expression}, {measure.low:g} to {measure.high:g} in {measure.cells} cells")
            )
        return facts

    def to_json(self) -> dict[str, Any]:
        """Returns all of it as plain data."""
        best = self.best
        champions = {role: {"index": each.index, "score": each.score} for role, each in self.champions.items()}
        return {
            "settings": self._run.settings.document,
            "told": len(self.history.rows),
            "without_score": self.without_score,
            "best": None if best is None else {"index": best.index, "score": best.score},
            **({"champions": champions} if self._run.settings.populations else {}),
            "elites": list(self.elites),
            "figures": dict(self._run.figures()),
            "top": [{"index": row.index, "score": row.score, "operator": row.operator} for row in self.top],
            "operators": [asdict(record) for record in self.history.operators()],
            "digest": self._run.digest,
        }


def _begins(starts: Sequence[Genome]) -> str:
    """Returns the beginning of a population in words."""
    more = f", and {len(starts) - _TOP:,} other genomes" if len(starts) > _TOP else ""
    return (", ".join(genome.name for genome in starts[:_TOP]) or "random") + more
