"""`nmes leaderboard`: scores, each proved by a recording that was run again here."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nmes.cli._columns import columns
from nmes.cli._json import print_json
from nmes.cli._output import whole_file
from nmes.cli._progress import QUIET, progress_bars
from nmes.errors import DocumentError, NmesError, visible
from nmes.evaluation.leaderboard import Leaderboard
from nmes.evaluation.task import Task

if TYPE_CHECKING:
    from nmes.evaluation import Proof
    from nmes.evaluation.leaderboard_entry import Entry, Verdict

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
@click.option("--allow", metavar="T", multiple=True, help="Take this one too: a file, or a name. May be repeated.")
@click.option("--json", "as_json", is_flag=True, help="Print the tasks as JSON.")
def tasks(file: Path, allow: tuple[str, ...], as_json: bool) -> None:
    """Show the tasks on which entries are taken, or allow others.

    These are the tasks that ship with the version that made FILE, and those that --allow has named. A task is known by
    its hash; one that has the name of a task that ships, but is another, is refused. With --allow, FILE is made if it
    is not there.

    For example:

    \b
        nmes leaderboard tasks board.sqlite
        nmes leaderboard tasks board.sqlite --allow mine.json
    """
    allowed = [_task(name) for name in allow]
    board = _open(file, create=bool(allow))
    for task in allowed:
        try:
            board.allow(task)
        except NmesError as error:
            raise click.BadParameter(error.message, param_hint="--allow") from error
    listed = board.tasks()
    if as_json:
        print_json([{"name": name, "hash": digest} for name, digest in listed])
    else:
        click.echo("\n".join(columns([(visible(name), visible(digest)) for name, digest in listed])))


def _task(name: str) -> Task:
    try:
        return Task.load(name)
    except DocumentError as error:
        raise click.BadParameter(f"{visible(name)}:\n{error.message}", param_hint="--allow") from error


@command.command()
@click.argument("file", metavar="FILE", type=_FILE)
@click.argument(
    "recordings", metavar="RECORDING...", nargs=-1, required=True, type=click.Path(exists=True, dir_okay=False)
)
@click.option("--json", "as_json", is_flag=True, help="Print what was listed as JSON.")
def add(file: Path, recordings: tuple[str, ...], as_json: bool) -> None:
    """List what recordings prove.

    The recordings are those that `nmes eval --record` left, one for each seed of the task. They are replayed and scored
    here, with the brain run beside them: one in which anything comes out otherwise is refused, with the first frame
    at which it does. The author is whom the genome names; who has signed all of the recordings (nmes sign) is shown
    beside it, and from then on nobody else is listed under that name. FILE is made if it is not there.

    Exit status: 0 all are listed, 1 one was refused, 2 wrong usage, 3 none was refused, but one does not come out the
    same on this machine.

    For example:

    \b
        nmes leaderboard add board.sqlite proofs/*.mcap
    """
    from nmes.evaluation import prove  # here and below: what only some of the subcommands need takes long to load

    board = _open(file, create=True)
    groups: dict[tuple[str, str], list[Proof]] = {}
    refusals: list[str] = []

    def refuse(error: Exception) -> None:
        refusals.append(error.code if isinstance(error, NmesError) else "")
        click.echo(f"refused: {visible(str(error))}", err=True)

    for path in recordings:
        try:
            proof = prove(path, brain=True)
            groups.setdefault((proof.task.hash, proof.genome.hash), []).append(proof)
        except (NmesError, OSError) as error:
            refuse(error)
    listed: list[Entry] = []
    for proofs in groups.values():
        try:
            entry = board.add(proofs)
        except NmesError as error:
            refuse(error)
            continue
        listed.append(entry)
        if not as_json:
            what = f"listed: {entry.name} ({entry.genome_hash[:16]}), task {entry.task}, score {entry.score:.6g}"
            click.echo(visible(what))
    if as_json:
        print_json([entry.to_json() for entry in listed])
    sys.exit(0 if not refusals else 3 if set(refusals) == {"not_comparable"} else 1)


@command.command()
@click.argument("file", metavar="FILE", type=_FILE)
@click.option("--task", metavar="T", help="Only this task's entries.")
@click.option("--top", type=click.IntRange(1), help="Only so many of each task.")
@click.option("--broken", is_flag=True, help="Also entries that `verify --write` has marked as broken.")
@click.option("--json", "as_json", is_flag=True, help="Print the entries as JSON.")
def show(file: Path, task: str | None, top: int | None, broken: bool, as_json: bool) -> None:
    """Show the entries, task by task, the highest score first.

    For example:

    \b
        nmes leaderboard show board.sqlite --task walk --top 10
    """
    board = _open(file)
    entries = board.entries(task=task, top=top, broken=broken)
    units = board.units(entries)
    if as_json:
        print_json([{**entry.to_json(), "unit": units[entry.task_hash]} for entry in entries])
    else:
        click.echo("\n".join(_lines(entries, units)))


def _lines(entries: list[Entry], units: dict[str, str]) -> list[str]:
    """Lays the entries out in columns."""
    rows = [("task", "", "score", "", "genome", "hash", "author", "recording", "recorded")]
    rank, of = 0, ""
    for entry in entries:
        rank, of = (rank + 1 if entry.task_hash == of else 1), entry.task_hash
        name = entry.name if entry.broken is None else f"{entry.name} (broken: {entry.broken})"
        rows.append(
            (
                visible(f"{entry.task_title} {of[:16]}"),
                str(rank),
                f"{entry.score:.6g}",
                visible(units[entry.task_hash]),
                visible(name),
                entry.genome_hash[:16],
                visible(entry.signed_author),
                entry.recording_hash[:16],
                visible(entry.recorded[:10]),
            )
        )
    return columns(rows, right=(1, 2))


@command.command()
@click.argument("file", metavar="FILE", type=_FILE)
@click.option("--jobs", type=click.IntRange(1), help="How many processes.  [default: one a core]")
@click.option("--write", is_flag=True, help="Mark what is broken in FILE; what was marked and holds is listed again.")
@click.option("--json", "as_json", is_flag=True, help="Print the verdicts as JSON.")
@QUIET
def verify(file: Path, jobs: int | None, write: bool, as_json: bool) -> None:
    """Run every entry's recordings again, and compare all that it says.

    An entry is broken if its recordings are gone or changed, do not come out as recorded, are not one for each seed of
    a task that FILE takes, or prove anything else than is listed. It could not be judged here if that may be this
    machine's doing: another processor, a missing engine, a disk, a process that was killed. Each is judged by itself.

    Exit status: 0 all hold, 1 one is broken, 2 wrong usage, 3 none is broken, but one could not be judged.

    For example:

    \b
        nmes leaderboard verify board.sqlite --jobs 4
        nmes leaderboard verify board.sqlite --write
    """
    board = _open(file)
    total = len(board)
    verdicts: list[Verdict] = []
    with progress_bars(total > 1) as progress:
        progress("verifying", 0, total)
        for each in board.verify(jobs=jobs or os.cpu_count() or 1):
            verdicts.append(each)
            progress("verifying", len(verdicts), total)
    verdicts.sort(key=lambda each: each.id)
    if as_json:
        print_json([each.to_json() for each in verdicts])
    else:
        _print_verdicts(verdicts)
    if write:
        board.mark(verdicts)
    found = {each.verdict for each in verdicts}
    sys.exit(1 if "broken" in found else 3 if "not_judged" in found else 0)


def _print_verdicts(verdicts: list[Verdict]) -> None:
    words = {"broken": "broken", "not_judged": "could not be judged here"}
    for each in verdicts:
        if each.verdict != "holds":
            click.echo(visible(f"{words[each.verdict]}: entry {each.id}, {each.name}, task {each.task}: {each.reason}"))
    counts = {verdict: sum(each.verdict == verdict for each in verdicts) for verdict in ("holds", *words)}
    rest = "".join(f", {counts[verdict]:,} {said}" for verdict, said in words.items() if counts[verdict])
    click.echo(f"{counts['holds']:,} of {len(verdicts):,} entries hold{rest}")


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

    board = _open(file)
    with whole_file(output, file, *board.recordings.glob("*")) as page:
        count = write_page(board, page, task=task, top=top)
    click.echo(f"{visible(str(output))}: {count:,} {'entry' if count == 1 else 'entries'}")
