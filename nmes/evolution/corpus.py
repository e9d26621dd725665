"""A corpus of evolved creatures in one file: genomes, scores, digests of episodes, and the runs that they come from.

Hides the file's form: lines of JSON in one frame of Zstandard, the first what the creatures are of
(schemas/corpus.json), each other a creature (schemas/corpus_creature.json). Creatures stand by task, the highest score
first, so that the same creatures give the same bytes.

Invariant: what is read may be of anybody, and is bounded before it is unpacked; what a line means beyond its schema is
judged by `nmes.evolution.corpus_verify`, and by nobody here.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import zstandard

from nmes.errors import CorpusError, DocumentError
from nmes.evaluation.judge import Result
from nmes.evaluation.task import Task
from nmes.genome import Genome
from nmes.objective.means import mean_of_all
from nmes.schemas.documents import JsonObject, check, compile_schema, complete, parse_document, write_json

__all__ = [
    "Corpus",
    "CorpusCreature",
    "CorpusEpisode",
    "CorpusRun",
    "CorpusTask",
    "mean_score",
    "settings_of",
]

_FORMAT: Final = "nmes-corpus/1"
_HEAD: Final = compile_schema("corpus.json")
_CREATURE: Final = compile_schema("corpus_creature.json")
_RUN: Final = compile_schema("run.json")
_LARGEST: Final = 64 << 20  # bytes of a file
_LINE: Final = 4 << 20  # bytes of a creature
_HEAD_LINE: Final = 16 << 20  # bytes
_UNPACKED: Final = 256 << 20  # bytes of what is in it
_PACKED: Final = 64  # times: as much as a file, beyond the bytes that any may have, may be larger unpacked
_FREE: Final = 8 << 20  # bytes
_MOST: Final = 100_000  # creatures
_LEVEL: Final = 19
_DIGITS: Final = 12  # of a creature's hash in its name


@dataclass(frozen=True, slots=True)
class CorpusTask:
    """A task that creatures were evolved for.

    Attributes:
        task: The task.
        hash: The hash that the file gives it.
        fingerprint: What the last bits of its episodes depend on.
    """

    task: Task
    hash: str
    fingerprint: dict[str, str]


@dataclass(frozen=True, slots=True)
class CorpusRun:
    """A run of evolution that creatures come from.

    Attributes:
        settings: What `nmes evolve --settings` reads; a task and genomes that ship stand there by their names.
        digest: Of its log.
    """

    settings: JsonObject
    digest: str


@dataclass(frozen=True, slots=True)
class CorpusEpisode:
    """How an episode came out.

    Attributes:
        result: The figures.
        digest: The world's digest at the end, 32 hexadecimal digits; it follows from all that has happened.
    """

    result: Result
    digest: str

    def to_json(self) -> JsonObject:
        """Returns it as plain data."""
        told = self.result.to_json()
        del told["fault"]  # an episode with a fault has no score, and is in no corpus
        return {**told, "digest": self.digest}


@dataclass(frozen=True, slots=True)
class CorpusCreature:
    """A creature of a corpus, as its line says: nothing of it is believed by who verifies.

    Attributes:
        task: The hash of the task that it was evolved for.
        creature: The hash over its body, sensors and brain.
        text: The genome's document as JSON: unpacked, many of a stranger's could take gigabytes.
        genome_hash: Its hash.
        score: The mean over the task's seeds, in the task's unit.
        episodes: One for each of the task's seeds.
        run: Which of the corpus' runs it comes from.
        candidate: Its index in that run.
        generation: How many steps of variation it is from a founder.
        operator: How it came about.
    """

    task: str
    creature: str
    text: bytes
    genome_hash: str
    score: float
    episodes: tuple[CorpusEpisode, ...]
    run: int
    candidate: int
    generation: int
    operator: str

    @classmethod
    def from_json(cls, data: JsonObject) -> CorpusCreature:
        """Reads a line.

        Raises:
            DocumentError: It is not as schemas/corpus_creature.json says.
        """
        check(_CREATURE, data)
        data = complete(_CREATURE.schema, data)
        episodes = tuple(
            CorpusEpisode(Result(**{name: value for name, value in each.items() if name != "digest"}), each["digest"])
            for each in data["episodes"]
        )
        text = write_json(data.pop("genome"))
        return cls(**{**data, "episodes": episodes, "text": text})

    def to_json(self) -> JsonObject:
        """Returns it as plain data, in the order of the fields of its line."""
        return {
            "task": self.task,
            "creature": self.creature,
            "genome_hash": self.genome_hash,
            "score": self.score,
            "episodes": [episode.to_json() for episode in self.episodes],
            "run": self.run,
            "candidate": self.candidate,
            "generation": self.generation,
            "operator": self.operator,
            "genome": self.genome,
        }

    @property
    def genome(self) -> JsonObject:
        """The genome's document."""
        document: JsonObject = parse_document(self.text)
        return document

    @property
    def name(self) -> str:
        """What the genome is called, by whomever."""
        return str(self.genome.get("name", ""))


@dataclass(frozen=True, slots=True)
class Corpus:
    """A corpus.

    Attributes:
        tasks: The tasks, by their hashes.
        runs: The runs.
        creatures: The creatures, in the file's order.
    """

    tasks: dict[str, CorpusTask]
    runs: tuple[CorpusRun, ...]
    creatures: tuple[CorpusCreature, ...]

    @classmethod
    def of(cls, tasks: Iterable[CorpusTask], runs: Sequence[CorpusRun], creatures: Iterable[CorpusCreature]) -> Corpus:
        """Returns a corpus of creatures in any order, no two of one task alike."""
        known = {each.hash: each for each in sorted(tasks, key=lambda each: (each.task.name, each.hash))}
        place = {digest: number for number, digest in enumerate(known)}
        ordered = sorted(creatures, key=lambda each: (place[each.task], -each.score, each.creature))
        return cls(known, tuple(runs), tuple(ordered))

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Corpus:
        """Reads a file.

        Raises:
            CorpusError: It is no corpus, or too large, or cannot be read (`no_corpus`).
        """
        content = _unpacked(path)
        lines, number = BytesIO(content), 1
        try:
            head = parse_document(_line(lines, _HEAD_LINE))
            check(_HEAD, head)
            tasks = [CorpusTask(Task(each["task"]), each["hash"], each["fingerprint"]) for each in head["tasks"]]
            for each in head["runs"]:
                check(_RUN, each["settings"])
            creatures = []
            while lines.tell() < len(content):
                number += 1
                creatures.append(CorpusCreature.from_json(parse_document(_line(lines, _LINE))))
        except DocumentError as error:
            raise _refused(path, f"line {number}: {error.message}") from error
        runs = tuple(CorpusRun(each["settings"], each["digest"]) for each in head["runs"])
        return cls({each.hash: each for each in tasks}, runs, tuple(creatures))

    def content(self) -> bytes:
        """Returns the file's content before it is packed."""
        head = {
            "format": _FORMAT,
            "tasks": [
                {"task": each.task.document, "hash": each.hash, "fingerprint": each.fingerprint}
                for each in self.tasks.values()
            ],
            "runs": [{"settings": run.settings, "digest": run.digest} for run in self.runs],
        }
        return b"".join(write_json(each) + b"\n" for each in (head, *(one.to_json() for one in self.creatures)))

    @property
    def digest(self) -> str:
        """SHA-256 of the content, hexadecimal: what the corpus is known by, however it is packed."""
        return sha256(self.content()).hexdigest()

    def write(self, path: Path) -> None:
        """Writes the file."""
        path.write_bytes(zstandard.ZstdCompressor(level=_LEVEL).compress(self.content()))

    def name_of(self, creature: CorpusCreature) -> str:
        """Returns a creature's name on the command line: its task, and the first digits of its hash."""
        known = self.tasks.get(creature.task)
        return f"{creature.task[:_DIGITS] if known is None else known.task.name}-{creature.creature[:_DIGITS]}"

    def find(self, name: str) -> CorpusCreature:
        """Returns the creature of a name, or of its beginning if no other name has that.

        Raises:
            CorpusError: There is none, or there are several (`no_creature`).
        """
        found = [each for each in self.creatures if self.name_of(each).startswith(name)]
        exact = [each for each in found if self.name_of(each) == name]
        if len(exact or found) == 1:
            return (exact or found)[0]
        what = f"{len(found):,} creatures have names that begin so" if found else "no creature has that name"
        raise CorpusError("no_creature", f"{name!r}: {what}; `nmes corpus show` tells the names")


def mean_score(episodes: Sequence[CorpusEpisode]) -> float | None:
    """Returns the mean score of episodes; None where one has none."""
    return mean_of_all([episode.result.score for episode in episodes])


def settings_of(document: JsonObject, shipped_task: bool) -> JsonObject:
    """Returns the settings of a run with what ships by its name: shorter, and the same run.

    Args:
        document: The settings, whole.
        shipped_task: Whether the task is one that ships.
    """
    known = {Genome.load(name).hash: name for name in Genome.names()}
    starts: list[Any] = [known.get(Genome(each).hash, each) for each in document["starts"]]
    task = document["task"]["name"] if shipped_task else document["task"]
    return {**document, "task": task, "starts": starts}


def _line(lines: BytesIO, most: int) -> bytes:
    """Reads a line.

    Raises:
        DocumentError: It is longer than so many bytes.
    """
    line = lines.readline(most + 1)
    if len(line) > most:
        raise DocumentError([("", f"it has over {most >> 20} MiB")])
    return line


def _unpacked(path: str | os.PathLike[str]) -> bytes:
    """Returns the unpacked content of a file, which ends with a line."""
    try:
        with open(path, "rb") as file:
            packed = file.read(_LARGEST + 1)
    except OSError as error:
        where = ". That of NMES itself is corpus/creatures.jsonl.zst in its repository"
        raise CorpusError("no_corpus", f"cannot read {os.fspath(path)}: {error.strerror}{where}") from error
    if len(packed) > _LARGEST:
        raise _refused(path, f"it has over {_LARGEST >> 20} MiB")
    try:
        size = zstandard.frame_content_size(packed)
        if not 0 < size <= _UNPACKED:
            raise _refused(path, f"it says that it holds {size:,} bytes; 1 to {_UNPACKED:,} are read")
        if size > _FREE + _PACKED * len(packed):
            raise _refused(path, f"it has {len(packed):,} bytes, and {size:,} unpacked: such files are not read")
        content = zstandard.ZstdDecompressor().decompress(packed, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise _refused(path, f"it cannot be unpacked: {error}") from error
    if not content.endswith(b"\n"):
        raise _refused(path, "its last line is cut")
    if content.count(b"\n") > _MOST + 1:
        raise _refused(path, f"it has over {_MOST:,} creatures")
    return content


def _refused(path: str | os.PathLike[str], reason: str) -> CorpusError:
    return CorpusError("no_corpus", f"{os.fspath(path)} is no corpus: {reason}")
