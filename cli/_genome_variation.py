"""`nmes genome mutate` and `cross`: genomes that are made of others, one at a time or many."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click

from nmes.cli._genomes import load_genome, write_genome
from nmes.cli._json import print_json
from nmes.cli._output import check_output
from nmes.errors import DocumentError, VariationError, visible
from nmes.genome import Genome
from nmes.schemas.documents import did_you_mean

if TYPE_CHECKING:
    from nmes.variation import Draw, Requirements

__all__ = ["cross", "mutate"]

Bred = TypeVar("Bred")

_seed = click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of all that is drawn.")
_count = click.option(
    "-n", "--count", type=click.IntRange(1, 100_000), default=1, show_default=True, help="How many to make."
)
_task = click.option(
    "--task", metavar="NAME|FILE", help="Make only what may take part in this task: a shipped one's name, or a file."
)
_role = click.option(
    "--role", metavar="ROLE", help="Which role of the task they are to play, where it has several that differ."
)
_output = click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="PATH",
    help="Write to a file; of many, to files in a directory. Else they are printed.",
)


@click.command("mutate")
@click.argument("file", metavar="GENOME")
@click.option(
    "--kind", metavar="KIND", help="What to change, such as add-part; drawn if left out. See docs/evolution.md."
)
@_task
@_role
@_seed
@_count
@_output
def mutate(
    file: str, kind: str | None, task: str | None, role: str | None, seed: int, count: int, output: Path | None
) -> None:
    """Change a genome a little: its body, and the brain along with it.

    What comes out is a good genome, and the same one for the same seed.

    For example:

    \b
        nmes genome mutate walker -o mutant.json
        nmes genome mutate walker --kind add-part --seed 7 --task walk -o mutant.json
        nmes genome mutate walker --task chase --role prey -o prey.json
        nmes genome mutate walker -n 20 -o mutants/
    """
    from nmes.variation import mutate as vary

    parent, needs = load_genome(file), _load_requirements(task, role)
    mutants = [_bred(lambda d: vary(parent, d, kind=kind, requirements=needs), seed, i) for i in range(count)]
    _write_bred([(mutant.genome, mutant.kind) for mutant in mutants], output, seed, (file,), task)


@click.command("cross")
@click.argument("first", metavar="GENOME")
@click.argument("second", metavar="GENOME")
@_task
@_role
@_seed
@_count
@_output
def cross(
    first: str, second: str, task: str | None, role: str | None, seed: int, count: int, output: Path | None
) -> None:
    """Breed two genomes: the child is mostly like the first, and has something of the second.

    For example:

    \b
        nmes genome cross walker roller -o child.json
        nmes genome cross centipede inchworm -n 10 --task walk -o children/
    """
    from nmes.variation import cross as breed

    one, other, needs = load_genome(first), load_genome(second), _load_requirements(task, role)
    children = [_bred(lambda d: breed(one, other, d, requirements=needs), seed, i) for i in range(count)]
    _write_bred([(child, f"cross with {other.name}") for child in children], output, seed, (first, second), task)


def _load_requirements(name: str | None, role: str | None) -> Requirements:
    """Returns the requirements of bodies that take part in a task, in a role if it has any; none where none is named.

    Raises:
        UsageError: The task has no such role, or it has several and none is named.
    """
    from nmes.variation import ANY

    if name is None:
        if role is not None:
            raise click.UsageError("--role is one of a task: name that with --task")
        return ANY
    from nmes.evaluation.match_task import MatchTask, load_task
    from nmes.evolution.coevolution import default_roles

    try:
        task = load_task(name)
    except DocumentError as error:
        raise click.ClickException(f"{visible(name)}:\n{error.message}") from error
    if not isinstance(task, MatchTask):
        if role is not None:
            raise click.UsageError(f"{visible(task.name)} has no roles")
        return task.requirements
    roles = default_roles(task) if role is None else (role,)
    if len(roles) > 1:
        raise click.UsageError(f"{visible(task.name)} has several roles: say --role {' or --role '.join(roles)}")
    if roles[0] not in task.roles:
        hint = did_you_mean(roles[0], task.roles) or f": there are {', '.join(task.roles)}"
        raise click.UsageError(visible(f"{task.name} has no role {roles[0]!r}{hint}"))
    return task.requirements(roles[0])


def _bred(breed: Callable[[Draw], Bred], seed: int, number: int) -> Bred:
    """Makes the genome of that number; every number has choices of its own."""
    from nmes.variation import Draw

    try:
        return breed(Draw(seed, "genome", number))
    except (DocumentError, VariationError) as error:
        raise click.ClickException(visible(error.message, keep="\n")) from error


def _write_bred(
    bred: list[tuple[Genome, str]], output: Path | None, seed: int, parents: tuple[str, ...], task: str | None
) -> None:
    """Prints genomes, or writes them to a file or to files of a directory, and says how each came about."""
    if output is None:
        for genome, _ in bred:
            print_json(genome.document)
        return
    targets = [output]
    if len(bred) > 1 or output.is_dir():
        names = "-".join(Path(name).name.removesuffix(".json") for name in parents)
        targets = [output / f"{names}-{seed}-{number}.json" for number in range(len(bred))]
    for target in targets:
        check_output(target, *parents, *([] if task is None else [task]))
    for target, (genome, how) in zip(targets, bred, strict=True):
        write_genome(target, genome.document)
        click.echo(f"wrote {visible(str(target))}: {visible(how)}")
