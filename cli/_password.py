"""The password of subcommands: from an option, a file, or the environment."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from nmes.protocol import PASSWORD_VARIABLE

__all__ = ["PASSWORD_VARIABLE", "choose_password", "password_options", "read_password"]

F = TypeVar("F", bound=Callable[..., Any])


def password_options(text: str) -> Callable[[F], F]:
    """Adds `--password`, with a help text, and `--password-file`."""

    def add(function: F) -> F:
        file = click.option(
            "--password-file",
            type=click.Path(path_type=Path, exists=True, dir_okay=False),
            help="File whose first line is the password.",
        )
        return click.option("--password", help=text)(file(function))

    return add


def read_password(file: Path) -> str:
    """Returns the first line of a file.

    Raises:
        UsageError: The file cannot be read, or the line is empty.
    """
    try:
        lines = file.read_text("utf-8").splitlines()
    except (OSError, ValueError) as error:
        raise click.UsageError(f"{file}: {error}") from error
    if not lines or not lines[0]:
        raise click.UsageError(f"{file}: its first line is to be the password, and is empty")
    return lines[0]


def choose_password(option: str | None, file: Path | None) -> tuple[str, str] | None:
    """Returns the password and the name of its source, the most explicit one; None if there is no password.

    Raises:
        UsageError: Both an option and a file are there, the file cannot be read, or the password is empty.
    """
    if option is not None and file is not None:
        raise click.UsageError("give --password or --password-file, not both")
    if option is not None:
        password, source = option, "option"
    elif file is not None:
        password, source = read_password(file), "file"
    elif PASSWORD_VARIABLE in os.environ:
        password, source = os.environ[PASSWORD_VARIABLE], "environment"
    else:
        return None
    if not password:
        raise click.UsageError(f"the password given by {source} is empty")
    return password, source
