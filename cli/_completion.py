"""What a shell completes: files, and the names of what ships, after the words by which help shows arguments.

An argument or option that takes any text is completed by its placeholder: FILE as files, GENOME as files and the
names of the genomes that ship. So a command needs no line about completion.
"""

from __future__ import annotations

import os
import re
from functools import partial

import click
from click.shell_completion import CompletionItem

__all__ = ["VARIABLE", "complete_arguments", "is_completing"]

VARIABLE = "_NMES_COMPLETE"
"""By which a shell asks the command what to complete; click's convention."""

_FILES = frozenset({"FILE", "A", "B", "MODEL"})

_WITH_ROLES = frozenset({"eval", "tasks", "tournament"})  # the commands that take tasks with roles


def is_completing() -> bool:
    """Returns whether a shell asks."""
    return VARIABLE in os.environ


def complete_arguments(command: click.Command) -> None:
    """Lets a command, and those in it, complete what they take; what click completes itself stays as it is."""
    for inner in getattr(command, "commands", {}).values():
        complete_arguments(inner)
    for parameter in command.params:
        if isinstance(parameter.type, click.types.StringParamType):
            # A method of each: click passes a function of its own only where a parameter is declared.
            vars(parameter)["shell_complete"] = partial(_complete, parameter)


def _complete(parameter: click.Parameter, context: click.Context, incomplete: str) -> list[CompletionItem]:
    words = set(re.findall("[A-Z]+", parameter.metavar or parameter.name.upper()))
    is_argument, names = isinstance(parameter, click.Argument), list[str]()
    if "--task" in parameter.opts or (is_argument and words == {"NAME"}):
        names = _task_names(context.command.name)
    elif words & {"GENOME", "WHAT"}:
        names = _genome_names()
    elif not (is_argument and words & _FILES):
        return []
    # Files first: bash forgets what came before them, and shows them where no name fits.
    fitting = [CompletionItem(name) for name in names if name.startswith(incomplete)]
    return [CompletionItem(incomplete, type="file"), *fitting]


def _genome_names() -> list[str]:
    from nmes.genome import Genome

    return list(Genome.names())


def _task_names(command: str | None) -> list[str]:
    """Returns the names of the tasks that a command takes: for one creature, with roles, or both."""
    from nmes.evaluation import MatchTask, Task

    names = () if command == "tournament" else Task.names()
    return [*names, *(MatchTask.names() if command in _WITH_ROLES else ())]
