"""How a corpus is proved: each line is judged as it stands, and episodes are run again.

Invariants: nothing that a line says is believed, and what is compared is compared to the last bit. A verdict does not
depend on how many processes there are. What this machine lacks is never held against a creature.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from nmes.backend import load_backend
from nmes.backend.fingerprint import decisive, differences, fingerprint
from nmes.brain import Brain
from nmes.errors import BackendNotFound, MachineError, MissingPackage, NmesError, RecordingError
from nmes.evaluation.again import MODEL, drawn, has_model, unforeseen
from nmes.evaluation.episode import Episode
from nmes.evaluation.evaluator import episode_metadata, file_name, recorded
from nmes.evaluation.identity import borrows_name, creature_hash
from nmes.evaluation.judge import Result
from nmes.evaluation.parallel import Lost, in_processes
from nmes.evaluation.population import admit, guarded
from nmes.evaluation.task import Task
from nmes.evolution.corpus import Corpus, CorpusCreature, CorpusEpisode, mean_score
from nmes.genome import Genome
from nmes.schemas.documents import JsonObject
from nmes.variation.draw import Draw
from nmes.world import World

__all__ = ["CorpusFinding", "CorpusVerdict", "Episodes", "Work", "fingerprint_of", "run_episodes", "verify_corpus"]

Verdict = Literal["holds", "broken", "not_judged"]
_MACHINE: Final = (BackendNotFound, MachineError, MissingPackage, RecordingError)
"""Errors that say something of this machine, and nothing of a creature: a recording is one that cannot be written."""


@dataclass(frozen=True, slots=True)
class CorpusFinding:
    """What is wrong with a creature, or with the corpus as a whole.

    Attributes:
        name: The creature's; empty: it is of the whole.
        verdict: `broken`, or `not_judged`: that may be this machine's doing.
        reason: In words.
    """

    name: str
    verdict: Verdict
    reason: str


@dataclass(frozen=True, slots=True)
class CorpusVerdict:
    """What came out when a corpus was verified.

    Attributes:
        verdict: It `holds`, it is `broken`, or nothing is broken and something could not be judged here.
        findings: What does not hold.
        creatures: How many there are.
        again: How many of them were run again.
        episodes: In how many episodes.
        seed: Of the draw by which these were chosen.
        digest: The corpus'.
    """

    verdict: Verdict
    findings: tuple[CorpusFinding, ...]
    creatures: int
    again: int
    episodes: int
    seed: int
    digest: str


@dataclass(frozen=True, slots=True)
class Work:
    """A creature whose episodes are to be run: plain data, for another process.

    Attributes:
        genome: The genome's document.
        task: The task's.
        record: A folder for recordings; None: none are made.
    """

    genome: JsonObject
    task: JsonObject
    record: str | None = None


class Refusal(NmesError):
    """Why a creature cannot take part, as other errors of NMES say it, which no process can send to another.

    Attributes:
        machine: Whether that says something of this machine alone.
    """

    def __init__(self, code: str, message: str, machine: bool) -> None:
        super().__init__(code, message)
        self.machine = machine

    def __reduce__(self) -> tuple[type[Refusal], tuple[str, str, bool]]:
        """Returns how another process makes the same error, with its arguments."""
        return Refusal, (self.code, self.message, self.machine)


Episodes = tuple[CorpusEpisode, ...]


def run_episodes(work: Work) -> Episodes | Refusal:
    """Runs a creature's episodes, one for each seed of the task, each in a world of its own.

    Returns:
        How they came out, or why the creature cannot take part.
    """
    try:
        genome, task = Genome(work.genome), Task(work.task)
        brain = admit(genome, task)
        return tuple(_episode(genome, brain, task, seed, work.record) for seed in task.seeds)
    except NmesError as error:
        return Refusal(error.code, error.message, isinstance(error, _MACHINE))


def _episode(genome: Genome, brain: Brain | None, task: Task, seed: int, record: str | None) -> CorpusEpisode:
    about = episode_metadata(genome, task, seed)
    place = f"{task.name}-{file_name(genome.name)}-{genome.hash[:16]}-{seed}.mcap"
    with nullcontext() if record is None else recorded(Path(record, place), about) as journal:
        world = World(task.world_config(seed))
        if journal is not None:
            world.journal = journal(world)
        try:
            result: Result = guarded(lambda: Episode(world, genome, brain, task, seed).run(), seed)
            if world.fault is not None and world.fault.code == "recording_failed":
                raise RecordingError(world.fault.code, world.fault.message)
            return CorpusEpisode(result, world.digest().hex())
        finally:
            world.close()


def fingerprint_of(task: Task) -> dict[str, str]:
    """Returns the parts of the fingerprint that decide the last bits of a task's episodes here."""
    return decisive(fingerprint(load_backend(task.world_config(0)["backend"])))


def verify_corpus(
    corpus: Corpus,
    *,
    jobs: int = 1,
    sample: int | None = None,
    seed: int | None = None,
    record: str | os.PathLike[str] | None = None,
    progress: Callable[[str, int, int], None] = lambda doing, done, total: None,
) -> CorpusVerdict:
    """Verifies a corpus.

    Every line is judged as it stands: tasks, genomes and hashes, order, and that no creature is there twice. Of all
    creatures, or of the best of each task and those that are drawn, every episode is run again.

    Args:
        corpus: The corpus.
        jobs: In how many processes.
        sample: How many creatures are run again beside the best of each task, drawn by the seed and the corpus'
            digest; None: all.
        seed: Of the draw; None: one that nobody can foresee.
        record: An existing folder for recordings of the episodes that are run.
        progress: Called with what is being done, how much of it is done, and how much there is.
    """
    verification = _Verification(corpus)
    sound = verification.judge_lines(progress)
    digest, seed = corpus.digest, unforeseen(seed)
    chosen = sound if sample is None else _chosen(sound, sample, Draw(seed, "corpus", digest))
    folder = None if record is None else os.fspath(record)
    work = [Work(each.genome, corpus.tasks[each.task].task.document, folder) for each in chosen]
    progress("running again", 0, len(work))
    for done, (index, found) in enumerate(in_processes(run_episodes, work, jobs), start=1):
        verification.compare(chosen[index], found)
        progress("running again", done, len(work))
    place = {"": -1} | {corpus.name_of(each): number for number, each in enumerate(corpus.creatures)}
    findings = sorted(verification.findings, key=lambda each: place[each.name])
    kinds = {each.verdict for each in findings}
    verdict: Verdict = "broken" if "broken" in kinds else "not_judged" if kinds else "holds"
    episodes = sum(len(each.episodes) for each in chosen)
    return CorpusVerdict(verdict, tuple(findings), len(corpus.creatures), len(chosen), episodes, seed, digest)


def _chosen(creatures: Sequence[CorpusCreature], sample: int, draw: Draw) -> list[CorpusCreature]:
    """Returns the best creature of each task, and so many others, in their order."""
    best: dict[str, int] = {}
    for place, each in enumerate(creatures):
        if each.task not in best or each.score > creatures[best[each.task]].score:
            best[each.task] = place
    others = [place for place in range(len(creatures)) if place not in best.values()]
    return [creatures[place] for place in sorted([*best.values(), *drawn(others, sample, draw)])]


class _Verification:
    def __init__(self, corpus: Corpus) -> None:
        self._corpus = corpus
        self.findings: list[CorpusFinding] = []
        self._elsewhere: dict[str, str] = {}  # by a task's hash: in what its episodes were computed otherwise
        for key, known in corpus.tasks.items():
            if known.task.hash != key:
                self._find(None, "broken", f"the task {known.task.name} has the hash {known.task.hash}, not {key}")
            try:
                pairs = differences(known.fingerprint, fingerprint_of(known.task))
            except NmesError as error:
                self._elsewhere[key], pairs = error.message, {}
            if pairs:
                told = ", ".join(f"{name} {was}, here {here}" for name, (was, here) in pairs.items())
                self._elsewhere[key] = f"it was computed with another {told}"
            if borrows_name(known.task.name, known.task.hash):
                other = f"the task {known.task.name} is another than the one of that name that ships"
                self._find(None, "not_judged" if key in self._elsewhere else "broken", other)

    def _find(self, creature: CorpusCreature | None, verdict: Verdict, reason: str) -> None:
        name = "" if creature is None else self._corpus.name_of(creature)
        self.findings.append(CorpusFinding(name, verdict, reason))

    def judge_lines(self, progress: Callable[[str, int, int], None]) -> list[CorpusCreature]:
        """Judges each line as it stands; returns the creatures that can be run."""
        corpus = self._corpus
        sound: list[CorpusCreature] = []
        seen: set[tuple[str, str]] = set()
        for number, each in enumerate(corpus.creatures):
            progress("reading", number, len(corpus.creatures))
            if (each.task, each.creature) in seen:
                self._find(each, "broken", "the creature is there twice for its task")
            seen.add((each.task, each.creature))
            try:
                reasons = self._reasons(each)
            except NmesError as error:
                reasons = []
                self._find(each, "not_judged" if isinstance(error, _MACHINE) else "broken", error.message)
            else:
                sound += [] if reasons else [each]
            if reasons:
                self._find(each, "broken", "; ".join(reasons))
        known = [each for each in corpus.creatures if each.task in corpus.tasks]
        if len(known) == len(corpus.creatures):
            ordered = Corpus.of(corpus.tasks.values(), corpus.runs, known)
            if list(ordered.tasks) != list(corpus.tasks) or ordered.creatures != corpus.creatures:
                self._find(None, "broken", "the creatures are not in order: by task, the highest score first")
        return sound

    def _reasons(self, each: CorpusCreature) -> list[str]:
        """Returns why a line cannot be true, without running anything.

        Raises:
            DocumentError: Its genome is none.
            MissingPackage: Its brain needs a package that is not installed.
        """
        known = self._corpus.tasks.get(each.task)
        genome = Genome(each.genome)
        reasons = []
        for what, listed, value in (
            ("genome_hash", each.genome_hash, genome.hash),
            ("creature", each.creature, creature_hash(genome, None if known is None else known.task)),
            ("score", each.score, mean_score(each.episodes)),
        ):
            if listed != value:
                reasons.append(f"{what} is {listed!r}, and comes out as {value!r}")
        if known is None:
            reasons.append(f"the corpus has no task with the hash {each.task}")
        elif tuple(one.result.seed for one in each.episodes) != known.task.seeds:
            reasons.append("its episodes are not one for each of the task's seeds")
        if each.run >= len(self._corpus.runs):
            reasons.append(f"the corpus has no run {each.run}")
        elif each.candidate >= self._corpus.runs[each.run].settings.get("budget", 0):
            reasons.append(f"its run has no candidate {each.candidate}")
        return reasons

    def compare(self, creature: CorpusCreature, found: Episodes | Refusal | Lost) -> None:
        """Compares what a line says of its episodes with how they came out here."""
        if isinstance(found, Lost):
            self._find(creature, "not_judged", found.reason)
            return
        if isinstance(found, Refusal):
            self._find(creature, "not_judged" if found.machine else "broken", found.message)
            return
        listed = [episode.to_json() for episode in creature.episodes]
        again = [{**episode.to_json(), "fault": episode.result.fault} for episode in found]
        reasons = [
            f"seed {one['seed']}: {name} is {one.get(name)!r}, and comes out as {value!r}"
            for one, other in zip(listed, again, strict=True)
            for name, value in other.items()
            if one.get(name) != value
        ]
        if reasons:
            excuse = self._elsewhere.get(creature.task) or (MODEL if has_model([creature.genome]) else None)
            words = "; ".join([*reasons, excuse] if excuse else reasons)
            self._find(creature, "not_judged" if excuse else "broken", words)
