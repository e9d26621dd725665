"""Many matches, here or in many processes: each comes out the same wherever it is played."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import orjson

from nmes.errors import MissingPackage, NmesError, RecordingError
from nmes.evaluation.match import MatchResult, admit_players, play_match
from nmes.evaluation.match_task import MatchTask
from nmes.evaluation.parallel import Lost, Pool
from nmes.evaluation.referee import void_results
from nmes.genome import Genome
from nmes.schemas.documents import write_json

__all__ = ["Bout", "play_bouts"]


@dataclass(frozen=True, slots=True)
class Bout:
    """A match to be played somewhere else: plain data.

    Attributes:
        task: The task's document, as JSON.
        genomes: Those of the roles, as JSON, in the order of the roles.
        seed: The match's.
        record: An existing directory, in which a recording is left; None: there is none.
    """

    task: bytes
    genomes: tuple[bytes, ...]
    seed: int
    record: str | None = None

    @classmethod
    def of(cls, task: MatchTask, genomes: Mapping[str, Genome], seed: int, record: str | None = None) -> Bout:
        """Returns the bout of creatures in their roles."""
        documents = tuple(write_json(genomes[role].document) for role in task.roles)
        return cls(write_json(task.document), documents, seed, record)


@dataclass(frozen=True, slots=True)
class _Unrecorded:
    """A RecordingError as plain data, which can be sent from process to process."""

    code: str
    message: str


def play_bouts(
    pool: Pool, bouts: Sequence[Bout], progress: Callable[[int, int], None] | None = None
) -> Iterator[tuple[int, MatchResult]]:
    """Plays matches.

    Args:
        pool: Where.
        bouts: Which.
        progress: Called with how many are done, and how many there are.

    Yields:
        The index of a bout and its result, as they are ready. A match over which a process died, or whose creatures
        cannot be set down, is void.

    Raises:
        RecordingError: A recording cannot be written.
        MissingPackage: A brain needs a package that is not installed.
    """
    done, show = 0, progress or _silent
    show(done, len(bouts))
    for index, result in pool.run(_play, bouts):
        done += 1
        show(done, len(bouts))
        if isinstance(result, _Unrecorded):
            raise RecordingError(result.code, result.message)
        if isinstance(result, Lost):
            task, seed = MatchTask(orjson.loads(bouts[index].task)), bouts[index].seed
            yield index, MatchResult(seed, void_results(task, seed, result.reason))
        else:
            yield index, result


def _silent(_done: int, _total: int) -> None:
    pass


def _play(bout: Bout) -> MatchResult | _Unrecorded:
    task = MatchTask(orjson.loads(bout.task))
    genomes = {role: Genome.parse(text) for role, text in zip(task.roles, bout.genomes, strict=True)}
    try:
        brains = admit_players(task, genomes)
        return play_match(task, genomes, brains, bout.seed, None if bout.record is None else Path(bout.record))
    except RecordingError as error:
        return _Unrecorded(error.code, error.message)
    except MissingPackage:
        raise
    except NmesError as error:
        return MatchResult(bout.seed, void_results(task, bout.seed, f"{error.code}: {error.message}"))
