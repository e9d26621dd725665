"""How a creature did on a task: its results over the seeds, and the figures that follow from them."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from math import fsum
from typing import TYPE_CHECKING, Any, get_type_hints

from nmes.evaluation.judge import Result
from nmes.evaluation.population import Outcome
from nmes.evaluation.task import Task
from nmes.genome import Genome
from nmes.objective.means import mean_of_all
from nmes.schemas.notebook import card

if TYPE_CHECKING:
    from nmes.evaluation.match import MatchResult
    from nmes.evaluation.match_task import MatchTask
    from nmes.evaluation.proof import Proof

__all__ = ["Evaluation", "check_types"]


@dataclass(frozen=True, slots=True)
class Evaluation:
    """The outcome of a genome on a task. Two are equal when all but their time and recordings are.

    Attributes:
        genome: The genome's name.
        genome_hash: Its hash; empty where it is none.
        task: The task's name.
        task_hash: Its hash.
        results: One a seed, in the order of the seeds; none where the creature could not be evaluated.
        error: Why the creature could not be evaluated; None where it could.
        recordings: Where the episodes' recordings are, one a result; none where nothing was recorded.
        roles: Which role it had in each match, one a result; none where the task has no roles.
        wall_seconds: How long it took, s.
    """

    genome: str
    genome_hash: str
    task: str
    task_hash: str
    results: tuple[Result, ...] = ()
    error: str | None = None
    recordings: tuple[str, ...] = field(default=(), compare=False)
    wall_seconds: float = field(default=0.0, compare=False)
    roles: tuple[str, ...] = ()

    @classmethod
    def of_matches(cls, genome: Genome, task: MatchTask, matches: Sequence[tuple[str, MatchResult]]) -> Evaluation:
        """Returns how a creature did in matches, each told with the role that it had there."""
        recordings = tuple(match.recording for _, match in matches if match.recording is not None)
        results, roles = tuple(match.results[role] for role, match in matches), tuple(role for role, _ in matches)
        seconds = fsum(match.wall_seconds for _, match in matches)
        return cls(genome.name, genome.hash, task.name, task.hash, results, None, recordings, seconds, roles)

    @classmethod
    def of(cls, proofs: Sequence[Proof], *, wall_seconds: float = 0.0) -> Evaluation:
        """Returns the evaluation that recordings of one genome on one task prove; seeds are in the task's order."""
        task, genome = proofs[0].task, proofs[0].genome
        place = {seed: index for index, seed in enumerate(task.seeds)}
        ordered = sorted(proofs, key=lambda proof: (place.get(proof.result.seed, len(place)), proof.result.seed))
        return cls(
            genome=genome.name,
            genome_hash=genome.hash,
            task=task.name,
            task_hash=task.hash,
            results=tuple(proof.result for proof in ordered),
            recordings=tuple(proof.path for proof in ordered),
            wall_seconds=wall_seconds,
        )

    @classmethod
    def of_outcome(cls, genome: Genome, task: Task, seeds: Sequence[int], outcome: Outcome) -> Evaluation:
        """Returns the evaluation of a creature that was run with others."""
        names = genome.name, genome.hash, task.name, task.hash
        refusal = next((outcome.refusals[seed] for seed in seeds if seed in outcome.refusals), None)
        results = () if refusal else tuple(outcome.results[seed] for seed in seeds)
        return cls(*names, results, refusal, wall_seconds=outcome.seconds)

    @classmethod
    def joined(cls, parts: Sequence[Evaluation]) -> Evaluation:
        """Returns the evaluation of a creature whose seeds were evaluated in parts, given in the order of the seeds."""
        seconds = fsum(part.wall_seconds for part in parts)
        refused = next((part for part in parts if part.error is not None), None)
        if refused is not None:
            return replace(refused, wall_seconds=seconds)
        results = tuple(result for part in parts for result in part.results)
        recordings = tuple(path for part in parts for path in part.recordings)
        return replace(parts[0], results=results, recordings=recordings, wall_seconds=seconds)

    @property
    def score(self) -> float | None:
        """The mean over the seeds; None where one of them has no score."""
        return mean_of_all([result.score for result in self.results])

    @property
    def spread(self) -> float | None:
        """Standard deviation of the scores over the seeds, as of a whole population; None where there is no score."""
        scores = [result.score for result in self.results if result.score is not None]
        return None if self.score is None else statistics.pstdev(scores)

    @property
    def energy(self) -> float | None:
        """Mean work of the motors in an episode, J."""
        return mean_of_all([result.energy for result in self.results])

    @property
    def distance(self) -> float | None:
        """Mean distance over the ground, m."""
        return mean_of_all([result.distance for result in self.results])

    @property
    def duty(self) -> float | None:
        """Mean duty factor; None where it was not asked for, see `Task.with_duty`."""
        return mean_of_all([result.duty for result in self.results])

    @property
    def faults(self) -> int:
        """How many episodes have no score."""
        return sum(result.fault is not None for result in self.results)

    def _repr_html_(self) -> str:
        """Returns its card in a notebook, HTML."""
        facts = {
            "score": self.score,
            "spread": self.spread,
            "energy": None if self.energy is None else f"{self.energy:.6g} J",
            "distance": None if self.distance is None else f"{self.distance:.6g} m",
            "faults": self.faults or None,
            "error": self.error,
        }
        header = "seed", "score", "energy (J)", "distance (m)", "ended", "fault"
        rows = [(one.seed, one.score, one.energy, one.distance, one.ended, one.fault) for one in self.results]
        return card(f"{self.genome} on {self.task}", facts, header=header, rows=rows)

    def to_json(self) -> dict[str, Any]:
        """Returns the fields as plain data, with the figures computed from them."""
        return {
            "genome": self.genome,
            "genome_hash": self.genome_hash,
            "task": self.task,
            "task_hash": self.task_hash,
            "score": self.score,
            "spread": self.spread,
            "energy": self.energy,
            "distance": self.distance,
            "faults": self.faults,
            "error": self.error,
            "results": [result.to_json() for result in self.results],
            "recordings": list(self.recordings),
            "wall_seconds": self.wall_seconds,
            **({"roles": list(self.roles)} if self.roles else {}),
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Evaluation:
        """Reads the plain data that `to_json` returned.

        Raises:
            KeyError, TypeError: They are something else.
        """
        results = tuple(Result(**result) for result in data["results"])
        plain = {name: data[name] for name in ("genome", "genome_hash", "task", "task_hash", "error", "wall_seconds")}
        evaluation = cls(**plain, results=results, recordings=tuple(data["recordings"]))
        check_types(evaluation, plain)
        for result in results:
            check_types(result, asdict(result))
        if not all(isinstance(recording, str) for recording in evaluation.recordings):
            raise TypeError("a recording is no text")
        return evaluation


def check_types(value: Evaluation | Result, fields: Mapping[str, Any]) -> None:
    """Compares fields of a dataclass with their types; None stands for what JSON cannot say too."""
    kinds = get_type_hints(type(value))
    for name, field_value in fields.items():
        if not isinstance(field_value, kinds[name] | None):
            raise TypeError(f"{name} is a {type(field_value).__name__}")
