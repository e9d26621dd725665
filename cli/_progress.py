"""Progress bars of long work, on standard error and only on a terminal."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

import click

if TYPE_CHECKING:
    from rich.progress import TaskID

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
    context = click.get_current_context(silent=True)
    quiet = context is not None and context.meta.get(_QUIET)
    asked = not os.environ.keys().isdisjoint({"FORCE_COLOR", "TTY_COMPATIBLE"})  # Rich takes that for a terminal
    if not visible or quiet or not (asked or (sys.stderr is not None and sys.stderr.isatty())):
        yield lambda doing, done, total, note="": None
        return
    # Not before it is needed: it takes a tenth of a second.
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
    from rich.table import Column

    console = Console(stderr=True)
    texts = TextColumn("{task.description}"), TextColumn("{task.fields[note]}")
    bar = BarColumn(None, table_column=Column(max_width=40))  # narrower where the note would not fit beside it
    columns = (texts[0], bar, TaskProgressColumn(), TimeRemainingColumn(), texts[1])
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
        tasks: dict[str, TaskID] = {}

        def progress(doing: str, done: int, total: int, note: str = "") -> None:
            if doing not in tasks:
                tasks[doing] = bars.add_task(doing, total=total, note=note)
            bars.update(tasks[doing], completed=done, total=total, note=note)

        yield progress
