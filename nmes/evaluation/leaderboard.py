"""Leaderboards: a SQLite file of scores, and beside it the recordings that prove them.

It hides the tables and where the recordings lie: `board.sqlite` has its recordings in `board.recordings`, each under
the SHA-256 of its content, a signature beside it.

Invariants:

- An entry is made from proofs alone: one recording a seed of the task, or of a task with roles one for each match of
  the same creatures, each replayed on this machine and scored from its log. All that it says follows from them.
- The file lists the tasks that it takes, by their hashes. One entry a task and creature, or group of creatures: a copy
  by another name is no other creature.
- An author's name belongs to the first key that signed under it.
- A recording that an entry stands on is never written to. An entry that is marked as broken is not listed.
- What is in the file may be of anybody: rows are read one by one, and a file of other tables is refused.
"""

from __future__ import annotations

import os
import secrets
import shutil
import sqlite3
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from hashlib import file_digest
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import orjson

from nmes.errors import LeaderboardError, NmesError
from nmes.evaluation.authors import author_forms
from nmes.evaluation.identity import borrows_name, shipped_hash, shipped_task
from nmes.evaluation.leaderboard_entry import COLUMNS, Entry, Verdict, examine, facts, proved, read_row, told
from nmes.evaluation.match_task import MatchTask
from nmes.evaluation.parallel import Lost, in_processes
from nmes.evaluation.setting import MATCHES
from nmes.evaluation.task import Task
from nmes.genome import Genome
from nmes.recording.signed import SUFFIX
from nmes.schemas.files import names_another_file

if TYPE_CHECKING:
    from nmes.evaluation.leaderboard_entry import AnyProof

__all__ = ["Leaderboard"]

_VERSION = 4
_KIND = 0x4E4D4553  # "NMES": the file's application_id
_TABLES = (
    "CREATE TABLE tasks (hash TEXT PRIMARY KEY, name TEXT NOT NULL) STRICT",
    """CREATE TABLE entries (
    id INTEGER PRIMARY KEY,
    task TEXT NOT NULL,
    task_hash TEXT NOT NULL,
    name TEXT NOT NULL,
    genome_hash TEXT NOT NULL,
    creature_hash TEXT NOT NULL,
    author TEXT NOT NULL,
    key TEXT NOT NULL,
    score REAL NOT NULL,
    spread REAL NOT NULL,
    players TEXT NOT NULL,
    recordings TEXT NOT NULL,
    recorded TEXT NOT NULL,
    broken TEXT,
    UNIQUE (task_hash, creature_hash)
) STRICT""",
)
_EMPTY: tuple[int, int, list[tuple[str, ...]]] = (0, 0, [])  # kind, version and tables of a new file
_SCHEMA = "SELECT type, name, tbl_name, sql FROM sqlite_schema ORDER BY name"
_HIGHEST = 2**63 - 1  # number of a row
_LONGEST = 1 << 20  # bytes of a row that are read: 1,000 recordings, the most that there can be, are 67 kB


class Leaderboard:
    """A leaderboard in a file.

    Args:
        path: The SQLite file.
        create: Make it if it is not there; it takes the tasks that ship with the package.

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
            if names_another_file(self.path):
                what = f"{self.path}-journal names another file, which SQLite would remove: remove the journal"
                raise LeaderboardError("no_leaderboard", what)
            self._db = sqlite3.connect(self.path, isolation_level=None)
            try:
                self._db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST)
                self._db.text_factory = lambda raw: raw.decode(errors="backslashreplace")
                self._begin(create)
            except BaseException:
                self._db.close()
                raise

    def _begin(self, create: bool) -> None:
        if create and self._state() == _EMPTY:
            self._create()
        kind, version, tables = state = self._state()
        if kind != _KIND:
            what = "empty" if state == _EMPTY else "a database, but no leaderboard"
            raise LeaderboardError("no_leaderboard", f"{self.path} is {what}")
        elif version != _VERSION:
            what = f"{self.path} is a leaderboard of format {version}, not {_VERSION}"
            again = f"list them anew: nmes leaderboard add NEW {self.recordings}/*.mcap"
            raise LeaderboardError("no_leaderboard", f"{what}. Its recordings prove its entries still: {again}")
        elif tables != _own_tables():
            raise LeaderboardError("no_leaderboard", f"{self.path} is a leaderboard with tables of somebody else")

    def _state(self) -> tuple[int, int, list[tuple[str, ...]]]:
        """Returns the kind and version that the file states, and the names of its tables."""
        kind, version = (
            self._db.execute(f"PRAGMA {name}").fetchone()[0] for name in ("application_id", "user_version")
        )
        return kind, version, self._db.execute(_SCHEMA).fetchall()

    def _create(self) -> None:
        with self._transaction():
            if self._state() != _EMPTY:
                return  # another process has made it meanwhile
            for table in _TABLES:
                self._db.execute(table)
            shipped = [(shipped_hash(name), name) for name in (*Task.names(), *MATCHES.names())]
            self._db.executemany("INSERT INTO tasks VALUES (?, ?)", shipped)
            self._db.execute(f"PRAGMA application_id = {_KIND}")
            self._db.execute(f"PRAGMA user_version = {_VERSION}")

    def close(self) -> None:
        """Closes the file, as leaving a `with` does."""
        self._db.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    # -- tasks -------------------------------------------------------------------------------------------------------

    def allow(self, task: Task | MatchTask) -> None:
        """Takes entries on a task from now on.

        Raises:
            LeaderboardError: It has the name of one that ships, and is another (`borrowed_name`).
        """
        if borrows_name(task.name, task.hash):
            what = f"the name {task.name} is that of a task that ships, and this is another: give it a name of its own"
            raise LeaderboardError("borrowed_name", what)
        with self._trouble():
            self._db.execute("INSERT OR IGNORE INTO tasks VALUES (?, ?)", (task.hash, task.name))

    def tasks(self) -> list[tuple[str, str]]:
        """Returns name and hash of the tasks on which entries are taken, sorted."""
        with self._trouble():
            rows = self._db.execute("SELECT name, hash FROM tasks ORDER BY name, hash").fetchall()
        return [(str(name), str(task_hash)) for name, task_hash in rows]

    def _takes(self, task_hash: str) -> bool:
        with self._trouble():
            return self._db.execute("SELECT 1 FROM tasks WHERE hash = ?", (task_hash,)).fetchone() is not None

    def _require_taken(self, task: str, task_hash: str) -> None:
        if not self._takes(task_hash) or borrows_name(task, task_hash):
            what = f"{self.path} does not take the task {task} ({task_hash[:16]})"
            raise LeaderboardError("task_not_taken", f"{what}: see `nmes leaderboard tasks`")

    # -- entries -----------------------------------------------------------------------------------------------------

    def prove(self, recording: str | os.PathLike[str]) -> AnyProof:
        """Runs a recording again, the brains beside it, if its task is taken: one of another may be of any length.

        Raises:
            LeaderboardError: The task is none that is taken (`task_not_taken`).
            RecordingError, ProofError, DocumentError, MissingPackage: As by `prove` and `prove_match`.
        """
        task = told(recording)[0]
        self._require_taken(task.name, task.hash)
        return proved(recording)

    def add(self, proofs: Sequence[AnyProof], *, allow: bool = False) -> Entry:
        """Lists the score that recordings prove, and keeps copies of them and of their signatures.

        An entry of the same creature that is marked as broken, or cannot be read, makes room.

        Args:
            proofs: Of one genome on one task: one for each of its seeds, in any order. Of a task with roles: of the
                same genomes, one for each match of each of its seeds.
            allow: Take entries on their task from now on, if this one is listed.

        Raises:
            LeaderboardError: They are of several genomes or tasks, or not all (`incomplete`); an episode has
                no score (`no_score`); the task is none that is taken (`task_not_taken`), or that may be allowed
                (`borrowed_name`); the creature is listed for this task already (`already_listed`); the author's name
                belongs to another key (`author_taken`); a file is not the one that was proved any more (`changed`).
            SigningError: The signature beside a recording is none of it.
        """
        row = facts(proofs)
        with self._transaction():
            if allow:  # within the transaction: what refuses the entry takes this back
                self.allow(proofs[0].task)
            self._check(row)
            # Beyond that of an entry which makes room: a verdict on that one, given meanwhile, is of no other.
            (highest,) = self._db.execute("SELECT coalesce(max(id), 0) FROM entries").fetchone()
            free = highest + 1 if highest < _HIGHEST else None  # SQLite looks for one
            same = row["task_hash"], row["creature_hash"]
            self._db.execute("DELETE FROM entries WHERE task_hash = ? AND creature_hash = ?", same)  # which is broken
            columns = ", ".join(("id", *row))
            values = [orjson.dumps(value).decode() if isinstance(value, tuple) else value for value in row.values()]
            places = ", ".join("?" * (1 + len(row)))
            number = self._db.execute(f"INSERT INTO entries ({columns}) VALUES ({places})", (free, *values)).lastrowid
            # Within the transaction: an entry without its recordings is never seen.
            self.recordings.mkdir(exist_ok=True)
            for proof in proofs:
                self._keep(proof)
        assert number is not None
        return Entry(id=number, broken=None, **row)

    def _check(self, row: Mapping[str, Any]) -> None:
        """Refuses an entry that may not be listed here."""
        task, task_hash = row["task"], row["task_hash"]
        self._require_taken(task, task_hash)
        others = self.entries(broken=True)
        for other in others:
            if other.broken is None and (other.task_hash, other.creature_hash) == (task_hash, row["creature_hash"]):
                these = "these creatures are" if other.players else "this creature is"
                what = f"{these} listed for the task {task} already: {other.name!r} by {other.signed_author!r}"
                raise LeaderboardError("already_listed", what)
        taken = _taken(row["author"], row["key"], _owners(other for other in others if other.broken is None))
        if taken is not None:
            raise LeaderboardError("author_taken", taken)

    def _keep(self, proof: AnyProof) -> None:
        copy = self.recording(proof.recording_hash)
        part = copy.with_suffix(f".{secrets.token_hex(8)}")
        try:
            shutil.copyfile(proof.path, part)
            with part.open("rb") as file:
                if file_digest(file, "sha256").hexdigest() != proof.recording_hash:
                    raise LeaderboardError("changed", f"{proof.path} was changed while it was looked at")
            part.replace(copy)
            signature = Path(f"{copy}{SUFFIX}")
            if Path(f"{proof.path}{SUFFIX}").is_file():
                shutil.copyfile(f"{proof.path}{SUFFIX}", part)
                part.replace(signature)
            else:
                signature.unlink(missing_ok=True)  # of an entry that was here before
        finally:
            part.unlink(missing_ok=True)

    def entries(self, *, task: str | None = None, top: int | None = None, broken: bool = False) -> list[Entry]:
        """Returns the entries task by task, the highest score first.

        Args:
            task: Only those of the task with this name.
            top: Only so many of each task.
            broken: Also those that are marked as broken.
        """
        found = []
        for entry in self._rows():
            if isinstance(entry, Entry):
                if task in (None, entry.task) and (broken or entry.broken is None):
                    found.append(entry)
            elif entry.verdict == "not_judged":
                raise LeaderboardError("no_leaderboard", f"{self.path}, entry {entry.id}: {entry.reason}")
        found.sort(key=lambda entry: (entry.task, entry.task_hash, -entry.score, entry.id))
        groups = groupby(found, key=lambda entry: (entry.task, entry.task_hash))
        return [entry for _, group in groups for entry in list(group)[:top]]

    def genomes(self, entry: Entry) -> tuple[Genome, ...]:
        """Returns an entry's genome, as the first of its recordings has it; of several creatures those of all roles.

        Raises:
            LeaderboardError: They are others (`changed`).
            RecordingError, ProofError, DocumentError: They cannot be read.
        """
        genomes = told(self.recording(entry.recordings[0]))[1]
        listed = [player.genome_hash for player in entry.players] or [entry.genome_hash]
        if sorted(genome.hash for genome in genomes) != sorted(listed):
            raise LeaderboardError("changed", f"the recordings of {entry.name!r} are of other genomes")
        return genomes

    def units(self, entries: Iterable[Entry]) -> dict[str, str]:
        """Returns the units of scores by the hashes of the tasks of some entries.

        Of a task that ships it is its own, else what a recording of the first of its entries says: a unit is for
        people, and proves nothing. Empty where there is none, or where that recording cannot be read.
        """
        units: dict[str, str] = {}
        for entry in entries:
            if entry.task_hash not in units:
                units[entry.task_hash] = self._unit(entry)
        return units

    def _unit(self, entry: Entry) -> str:
        if entry.task_hash == shipped_hash(entry.task):
            return shipped_task(entry.task).unit
        try:
            task = told(self.recording(entry.recordings[0]))[0]
        except NmesError:
            return ""
        return task.unit if task.hash == entry.task_hash else ""

    def recording(self, recording_hash: str) -> Path:
        """Returns the path of the recording with this hash."""
        return self.recordings / f"{recording_hash}.mcap"

    def verify(self, *, jobs: int = 1, only: Collection[int] | None = None) -> Iterator[Verdict]:
        """Runs every entry's recordings again, and compares all that they prove with what it says; writes nothing.

        Args:
            jobs: In how many processes.
            only: The numbers of some entries. Others whose author has the same name and another key are run too, since
                the name is that of the first who holds. None: all.

        Yields:
            A verdict for each entry, as they are ready.
        """
        work = []
        seen: set[tuple[str, str]] = set()
        for entry in self._rows():
            if isinstance(entry, Verdict):
                if only is None or entry.id in only:
                    yield entry
                continue
            reason = None if self._takes(entry.task_hash) else "the leaderboard does not take its task"
            if (entry.task_hash, entry.creature_hash) in seen:
                reason = "its creature is listed for its task already"
            seen.add((entry.task_hash, entry.creature_hash))
            if reason is None:
                work.append((entry, [self.recording(each) for each in entry.recordings]))
            elif only is None or entry.id in only:
                yield Verdict(entry.id, entry.task, entry.name, "broken", reason)
        contested = []
        keys = _keys_by_author(entry for entry, _ in work)
        if only is not None:
            asked = {form for entry, _ in work if entry.id in only for form in author_forms(entry.author)}
            rivals = {form for form in asked if len(keys[form]) > 1}
            work = [each for each in work if each[0].id in only or not rivals.isdisjoint(author_forms(each[0].author))]
        for index, verdict in in_processes(examine, work, jobs):
            entry = work[index][0]
            if isinstance(verdict, Lost):
                verdict = Verdict(entry.id, entry.task, entry.name, "not_judged", verdict.reason)
            elif verdict.verdict == "holds" and borrows_name(entry.task, entry.task_hash):
                reason = f"its task is another {entry.task} than the one that ships with this version"
                verdict = Verdict(entry.id, entry.task, entry.name, "not_judged", reason)
            if verdict.verdict == "holds" and any(len(keys[form]) > 1 for form in author_forms(entry.author)):
                contested.append((entry, verdict))  # until it is known which of those who claim the name hold
            elif only is None or entry.id in only:
                yield verdict
        yield from (verdict for verdict in _settled(contested) if only is None or verdict.id in only)

    def mark(self, verdicts: Iterable[Verdict]) -> None:
        """Writes down which entries are broken, and that others hold again; what was not judged stays as it is."""
        marks = [(each.reason, each.id, each.reason) for each in verdicts if each.verdict != "not_judged"]
        with self._transaction():
            for mark in marks:
                with suppress(sqlite3.DataError):  # a row that is too long to be read, and so is never listed
                    self._db.execute("UPDATE entries SET broken = ? WHERE id = ? AND broken IS NOT ?", mark)

    def __len__(self) -> int:
        with self._trouble():
            (count,) = self._db.execute("SELECT count(*) FROM entries").fetchone()
        return int(count)

    def _rows(self) -> Iterator[Entry | Verdict]:
        """Yields the entries in the order of their numbers; for a row that is none, the verdict on it."""
        columns = ", ".join(COLUMNS)
        with self._trouble():
            numbers = [number for (number,) in self._db.execute("SELECT id FROM entries ORDER BY id")]
        for number in numbers:
            try:
                row = self._db.execute(f"SELECT {columns} FROM entries WHERE id = ?", (number,)).fetchone()
                yield read_row(row or ())  # a damaged file may not find what it has listed
            except sqlite3.OperationalError as error:  # another process, the disk: nothing that the row is to blame for
                yield Verdict(number, "", "", "not_judged", f"its row cannot be read: {error}")
            except (ValueError, sqlite3.Error) as error:
                yield Verdict(number, "", "", "broken", f"its row cannot be read: {error}")

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with self._trouble():
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield
            except BaseException:
                if self._db.in_transaction:  # SQLite has ended it itself where the disk is full
                    self._db.execute("ROLLBACK")
                raise
            self._db.execute("COMMIT")

    @contextmanager
    def _trouble(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.Error, OSError, UnicodeDecodeError) as error:  # the last where SQLite repeats what it has read
            raise LeaderboardError("no_leaderboard", f"{self.path}: {error}") from error


def _own_tables() -> list[tuple[str, ...]]:
    """Returns the schema of a new leaderboard: no view, no trigger, no other type."""
    database = sqlite3.connect(":memory:")
    try:
        for table in _TABLES:
            database.execute(table)
        return database.execute(_SCHEMA).fetchall()
    finally:
        database.close()


def _keys_by_author(entries: Iterable[Entry]) -> dict[str, set[str]]:
    """Returns the keys with which entries are signed, "" for none, by the forms of their authors."""
    keys: dict[str, set[str]] = {}
    for entry in entries:
        for form in author_forms(entry.author):
            keys.setdefault(form, set()).add(entry.key)
    return keys


def _owners(entries: Iterable[Entry]) -> dict[str, Entry]:
    """Returns the first entry that was signed under a name, by each form of it."""
    owners: dict[str, Entry] = {}
    for entry in entries:
        if entry.key:
            for form in author_forms(entry.author):
                owners.setdefault(form, entry)
    return owners


def _taken(author: str, key: str, owners: Mapping[str, Entry]) -> str | None:
    """Returns why a name cannot be that of somebody who signs with a key, or with none; None where it can."""
    for form in author_forms(author):
        other = owners.get(form)
        if other is not None and other.key != key:
            return f"entries by {other.author!r} are signed with another key ({other.key[:16]})"
    return None


def _settled(contested: list[tuple[Entry, Verdict]]) -> Iterator[Verdict]:
    """Yields the verdicts on entries that hold under names with several keys: each name is the first one's."""
    owners: dict[str, Entry] = {}
    for entry, verdict in sorted(contested, key=lambda each: each[0].id):
        taken = _taken(entry.author, entry.key, owners)
        if taken is not None:
            verdict = Verdict(entry.id, entry.task, entry.name, "broken", taken)
        else:
            owners = {**_owners([entry]), **owners}
        yield verdict
