"""`nmes tournament`: every creature plays every other on a task with roles, and a table with ratings comes of it."""

from __future__ import annotations

import shlex
import signal
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from nmes.cli._eval_matches import read_creature
from nmes.cli._genomes import find_genomes
from nmes.cli._interruptions import interruptions
from nmes.cli._json import print_json
from nmes.cli._pool import JOBS
from nmes.cli._progress import QUIET, progress_bars
from nmes.cli._seeds import read_seeds
from nmes.cli._tasks import require_own_name
from nmes.errors import DocumentError, visible
from nmes.evaluation import MatchTask
from nmes.evaluation.parallel import open_pool
from nmes.evaluation.tournament import Standing, Tournament
from nmes.schemas.documents import JsonObject

__all__ = ["command"]


@click.command("tournament")
@click.argument("genomes", metavar="GENOME...", nargs=-1, required=True)
@click.option("--task", metavar="T", required=True, help="A task with roles: a file, or the name of one that ships.")
@click.option("--seeds", metavar="LIST", callback=read_seeds, help="Such as 1,2,3 or 0-9.  [default: the task's]")
@click.option(
    "-o",
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    help="Keep every match and its recording in this folder; skip what it has.",
)
@JOBS
@click.option("--json", "as_json", is_flag=True, help="Print the table and all matches as JSON.")
@QUIET
def command(
    genomes: tuple[str, ...],
    task: str,
    seeds: tuple[int, ...] | None,
    output: Path | None,
    jobs: int | None,
    as_json: bool,
) -> None:
    """Have creatures play each other, and rate them.

    GENOME is a file, a directory of them, a pattern, or the name of a genome that ships. Every group of creatures plays
    once a seed in as many ways as there are roles, so that each is in each role. The higher score wins; scores that
    differ by no more than the task's margin are a draw. The table is the same whatever --jobs says, and however often
    it was stopped.

    Skill is a rating by the Plackett-Luce model; creatures are in the order of what it is beyond doubt: less three
    standard deviations.

    Ctrl-C stops it; with -o the same command goes on, and every match is kept with its recording, which nmes eval
    --from-recording scores again.

    Exit status: 0 good, 1 it was stopped, or a creature may not play, 2 wrong usage.

    For example:

    \b
        nmes tournament creatures --task sumo
        nmes tournament walker seeker roller --task chase -o cup --json
    """
    tournament = Tournament(_task(task), [read_creature(name) for name in find_genomes(genomes)], seeds)
    stopped = False
    try:
        with (
            progress_bars() as progress,
            interruptions(signal.SIGINT, signal.SIGTERM) as interrupted,
            open_pool(jobs) as pool,
        ):
            for _ in tournament.play(pool, output, partial(progress, "playing")):
                if interrupted():
                    raise KeyboardInterrupt
    except KeyboardInterrupt:
        stopped = True
    if as_json:
        _print_json(tournament)
    else:
        _print_table(tournament, tournament.standings())
    if stopped:
        click.echo(f"stopped: {len(tournament.results):,} of {len(tournament.pairings):,} matches played", err=True)
        if output is not None:
            click.echo(visible(f"go on with: nmes {shlex.join(sys.argv[1:])}"), err=True)
    sys.exit(1 if stopped else 0)


def _task(name: str) -> MatchTask:
    try:
        task = MatchTask.load(name)
    except DocumentError as error:
        raise click.BadParameter(f"{visible(name)}:\n{error.message}", param_hint="--task") from error
    require_own_name(task, name)
    return task


def _print_json(tournament: Tournament) -> None:
    matches = [_match(tournament, number) for number in sorted(tournament.results)]
    task, standings = tournament.task, [standing.to_json() for standing in tournament.standings()]
    print_json({"task": task.name, "task_hash": task.hash, "standings": standings, "matches": matches})


def _match(tournament: Tournament, number: int) -> JsonObject:
    """Returns a match as plain data."""
    pairing, match = tournament.pairings[number], tournament.results[number]
    genomes = (tournament.genomes[player] for player in pairing.players)
    roles = {
        role: {"genome": genome.name, "genome_hash": genome.hash, **result.to_json()}
        for genome, (role, result) in zip(genomes, match.results.items(), strict=True)
    }
    return {"seed": pairing.seed, "roles": roles, "recording": match.recording}


def _print_table(tournament: Tournament, standings: Sequence[Standing]) -> None:
    table = Table("", "genome", box=None, pad_edge=False)
    table.columns[1].overflow, table.columns[1].min_width = "fold", 12
    for title in ("beyond\ndoubt", "skill", "won, drawn,\nlost", "void"):
        table.add_column(title, justify="right", no_wrap=True)
    for role in tournament.task.roles:
        table.add_column(f"score as\n{role}", justify="right", no_wrap=True)
    for place, each in enumerate(standings, start=1):
        rating, counts = each.rating, f"{each.wins}, {each.draws}, {each.losses}"
        skill = f"{rating.skill:.2f} ± {rating.doubt:.2f}"
        scores = ("-" if score is None else f"{score:.3f}" for score in each.score.values())
        table.add_row(
            str(place), visible(each.genome), f"{rating.sure:.2f}", skill, counts, str(each.void or ""), *scores
        )
    console = Console(markup=False, highlight=False)
    console.print(table)
    _print_faults(console, tournament)


def _print_faults(console: Console, tournament: Tournament) -> None:
    """Prints who has lost by rule, and which matches were void."""
    for number in sorted(tournament.results):
        pairing, match = tournament.pairings[number], tournament.results[number]
        for player, (role, result) in zip(pairing.players, match.results.items(), strict=True):
            if result.fault is not None:
                what = f"{tournament.genomes[player].name} as {role}, seed {pairing.seed}: {result.fault}"
                console.print(visible(what), soft_wrap=True)
