"""The documents that `best` writes beside the recordings of a proof: a genome, and its task if no such one ships."""

from __future__ import annotations

from pathlib import Path

import click

from nmes.cli._output import whole_file
from nmes.recording.signed import SUFFIX
from nmes.schemas.documents import JsonObject
from nmes.schemas.files import read_regular

__all__ = ["check_place", "write_documents"]


def check_place(folder: Path, documents: dict[str, JsonObject]) -> None:
    """Refuses a folder with what must not be written over: other documents, and recordings that somebody signed.

    Args:
        folder: Where they are to be written, which need not be there.
        documents: What is to be written, by the name of the file.

    Raises:
        UsageError: It holds a run, a file of such a name with other content, or a recording that is signed.
    """
    from nmes.evolution.run_folder import SETTINGS, text_of  # its imports take long, and all commands import this

    if (folder / SETTINGS).exists():
        raise click.UsageError(f"{folder} holds a run: name another folder with -o")
    for name, document in documents.items():
        if (folder / name).exists() and not _holds(folder / name, text_of(document)):
            raise click.UsageError(f"there is another {name} in {folder}: name another folder with -o")
    for signature in folder.glob(f"*.mcap{SUFFIX}"):
        what = f"{signature.with_suffix('')} is signed, and is not written over"
        raise click.UsageError(f"{what}: name another folder with -o")


def write_documents(folder: Path, documents: dict[str, JsonObject]) -> list[Path]:
    """Writes documents into a folder, and returns their files."""
    from nmes.evolution.run_folder import text_of

    for name, document in documents.items():
        with whole_file(folder / name) as file:
            file.write_bytes(text_of(document))
    return [folder / name for name in documents]


def _holds(path: Path, text: bytes) -> bool:
    try:
        return read_regular(path, len(text)) == text
    except OSError:  # it is larger, or cannot be read
        return False
