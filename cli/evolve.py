"""`nmes evolve`: begin a run of evolution, go on with it, look at it, prove it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from nmes.cli import _evolve_best, _evolve_film, _evolve_resume, _evolve_show, _evolve_verify
from nmes.cli._evolve_run import JSON, go_on
from nmes.cli._genomes import find_genomes
from nmes.cli._options import BeginningGroup, read_values
from nmes.cli._pool import JOBS, RAY, check_pool
from nmes.cli._progress import QUIET
from nmes.cli._seeds import read_seeds
from nmes.cli._tasks import require_own_name
from nmes.errors import DocumentError

__all__ = ["command"]

_FORMAT = "nmes-run/1"
_MEASURE = re.compile(r"(.+)\sfrom\s+(\S+)\s+to\s+(\S+)(?:\s+in\s+(\d{1,9}))?\s*", re.DOTALL)
_CELLS = 50
_BESIDE = {"settings", "output", "jobs", "ray", "as_json"}  # options that are not of the run itself


def _roles(_: click.Context, parameter: click.Parameter, value: str | None) -> tuple[str, ...] | None:
    """Reads `hunter,prey`."""
    if value is None:
        return None
    roles = tuple(role.strip() for role in value.split(","))
    if not all(roles):
        raise click.BadParameter("expected roles with commas between them: hunter,prey", param=parameter)
    return roles


@click.group("evolve", cls=BeginningGroup, context_settings={"ignore_unknown_options": True})
def command() -> None:
    """Evolve creatures, in runs that anyone can repeat."""


for _each in (_evolve_best, _evolve_film, _evolve_resume, _evolve_show, _evolve_verify):
    command.add_command(_each.command)


@command.command("", hidden=True)
@click.argument("what", metavar="WHAT...", nargs=-1)
@click.option(
    "--task", metavar="T", default="walk", show_default=True, help="A file, or the name of a task that ships."
)
@click.option("--algorithm", metavar="A", default="ga", show_default=True, help="Its name, one of those above.")
@click.option(
    "--budget", metavar="N", type=click.IntRange(1), default=1000, show_default=True, help="How many candidates."
)
@click.option(
    "--seed", metavar="S", type=click.IntRange(0), default=0, show_default=True, help="Of all that the run draws."
)
@click.option("--seeds", metavar="LIST", callback=read_seeds, help="Of episodes, such as 1-5.  [default: the task's]")
@click.option("--set", "options", metavar="NAME=VALUE", multiple=True, help="An option of the algorithm.")
@click.option("--objective", "objectives", metavar="EXPR", multiple=True, help="What is maximised: one of several.")
@click.option(
    "--measure", "measures", metavar="MEASURE", multiple=True, help="Of an archive: 'EXPR from LOW to HIGH in CELLS'."
)
@click.option(
    "--populations",
    metavar="ROLES",
    callback=_roles,
    help="Of a task with roles: hunter,prey.  [default: all roles, or one population for those that are alike]",
)
@click.option(
    "--settings", type=click.Path(exists=True, dir_okay=False, path_type=Path), help="All of this from a file instead."
)
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="The run's folder.  [default: runs/TASK-ALGORITHM-SEED]"
)
@JOBS
@RAY
@JSON
@QUIET
@click.pass_context
def begin(context: click.Context, /, settings: Path | None, output: Path | None, **options: Any) -> None:
    """Evolve creatures, in runs that anyone can repeat.

    WHAT is where the run begins: `random` for random creatures, or genomes: files, directories, patterns, or names of
    genomes that ship. The run is kept in a folder: its settings, a log of all candidates, an index. It comes out the
    same for any number of processes, and also if it was interrupted in between: the digest that is printed at the end
    proves it.

    With a task that has roles, populations are bred side by side, one a role, and a candidate's score is that of
    matches against the others' best, of late and of old. Then there is one WHAT for all of them, or one a population.

    The algorithms: random, ga, afpo, islands (a race of populations), nsga2 (several objectives) and map-elites (an
    archive by measures) are for bodies and brains; cma, es, cma-me (an archive) and neat (the network's shape too) for
    the brain of one creature.

    Ctrl-C leaves a run that `nmes evolve resume` goes on with, and says so.

    Exit status: 0 the budget is spent, 1 it was interrupted, 2 wrong usage.

    For example:

    \b
        nmes evolve random --task walk --algorithm ga --budget 2000 --seed 1 -o runs/first
        nmes evolve walker --algorithm cma --budget 600 --set sigma=0.2
        nmes evolve random --algorithm map-elites --measure 'legs from 0 to 10 in 10' --measure 'mass from 0 to 50'
        nmes evolve random --algorithm nsga2 --objective distance --objective -energy
        nmes evolve random --task sumo --budget 2000
        nmes evolve random walker --task chase --populations hunter,prey --budget 2000
        nmes evolve --settings mine.json -o runs/mine
    """
    from nmes.evolution.run import Run
    from nmes.evolution.run_folder import require_no_run
    from nmes.evolution.run_settings import RunSettings

    check_pool(options["jobs"], options["ray"])
    try:
        document = _from_options(options) if settings is None else _from_file(context, settings)
        judged = RunSettings.read(document)
    except DocumentError as error:
        raise click.UsageError(error.message if settings is None else f"{settings}:\n{error.message}") from error
    require_own_name(judged.task, options["task"] if settings is None else str(settings))
    folder = output or Path("runs", f"{judged.task.name}-{judged.algorithm}-{judged.seed}")
    require_no_run(folder)  # before a cluster is asked for
    go_on(lambda: Run.create(folder, judged), options["jobs"], options["ray"], options["as_json"])


def _from_file(context: click.Context, settings: Path) -> Any:
    """Reads a settings file, beside which nothing else may say what the run is."""
    from nmes.evolution.run_folder import read_settings

    used = {name for name in context.params if context.get_parameter_source(name) is ParameterSource.COMMANDLINE}
    if used - _BESIDE:
        raise click.UsageError("--settings says all of the run: only -o, --jobs, --ray and --json go with it")
    try:
        return read_settings(settings)
    except OSError as error:
        raise click.UsageError(f"cannot read {settings}: {error.strerror}") from error


def _from_options(options: dict[str, Any]) -> dict[str, Any]:
    """Returns the settings that arguments and options mean, as a document."""
    what: Sequence[str] = options["what"]
    if not what:
        raise click.UsageError("say where to begin: `random`, or genomes; or give --settings")
    roles = _populated(options["task"], options["populations"])
    document = {
        "format": _FORMAT,
        "task": options["task"],
        "algorithm": options["algorithm"],
        "options": read_values(options["options"]),
        "seed": options["seed"],
        "budget": options["budget"],
        "objectives": list(options["objectives"]),
        "measures": [_measure(text) for text in options["measures"]],
        **({"populations": _populations(what, roles)} if roles else {"starts": _starts(what)}),
    }
    return document if options["seeds"] is None else {**document, "seeds": list(options["seeds"])}


def _populated(task: str, given: Sequence[str] | None) -> Sequence[str]:
    """Returns the roles that have a population; none where the task has no roles and none are given.

    Raises:
        DocumentError: There is no such task.
    """
    from nmes.evaluation.match_task import MatchTask, load_task
    from nmes.evolution.coevolution import default_roles

    if given is not None:
        return given
    try:
        loaded = load_task(task)
    except DocumentError:
        return ()  # what is wrong with it is told with all else
    return default_roles(loaded) if isinstance(loaded, MatchTask) else ()


def _populations(what: Sequence[str], roles: Sequence[str]) -> list[dict[str, Any]]:
    """Returns the populations: each begins with a WHAT of its own, or all with the only one; a single one with all."""
    if len(roles) == 1:
        return [{"role": roles[0], "starts": _starts(what)}]
    if len(what) not in (1, len(roles)):
        raise click.UsageError(f"say WHAT once for all populations, or once for each of {', '.join(roles)}")
    starts = [_starts([each]) for each in what]
    return [{"role": role, "starts": starts[place % len(starts)]} for place, role in enumerate(roles)]


def _starts(what: Sequence[str]) -> list[Any]:
    """Returns the genomes to begin with; none for random ones."""
    if "random" in what and len(what) > 1:
        raise click.UsageError("either `random` or genomes")
    return [] if "random" in what else find_genomes(what)


def _measure(text: str) -> dict[str, Any]:
    """Reads `EXPR from LOW to HIGH in CELLS`; without the last, there are 50."""
    found = _MEASURE.fullmatch(text)
    try:
        if found is None:
            raise ValueError
        expression, low, high, cells = found.groups()
        bounds = float(low), float(high)
        if not all(map(isfinite, bounds)):
            raise ValueError
    except ValueError:
        message = f"{text!r} is not of the form EXPR from LOW to HIGH in CELLS, such as 'legs from 0 to 10 in 10'"
        raise click.BadParameter(message, param_hint="--measure") from None
    return {"expression": expression, "low": bounds[0], "high": bounds[1], "cells": int(cells or _CELLS)}
