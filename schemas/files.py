"""Files in folders that strangers may have made, where a name may stand for a pipe that never ends or a device.

A file that somebody names on a command line may be a pipe; one that a folder names may not.
"""

from __future__ import annotations

import errno
import fcntl
import os
import stat
import time
from pathlib import Path
from typing import BinaryIO, Final

__all__ = ["lock_kept", "names_another_file", "open_kept", "open_regular", "read_regular"]

_KEPT: Final = os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK

_HELD: Final = (errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES)  # what a lock says that another process has
_MOMENT: Final = 1.0  # s for which a child that a killed process was about to begin may have its lock
_LOOK: Final = 0.01  # s between looks at whether it is free
_PIECE = 1 << 20  # bytes
_SUPER_JOURNAL: Final = bytes.fromhex("d9d505f920a163d7")  # what a journal that names another one ends with


def open_regular(path: Path) -> BinaryIO:
    """Opens a file for reading, without waiting for anybody.

    Raises:
        OSError: It cannot be read, or is no regular file.
    """
    file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise _irregular(path)
    return file


def open_kept(path: Path) -> int:
    """Opens a file to be read, cut and appended to, and makes it where it is not there.

    Returns:
        Its descriptor.

    Raises:
        OSError: It cannot be written, or is a link or no regular file.
    """
    try:
        file = os.open(path, _KEPT, 0o666)
    except OSError as error:
        if error.errno == errno.ELOOP:  # a stranger's folder may name any file of whoever goes on with it
            raise OSError(errno.ELOOP, "it is a link, not a file", str(path)) from error
        raise
    if not stat.S_ISREG(os.fstat(file).st_mode):
        os.close(file)
        raise _irregular(path)
    return file


def lock_kept(file: int, path: Path) -> None:
    """Locks an open file for this process alone, until it is closed; waits a moment for one that has just been killed.

    Args:
        file: Its descriptor.
        path: What it is called, for messages.

    Raises:
        BlockingIOError: Another process has the lock.
        OSError: It cannot be locked: not every disk of a network knows locks.
    """
    until = time.monotonic() + _MOMENT
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in _HELD:
                advice = "where a disk knows no locks, keep it on another"
                raise OSError(error.errno, f"it cannot be locked: {error.strerror}; {advice}", str(path)) from error
            if time.monotonic() >= until:
                raise BlockingIOError(errno.EWOULDBLOCK, "another process has locked it", str(path)) from error
            time.sleep(_LOOK)
        else:
            return


def _irregular(path: Path) -> OSError:
    return OSError(errno.EINVAL, "it is no regular file", str(path))


def names_another_file(database: Path) -> bool:
    """Whether beside a database of SQLite lies a journal that has another file removed when the database is opened.

    Such a journal is of a change to several databases at once, of which we make none. SQLite trusts it, and removes
    whatever file it says is in common to them: https://www.sqlite.org/fileformat2.html#the_rollback_journal.

    Raises:
        OSError: It cannot be read.
    """
    path = database.resolve()
    try:
        with open_regular(path.with_name(path.name + "-journal")) as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - len(_SUPER_JOURNAL)))
            return file.read() == _SUPER_JOURNAL
    except FileNotFoundError:
        return False


def read_regular(path: Path, most: int) -> bytes:
    """Returns what is in a file.

    Args:
        path: The file.
        most: How many bytes it may have.

    Raises:
        OSError: It cannot be read, is no regular file, or is larger.
    """
    text = bytearray()
    with open_regular(path) as file:
        while piece := file.read(_PIECE):  # not all at once: memory for all that it may have would be taken first
            text += piece
            if len(text) > most:
                raise OSError(errno.EFBIG, f"it has over {most:,} bytes", str(path))
    return bytes(text)
