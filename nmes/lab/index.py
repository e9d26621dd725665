"""What a lab's folder holds, in a SQLite file, so that a list of very many is there at once.

Hides when the folder is looked through, and what is read of each recording and run only when there is time. It follows
from the folder: a file that is missing or of another version is made anew.
"""

from __future__ import annotations

import asyncio
import os
import sqlite3
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from itertools import islice
from math import inf
from time import monotonic
from typing import Any, Final, TypeVar

import orjson

from nmes.errors import NmesError
from nmes.evaluation import episode, match_task
from nmes.evolution.run_folder import SETTINGS, read_settings
from nmes.lab.folder import Folder, Kind
from nmes.protocol.messages import parse
from nmes.recording import Recording, records
from nmes.schemas.documents import JsonObject, parse_document
from nmes.schemas.files import names_another_file, open_regular

__all__ = ["PAGE", "Index"]

PAGE: Final = 100
_VERSION: Final = 2
_AGAIN: Final = 2.0  # s after which a folder is looked through again where that takes long
_LONG: Final = 0.02  # s that looking through a folder may take before a list waits for it no more
_STEP: Final = 0.05  # s of reading before others have their turn
_LARGEST: Final = 64 << 20  # bytes of a file that is read for a list
_LONGEST: Final = 200  # characters of what is shown of settings
_GREATEST: Final = 2**53  # whole number of these
_BEGINNING: Final = 100  # records of an episode among which its creatures are looked for
_EPISODES: Final = (episode.METADATA, match_task.METADATA)
_TABLE: Final = (
    "CREATE TABLE IF NOT EXISTS things (kind TEXT NOT NULL, name TEXT NOT NULL, time REAL NOT NULL, "
    "size INTEGER NOT NULL, details TEXT, PRIMARY KEY (kind, name)) STRICT, WITHOUT ROWID",
    "CREATE INDEX IF NOT EXISTS things_by_time ON things (kind, time DESC, name)",
)

_KINDS: Final[tuple[Kind, ...]] = ("recordings", "runs")

T = TypeVar("T")


class Index:
    """The recordings and runs of a folder."""

    def __init__(self, folder: Folder) -> None:
        """Opens it, and has the folder looked through beside all else."""
        self._folder = folder
        self._thread = ThreadPoolExecutor(1, "nmes-lab-index")
        self._scanned: dict[Kind, tuple[float, float]] = {}  # when, and how long it took
        self._reading: asyncio.Task[None] | None = None
        self._db = self._thread.submit(self._open).result()
        for kind in _KINDS:
            self._thread.submit(self._scan, kind)

    def _open(self) -> sqlite3.Connection:
        path = self._folder.path / ".index.sqlite"
        if names_another_file(path):
            path = path.resolve()
            path.with_name(path.name + "-journal").unlink()
        for _ in range(2):
            db = sqlite3.connect(path, isolation_level=None)
            try:
                if db.execute("PRAGMA user_version").fetchone()[0] in (0, _VERSION):
                    db.execute("PRAGMA synchronous = OFF")
                    for statement in _TABLE:
                        db.execute(statement)
                    db.execute(f"PRAGMA user_version = {_VERSION}")
                    return db
            except sqlite3.Error:
                pass  # it is none of ours, or torn
            db.close()
            path.unlink()
        raise AssertionError("a new database is of no version")

    async def page(self, kind: Kind, after: str | None = None, part: str = "") -> JsonObject:
        """Returns a page of a list, the newest first.

        Args:
            kind: Of what.
            after: `next` of the page before; None: the first page.
            part: What names must have in them.
        """
        if self._scanned.get(kind, (0.0, inf))[1] <= _LONG:
            await self._do(self._scan, kind)
        self._read_on()
        return await self._do(self._page, kind, after, part)

    async def close(self) -> None:
        """Ends reading, and closes the file."""
        if self._reading is not None:
            self._reading.cancel()
            await asyncio.wait([self._reading])
        await self._do(self._db.close)
        self._thread.shutdown()

    async def _do(self, work: Callable[..., T], *arguments: Any) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._thread, work, *arguments)

    # -- in the thread ---------------------------------------------------------------------------------------------

    def _page(self, kind: Kind, after: str | None, part: str) -> JsonObject:
        time, _, name = (after or "").partition(":")
        bound: tuple[Any, ...] = ()
        condition = ""
        if after is not None:
            try:
                bound = (float(time), float(time), name)
            except ValueError:
                return {"items": [], "next": None, "count": 0}
            condition = "AND (time < ? OR (time = ? AND name > ?))"
        like = "%" + part.replace("\\", "\\\\").replace("%", "\\%").replace("_", "\\_") + "%"
        if part:
            condition += " AND name LIKE ? ESCAPE '\\'"
            bound = (*bound, like)
        query = f"SELECT name, time, size, details FROM things WHERE kind = ? {condition} ORDER BY time DESC, name"
        rows = self._db.execute(f"{query} LIMIT {PAGE + 1}", (kind, *bound)).fetchall()
        count = self._db.execute("SELECT count(*) FROM things WHERE kind = ?", (kind,)).fetchone()[0]
        items = [
            {"name": name, "time": time, "size": size, "details": None if details is None else orjson.loads(details)}
            for name, time, size, details in rows[:PAGE]
        ]
        last = rows[PAGE - 1] if len(rows) > PAGE else None
        return {"items": items, "next": None if last is None else f"{last[1]!r}:{last[0]}", "count": count}

    def _scan(self, kind: Kind) -> None:
        """Looks through a folder, and takes up what is there."""
        began = monotonic()
        self._take_up(kind, self._folder.scan(kind))
        now = monotonic()
        self._scanned[kind] = now, now - began

    def _take_up(self, kind: Kind, found: Mapping[str, os.stat_result]) -> None:
        """Notes what is in a folder: what is new or was changed is to be read again."""
        there = {name: (status.st_mtime, status.st_size) for name, status in found.items()}
        rows = self._db.execute("SELECT name, time, size FROM things WHERE kind = ?", (kind,)).fetchall()
        known = {name: (time, size) for name, time, size in rows}
        with self._db:
            self._db.execute("BEGIN")
            self._db.executemany(
                "DELETE FROM things WHERE kind = ? AND name = ?", [(kind, name) for name in known if name not in there]
            )
            self._db.executemany(
                "INSERT OR REPLACE INTO things VALUES (?, ?, ?, ?, NULL)",
                [(kind, name, *values) for name, values in there.items() if known.get(name) != values],
            )

    def _read_some(self) -> bool:
        """Reads what is there to know of some things, the newest first; returns whether there are more."""
        until = monotonic() + _STEP
        query = "SELECT kind, name FROM things WHERE details IS NULL ORDER BY kind, time DESC, name LIMIT 50"
        rows = self._db.execute(query).fetchall()
        for kind, name in rows:
            details = orjson.dumps(_DETAILS[kind](self._folder, name)).decode()
            self._db.execute("UPDATE things SET details = ? WHERE kind = ? AND name = ?", (details, kind, name))
            if monotonic() >= until:
                break
        return bool(rows)

    # -- in the loop -----------------------------------------------------------------------------------------------

    def _read_on(self) -> None:
        """Has the folder looked through, where that is due, and what is new read, beside all else."""
        if self._reading is not None and self._reading.done():
            ended, self._reading = self._reading, None  # so that what failed is told once, and tried again
            ended.result()
        if self._reading is None:
            self._reading = asyncio.create_task(self._read())

    async def _read(self) -> None:
        for kind, (scanned, cost) in list(self._scanned.items()):
            began = monotonic()
            if cost > _LONG and began > scanned + _AGAIN:
                found = await asyncio.to_thread(self._folder.scan, kind)  # lists are told meanwhile
                await self._do(self._take_up, kind, found)
                now = monotonic()
                self._scanned[kind] = now, now - began
        while await self._do(self._read_some):
            pass


def _recording(folder: Folder, name: str) -> JsonObject:
    """Returns the entry of a recording in a list."""
    try:
        recording = Recording(folder.find("recordings", name))
        config = recording.config
        told = {field: config[field] for field in ("backend", "seed", "mode", "tick_rate")}
        told |= {"world": config["name"], **_episode(recording)}
        told["frames"] = recording.last_frame if recording.size <= _LARGEST else None
    except (NmesError, OSError) as error:
        return {"error": str(error)}
    return told


def _episode(recording: Recording) -> JsonObject:
    """Returns the names of the creatures and of the task of a recorded episode; None of what is no episode.

    Raises:
        DocumentError: Its task is no document.
    """
    about = next((recording.metadata[name] for name in _EPISODES if name in recording.metadata), None)
    if about is None:
        return {"creature": None, "task": None}
    task = parse_document(about.get("task", "").encode())
    creatures = []
    for record in islice(recording, _BEGINNING):
        if record.kind is records.Kind.TICKS:
            break
        command = parse(record.data).command if record.kind is records.Kind.COMMAND else None
        if command is not None and command["type"] == "spawn_creature":
            creatures.append(command["genome"].get("name"))
    named = task.get("name") if isinstance(task, dict) else None
    known = [name for name in creatures if isinstance(name, str)]  # a genome that was refused may have any other
    return {"creature": _shown(", ".join(known)) or None, "task": _shown(named)}


def _run(folder: Folder, name: str) -> JsonObject:
    """Returns the entry of a run in a list."""
    try:
        path = folder.find("runs", name)
        settings = read_settings(path / SETTINGS)
        if not isinstance(settings, dict):
            return {"error": "it is no run"}
        task = settings.get("task")
        told = {
            "kind": "learn" if str(settings.get("format")).startswith("nmes-learning") else "evolve",
            "task": _shown(task.get("name") if isinstance(task, dict) else None),
            **{field: _shown(settings.get(field)) for field in ("algorithm", "seed", "budget", "steps")},
        }
        with suppress(FileNotFoundError), open_regular(path / "log.jsonl") as log:
            if os.fstat(log.fileno()).st_size <= _LARGEST:
                told["told"] = log.read().count(b"\n")
    except (NmesError, OSError) as error:
        return {"error": str(error)}
    return told


_DETAILS: Final[dict[str, Callable[[Folder, str], JsonObject]]] = {"recordings": _recording, "runs": _run}


def _shown(value: Any) -> str | int | None:
    """Returns a value of settings that nobody has judged yet, where a list can show it."""
    if isinstance(value, str):
        return value[:_LONGEST]
    return value if isinstance(value, int) and abs(value) <= _GREATEST else None
