"""Journals of SQLite as nobody makes them who means well."""

from __future__ import annotations

import struct
from pathlib import Path

__all__ = ["write_naming_journal"]

MAGIC = bytes.fromhex("d9d505f920a163d7")


def write_naming_journal(database: Path, named: Path) -> None:
    """Writes a journal beside a database that has SQLite remove a file when the database is opened."""
    with database.open("rb") as file:
        page = int.from_bytes(file.read(100)[16:18], "big")
    name = str(named).encode()
    head = MAGIC + struct.pack(">IIIII", 0, 1, database.stat().st_size // page, 512, page)
    tail = struct.pack(">I", 2**30 // page + 1) + name + struct.pack(">II", len(name), sum(name)) + MAGIC
    database.with_name(database.name + "-journal").write_bytes(head.ljust(512, b"\0") + tail)
