"""Leaderboards: a SQLite file of scores, and beside it the recordings that prove them.

It hides the tables and where the recordings lie: `board.sqlite` has its recordings in `board.recordings`, each under
the SHA-256 of its content.

Invariants:

- An entry is made from `Proof`s alone: one recording a seed of the task, each replayed on this machine and scored from
  its log.
- One entry a task and genome; both are known by their hashes, so that an edited task or genome is another one.
- A recording that an entry stands on is never written to. An entry whose proof fails is not listed until it holds.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from hashlib import file_digest, sha256
from math import fsum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import orjson

from nmes.errors import LeaderboardError, NmesError
from nmes.evaluation.parallel import Lost, in_processes

if TYPE_CHECKING:
    from nmes.evaluation.proof import Proof

__all__ = ["Entry", "Leaderboard"]

_VERSION = 1
_KIND = 0x4E4D4553  # "NMES": the file's application_id
_TABLES = """
CREATE TABLE entries (
    id INTEGER PRIMARY KEY,
    task TEXT NOT NULL,
    task_hash TEXT NOT NULL,
    name TEXT NOT NULL,
    genome_hash TEXT NOT NULL,
    author TEXT NOT NULL,
    score REAL NOT NULL,
    recordings TEXT NOT NULL,
    fingerprint TEXT NOT NULL,
    genome BLOB NOT NULL,
    added TEXT NOT NULL,
    refused TEXT,
    UNIQUE (task_hash, genome_hash)
) STRICT;
CREATE INDEX best ON entries (task, task_hash, score DESC);
"""
_COLUMNS = "id, task, task_hash, name, genome_hash, author, score, recordings, fingerprint, added, refused"


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of a leaderboard.

    Attributes:
        id: Its number in the file.
        task: The task's name.
        task_hash: SHA-256 of the task, hexadecimal.
        name: The genome's name.
        genome_hash: SHA-256 of the genome, hexadecimal.
        author: Whose genome it is; empty where nobody says.
        score: The mean over the task's seeds, in whatever the task's objective measures.
        recordings: SHA-256 of the recordings' files, hexadecimal, one a seed of the task, in its order.
        fingerprint: What the score's last bits depend on: versions, binaries, processor.
        added: When it was listed: UTC, ISO 8601.
        refused: Why its proof did not hold when it was last verified; None while it does.
    """

    id: int
    task: str
    task_hash: str
    name: str
    genome_hash: str
    author: str
    score: float
    recordings: tuple[str, ...]
    fingerprint: dict[str, str]
    added: str
    refused: str | None

    @property
    def recording_hash(self) -> str:
        """One hash for all recordings: the file's own, or SHA-256 over the files' hashes, a line each."""
        if len(self.recordings) == 1:
            return self.recordings[0]
        return sha256("".join(f"{each}\n" for each in self.recordings).encode()).hexdigest()

    def to_json(self) -> dict[str, Any]:
        """Returns the entry as plain data."""
        return {**{name: getattr(self, name) for name in self.__slots__}, "recording_hash": self.recording_hash}


class Leaderboard:
    """A leaderboard in a file.

    Args:
        path: The SQLite file.
        create: Make it if it is not there.

    Raises:
        LeaderboardError: It is not there, or no leaderboard, or cannot be read (`no_leaderboard`). Every other method
            raises this too when the file cannot be read or written.
    """

    def __init__(self, path: str | os.PathLike[str], *, create: bool = False) -> None:
        self.path = Path(path)
        self.recordings = self.path.with_suffix(".recordings")
        if not create and not self.path.is_file():
            raise LeaderboardError("no_leaderboard", f"there is no leaderboard {self.path}")
        with self._trouble():
            self._db = sqlite3.connect(self.path)
            try:
                self._begin(create)
            except BaseException:
                self._db.close()
                raise

    def _begin(self, create: bool) -> None:
        kind, version = (
            self._db.execute(f"PRAGMA {name}").fetchone()[0] for name in ("application_id", "user_version")
        )
        empty = (kind, version) == (0, 0) and not self._db.execute("SELECT 1 FROM sqlite_schema").fetchone()
        if empty and create:
            with self._db:
                self._db.executescript(
                    f"BEGIN; PRAGMA application_id = {_KIND}; PRAGMA user_version = {_VERSION}; {_TABLES} COMMIT;"
                )
        elif kind != _KIND:
            what = "empty" if empty else "a database, but no leaderboard"
            raise LeaderboardError("no_leaderboard", f"{self.path} is {what}")
        elif version != _VERSION:
            raise LeaderboardError(
                "no_leaderboard", f"{self.path} is a leaderboard of format {version}, not {_VERSION}"
            )

    def close(self) -> None:
        """Closes the file."""
        self._db.close()

    def add(self, proofs: Sequence[Proof], author: str | None = None) -> Entry:
        """Lists the score that recordings prove, and keeps copies of them.

        Args:
            proofs: Of one genome on one task: one for each of its seeds, in any order.
            author: Whose the genome is; where None, whom the genome names.

        Raises:
            LeaderboardError: They are of several genomes or tasks, or not one a seed (`incomplete`); an episode has
                no score (`no_score`); the genome is listed for this task already (`already_listed`); a file is not
                the one that was proved any more (`changed`).
        """
        task, genome = proofs[0].task, proofs[0].genome
        by_seed = {proof.result.seed: proof for proof in proofs}
        same = all((proof.task.hash, proof.genome.hash) == (task.hash, genome.hash) for proof in proofs)
        if not same or sorted(by_seed) != sorted(task.seeds) or len(proofs) != len(by_seed):
            seeds = ", ".join(map(str, task.seeds))
            what = f"{genome.name} on {task.name}: it takes one recording for each of the seeds {seeds}"
            raise LeaderboardError("incomplete", what)
        ordered = [by_seed[seed] for seed in task.seeds]
        scores = [proof.result.score for proof in ordered if proof.result.score is not None]
        if len(scores) < len(ordered):
            raise LeaderboardError(
                "no_score", f"{genome.name} on {task.name}: an episode faulted, so there is no score"
            )
        row = (
            task.name,
            task.hash,
            genome.name,
            genome.hash,
            str(genome.document.get("author", "")) if author is None else author,
            fsum(scores) / len(scores),
            orjson.dumps([proof.recording_hash for proof in ordered]).decode(),
            orjson.dumps(dict(ordered[0].fingerprint), option=orjson.OPT_SORT_KEYS).decode(),
            orjson.dumps(genome.document),
            datetime.now(UTC).isoformat(timespec="seconds"),
        )
        with self._trouble(), self._db:
            try:
                number = self._db.execute(
                    "INSERT INTO entries (task, task_hash, name, genome_hash, author, score, recordings, fingerprint,"
                    " genome, added) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                    row,
                ).lastrowid
            except sqlite3.IntegrityError as error:
                what = f"{genome.name} ({genome.hash[:12]}) is listed for the task {task.name} already"
                raise LeaderboardError("already_listed", what) from error
            # Within the transaction: an entry without its recordings is never seen.
            self.recordings.mkdir(exist_ok=True)
            for proof in ordered:
                self._keep(proof)
        (entry,) = self._select("WHERE id = ?", number)
        return entry

    def _keep(self, proof: Proof) -> None:
        copy = self.recording(proof.recording_hash)
        part = copy.with_suffix(".part")
        shutil.copyfile(proof.path, part)
        with part.open("rb") as file:
            if file_digest(file, "sha256").hexdigest() != proof.recording_hash:
                raise LeaderboardError("changed", f"{proof.path} was changed while it was looked at")
        part.replace(copy)

    def entries(self, *, task: str | None = None, top: int | None = None, refused: bool = False) -> list[Entry]:
        """Returns the entries task by task, the highest score first.

        Args:
            task: Only those of the task with this name.
            top: Only so many of each task.
            refused: Also those whose proof did not hold.
        """
        rank = "row_number() OVER (PARTITION BY task, task_hash ORDER BY score DESC, id) AS rank"
        where = "WHERE (?1 IS NULL OR task = ?1) AND (?2 OR refused IS NULL)"
        return self._select(
            "WHERE rank <= ?3 ORDER BY task, task_hash, rank",
            task,
            refused,
            (1 << 62) if top is None else top,
            source=f"(SELECT {_COLUMNS}, {rank} FROM entries {where})",
        )

    def genome(self, entry: Entry) -> bytes:
        """Returns an entry's genome, as JSON."""
        with self._trouble():
            (document,) = self._db.execute("SELECT genome FROM entries WHERE id = ?", (entry.id,)).fetchone()
        return bytes(document)

    def recording(self, recording_hash: str) -> Path:
        """Returns the path of the recording with this hash."""
        return self.recordings / f"{recording_hash}.mcap"

    def verify(self, *, jobs: int = 1) -> Iterator[tuple[Entry, str | None]]:
        """Runs every entry's recordings again, and notes whether they prove it.

        Args:
            jobs: In how many processes.

        Yields:
            An entry, and why its proof does not hold, or None, as they are ready.
        """
        entries = self.entries(refused=True)
        work = [(entry, [str(self.recording(each)) for each in entry.recordings]) for entry in entries]
        for index, verdict in in_processes(_examine, work, jobs):
            refused = verdict.reason if isinstance(verdict, Lost) else verdict
            with self._trouble(), self._db:
                self._db.execute("UPDATE entries SET refused = ? WHERE id = ?", (refused, entries[index].id))
            yield entries[index], refused

    def _select(self, clause: str, *values: object, source: str = "entries") -> list[Entry]:
        with self._trouble():
            rows = self._db.execute(f"SELECT {_COLUMNS} FROM {source} {clause}", values).fetchall()
        entries = []
        for row in rows:
            fields = dict(zip(Entry.__slots__, row, strict=True))
            fields["recordings"] = tuple(orjson.loads(fields["recordings"]))
            fields["fingerprint"] = orjson.loads(fields["fingerprint"])
            entries.append(Entry(**fields))
        return entries

    @contextmanager
    def _trouble(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.Error, OSError) as error:
            raise LeaderboardError("no_leaderboard", f"{self.path}: {error}") from error


def _examine(work: tuple[Entry, list[str]]) -> str | None:
    """Returns the reason why recordings do not prove an entry, or None."""
    from nmes.evaluation.proof import prove  # here, since whoever looks at a list needs no engine: that takes seconds

    entry, paths = work
    scores = []
    for path, expected in zip(paths, entry.recordings, strict=True):
        try:
            proof = prove(path, brain=True)
        except NmesError as error:
            return error.message
        if proof.recording_hash != expected:
            return f"{path} is not the recording that was listed"
        if (proof.task.hash, proof.genome.hash) != (entry.task_hash, entry.genome_hash):
            return f"{path} is of another genome or task"
        if proof.result.score is None:
            return f"{path}: {proof.result.fault}"
        scores.append(proof.result.score)
    if fsum(scores) / len(scores) != entry.score:
        return f"the recordings prove a score of {fsum(scores) / len(scores)!r}, not {entry.score!r}"
    return None
