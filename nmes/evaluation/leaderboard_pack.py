"""A leaderboard in one file, for others to prove again: its entries' recordings and their signatures.

It is a zip without compression: `entries.json` (schemas/leaderboard_pack.json) has the hashes of each entry's
recordings, which lie beside it as `HASH.mcap`, their signatures as `HASH.mcap.sig`. It states no score: whoever takes
entries out of it proves them first.

Invariants: packing the same entries gives the same bytes. What is read may be of anybody, and is bounded before it is
read: by the file's own size in all, since nothing in it may be compressed, or share bytes with anything else. Nothing
is written but to the names of hashes in a folder that the caller names, and only content of that hash is handed out.
"""

from __future__ import annotations

import os
import re
import shutil
import struct
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from hashlib import file_digest
from pathlib import Path
from types import TracebackType
from typing import IO, Final

import orjson

from nmes.errors import DocumentError, LeaderboardError
from nmes.evaluation.leaderboard import Leaderboard
from nmes.recording.signed import SUFFIX
from nmes.schemas.documents import check, compile_schema, parse_document

__all__ = ["Pack", "pack"]

_FORMAT: Final = "nmes-leaderboard-pack/1"
_SCHEMA: Final = compile_schema("leaderboard_pack.json")
_ENTRIES: Final = "entries.json"
_NAME: Final = re.compile(r"[0-9a-f]{64}\.mcap(\.sig)?")
_END: Final = struct.Struct("<4s4H2LH")  # the record at the end of a zip, without a comment
_SMALL: Final = {_ENTRIES: 16 << 20, SUFFIX: 1 << 16}  # bytes of what is read at once
_DIRECTORY: Final = 16 << 20  # bytes of the list of members, which is read at once too
_MEMBERS: Final = 0xFFFE  # more need another form of zip


def pack(board: Leaderboard, path: str | os.PathLike[str], *, task: str | None = None, top: int | None = None) -> int:
    """Writes the entries of a leaderboard to one file; returns how many.

    Args:
        board: The leaderboard.
        path: The file to write.
        task: Only those of the task with this name.
        top: Only so many of each task.

    Raises:
        LeaderboardError: There is no entry (`nothing_to_pack`), they are too many or too large for one file
            (`too_large`), or a recording is gone (`changed`).
    """
    entries = board.entries(task=task, top=top)
    if not entries:
        raise LeaderboardError("nothing_to_pack", f"{board.path} has no such entry to pack")
    recordings = list(dict.fromkeys(name for entry in entries for name in entry.recordings))
    if 2 * len(recordings) + 1 > _MEMBERS:
        raise _too_large(board)
    listed = {"format": _FORMAT, "entries": [{"recordings": list(entry.recordings)} for entry in entries]}
    try:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED, allowZip64=False) as archive:
            archive.writestr(zipfile.ZipInfo(_ENTRIES), orjson.dumps(listed))
            for name in recordings:
                for file in (board.recording(name), Path(f"{board.recording(name)}{SUFFIX}")):
                    if file.suffix != SUFFIX or file.is_file():
                        _add(archive, file)
    except zipfile.LargeZipFile as error:
        raise _too_large(board) from error
    return len(entries)


def _add(archive: zipfile.ZipFile, file: Path) -> None:
    try:
        info = zipfile.ZipInfo(file.name)  # dated 1980, so that the same entries give the same bytes
        info.file_size = file.stat().st_size
        with file.open("rb") as source, archive.open(info, "w") as target:
            shutil.copyfileobj(source, target)
    except FileNotFoundError as error:
        raise LeaderboardError("changed", f"there is no recording {file}") from error


def _too_large(board: Leaderboard) -> LeaderboardError:
    what = f"the entries of {board.path} are over 4 GiB, or {_MEMBERS:,} files, which one file can hold"
    return LeaderboardError("too_large", f"{what}: pack some, by their task or their rank")


class Pack:
    """A packed leaderboard that is read; to be closed, as by `with`.

    Args:
        path: The file.

    Attributes:
        entries: The hashes of the recordings of each entry.

    Raises:
        LeaderboardError: It is none (`no_pack`); every other method raises this too.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        with self._trouble():
            file = self.path.open("rb")
            try:
                self._members = self._open(file)
                self.entries = self._listed()
            except BaseException:
                file.close()
                raise

    def __enter__(self) -> Pack:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Closes the file."""
        self._archive.close()
        self._file.close()

    def _open(self, file: IO[bytes]) -> dict[str, zipfile.ZipInfo]:
        """Returns the members by their names, which all together are no larger than the file."""
        self._file = file
        size = os.fstat(file.fileno()).st_size
        file.seek(max(0, size - _END.size))
        end = file.read(_END.size)
        if len(end) < _END.size or not end.startswith(b"PK\x05\x06"):
            raise self._refused("it is no zip that `nmes leaderboard pack` wrote, or was cut")
        _, disk, first_disk, here, count, length, offset, comment = _END.unpack(end)
        # Nothing between the list of members and the end, where a larger list might be announced.
        whole = offset + length + _END.size == size and (disk, first_disk, comment, here) == (0, 0, 0, count)
        if not whole or count > _MEMBERS or length > _DIRECTORY:
            raise self._refused("its list of files is not as `nmes leaderboard pack` writes it")
        self._archive = zipfile.ZipFile(file)
        infos = self._archive.infolist()
        for info in infos:
            self._check(info)
        members = {info.filename: info for info in infos}
        if len(members) < len(infos) or sum(info.file_size for info in infos) > size:
            raise self._refused("several of its files are in the same place")
        return members

    def _check(self, info: zipfile.ZipInfo) -> None:
        name = info.filename
        if name != _ENTRIES and not _NAME.fullmatch(name):
            raise self._refused(f"it has a file {name[:80]!r}")
        if info.compress_type != zipfile.ZIP_STORED or info.compress_size != info.file_size or info.flag_bits & 1:
            raise self._refused(f"{name} is compressed or encrypted in it")
        if info.file_size > _SMALL.get(_ENTRIES if name == _ENTRIES else Path(name).suffix, info.file_size):
            raise self._refused(f"{name} is too large in it")

    def _listed(self) -> tuple[tuple[str, ...], ...]:
        if _ENTRIES not in self._members:
            raise self._refused(f"it has no {_ENTRIES}")
        try:
            document = parse_document(self._archive.read(_ENTRIES))
            check(_SCHEMA, document)
        except DocumentError as error:
            raise self._refused(f"{_ENTRIES}: {error.message}") from error
        entries = tuple(tuple(entry["recordings"]) for entry in document["entries"])
        listed: set[str] = set()
        for name in (name for entry in entries for name in entry):
            if f"{name}.mcap" not in self._members:
                raise self._refused(f"it lists {name}.mcap, which is not in it")
            if name in listed:
                raise self._refused(f"it lists {name}.mcap for two entries")
            listed.add(name)
        return entries

    def extract(self, recordings: Sequence[str], folder: Path) -> list[Path]:
        """Writes recordings, and their signatures where there are any, to a folder; returns the recordings' paths.

        Args:
            recordings: Hashes, of `entries`.
            folder: The folder, which exists.
        """
        paths = []
        for name in recordings:
            path = folder / f"{name}.mcap"
            with self._trouble():
                self._write(path)
                with path.open("rb") as file:
                    if file_digest(file, "sha256").hexdigest() != name:
                        raise self._refused(f"{path.name} has another content than its name says")
                if f"{path.name}{SUFFIX}" in self._members:
                    self._write(Path(f"{path}{SUFFIX}"))
            paths.append(path)
        return paths

    def _write(self, path: Path) -> None:
        with self._archive.open(path.name) as source, path.open("wb") as target:
            shutil.copyfileobj(source, target)

    def _refused(self, reason: str) -> LeaderboardError:
        return LeaderboardError("no_pack", f"{self.path} is no packed leaderboard: {reason}")

    @contextmanager
    def _trouble(self) -> Iterator[None]:
        try:
            yield
        except (zipfile.BadZipFile, zlib.error, struct.error, EOFError, ValueError, NotImplementedError) as error:
            raise self._refused(str(error) or "it is cut") from error
        except OSError as error:
            raise LeaderboardError("no_pack", f"{self.path}: {error.strerror or error}") from error
