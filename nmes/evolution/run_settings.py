"""What a run is about, as a document: read, completed, judged as a whole, and kept as `run.json`.

Invariants: settings that were read can be run; two runs whose settings are equal but for the budget have one history,
of which the one with the greater budget has more.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any, Final

import orjson

from nmes.backend import load_backend
from nmes.backend.fingerprint import fingerprint
from nmes.errors import DocumentError, MissingPackage, NmesError
from nmes.evaluation import MatchTask, Task, brain_of
from nmes.evaluation.match_task import load_task
from nmes.evaluation.population import admit
from nmes.evaluation.setting import task_identity
from nmes.evolution.algorithm import Algorithm, Measure, Problem
from nmes.evolution.algorithms import algorithm_options, load_algorithm
from nmes.evolution.algorithms.requirements import require_ranges
from nmes.evolution.coevolution import (
    Coevolution,
    coevolution_options,
    complete_options,
    default_roles,
    role_problems,
)
from nmes.evolution.quantities import read_expressions
from nmes.evolution.run_folder import require_documents
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

__all__ = ["FORMAT", "Population", "RunSettings"]

FORMAT: Final = "nmes-run/1"
_RUN: Final = compile_schema("run.json")


@dataclass(frozen=True, slots=True)
class Population:
    """A population of a run of several.

    Attributes:
        role: The role that its candidates play, which is its name.
        starts: The genomes that it begins with; none: random ones.
    """

    role: str
    starts: tuple[Genome, ...]


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
        populations: Of a task with roles, in the order in which their candidates take turns; else none.
    """

    task: Task | MatchTask
    algorithm: str
    options: Mapping[str, int | float | bool]
    starts: tuple[Genome, ...]
    seed: int
    seeds: tuple[int, ...]
    budget: int
    objectives: tuple[str, ...]
    measures: tuple[Measure, ...]
    populations: tuple[Population, ...] = ()

    @classmethod
    def read(cls, document: Mapping[str, Any]) -> RunSettings:
        """Reads a document as `schemas/run.json` says; names and files of the task and of genomes are looked up.

        Raises:
            DocumentError: It is not such a document, or what it says cannot be run, with all that is wrong.
            MissingPackage: The algorithm, or a brain to begin with, needs a package that is not installed.
        """
        found = cls._of(document)
        known = coevolution_options if found.populations else algorithm_options
        settings = replace(found, options={**known(found.algorithm), **found.options})
        if problems := list(settings._refusals()):
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

        Options that it lacks are at their defaults, with which alone its log can have been written.

        Raises:
            DocumentError: It is no such document.
        """
        given = plain(document)
        check(_RUN, given)
        require_documents(given)
        found = cls._of(given)
        require_ranges(found.measures)
        return replace(found, options=complete_options(found.options)) if found.populations else found

    @classmethod
    def _of(cls, document: Mapping[str, Any]) -> RunSettings:
        """Reads a document whose task and genomes may be names or files."""
        given = plain(document)
        check(_RUN, given)
        full = complete(_RUN.schema, given)
        task = _task(full["task"])
        populations = _populations(task, full)
        settings = cls(
            task=task,
            algorithm=full["algorithm"],
            options=full["options"],
            starts=_starts(full["starts"], "starts"),
            seed=full["seed"],
            seeds=tuple(full.get("seeds", task.seeds)),
            budget=full["budget"],
            objectives=tuple(full["objectives"]),
            measures=tuple(Measure(**measure) for measure in full["measures"]),
            populations=populations,
        )
        asked = {need.name for expression in settings.expressions() for need in expression.needs}
        return replace(settings, task=task.with_duty()) if "duty" in asked and isinstance(task, Task) else settings

    @property
    def document(self) -> JsonObject:
        """The document, everything filled in: a new copy, plain JSON data."""
        populations = [
            {"role": each.role, "starts": [genome.document for genome in each.starts]} for each in self.populations
        ]
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
            **({"populations": populations} if populations else {}),
        }

    @property
    def hash(self) -> str:
        """SHA-256 of what decides the run's history: the document in canonical form without the budget."""
        decisive = {**self.document, "task": task_identity(self.task.document)}
        del decisive["budget"]
        return canonical_hash(decisive)

    def begin(self) -> Algorithm:
        """Returns the algorithm at its beginning.

        Raises:
            DocumentError: As `load_algorithm`.
            MissingPackage: As `load_algorithm`.
        """
        given = self.task, self.seed
        asked = self.objectives, self.measures
        if self.populations:
            problems = [Problem(*given, each.starts, *asked, each.role) for each in self.populations]
            return Coevolution(problems, self.algorithm, self.options)
        return load_algorithm(self.algorithm, Problem(*given, self.starts, *asked), self.options)

    def expressions(self) -> tuple[Objective, ...]:
        """Returns the objectives, then the measures, ready to be evaluated.

        Raises:
            DocumentError: Some cannot be read.
        """
        measures = [measure.expression for measure in self.measures]
        return read_expressions(self.objectives, "objectives") + read_expressions(measures, "measures")

    def _refusals(self) -> Iterator[tuple[str, str]]:
        """Yields the genomes to begin with that may not take part, each with its place, and why."""
        places = {"starts": ("", self.starts)}
        places |= {f"populations/{at}/starts": (each.role, each.starts) for at, each in enumerate(self.populations)}
        for place, (role, starts) in places.items():
            for index, genome in enumerate(starts):
                if reason := _barred(genome, self.task, role):
                    yield f"{place}/{index}", f"{genome.name!r} may not take part: {reason}"

    def in_turn(self, index: int, group: str) -> bool:
        """Whether a candidate can be of a group: populations take turns, and other groups are as they come."""
        return not self.populations or self.populations[index % len(self.populations)].role == group

    def with_budget(self, budget: int) -> RunSettings:
        """Returns the same settings with another budget.

        Raises:
            DocumentError: No run may have it.
        """
        check(_RUN, {"format": FORMAT, "task": self.task.name, "algorithm": self.algorithm, "budget": budget})
        return replace(self, budget=budget)

    def fingerprint(self) -> dict[str, str]:
        """Returns the fingerprint of what would compute the run here: of the engine, the draws and the algorithm.

        The versions of packages are there to be read; what decides is what they compute.
        """
        draw = Draw(0, "fingerprint")
        drawn = [[draw.normal(), draw.uniform(-1.0, 1.0), draw.count(0, 1 << 40)] for _ in range(100)]
        return {
            **fingerprint(load_backend(self.task.world_config(0)["backend"])),
            "draws": sha256(orjson.dumps(drawn)).hexdigest(),
            "algorithm": self.begin().probe(),
            **{name: version(name) for name in ("numpy", "cma") if find_spec(name) is not None},
        }


def _task(value: str | JsonObject) -> Task | MatchTask:
    try:
        if isinstance(value, str):
            return load_task(value)
        return MatchTask(value) if "roles" in value else Task(value)
    except DocumentError as error:
        raise DocumentError((f"task/{path}" if path else "task", words) for path, words in error.problems) from error


def _populations(task: Task | MatchTask, document: JsonObject) -> tuple[Population, ...]:
    """Reads the populations of a sound document, which a task with roles has, and no other.

    Raises:
        DocumentError: There are such as there may not be.
    """
    given: list[JsonObject] | None = document.get("populations")
    if not isinstance(task, MatchTask):
        if given is not None:
            raise DocumentError([("populations", f"{task.name} has no roles: its candidates are one population")])
        return ()
    if document["starts"]:
        raise DocumentError([("starts", f"{task.name} has roles: each population has its own: populations/0/starts")])
    if given is None:
        given = [{"role": role, "starts": []} for role in default_roles(task)]
    problems = role_problems(task, [each["role"] for each in given])
    if problems:
        raise DocumentError((f"populations/{place}/role", words) for place, words in problems)
    return tuple(
        Population(each["role"], _starts(each["starts"], f"populations/{place}/starts"))
        for place, each in enumerate(given)
    )


def _starts(values: Sequence[str | JsonObject], place: str) -> tuple[Genome, ...]:
    """Reads the genomes to begin with, which stand at this place of the document."""
    problems: list[tuple[str, str]] = []
    starts = []
    for index, value in enumerate(values):
        try:
            starts.append(Genome.load(value))
        except DocumentError as error:
            named = f"{value}: " if isinstance(value, str) else ""
            problems += [(f"{place}/{index}/{path}".rstrip("/"), named + words) for path, words in error.problems]
    if problems:
        raise DocumentError(problems)
    return tuple(starts)


def _barred(genome: Genome, task: Task | MatchTask, role: str) -> str | None:
    """Returns why a genome may not take part, or its brain is none for its body; None if it may.

    Raises:
        MissingPackage: Its brain needs a package that is not installed, which says nothing of it.
    """
    try:
        if isinstance(task, Task):
            admit(genome, task)
            return None
        brain_of(genome)
    except MissingPackage:
        raise
    except NmesError as error:
        return error.message
    return "; ".join(task.check(role, genome.body)) or None
