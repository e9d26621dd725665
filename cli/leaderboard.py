"""`nmes leaderboard`: scores, each proved by a recording that was run again here."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click
import orjson

from nmes.cli._progress import progress_bars
from nmes.errors import NmesError
from nmes.evaluation.leaderboard import Entry, Leaderboard

if TYPE_CHECKING:
    from nmes.evaluation import Proof

__all__ = ["command"]

_FILE = click.Path(dir_okay=False, path_type=Path)


@click.group("leaderboard")
def command() -> None:
    """Keep a list of scores that are proved.

    FILE is a SQLite file; the recordings that prove its entries lie beside it, in a folder of its name with the ending
    .recordings.
    """


def _open(file: Path, *, create: bool = False) -> Leaderboard:
    """Opens the leaderboard that an argument names; what is none is wrong usage."""
    try:
        return Leaderboard(file, create=create)
    except NmesError as error:
        raise click.UsageError(error.message) from error


@command.command()
@click.argument("file", metavar="FILE", type=_FILE)
@click.argument(
    "recordings", metavar="RECORDING...", nargs=-1, required=True, type=click.Path(exists=True, dir_okay=False)
)
@click.option("--author", help="Whose creatures these are.  [default: whom the genome names]")
@click.option("--json", "as_json", is_flag=True, help="Print what was listed as JSON.")
def add(file: Path, recordings: tuple[str, ...], author: str | None, as_json: bool) -> None:
    """List what recordings prove.

    The recordings are those that `nmes eval --record` left, one for each seed of the task. They are replayed and scored
    here, with the brain run beside them: one in which anything comes out otherwise is refused, with the first frame
    at which it does. FILE is made if it is not there.

    Exit status: 0 all are listed, 1 one was refused, 2 wrong usage.

    For example:

    \b
        nmes leaderboard add board.sqlite proofs/*.mcap --author Ada
    """
    from nmes.evaluation import prove  # here and below: what only some of the subcommands need takes long to load

    board = _open(file, create=True)
    groups: dict[tuple[str, str], list[Proof]] = {}
    refused = 0
    for path in recordings:
        try:
            proof = prove(path, brain=True)
            groups.setdefault((proof.task.hash, proof.genome.hash), []).append(proof)
        except NmesError as error:
            refused += 1
            click.echo(f"refused: {error.message}", err=True)
    listed: list[Entry] = []
    for proofs in groups.values():
        try:
            entry = board.add(proofs, author)
        except NmesError as error:
            refused += 1
            click.echo(f"refused: {error.message}", err=True)
            continue
        listed.append(entry)
        if not as_json:
            click.echo(f"listed: {entry.name} ({entry.genome_hash[:12]}), task {entry.task}, score {entry.score:.6g}")
    if as_json:
        click.echo(orjson.dumps([entry.to_json() for entry in listed], option=orjson.OPT_INDENT_2))
    sys.exit(1 if refused else 0)


@command.command()
@click.argument("file", metavar="FILE", type=_FILE)
@click.option("--task", metavar="T", help="Only this task's entries.")
@click.option("--top", type=click.IntRange(1), help="Only so many of each task.")
@click.option("--refused", is_flag=True, help="Also entries of which the proof did not hold when it was verified.")
@click.option("--json", "as_json", is_flag=True, help="Print the entries as JSON.")
def show(file: Path, task: str | None, top: int | None, refused: bool, as_json: bool) -> None:
    """Show the entries, task by task, the highest score first.

    For example:

    \b
        nmes leaderboard show board.sqlite --task walk --top 10
    """
    entries = _open(file).entries(task=task, top=top, refused=refused)
    if as_json:
        click.echo(orjson.dumps([entry.to_json() for entry in entries], option=orjson.OPT_INDENT_2))
    else:
        click.echo("\n".join(_lines(entries)))


def _lines(entries: list[Entry]) -> list[str]:
    """Lays the entries out in columns."""
    # By hand: a table of rich takes seconds for what is here a moment, where there are thousands.
    head = ("task", "", "score", "genome", "hash", "author", "recording", "added")
    rows = [head]
    rank, of = 0, ""
    for entry in entries:
        rank, of = (rank + 1 if entry.task_hash == of else 1), entry.task_hash
        name = entry.name if entry.refused is None else f"{entry.name} (refused: {entry.refused})"
        rows.append(
            (
                f"{entry.task} {of[:6]}",
                str(rank),
                f"{entry.score:.6g}",
                name,
                entry.genome_hash[:12],
                entry.author,
                entry.recording_hash[:12],
                entry.added[:10],
            )
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    right = (1, 2)
    return [
        "  ".join(
            cell.rjust(width) if i in right else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


@command.command()
@click.argument("file", metavar="FILE", type=_FILE)
@click.option("--jobs", type=click.IntRange(1), help="How many processes.  [default: one a core]")
@click.option("--json", "as_json", is_flag=True, help="Print what was found as JSON.")
def verify(file: Path, jobs: int | None, as_json: bool) -> None:
    """Run every entry's recording again, and compare.

    An entry of which the recording is gone or changed, or does not come out as recorded, or proves another score than
    the one listed, is refused: it is no longer shown, until it holds again.

    Exit status: 0 all hold, 1 one does not, 2 wrong usage.

    For example:

    \b
        nmes leaderboard verify board.sqlite --jobs 4
    """
    board = _open(file)
    total = len(board.entries(refused=True))
    verdicts: list[tuple[Entry, str | None]] = []
    with progress_bars(total > 1) as progress:
        progress("verifying", 0, total)
        for each in board.verify(jobs=jobs or os.cpu_count() or 1):
            verdicts.append(each)
            progress("verifying", len(verdicts), total)
    verdicts.sort(key=lambda each: each[0].id)
    bad = [(entry, refused) for entry, refused in verdicts if refused is not None]
    if as_json:
        rows = [
            {"id": entry.id, "name": entry.name, "task": entry.task, "refused": refused} for entry, refused in verdicts
        ]
        click.echo(orjson.dumps(rows, option=orjson.OPT_INDENT_2))
    else:
        for entry, refused in bad:
            click.echo(f"refused: {entry.name} ({entry.genome_hash[:12]}), task {entry.task}: {refused}")
        click.echo(f"{total - len(bad):,} of {total:,} entries hold")
    sys.exit(1 if bad else 0)


@command.command()
@click.argument("file", metavar="FILE", type=_FILE)
@click.option("-o", "--output", required=True, type=_FILE, help="The page, an .html file.")
@click.option("--task", metavar="T", help="Only this task's entries.")
@click.option("--top", type=click.IntRange(1), default=50, show_default=True, help="So many of each task.")
def export(file: Path, output: Path, task: str | None, top: int) -> None:
    """Write the entries as a page for a browser: one file, with a picture of each creature.

    For example:

    \b
        nmes leaderboard export board.sqlite -o board.html --top 100
    """
    from nmes.evaluation.leaderboard_page import write_page

    count = write_page(_open(file), output, task=task, top=top)
    click.echo(f"{output}: {count:,} {'entry' if count == 1 else 'entries'}")
