"""The worlds that a folder of recordings keeps: which there are, and with which file each goes on.

It hides how the files of a host are called, and how worlds that were closed for good are told from others: their last
recordings are listed in a file beside them. Of what happened nothing is read but how each recording begins, and of one
that goes on from another whether it came as far as that.
"""

from __future__ import annotations

import logging
import re
from collections import defaultdict
from datetime import UTC, datetime
from pathlib import Path

from nmes.errors import NmesError
from nmes.recording import Recording
from nmes.recording.records import PARENT
from nmes.schemas.files import read_regular

__all__ = ["CLOSED", "about_maker", "kept_worlds", "maker_of", "new_recording_path", "note_closed"]

logger = logging.getLogger(__name__)

CLOSED = "closed-worlds.txt"
"""The file that lists the last recordings of worlds that were closed for good, a name a line."""
_MAKER = "nmes.maker"  # the metadata of a recording that say who created its world
_NAME = re.compile(r"(.+)-[0-9]{8}T[0-9]{6}\.[0-9]{6}Z\.mcap", re.DOTALL)
_LISTED = 64 << 20  # bytes of the names of closed worlds
_LONGEST = 200  # bytes of a world's name, of the 255 that the name of a file may have


def new_recording_path(folder: Path, world: str) -> Path:
    """Returns a path that names the world and the time, so exactly that servers which start together differ."""
    return folder / f"{_stem(world)}-{datetime.now(UTC):%Y%m%dT%H%M%S.%fZ}.mcap"


def _stem(world: str) -> str:
    return re.sub(r"[^\w.-]", "_", world).encode()[:_LONGEST].decode(errors="ignore")


def kept_worlds(folder: Path) -> dict[str, Recording]:
    """Finds the worlds of a folder that were not closed, by name, each with the recording from whose end it goes on.

    Files that are called otherwise than a host calls them are not looked at. The log tells of those that are no
    recordings, as a full disk leaves them, and of those with which a host that was killed had only begun to go on.

    Raises:
        OSError: The folder cannot be read.
    """
    by_stem = defaultdict[str, list[Path]](list)
    for path in sorted(folder.iterdir(), reverse=True):  # the newest of a world comes first
        if match := _NAME.fullmatch(path.name):
            by_stem[match[1]].append(path)
    closed = set(_lines(folder / CLOSED))
    found: dict[str, Recording] = {}
    ended: set[str] = set()
    for stem, paths in by_stem.items():
        alone = "_" not in stem and len(stem.encode()) < _LONGEST - 3  # else several worlds may be called like that
        for path in paths:
            try:
                recording = Recording(path)
            except NmesError as error:
                logger.warning("%s is left where it is: %s", path, error.message)
                continue
            name = recording.config["name"]
            if path.name in closed and name not in found:
                ended.add(name)
            if name not in ended and name not in found:
                if (flaw := _flaw(recording)) is not None:
                    logger.warning("%s is left where it is: %s", path, flaw)
                    continue
                found[name] = recording
            if alone:
                break
    return dict(sorted(found.items()))


def _flaw(recording: Recording) -> str | None:
    """Returns why nobody can go on from a recording that itself goes on from another; None: it came as far as that."""
    if PARENT not in recording.metadata:
        return None
    recording = Recording(recording.path)  # in this one the first keyframe is kept, and not in one that is found
    try:
        frame = int(recording.metadata[PARENT]["frame"])
        if recording.start().frame >= frame or recording.last_frame >= frame:  # for the second it is read to its end
            return None
    except (NmesError, ValueError) as error:  # the first keyframe is of a newer version, or the number is endless
        return str(getattr(error, "message", error))
    return "it ends before the frame from which it was to go on"


def _lines(path: Path) -> list[str]:
    """Returns the lines of a file of names; none where there is no file.

    Raises:
        OSError: It cannot be read.
    """
    try:
        return read_regular(path, _LISTED).decode(errors="replace").split("\n")
    except FileNotFoundError:
        return []


def about_maker(maker: str | None) -> dict[str, dict[str, str]]:
    """Returns the metadata of a recording by which its world has the same maker when a host goes on with it."""
    return {} if maker is None else {_MAKER: {"name": maker}}


def maker_of(recording: Recording) -> str | None:
    """Returns the maker who created the world of a recording; None: the host did."""
    return recording.metadata.get(_MAKER, {}).get("name")


def note_closed(recording: Path) -> None:
    """Lists the last recording of a world that was closed for good.

    Raises:
        OSError: That cannot be written.
    """
    with open(recording.parent / CLOSED, "a") as file:
        file.write(f"{recording.name}\n")
