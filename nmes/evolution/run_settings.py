"""What a run is about, as a document: read, completed, judged as a whole, and kept as `run.json`.

Invariants: settings that were read can be run; two runs whose settings are equal but for the budget have one history,
of which the one with the greater budget has more.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from typing import Any, Final

import orjson

from nmes.backend import load_backend
from nmes.backend.fingerprint import fingerprint
from nmes.errors import DocumentError, NmesError
from nmes.evaluation import Task
from nmes.evaluation.population import admit
from nmes.evaluation.setting import task_identity
from nmes.evolution.algorithm import Algorithm, Measure, Problem
from nmes.evolution.algorithms import algorithm_options, load_algorithm
from nmes.evolution.quantities import read_expressions
from nmes.genome import Genome
from nmes.objective import Objective
from nmes.schemas.documents import (
    JsonObject,
    canonical_hash,
    check,
    compile_schema,
    complete,
    parse_document,
    plain,
    write_json,
)
from nmes.variation.draw import Draw

__all__ = ["FORMAT", "RunSettings"]

FORMAT: Final = "nmes-run/1"
_RUN: Final = compile_schema("run.json")


@dataclass(frozen=True, slots=True)
class RunSettings:
    """What a run is about.

    Attributes:
        task: What candidates are evaluated on, told to note what the expressions need.
        algorithm: Its name.
        options: All of its options.
        starts: The genomes to begin with; none: random ones.
        seed: Of everything that the run draws.
        seeds: Of the episodes of each candidate.
        budget: How many candidates are evaluated.
        objectives: The expressions to be maximised, where the algorithm has several objectives.
        measures: The measures of an archive, where the algorithm has one.
    """

    task: Task
    algorithm: str
    options: Mapping[str, int | float | bool]
    starts: tuple[Genome, ...]
    seed: int
    seeds: tuple[int, ...]
    budget: int
    objectives: tuple[str, ...]
    measures: tuple[Measure, ...]

    @classmethod
    def read(cls, document: Mapping[str, Any]) -> RunSettings:
        """Reads a document as `schemas/run.json` says; names and files of the task and of genomes are looked up.

        Raises:
            DocumentError: It is not such a document, or what it says cannot be run, with all that is wrong.
            MissingPackage: The algorithm needs a package that is not installed.
        """
        found = cls.reopen(document)
        settings = replace(found, options={**algorithm_options(found.algorithm), **found.options})
        if problems := list(_refusals(settings.starts, settings.task)):
            raise DocumentError(problems)
        settings.expressions()
        settings.begin()
        try:
            parse_document(write_json(settings.document))
        except DocumentError as error:  # else nobody could read the run that begins with them
            raise DocumentError([("starts", f"are too many: {error.message}")]) from error
        return settings

    @classmethod
    def reopen(cls, document: Mapping[str, Any]) -> RunSettings:
        """Reads the document of a run that is there, whether or not it could be run here.

        Raises:
            DocumentError: It is no such document.
        """
        given = plain(document)
        check(_RUN, given)
        full = complete(_RUN.schema, given)
        task = _task(full["task"])
        settings = cls(
            task=task,
            algorithm=full["algorithm"],
            options=full["options"],
            starts=_starts(full["starts"]),
            seed=full["seed"],
            seeds=tuple(full.get("seeds", task.seeds)),
            budget=full["budget"],
            objectives=tuple(full["objectives"]),
            measures=tuple(Measure(**measure) for measure in full["measures"]),
        )
        asked = {need.name for expression in settings.expressions() for need in expression.needs}
        return replace(settings, task=task.with_duty()) if "duty" in asked else settings

    @property
    def document(self) -> JsonObject:
        """The document, everything filled in: a new copy, plain JSON data."""
        return {
            "format": FORMAT,
            "task": self.task.document,
            "algorithm": self.algorithm,
            "options": dict(self.options),
            "starts": [genome.document for genome in self.starts],
            "seed": self.seed,
            "seeds": list(self.seeds),
            "budget": self.budget,
            "objectives": list(self.objectives),
            "measures": [asdict(measure) for measure in self.measures],
        }

    @property
    def hash(self) -> str:
        """SHA-256 of what decides the run's history: the document in canonical form without the budget."""
        decisive = {**self.document, "task": task_identity(self.task.document)}
        del decisive["budget"]
        return canonical_hash(decisive)

    @property
    def problem(self) -> Problem:
        """What the algorithm sees of the run."""
        return Problem(self.task, self.seed, self.starts, self.objectives, self.measures)

    def begin(self) -> Algorithm:
        """Returns the algorithm at its beginning.

        Raises:
            DocumentError: As `load_algorithm`.
            MissingPackage: As `load_algorithm`.
        """
        return load_algorithm(self.algorithm, self.problem, self.options)

    def expressions(self) -> tuple[Objective, ...]:
        """Returns the objectives, then the measures, ready to be evaluated.

        Raises:
            DocumentError: Some cannot be read.
        """
        measures = [measure.expression for measure in self.measures]
        return read_expressions(self.objectives, "objectives") + read_expressions(measures, "measures")

    def with_budget(self, budget: int) -> RunSettings:
        """Returns the same settings with another budget."""
        return replace(self, budget=budget)

    def fingerprint(self) -> dict[str, str]:
        """Returns the fingerprint of what would compute the run here: of the engine, the draws and the algorithm."""
        draw = Draw(0, "fingerprint")
        drawn = [[draw.normal(), draw.uniform(-1.0, 1.0), draw.count(0, 1 << 40)] for _ in range(100)]
        return {
            **fingerprint(load_backend(self.task.world_config(0)["backend"])),
            "draws": sha256(orjson.dumps(drawn)).hexdigest(),
            "algorithm": self.begin().probe(),
        }


def _task(value: str | JsonObject) -> Task:
    try:
        return Task.load(value)
    except DocumentError as error:
        raise DocumentError((f"task/{path}" if path else "task", words) for path, words in error.problems) from error


def _starts(values: Sequence[str | JsonObject]) -> tuple[Genome, ...]:
    """Reads the genomes to begin with."""
    problems: list[tuple[str, str]] = []
    starts = []
    for index, value in enumerate(values):
        try:
            starts.append(Genome.load(value))
        except DocumentError as error:
            problems += [(f"starts/{index}/{path}".rstrip("/"), words) for path, words in error.problems]
    if problems:
        raise DocumentError(problems)
    return tuple(starts)


def _refusals(starts: Sequence[Genome], task: Task) -> Iterator[tuple[str, str]]:
    """Yields the genomes that may not take part, or whose brain is none for their body, and why."""
    for index, genome in enumerate(starts):
        try:
            admit(genome, task)
        except NmesError as error:
            yield f"starts/{index}", f"{genome.name!r} may not take part: {error.message}"
