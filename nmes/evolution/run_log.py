"""The log of a run: a line for every candidate that was told, in order, each with the digest of all lines up to it.

Hides the file's form: JSON lines that are only ever appended, whose last field is a chain of BLAKE2b digests, and how
they are written so that a kill at any byte leaves whole lines and at most one torn one, which nothing stands on.
"""

from __future__ import annotations

import errno
import os
import secrets
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any, Final

from nmes.errors import RunError
from nmes.schemas.documents import write_json
from nmes.schemas.files import lock_kept, open_kept, open_regular

__all__ = ["Line", "RunLog", "RunWriter", "write_whole"]

_BEFORE, _AFTER = b',"digest":"', b'"}\n'  # the digest, at the end of a line
_DIGITS: Final = 32
_TAIL: Final = len(_BEFORE) + _DIGITS + len(_AFTER)
_LONGEST: Final = 160 << 20  # bytes of a line: a genome's file may have half of that
_SYNC: Final = 1.0  # s; what a machine that fails may lose, and a kill never does
_FULL: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_BLOCK: Final = 1 << 20  # bytes that are read at once


@dataclass(frozen=True, slots=True)
class Line:
    """A line of the log.

    Attributes:
        begin: Where it begins, bytes from the beginning of the file.
        end: Where the next one begins.
        content: Its record, as JSON.
        digest: Of all lines up to this one, 32 hexadecimal digits.
    """

    begin: int
    end: int
    content: bytes
    digest: str


class RunLog:
    """A log, for reading; `writing` gives one that can be appended to.

    Args:
        path: The file. One that is not there yet is empty.
        origin: What the chain of digests begins with.
    """

    def __init__(self, path: Path, origin: str) -> None:
        self.path, self.origin = path, origin

    def lines(self, number: int = 0, begin: int = 0, digest: str | None = None) -> Iterator[Line]:
        """Reads whole lines; a last line that was torn, or is just being written, is not there yet.

        Args:
            number: How many lines are before the first to read.
            begin: Where that line begins, bytes.
            digest: Of the line before it; None: it is the first.

        Raises:
            RunError: A line is damaged or none of a log (`log_damaged`), or the file cannot be read (`no_run`).
        """
        digest = self.origin if digest is None else digest
        try:
            with open_regular(self.path) as file:
                file.seek(begin)
                while (text := file.readline(_LONGEST)).endswith(b"\n"):
                    number += 1
                    line = _line(text, begin, digest)
                    if line is None:
                        beside = ", or the settings beside the log are not" if number == 1 else ""
                        raise self.damaged(number, f"it is not as it was written{beside}")
                    begin, digest = line.end, line.digest
                    yield line
                if len(text) == _LONGEST:
                    raise self.damaged(number + 1, f"it is longer than {_LONGEST >> 20} MiB")
        except FileNotFoundError:
            return
        except OSError as error:
            raise RunError("no_run", f"cannot read {self.path}: {error.strerror}") from error

    def damaged(self, number: int, what: str) -> RunError:
        """Returns the error about a line, counted from 1."""
        whole = self._count_whole(number - 1)
        keep = f"keep the first {whole:,}, which are whole (head -n {whole}), and resume the run, or " if whole else ""
        return RunError("log_damaged", f"{self.path}, line {number}: {what}; restore the file, {keep}begin a new run")

    def _count_whole(self, most: int) -> int:
        """Returns how many lines are as they were written, from the first on: who reads by an index knows of few."""
        count, end, digest = 0, 0, self.origin
        with suppress(OSError), open_regular(self.path) as file:
            while count < most and (line := _line(file.readline(_LONGEST), end, digest)) is not None:
                count, end, digest = count + 1, line.end, line.digest
        return count


class RunWriter:
    """A log that this process, and no other, appends to, until it is closed.

    Args:
        log: The log.

    Raises:
        RunError: Another process does (`run_busy`), or the file cannot be written or locked (`cannot_write`).
    """

    def __init__(self, log: RunLog) -> None:
        self._log = log
        try:
            self._file = open_kept(log.path)
        except OSError as error:
            raise _unwritten(log.path, error) from error
        try:
            lock_kept(self._file, log.path)
        except OSError as error:
            os.close(self._file)
            if isinstance(error, BlockingIOError):
                message = f"another process goes on with the run in {log.path.parent}"
                raise RunError("run_busy", message) from error
            raise _unwritten(log.path, error) from error
        self.end, self.digest = 0, log.origin
        self._synced = time.monotonic()
        _sync_names(log.path.parent)

    def resume(self, end: int, digest: str, head: bytes) -> None:
        """Goes on behind the last whole line; a torn one behind it, which a kill or a power cut left, is cut off.

        Args:
            end: Where that line ends, bytes.
            digest: Of all lines up to it.
            head: What the next line begins with, by which a torn one is known.

        Raises:
            RunError: What is behind it is no torn line (`log_damaged`), or it cannot be cut off (`cannot_write`).
        """
        try:
            if not self._is_torn(end, head):
                keep = f"keep what is before (head -c {end}) and resume the run, or " if end else ""
                what = f"what is behind byte {end:,} is no line of a run; restore the file, {keep}begin a new run"
                raise RunError("log_damaged", f"{self._log.path}: {what}")
            self.end, self.digest = end, digest
            self._cut()
        except OSError as error:
            raise _unwritten(self._log.path, error) from error

    def _is_torn(self, end: int, head: bytes) -> bool:
        """Whether what is behind a byte is a torn line that begins so.

        A power cut may leave the length of what was appended, and of its bytes but the first or none: the others are 0.
        """
        found = os.pread(self._file, len(head), end)
        written = found.rstrip(b"\0")
        return head.startswith(written) and (written == head or self._is_blank(end + len(found)))

    def _is_blank(self, begin: int) -> bool:
        """Whether all bytes from a place on are 0."""
        while block := os.pread(self._file, _BLOCK, begin):
            if block.strip(b"\0"):
                return False
            begin += len(block)
        return True

    def append(self, records: Sequence[Mapping[str, Any]]) -> list[Line]:
        """Appends records, and returns their lines; about once a second all is synced to the disk.

        Raises:
            RunError: They cannot be written (`cannot_write`); none of them is in the log then.
        """
        lines, texts = [], []
        end, digest = self.end, self.digest
        for record in records:
            content = write_json(record)
            digest = _chain(digest, content)
            texts.append(content[:-1] + _BEFORE + digest.encode() + _AFTER)
            lines.append(Line(end, end + len(texts[-1]), content, digest))
            end = lines[-1].end
        try:
            _write(self._file, b"".join(texts))
            if time.monotonic() >= self._synced + _SYNC:
                self._sync()
        except OSError as error:
            with suppress(OSError):  # whoever goes on cuts it off
                self._cut()
            raise _unwritten(self._log.path, error) from error
        self.end, self.digest = end, digest
        return lines

    def _cut(self) -> None:
        os.ftruncate(self._file, self.end)

    def _sync(self) -> None:
        os.fsync(self._file)
        self._synced = time.monotonic()

    def close(self) -> None:
        """Lets others go on with the run."""
        try:
            self._sync()
        except OSError as error:
            raise _unwritten(self._log.path, error) from error
        finally:
            os.close(self._file)


def write_whole(path: Path, text: bytes, *, new: bool = False) -> None:
    """Writes a file of a run whole, or not at all.

    Args:
        path: The file.
        text: What to write.
        new: Whether it must not be there yet.

    Raises:
        RunError: It is there (`run_exists`), or cannot be written (`cannot_write`).
    """
    part = path.with_name(f".{secrets.token_hex(8)}.part")
    try:
        with part.open("xb") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        if new:
            os.link(part, path)
        else:
            part.replace(path)
        _sync_names(path.parent)
    except FileExistsError as error:
        raise RunError("run_exists", f"another process has begun a run in {path.parent}") from error
    except OSError as error:
        raise _unwritten(path, error, "begin the run again" if new else "resume the run") from error
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def _sync_names(folder: Path) -> None:
    """Syncs which files a folder has, so that a power cut does not take a new one away."""
    with suppress(OSError):  # there are file systems whose folders cannot be synced
        names = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(names)
        finally:
            os.close(names)


def _write(file: int, text: bytes) -> None:
    """Writes all of a text; a disk that is full takes a part, and then nothing."""
    left = memoryview(text)
    while left:
        left = left[os.write(file, left) :]


def _unwritten(path: Path, error: OSError, then: str = "resume the run") -> RunError:
    advice = f"; make room, then {then}" if error.errno in _FULL else ""
    return RunError("cannot_write", f"cannot write {path}: {error.strerror}{advice}")


def _chain(digest: str, content: bytes) -> str:
    return blake2b(content, key=digest.encode(), digest_size=_DIGITS // 2).hexdigest()


def _content(text: bytes) -> bytes:
    return text[:-_TAIL] + b"}"


def _line(text: bytes, begin: int, digest: str) -> Line | None:
    """Reads a line; None if it is none, or does not follow on this digest."""
    content = _content(text)
    following = _chain(digest, content)
    if text[-_TAIL:] != _BEFORE + following.encode() + _AFTER:
        return None
    return Line(begin, begin + len(text), content, following)
