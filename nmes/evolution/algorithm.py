"""What an evolutionary algorithm is: it is asked for candidates and told their scores, both in one fixed order.

    for index in order:
        candidate = algorithm.ask(index)       # once the scores of the first `needs(index)` candidates are told
        algorithm.tell(index, candidate, score)

A run (`nmes.evolution.run`) keeps that order, whatever the order in which workers finish. Invariants that every
algorithm holds, so that a run follows from its settings and scores, and is resumed by telling it its log again:

- `ask` changes nothing that can be seen: what it returns follows from the problem, the options, the index and the
  scores of the first `needs(index)` candidates. All that it draws is from `Problem.draw`.
- `tell` alone changes the state. It is called once for every index, in ascending order, whether or not `ask` was
  called in this process: the candidate may come from a log.
- `needs(index)` is at most `index`, and never falls as the index grows.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from nmes.evaluation import MatchTask, Task
from nmes.evaluation.contest import Rivals
from nmes.genome import Genome
from nmes.variation import Requirements
from nmes.variation.draw import Draw

__all__ = ["Algorithm", "Candidate", "Measure", "Opponent", "Problem", "Score"]


@dataclass(frozen=True, slots=True, eq=False)
class Opponent:
    """A candidate whom others meet in matches.

    Attributes:
        index: Its index in the run.
        genome: Its genome.
    """

    index: int
    genome: Genome


@dataclass(frozen=True, slots=True)
class Candidate:
    """A genome that a run evaluates, and where it comes from.

    Attributes:
        genome: The genome.
        operator: How it came about, as `random`, `start`, `add-part`, `cross`, `sample`.
        parents: The indices of the candidates that it comes from, the one that it is mostly like first.
        generation: Of the algorithm's count.
        group: The species, emitter or island that it belongs to, where the algorithm has such; in co-evolution the
            population, which has the name of a role.
        lineups: In co-evolution, whom it meets, as `Rivals` has it; empty where the candidate comes from a log, since
            an algorithm need not be told.
    """

    genome: Genome
    operator: str
    parents: tuple[int, ...] = ()
    generation: int = 0
    group: str = ""
    lineups: tuple[tuple[Opponent, ...], ...] = ()

    @property
    def rivals(self) -> Rivals | None:
        """Whom it meets, for whoever evaluates; None where it meets nobody."""
        lineups = tuple(tuple(each.genome for each in lineup) for lineup in self.lineups)
        return Rivals(self.group, lineups) if lineups else None


@dataclass(frozen=True, slots=True)
class Score:
    """What an algorithm is told of a candidate.

    Attributes:
        score: The task's score, the mean over the seeds; None where the candidate has none (it was refused, or an
            episode faulted). Greater is better.
        objectives: The values of the run's objectives, to be maximised, in their order; empty where there is no score
            or a run has none.
        measures: The values of the run's measures, in their order; empty as above.
    """

    score: float | None
    objectives: tuple[float, ...] = ()
    measures: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Measure:
    """A quantity by which an archive keeps candidates apart.

    Attributes:
        expression: What it is, over the quantities of a genome and its evaluation (`nmes.evolution.quantities`).
        low: The lower end of its range.
        high: The upper end.
        cells: Into how many equal cells the range is cut.
    """

    expression: str
    low: float
    high: float
    cells: int


@dataclass(frozen=True, slots=True)
class Problem:
    """What a run is about, as an algorithm sees it.

    Attributes:
        task: What candidates are evaluated on, and must be allowed to take part in.
        seed: The run's.
        starts: The genomes to begin with; none: random ones.
        objectives: The expressions to be maximised, for algorithms with several objectives.
        measures: The measures of an archive, for algorithms that have one.
        role: The role of the candidates, where the task has roles; empty where it has none.
        island: The island of the candidates, from 0, where an algorithm has such; None where it has none.
    """

    task: Task | MatchTask
    seed: int
    starts: tuple[Genome, ...] = ()
    objectives: tuple[str, ...] = ()
    measures: tuple[Measure, ...] = field(default=())
    role: str = ""
    island: int | None = None

    @property
    def requirements(self) -> Requirements:
        """What a candidate's body must be like."""
        return self.task.requirements(self.role) if isinstance(self.task, MatchTask) else self.task.requirements

    def draw(self, *path: str | int) -> Draw:
        """Returns the stream of choices for a purpose, such as `"candidate", 12`; each role and island has its own."""
        island = ("island", self.island) if self.island is not None else ()
        return Draw(self.seed, "run", *([self.role] if self.role else []), *island, *path)


class Algorithm(ABC):
    """An evolutionary algorithm; see the module."""

    @abstractmethod
    def needs(self, index: int) -> int:
        """Returns how many candidates, from the first on, must be told before this one is asked for."""

    @abstractmethod
    def ask(self, index: int) -> Candidate:
        """Returns the candidate of this index.

        Raises:
            VariationError: No good candidate can be made (`no_offspring`).
        """

    @abstractmethod
    def tell(self, index: int, candidate: Candidate, score: Score) -> None:
        """Takes a candidate's score in."""

    @abstractmethod
    def elites(self) -> Sequence[int]:
        """Returns the indices of the candidates that count as the outcome so far, the best first.

        They are the best of a population, the contents of an archive, or the front of several objectives.
        """

    def probe(self) -> str:
        """Returns a digest of what the package that the algorithm rests on computes here; empty where there is none.

        A run of another digest asks for other candidates: it is not comparable.
        """
        return ""

    def figures(self) -> Mapping[str, float]:
        """Returns figures of the algorithm's own state by name, as `coverage`, `species`, `step size`."""
        return {}
