"""Progress bars of long work, on standard error and only on a terminal."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeRemainingColumn

__all__ = ["QUIET", "Progressing", "progress_bars"]

_QUIET = "nmes.quiet"


def _keep(context: click.Context, _parameter: click.Parameter, value: bool) -> None:
    context.meta[_QUIET] = value


QUIET = click.option(
    "-q", "--quiet", is_flag=True, expose_value=False, callback=_keep, help="Show no progress on standard error."
)
"""The option of commands that show progress: `progress_bars` minds it."""


class Progressing(Protocol):
    """Shows how far something is."""

    def __call__(self, doing: str, done: int, total: int, note: str = "") -> None:
        """Shows that so much of what is being done is done."""


@contextmanager
def progress_bars(visible: bool = True) -> Iterator[Progressing]:
    """Gives a function to call with what is being done, how much of it is done, how much there is, and maybe a note.

    Args:
        visible: Whether to show bars at all: short work needs none.
    """
    console = Console(stderr=True)
    context = click.get_current_context(silent=True)
    visible = visible and not (context is not None and context.meta.get(_QUIET))
    texts = TextColumn("{task.description}"), TextColumn("{task.fields[note]}")
    columns = (texts[0], BarColumn(), TaskProgressColumn(), TimeRemainingColumn(), texts[1])
    with Progress(*columns, console=console, transient=True, disable=not (visible and console.is_terminal)) as bars:
        tasks: dict[str, TaskID] = {}

        def progress(doing: str, done: int, total: int, note: str = "") -> None:
            if doing not in tasks:
                tasks[doing] = bars.add_task(doing, total=total, note=note)
            bars.update(tasks[doing], completed=done, total=total, note=note)

        yield progress
