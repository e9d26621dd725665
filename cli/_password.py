"""Where subcommands take the password from: an option, a file, or the environment."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

__all__ = ["PASSWORD_VARIABLE", "choose_password", "password_options"]

PASSWORD_VARIABLE = "NMES_PASSWORD"

F = TypeVar("F", bound=Callable[..., Any])


def password_options(about: str) -> Callable[[F], F]:
    """Adds `--password`, with what its help says, and `--password-file`."""

    def add(function: F) -> F:
        file = click.option(
            "--password-file",
            type=click.Path(path_type=Path, exists=True, dir_okay=False),
            help="File whose first line is the password.",
        )
        return click.option("--password", help=about)(file(function))

    return add


def choose_password(given: str | None, file: Path | None) -> tuple[str, str] | None:
    """Returns the password and where it is from, the most explicit source; None where none is given."""
    if given is not None and file is not None:
        raise click.UsageError("give --password or --password-file, not both")
    if given is not None:
        password, source = given, "option"
    elif file is not None:
        try:
            lines = file.read_text("utf-8").splitlines()
        except (OSError, ValueError) as error:
            raise click.UsageError(f"{file}: {error}") from error
        password, source = (lines[0] if lines else ""), "file"
    elif PASSWORD_VARIABLE in os.environ:
        password, source = os.environ[PASSWORD_VARIABLE], "environment"
    else:
        return None
    if not password:
        raise click.UsageError(f"the password given by {source} is empty")
    return password, source
