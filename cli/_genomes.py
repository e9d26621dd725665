"""The genomes that the arguments of a command mean."""

from __future__ import annotations

from collections.abc import Iterable
from glob import glob
from pathlib import Path
from typing import Any

import click
import orjson

from nmes.cli._output import whole_file
from nmes.errors import DocumentError, visible
from nmes.genome import Genome

__all__ = ["find_genomes", "load_genome", "write_genome"]


def find_genomes(arguments: Iterable[str], *, repeated: bool = False) -> list[str]:
    """Returns the files and shipped names that arguments mean, in order: each once, or as often as it was named.

    An argument is a file, a directory (its `*.json`), a pattern, or the name of a genome that ships with the package.
    One that means nothing is wrong usage.
    """
    names: list[str] = []
    for name in arguments:
        if Path(name).is_dir():
            inside = sorted(str(path) for path in Path(name).glob("*.json"))
            if not inside:
                raise click.UsageError(f"there is no .json file in {visible(name)}")
            names += inside
        elif Path(name).exists() or name in Genome.names():
            names.append(name)
        elif matching := sorted(glob(name, recursive=True)):
            names += matching
        else:
            shipped = ", ".join(Genome.names())
            raise click.UsageError(
                f"there is no file {visible(name)}, and no genome of that name ships (there are {shipped})"
            )
    return names if repeated else list(dict.fromkeys(names))


def load_genome(file: str) -> Genome:
    """Reads the genome that a file or a shipped name means.

    Raises:
        ClickException: It is none.
    """
    try:
        return Genome.load(file)
    except DocumentError as error:
        raise click.ClickException(f"{visible(file)}:\n{error.message}") from error


def write_genome(target: Path, document: Any) -> None:
    """Writes a genome's document for people to read, into a folder that is made where it is not there."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(target) as unfinished:
        unfinished.write_bytes(orjson.dumps(document, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE))
