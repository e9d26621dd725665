"""The index of a run: what is asked often of its log, by index, in a SQLite file.

Hides the tables. The index follows from the log: whoever reads it takes what it lacks from the log; only who goes on
with the run writes it. One that is missing, torn, of another version or of another log is made anew.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import orjson

from nmes.errors import RunError

__all__ = ["MADE_ANEW", "Record", "RunIndex", "State"]

MADE_ANEW: Final = "it follows from the log, and may be removed: then resume the run"
"""What to do about an index that cannot be used."""

_VERSION: Final = 1
_KIND: Final = 0x4E4D5255  # "NMRU": the file's application_id
_COLUMNS: Final = (
    '"index" INTEGER PRIMARY KEY, "begin" INTEGER NOT NULL, "end" INTEGER NOT NULL, digest TEXT NOT NULL, score REAL, '
    "operator TEXT NOT NULL, parents TEXT NOT NULL, generation INTEGER NOT NULL, species TEXT NOT NULL, "
    "objectives TEXT NOT NULL, measures TEXT NOT NULL, genome TEXT NOT NULL, genome_hash TEXT NOT NULL, "
    "plan TEXT NOT NULL, error TEXT"
)
_TABLES: Final = (
    f"CREATE TABLE records ({_COLUMNS}) STRICT",
    "CREATE TABLE state (told INTEGER PRIMARY KEY, elites TEXT NOT NULL, figures TEXT NOT NULL) STRICT",
)
_LONGEST: Final = 16 << 20  # bytes of a row that are read


@dataclass(frozen=True, slots=True)
class Record:
    """A candidate that was told, without its genome.

    Attributes:
        index: Its place in the order of asking.
        begin: Where its line of the log begins, bytes.
        end: Where the next line begins.
        digest: Of the log up to this line.
        score: What the algorithm was told; None where there is none.
        operator: How it came about.
        parents: The indices of the candidates that it comes from, the one that it is mostly like first.
        generation: Of the algorithm's count.
        group: The species, emitter or island that it belongs to; empty where there are none.
        objectives: The values of the run's objectives.
        measures: The values of its measures.
        genome: The genome's name.
        genome_hash: The genome's hash.
        plan: A digest of all of its body but the numbers: bodies of one plan have the same parts joined alike.
        error: Why there is no score; None where there is one.
    """

    index: int
    begin: int
    end: int
    digest: str
    score: float | None
    operator: str
    parents: tuple[int, ...]
    generation: int
    group: str
    objectives: tuple[float, ...]
    measures: tuple[float, ...]
    genome: str
    genome_hash: str
    plan: str
    error: str | None


@dataclass(frozen=True, slots=True)
class State:
    """What the algorithm said of itself when it had been told so many scores.

    Attributes:
        told: How many.
        elites: The indices of its elites.
        figures: Its figures; one that is no finite number is None once it was in the file.
    """

    told: int
    elites: tuple[int, ...]
    figures: Mapping[str, float | None]


class RunIndex:
    """An index in a file.

    Args:
        path: The file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    def read(self) -> tuple[list[Record], State | None]:
        """Returns the records and the state that it has; none where it is none, or cannot be read."""
        if not self._path.is_file():
            return [], None
        with suppress(sqlite3.Error, ValueError, TypeError):
            db = sqlite3.connect(f"{self._path.absolute().as_uri()}?mode=ro", uri=True, isolation_level=None)
            try:
                db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST)
                if _is_ours(db):
                    db.execute("BEGIN")  # both as of one moment
                    rows = db.execute('SELECT * FROM records ORDER BY "index"').fetchall()
                    states = db.execute("SELECT * FROM state").fetchall()
                    records = [_record(row) for row in rows]
                    return records, _state(states, len(records))
            finally:
                db.close()
        return [], None

    def write(self, anew: bool) -> IndexWriter:
        """Opens it for writing.

        Args:
            anew: Whether what it has is of no use.

        Raises:
            RunError: It cannot be made anew (`cannot_write`).
        """
        try:
            if anew:
                for ending in ("", "-journal", "-wal", "-shm"):
                    self._path.with_name(self._path.name + ending).unlink(missing_ok=True)
            return IndexWriter(self._path)
        except OSError as error:
            raise RunError("cannot_write", f"cannot write {self._path}: {error.strerror}; {MADE_ANEW}") from error


class IndexWriter:
    """An index that is written; there is one at a time.

    Args:
        path: The file.
    """

    def __init__(self, path: Path) -> None:
        self._db = sqlite3.connect(path, isolation_level=None)
        try:
            # It follows from the log, which is synced: what a failing machine leaves of it is made anew.
            self._db.execute("PRAGMA synchronous = OFF")
            if not _is_ours(self._db):
                self._create()
        except BaseException:
            self._db.close()
            raise

    def _create(self) -> None:
        if self._db.execute("SELECT count(*) FROM sqlite_schema").fetchone()[0]:
            raise sqlite3.DatabaseError("of another kind")
        self._db.execute("BEGIN")
        for table in _TABLES:
            self._db.execute(table)
        self._db.execute(f"PRAGMA application_id = {_KIND}")
        self._db.execute(f"PRAGMA user_version = {_VERSION}")
        self._db.execute("COMMIT")

    def put(self, records: Sequence[Record], state: State) -> None:
        """Adds records, and replaces the state; all or nothing."""
        places = ", ".join("?" * len(Record.__slots__))
        with self._db:
            self._db.execute("BEGIN")
            self._db.executemany(f"INSERT OR REPLACE INTO records VALUES ({places})", map(_row, records))
            self._db.execute("DELETE FROM state")
            elites, figures = (orjson.dumps(value).decode() for value in (state.elites, dict(state.figures)))
            self._db.execute("INSERT INTO state VALUES (?, ?, ?)", (state.told, elites, figures))

    def close(self) -> None:
        """Closes the file."""
        self._db.close()


def _is_ours(db: sqlite3.Connection) -> bool:
    kind, version = (db.execute(f"PRAGMA {name}").fetchone()[0] for name in ("application_id", "user_version"))
    tables = tuple(sql for (sql,) in db.execute("SELECT sql FROM sqlite_schema ORDER BY name"))
    return (kind, version, tables) == (_KIND, _VERSION, _TABLES)


def _row(record: Record) -> tuple[Any, ...]:
    values = (getattr(record, name) for name in Record.__slots__)
    return tuple(orjson.dumps(value).decode() if isinstance(value, tuple) else value for value in values)


def _record(row: Sequence[Any]) -> Record:
    values = dict(zip(Record.__slots__, row, strict=True))
    values["parents"] = _places(values["parents"], values["index"])
    for name in ("objectives", "measures"):
        values[name] = tuple(orjson.loads(values[name]))
        _require(all(isinstance(value, int | float) for value in values[name]))
    return Record(**values)


def _state(rows: Sequence[Sequence[Any]], count: int) -> State | None:
    """Reads what the algorithm said of itself.

    Raises:
        ValueError: It is nothing that an algorithm that was told so many candidates says.
    """
    if not rows:
        return None
    told, elites, figures = rows[0]
    figures = orjson.loads(figures)
    _require(0 <= told <= count and isinstance(figures, dict))
    _require(all(value is None or isinstance(value, int | float) for value in figures.values()))
    return State(told, _places(elites, told), figures)


def _places(text: str, count: int) -> tuple[int, ...]:
    """Reads the indices of some of a run's candidates.

    Raises:
        ValueError: It has something else.
    """
    places = orjson.loads(text)
    _require(isinstance(places, list) and all(type(place) is int and 0 <= place < count for place in places))
    return tuple(places)


def _require(sound: bool) -> None:
    if not sound:
        raise ValueError("the index has what no index has")
