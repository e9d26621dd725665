"""The files that commands write: never one of their inputs, and there whole or not at all."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from nmes.errors import NmesError

__all__ = ["check_output", "whole_file", "whole_folder"]


def check_output(output: Path | None, *inputs: str | os.PathLike[str]) -> None:
    """Refuses an output that is one of the inputs: the same file, whatever the two are called; None is none.

    An input may be one that is not there yet, and is written before the output.

    Raises:
        UsageError: It is one.
    """
    for path in inputs:
        if output is not None and (
            os.path.realpath(output) == os.path.realpath(path)
            or (output.exists() and os.path.exists(path) and os.path.samefile(output, path))
        ):
            raise click.UsageError(f"{output} is what is read ({path}): write to another file")


@contextmanager
def whole_file(output: Path, *inputs: str | os.PathLike[str]) -> Iterator[Path]:
    """Gives the path of a new file beside `output`, which takes its place once it is whole.

    Until then, and where something fails, a file that was there before stays as it is. What is no regular file (a
    device, a pipe) cannot be replaced: its own path is given.

    Args:
        output: The file to write. Where it is a link, what it leads to is written.
        inputs: The files that it is made from.

    Raises:
        UsageError: It is one of the inputs.
        ClickException: It cannot be written.
    """
    check_output(output, *inputs)
    target = Path(os.path.realpath(output))
    if target.exists() and not target.is_file():
        unfinished = target
    else:
        unfinished = target.with_name(f".{secrets.token_hex(8)}{target.suffix}")
    try:
        with unfinished.open("ab"):  # found before the work, not after it
            pass
        yield unfinished
        if unfinished != target:
            if target.exists():
                shutil.copymode(target, unfinished)
            unfinished.replace(target)
    except OSError as error:
        if isinstance(error, NmesError | TimeoutError):  # of a server that the content comes from
            raise
        raise click.ClickException(f"cannot write {output}: {error.strerror or error}") from error
    finally:
        if unfinished != target:
            unfinished.unlink(missing_ok=True)


@contextmanager
def whole_folder(output: Path) -> Iterator[Path]:
    """Gives the path of a new, empty folder, which takes the place of `output` once it is whole.

    A folder that is there stays the one that it is, and gets what is in the new one: it may be where somebody works, or
    where a disk is mounted.

    Raises:
        UsageError: There is something of that name already, and it is no empty folder.
        ClickException: It cannot be written.
    """
    there = output.is_dir()
    if output.is_symlink() or (output.exists() and not (there and not any(output.iterdir()))):
        raise click.UsageError(f"there is {output} already: name a folder that is not there yet")
    name = f".{secrets.token_hex(8)}"
    unfinished = output / name if there else output.absolute().with_name(name)
    try:
        unfinished.mkdir(parents=True)
        yield unfinished
        if not there:
            unfinished.replace(output)  # a folder that is empty and has come meanwhile is replaced too
        elif [*output.iterdir()] == [unfinished]:
            for path in [*unfinished.iterdir()]:
                path.replace(output / path.name)
        else:
            raise click.ClickException(f"somebody else has written to {output} meanwhile")
    except OSError as error:
        raise click.ClickException(f"cannot write {output}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
