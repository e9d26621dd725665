"""The command line in this process: for what needs no process of its own."""

from __future__ import annotations

from pathlib import Path

from click.testing import CliRunner, Result

from nmes.cli import main

__all__ = ["run"]


def run(*arguments: str | Path) -> Result:
    """Runs `nmes` with arguments; no exception may come out of it."""
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result
