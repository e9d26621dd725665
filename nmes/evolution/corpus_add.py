"""How creatures of runs come into a corpus: which are chosen, and how their episodes are run for it.

Invariant: the same runs in the same order give the same corpus, for any number of processes.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Final

from nmes.backend.fingerprint import differences
from nmes.errors import CorpusError, MachineError, NmesError
from nmes.evaluation.again import MODEL, has_model
from nmes.evaluation.identity import borrows_name, creature_hash, shipped_hash
from nmes.evaluation.parallel import Lost, in_processes
from nmes.evaluation.task import Task
from nmes.evolution.corpus import Corpus, CorpusCreature, CorpusRun, CorpusTask, mean_score, settings_of
from nmes.evolution.corpus_verify import Episodes, Refusal, Work, fingerprint_of, run_episodes
from nmes.evolution.run import Run
from nmes.genome import Genome
from nmes.schemas.documents import write_json

__all__ = ["add_runs"]

_FACTS: Final = ("score", "energy", "distance", "ticks", "ended", "fault")  # of an episode, that a run's log tells too


@dataclass(frozen=True, slots=True)
class _Chosen:
    """A candidate of a run that is to be added: the run, its place among the corpus' runs, and its index."""

    run: Run
    task: Task
    place: int
    index: int
    genome: Genome
    creature: str
    generation: int


def add_runs(
    corpus: Corpus,
    folders: Sequence[str | os.PathLike[str]],
    *,
    best: int,
    jobs: int = 1,
    progress: Callable[[str, int, int], None] = lambda doing, done, total: None,
) -> Corpus:
    """Returns a corpus with creatures of runs added.

    Args:
        corpus: What is there already, which may be nothing.
        folders: The runs', in the order in which of equal creatures the first counts.
        best: How many of each run at most: its elites, then the best of the others whose scores differ.
        jobs: In how many processes their episodes are run.
        progress: Called with what is being done, how much of it is done, and how much there is.

    Raises:
        CorpusError: A run has roles, or nothing to add (`nothing_to_add`); its task has the name of one that ships and
            is another (`borrowed_name`); what is there was computed where other numbers come out, or a run was
            (`not_comparable`), or a run's log says otherwise (`diverged`).
        RunError: A run cannot be read.
        MachineError: A process was killed (`worker_killed`).
    """
    tasks, runs = dict(corpus.tasks), list(corpus.runs)
    chosen: list[_Chosen] = []
    seen = {(each.task, each.creature) for each in corpus.creatures}
    for done, folder in enumerate(folders):
        progress("reading runs", done, len(folders))
        run = Run.open(folder)
        if run.digest in {each.digest for each in runs}:
            continue
        task = _task_of(run)
        _admit(tasks, task)
        found = list(islice(_candidates(run, task, len(runs), seen), best))
        if not found:
            raise CorpusError("nothing_to_add", f"{run.folder} has no candidate with a score above 0 that was varied")
        settings = settings_of(run.settings.document, task.hash == shipped_hash(task.name))
        runs.append(CorpusRun(settings, run.digest))
        chosen += found
    work = [Work(each.genome.document, each.task.document) for each in chosen]
    played: dict[int, Episodes] = {}
    for index, found_again in in_processes(run_episodes, work, jobs):
        played[index] = _played(chosen[index], found_again)
        progress("running", len(played), len(work))
    creatures = [_creature(each, played[number]) for number, each in enumerate(chosen)]
    new = (each for each in creatures if each is not None and each.score > 0)
    return Corpus.of(tasks.values(), runs, [*corpus.creatures, *new])


def _task_of(run: Run) -> Task:
    """Returns the task of a run, as it stands without what the run measures.

    Raises:
        CorpusError: It has roles (`nothing_to_add`), or the name of one that ships and is another (`borrowed_name`).
    """
    task = run.settings.task
    if borrows_name(task.name, task.hash):
        what = f"{run.folder} is of another task than the {task.name} that ships"
        raise CorpusError("borrowed_name", f"{what}: begin a run of it under a name of its own")
    if not isinstance(task, Task):
        raise CorpusError("nothing_to_add", f"{run.folder} is of {task.name}, a task with roles: it has no scores")
    return Task(task.document)


def _admit(tasks: dict[str, CorpusTask], task: Task) -> None:
    """Takes a task in; one that is there must have been computed where the same numbers come out.

    Raises:
        CorpusError: It was not (`not_comparable`).
    """
    here = fingerprint_of(task)
    known = tasks.setdefault(task.hash, CorpusTask(task, task.hash, here))
    if differences(known.fingerprint, here):
        what = f"the episodes on {task.name} that are there were computed where other numbers come out"
        raise CorpusError("not_comparable", f"{what}: begin a new corpus")


def _candidates(run: Run, task: Task, place: int, seen: set[tuple[str, str]]) -> Iterator[_Chosen]:
    """Yields candidates that have been varied and have a score above 0, those to be preferred first, none twice."""
    records = run.records
    generations: list[int] = []
    for record in records:
        generations.append(1 + max((generations[parent] for parent in record.parents), default=-1))
    elites = run.elites()
    ranked = sorted(range(len(records)), key=lambda index: (-(records[index].score or 0.0), index))
    scores: set[float] = set()
    for index in dict.fromkeys([*elites, *ranked]):
        score = records[index].score
        if score is None or score <= 0 or not generations[index] or score in scores:
            continue
        genome = run.genome(index)
        creature = creature_hash(genome, task)
        if (task.hash, creature) in seen:
            continue
        seen.add((task.hash, creature))
        scores.add(score)
        yield _Chosen(run, task, place, index, genome, creature, generations[index])


def _played(chosen: _Chosen, found: Episodes | NmesError | Lost) -> Episodes:
    """Returns how episodes came out, which must be as the run's log says where that tells of the same.

    Raises:
        CorpusError: They came out otherwise (`diverged`, or `not_comparable` where that may be for the machine).
        MachineError: A process was killed (`worker_killed`), or the machine lacks something that they need.
    """
    who = f"{chosen.run.folder}, candidate {chosen.index}"
    if isinstance(found, Lost):
        raise MachineError("worker_killed", f"{who}: {found.reason}")
    if isinstance(found, Refusal) and found.machine:
        raise MachineError(found.code, f"{who}: {found.message}")
    if isinstance(found, NmesError):
        raise CorpusError("diverged", f"{who}: {found.message}") from found
    logged = {result.seed: result for result in chosen.run.evaluation(chosen.index).results}
    for episode in found:
        result, before = episode.result, logged.get(episode.result.seed)
        if before is not None and any(getattr(result, name) != getattr(before, name) for name in _FACTS):
            excuse = _excuse(chosen)
            words = (
                f"{who}, seed {result.seed}: its log has {before}, and here it is {result}{excuse and f'; {excuse}'}"
            )
            raise CorpusError("not_comparable" if excuse else "diverged", words)
    return found


def _excuse(chosen: _Chosen) -> str:
    """Returns why the episodes of a candidate may come out otherwise here in good faith; empty where they must not."""
    if chosen.run.differences():
        return "the run was begun where other numbers come out"
    return MODEL if has_model([chosen.genome.document]) else ""


def _creature(chosen: _Chosen, episodes: Episodes) -> CorpusCreature | None:
    """Returns the creature as a corpus has it; None where an episode has no score."""
    score = mean_score(episodes)
    if score is None:
        return None
    return CorpusCreature(
        task=chosen.task.hash,
        creature=chosen.creature,
        text=write_json(chosen.genome.document),
        genome_hash=chosen.genome.hash,
        score=score,
        episodes=episodes,
        run=chosen.place,
        candidate=chosen.index,
        generation=chosen.generation,
        operator=chosen.run.records[chosen.index].operator,
    )
