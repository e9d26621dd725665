"""One line of a leaderboard: what its recordings prove of it, and how a row that anybody may have edited is judged.

Invariants:

- All that a line says follows from its recordings: whatever a row says otherwise, it is broken.
- What is in a row, or in a recording, is one entry's matter: judging one never fails.
- What is the verifier's own trouble (another machine, a missing engine, a disk) breaks nothing.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import file_digest, sha256
from math import fsum
from pathlib import Path
from statistics import pstdev
from typing import Any, Final, Literal

import orjson

from nmes.errors import LeaderboardError, NmesError
from nmes.evaluation.identity import borrows_name, creature_hash
from nmes.evaluation.proof import Proof, prove
from nmes.recording import Recording
from nmes.recording.signing import signer

__all__ = ["COLUMNS", "Entry", "Verdict", "examine", "facts", "read_row"]

_HASH: Final = re.compile("[0-9a-f]{64}")
_MACHINE: Final = {"backend_not_found", "missing_package", "not_comparable", "recording_unreadable", "unknown_format"}
"""Codes of errors that say something of the verifier's machine, and nothing of the entry."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of a leaderboard.

    Attributes:
        id: Its number in the file.
        task: The task's name.
        task_hash: SHA-256 of the task, hexadecimal.
        name: The genome's name.
        genome_hash: SHA-256 of the genome, hexadecimal.
        creature_hash: SHA-256 of what of the genome acts, hexadecimal; see `nmes.evaluation.identity`.
        author: Who made the genome, as it says itself; empty where it does not.
        key: SHA-256 of the Ed25519 public key that signed all of its recordings, hexadecimal; empty where none did.
        score: The mean over the task's seeds, in whatever the task's objective measures.
        spread: Standard deviation of the scores over the seeds, as of a whole population.
        recordings: SHA-256 of the recordings' files, hexadecimal, one a seed of the task, in its order.
        recorded: When the last recording was closed, as the clock of who made it had it: UTC, ISO 8601.
        broken: Why its proof was found not to hold, if that was written down; else None.
    """

    id: int
    task: str
    task_hash: str
    name: str
    genome_hash: str
    creature_hash: str
    author: str
    key: str
    score: float
    spread: float
    recordings: tuple[str, ...]
    recorded: str
    broken: str | None

    @property
    def recording_hash(self) -> str:
        """One hash for all recordings: the file's own, or SHA-256 over the files' hashes, a line each."""
        if len(self.recordings) == 1:
            return self.recordings[0]
        return sha256("".join(f"{each}\n" for each in self.recordings).encode()).hexdigest()

    @property
    def task_title(self) -> str:
        """The task's name and, where it is that of a task that ships and this is another, that it is."""
        return f"{self.task} (not the one that ships)" if borrows_name(self.task, self.task_hash) else self.task

    @property
    def signed_author(self) -> str:
        """The author, and whose signature vouches for that; empty where there is neither."""
        if not self.author and not self.key:
            return ""
        return f"{self.author} ({f'key {self.key[:16]}' if self.key else 'unsigned'})".lstrip()

    def to_json(self) -> dict[str, Any]:
        """Returns the entry as plain data."""
        return {**{name: getattr(self, name) for name in self.__slots__}, "recording_hash": self.recording_hash}


_KINDS: Final = {"id": (int,), "score": (float,), "spread": (float,), "broken": (str, type(None))}
COLUMNS: Final = Entry.__slots__
"""The columns of a row, in the order of the table."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """The judgement of one entry.

    Attributes:
        id: The entry's number in the file.
        task: The name of its task, as the row has it; empty where it cannot be read.
        name: That of its genome, likewise.
        verdict: `holds`; `broken`: it says what its recordings do not prove; or `not_judged`: this machine cannot tell.
        reason: Why it does not hold; None where it does.
    """

    id: int
    task: str
    name: str
    verdict: Literal["holds", "broken", "not_judged"]
    reason: str | None = None

    def to_json(self) -> dict[str, Any]:
        """Returns the verdict as plain data."""
        return {name: getattr(self, name) for name in self.__slots__}


def read_row(row: Sequence[Any]) -> Entry:
    """Reads a row of the table, whatever somebody has put there.

    Raises:
        ValueError: It is none that a leaderboard writes.
    """
    fields: dict[str, Any] = dict(zip(COLUMNS, row, strict=True))
    for name, value in fields.items():
        kinds: tuple[type, ...] = {
            "id": (int,),
            "score": (float,),
            "spread": (float,),
            "broken": (str, type(None)),
        }.get(name, (str,))
        if not isinstance(value, kinds) or (name.endswith("_hash") and not _HASH.fullmatch(str(value))):
            raise ValueError(f"{name} holds what no leaderboard writes")
    if not math.isfinite(fields["score"]) or not math.isfinite(fields["spread"]):
        raise ValueError("the score or its spread is no finite number")
    names = orjson.loads(fields["recordings"])
    if not isinstance(names, list) or not names or not all(isinstance(n, str) and _HASH.fullmatch(n) for n in names):
        raise ValueError("recordings holds what no leaderboard writes")
    return Entry(**{**fields, "recordings": tuple(names)})


def facts(proofs: Sequence[Proof]) -> dict[str, Any]:
    """Returns all that proofs say of an entry: the values of its columns, by name, but for `id` and `broken`.

    Args:
        proofs: Of one genome on one task: one for each of its seeds, in any order.

    Raises:
        LeaderboardError: They are of several genomes or tasks, or not one a seed (`incomplete`), or an episode has no
            score (`no_score`).
        SigningError: A signature beside a recording is none of it.
    """
    task, genome = proofs[0].task, proofs[0].genome
    by_seed = {proof.result.seed: proof for proof in proofs}
    same = all((proof.task.hash, proof.genome.hash) == (task.hash, genome.hash) for proof in proofs)
    if not same or sorted(by_seed) != sorted(task.seeds) or len(proofs) != len(by_seed):
        raise _incomplete(proofs[0])
    ordered = [by_seed[seed] for seed in task.seeds]
    scores = [proof.result.score for proof in ordered if proof.result.score is not None]
    if len(scores) < len(ordered):
        reason = next(proof.result.fault for proof in ordered if proof.result.score is None)
        what = f"{genome.name!r} on {task.name}: an episode has no score ({reason})"
        raise LeaderboardError("no_score", what)
    keys = {signer(Recording(proof.path)) for proof in ordered}
    return {
        "task": task.name,
        "task_hash": task.hash,
        "name": genome.name,
        "genome_hash": genome.hash,
        "creature_hash": creature_hash(genome),
        "author": str(genome.document.get("author", "")),
        "key": keys.pop() if len(keys) == 1 else "",
        "score": fsum(scores) / len(scores),
        "spread": pstdev(scores),
        "recordings": tuple(proof.recording_hash for proof in ordered),
        "recorded": max(proof.recorded for proof in ordered),
    }


def _incomplete(proof: Proof) -> LeaderboardError:
    seeds = ", ".join(map(str, proof.task.seeds))
    what = f"{proof.genome.name!r} on {proof.task.name}: it takes one recording for each of the seeds {seeds}"
    return LeaderboardError("incomplete", what)


def examine(work: tuple[Entry, Sequence[Path]]) -> Verdict:
    """Runs an entry's recordings again, and compares all that they prove with what it says; it never raises.

    Args:
        work: The entry, and the files of its recordings, in its order.
    """
    entry, paths = work
    verdict: Literal["holds", "broken", "not_judged"]
    try:
        reason = _differences(entry, _proved(entry, paths))
        verdict = "broken" if reason else "holds"
    except NmesError as error:
        verdict, reason = ("not_judged" if error.code in _MACHINE else "broken"), error.message
    except Exception as error:  # a disk, the memory, a mistake of ours: in no case the entry's fault that is proved
        verdict, reason = "not_judged", f"{type(error).__name__}: {error}"
    return Verdict(entry.id, entry.task, entry.name, verdict, reason or None)


def _proved(entry: Entry, paths: Sequence[Path]) -> Mapping[str, Any]:
    for path, expected in zip(paths, entry.recordings, strict=True):
        if not path.is_file():
            raise LeaderboardError("changed", f"there is no recording {path}")
        with path.open("rb") as file:
            if file_digest(file, "sha256").hexdigest() != expected:
                raise LeaderboardError("changed", f"{path} is not the recording that was listed")
    first = prove(paths[0], brain=True)
    if len(set(paths)) != len(first.task.seeds):  # counted before thousands of them are run
        raise _incomplete(first)
    return facts([first, *(prove(path, brain=True) for path in paths[1:])])


def _differences(entry: Entry, proved: Mapping[str, Any]) -> str:
    """Returns the differences between an entry and its recordings, in words."""
    pairs = ((name, getattr(entry, name), value) for name, value in proved.items())
    return "; ".join(f"{name}: listed {listed!r}, proved {value!r}" for name, listed, value in pairs if listed != value)
