"""The tasks of strangers: none goes by the name of one that ships."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from nmes.errors import visible

if TYPE_CHECKING:
    from nmes.evaluation.setting import Setting

__all__ = ["borrowed_names", "require_own_name"]


def require_own_name(task: Setting, source: str) -> None:
    """Refuses a task that has the name of one that ships and is another: its scores would be taken for that one's.

    Args:
        task: The task.
        source: What the user has named it by.

    Raises:
        BadParameter: It has such a name.
    """
    from nmes.evaluation.identity import borrows_name  # its imports take long, and all commands import this

    if borrows_name(task.name, task.hash):
        message = f"{visible(source)} is another task than the {task.name} that ships: give it a name of its own"
        raise click.BadParameter(message, param_hint="--task")


def borrowed_names(tasks: dict[str, str]) -> list[str]:
    """Returns a line for each task that has the name of one that ships and is another; `tasks` has names by hashes."""
    from nmes.evaluation.identity import borrows_name

    return [
        f"{name} is not the task of that name that ships: its hash is {digest[:16]}"
        for digest, name in tasks.items()
        if borrows_name(name, digest)
    ]
