"""The genomes that the arguments of a command mean."""

from __future__ import annotations

from collections.abc import Iterable
from glob import glob
from pathlib import Path

import click

from nmes.errors import visible
from nmes.genome import Genome

__all__ = ["find_genomes"]


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
