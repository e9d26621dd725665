"""The folder of a run, of evolution or of learning: `run.json`, which says what the run is about, beside its log.

Hides how a run begins in a folder, so that of two processes one has it, and what is told where there is none.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar

import orjson

from nmes.errors import DocumentError, RunError
from nmes.evolution.run_log import write_whole
from nmes.schemas.documents import JsonObject, parse_document
from nmes.schemas.files import read_regular

__all__ = ["SETTINGS", "begin_run", "open_run", "read_settings", "require_documents", "require_no_run", "text_of"]

SETTINGS: Final = "run.json"
_LARGEST: Final = 1 << 30  # bytes of a file of settings, which may hold many genomes

T = TypeVar("T")


def text_of(document: JsonObject) -> bytes:
    """Returns a document as a person would read it in a file."""
    return orjson.dumps(document, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE)


def require_no_run(folder: Path, *written: str) -> None:
    """Refuses a folder in which a run cannot begin.

    Args:
        folder: The folder.
        written: Names of what the run will write beside its settings and its log.

    Raises:
        RunError: There is a run, what is left of one, or something of those names (`run_exists`).
    """
    if any((folder / name).exists() for name in (SETTINGS, "log.jsonl")):
        raise RunError("run_exists", f"there is a run in {folder}: resume it, or choose another folder")
    for name in written:
        if os.path.lexists(folder / name):
            raise RunError("run_exists", f"there is another {name} in {folder}: choose another folder")


def begin_run(folder: Path, document: JsonObject) -> None:
    """Makes a folder for a run that has not begun yet.

    Args:
        folder: The folder; one that is there may hold what else it likes.
        document: What the run is about.

    Raises:
        RunError: There is a run in it (`run_exists`), or it cannot be written (`cannot_write`).
    """
    require_no_run(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunError("cannot_write", f"cannot make the folder {folder}: {error.strerror}") from error
    write_whole(folder / SETTINGS, text_of(document), new=True)


def open_run(folder: str | os.PathLike[str], run_format: str, read: Callable[[Path, JsonObject], T]) -> T:
    """Opens the run in a folder.

    Args:
        folder: The run's.
        run_format: That it must have.
        read: Makes a run of its folder and of what it is about; raises DocumentError where that is not as it must be.

    Raises:
        RunError: There is none, or none of this format (`no_run`); and what `read` raises.
    """
    path = Path(folder) / SETTINGS
    try:
        document = read_settings(path)
        found = document.get("format") if isinstance(document, dict) else None
        if isinstance(found, str) and found != run_format:
            raise RunError("no_run", f"{path.parent} is a run of the format {found}, not {run_format}: {_hint(found)}")
        return read(path.parent, document)
    except OSError as error:
        raise RunError("no_run", f"there is no run in {path.parent}: {error.strerror}") from error
    except DocumentError as error:
        raise RunError("no_run", f"{path} is not as it must be:\n{error.message}") from error


def _hint(run_format: str) -> str:
    command = {"nmes-run": "evolve", "nmes-learning": "learn", "nmes-survey": "survey"}.get(
        run_format.partition("/")[0]
    )
    return "go on with it in the version of NMES that began it" + (f", by `nmes {command}`" if command else "")


def require_documents(settings: JsonObject) -> None:
    """Raises DocumentError where the settings of a run that is there name a task or a genome, instead of holding it.

    A name would stand for whatever it is called on the machine of whoever opens the folder.
    """
    places: list[tuple[str, Any]] = [(name, settings.get(name)) for name in ("task", "genome")]
    places += [(f"starts/{number}", start) for number, start in enumerate(settings.get("starts", ()))]
    for number, each in enumerate(settings.get("populations", ())):
        starts = enumerate(each.get("starts", ()))
        places += [(f"populations/{number}/starts/{which}", start) for which, start in starts]
    problems = [(place, "must be the document itself") for place, value in places if isinstance(value, str)]
    if problems:
        raise DocumentError(problems)


def read_settings(path: Path) -> Any:
    """Reads the document in a file of settings, which nobody has judged yet.

    Raises:
        OSError: The file cannot be read.
        DocumentError: It is not strict JSON.
    """
    return parse_document(read_regular(path, _LARGEST))
