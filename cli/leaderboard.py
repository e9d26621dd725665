"""`nmes leaderboard`: scores, each proved by a recording that was run again here."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import click

from nmes.cli._columns import columns
from nmes.cli._json import print_json
from nmes.cli._output import whole_file
from nmes.cli._pool import JOBS
from nmes.cli._progress import QUIET, progress_bars
from nmes.cli._tasks import borrowed_names
from nmes.errors import DocumentError, NmesError, visible
from nmes.evaluation.leaderboard import Leaderboard
from nmes.evaluation.match_task import MatchTask, load_task
from nmes.evaluation.task import Task

if TYPE_CHECKING:
    from nmes.evaluation.leaderboard_entry import AnyProof, Entry, Verdict
    from nmes.evaluation.leaderboard_pack import Pack

__all__ = ["command"]

_FILE = click.Path(dir_okay=False, path_type=Path)


@click.group("leaderboard")
def command() -> None:
    """Keep a list of scores that are proved.

    FILE is a SQLite file; the recordings that prove its entries lie beside it, in a folder of its name with the ending
    .recordings.
    """


def _open(file: Path, *, create: bool = False) -> Leaderboard:
    """Opens the leaderboard that an argument names, until the command ends; what is none is wrong usage."""
    try:
        return click.get_current_context().with_resource(Leaderboard(file, create=create))
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
        for line in borrowed_names({digest: name for name, digest in listed}):
            click.echo(visible(line))


def _task(name: str) -> Task | MatchTask:
    try:
        return load_task(name)
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

    The recordings are those that `nmes eval --record` left, one for each seed of the task; of a task with roles, those
    of all matches of the same creatures. They are replayed and scored here, the brains run beside them: one in which
    anything comes out otherwise is refused, with the first frame at which it does. The author is whom the genome names;
    who has signed all of the recordings (nmes sign) is shown beside it, and from then on nobody else is listed under
    that name. FILE is made if it is not there.

    Exit status: 0 all are listed, 1 one was refused, 2 wrong usage, 3 none was refused, but one does not come out the
    same on this machine.

    For example:

    \b
        nmes leaderboard add board.sqlite proofs/*.mcap
    """
    from nmes.evaluation.leaderboard_entry import group

    listing = _Listing(_open(file, create=True), as_json)
    groups: dict[tuple[str, ...], list[AnyProof]] = {}
    for path in recordings:
        try:
            proof = listing.board.prove(path)
            groups.setdefault(group(proof), []).append(proof)
        except (NmesError, OSError) as error:
            listing.refuse(error)
    for proofs in groups.values():
        try:
            listing.add(proofs)
        except NmesError as error:
            listing.refuse(error)
    if as_json:
        print_json([entry.to_json() for entry in listing.entries])
    sys.exit(listing.status)


class _Listing:
    """What becomes of entries that are to be listed: said as it happens, but for JSON only what is refused."""

    def __init__(self, board: Leaderboard, as_json: bool) -> None:
        self.board, self._as_json = board, as_json
        self.entries: list[Entry] = []
        self._refusals: list[str] = []

    def refuse(self, error: Exception) -> None:
        """Says why something is not listed."""
        self._refusals.append(error.code if isinstance(error, NmesError) else "")
        click.echo(f"refused: {visible(str(error))}", err=True)

    def add(self, proofs: Sequence[AnyProof], *, allow: bool = False) -> None:
        """Lists what proofs prove, on a task that is not taken yet if that is allowed."""
        entry = self.board.add(proofs, allow=allow)
        self.entries.append(entry)
        self.say(f"listed: {entry.title} ({entry.genome_hash[:16]}), task {entry.task}, score {entry.score:.6g}")

    def say(self, line: str) -> None:
        """Says something that is not for JSON."""
        if not self._as_json:
            click.echo(visible(line))

    @property
    def status(self) -> int:
        """The exit status."""
        return 0 if not self._refusals else 3 if set(self._refusals) == {"not_comparable"} else 1


@command.command("pack")
@click.argument("file", metavar="FILE", type=_FILE)
@click.option("-o", "--output", required=True, type=_FILE, help="The packed leaderboard: a .zip file.")
@click.option("--task", metavar="T", help="Only this task's entries.")
@click.option("--top", type=click.IntRange(1), help="Only so many of each task.")
def pack_entries(file: Path, output: Path, task: str | None, top: int | None) -> None:
    """Write entries and what proves them to one file, for others to import and verify.

    It holds the recordings of the entries and their signatures, and no score: who imports it computes that again.

    For example:

    \b
        nmes leaderboard pack board.sqlite -o board.zip
        nmes leaderboard pack board.sqlite --task walk --top 10 -o best.zip
    """
    from nmes.evaluation.leaderboard_pack import pack

    board = _open(file)
    with whole_file(output, file, *board.recordings.glob("*")) as unfinished:
        count = pack(board, unfinished, task=task, top=top)
    click.echo(f"{visible(str(output))}: {_entries(count)}")


@command.command("import")
@click.argument("file", metavar="FILE", type=_FILE)
@click.argument("packed", metavar="PACKED", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--allow", is_flag=True, help="Take the tasks of its entries too, where FILE does not yet.")
@click.option("--json", "as_json", is_flag=True, help="Print what was listed as JSON.")
def import_entries(file: Path, packed: Path, allow: bool, as_json: bool) -> None:
    """List the entries of a packed leaderboard, each proved here first.

    PACKED is what `nmes leaderboard pack` wrote. Its recordings are run again and scored as by `add`; an entry that
    does not hold is refused, and does not stop the others. What is listed already is left as it is. FILE is made if it
    is not there.

    Exit status: 0 all are listed, 1 one was refused, 2 wrong usage, 3 none was refused, but one does not come out the
    same on this machine.

    For example:

    \b
        nmes leaderboard import board.sqlite theirs.zip
        nmes leaderboard import board.sqlite theirs.zip --allow
    """
    from nmes.evaluation.leaderboard_pack import Pack

    try:
        opened = Pack(packed)
    except NmesError as error:
        raise click.UsageError(error.message) from error
    with opened, progress_bars(len(opened.entries) > 1) as progress:
        listing = _Listing(_open(file, create=True), as_json)
        known = {entry.recordings for entry in listing.board.entries()}  # one that is broken makes room
        for done, recordings in enumerate(opened.entries):
            progress("proving", done, len(opened.entries))
            if recordings not in known:
                _import(listing, opened, recordings, allow)
    listing.say(f"{_entries(len(listing.entries))} of {len(opened.entries):,} new to {file}")
    if as_json:
        print_json([entry.to_json() for entry in listing.entries])
    sys.exit(listing.status)


def _import(listing: _Listing, packed: Pack, recordings: tuple[str, ...], allow: bool) -> None:
    """Lists one entry of a packed leaderboard, if it holds."""
    from nmes.evaluation.leaderboard_entry import proved

    with TemporaryDirectory() as folder:
        try:
            prove = proved if allow else listing.board.prove
            proofs = [prove(path) for path in packed.extract(recordings, Path(folder))]
            listing.add(proofs, allow=allow)
        except (NmesError, OSError) as error:
            if getattr(error, "code", "") == "already_listed":
                listing.say(str(error))
            else:
                listing.refuse(error)


def _entries(count: int) -> str:
    return f"{count:,} {'entry' if count == 1 else 'entries'}"


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


@command.command()
@click.argument("file", metavar="FILE", type=_FILE)
@click.option("--task", metavar="T", help="Only of this task.")
@click.option("--json", "as_json", is_flag=True, help="Print the ratings as JSON.")
def ratings(file: Path, task: str | None, as_json: bool) -> None:
    """Rate the creatures that have met: who won how often, and the skill that this shows.

    It is about the matches of all entries on tasks with roles in which somebody can be better than another. Ratings are
    as of `nmes tournament`, which has everybody play everybody: here only listed matches count.

    For example:

    \b
        nmes leaderboard ratings board.sqlite --task sumo
    """
    from nmes.evaluation.leaderboard_ratings import rated

    found = rated(_open(file).entries(task=task))
    if as_json:
        print_json([each.to_json() for each in found])
        return
    rows: list[tuple[str, ...]] = [("task", "", "creature", "beyond doubt", "skill", "matches", "won", "drawn", "lost")]
    rank, of = 0, ""
    for each in found:
        rank, of = (rank + 1 if each.task_hash == of else 1), each.task_hash
        told = (f"{each.rating.sure:.2f}", f"{each.rating.skill:.2f} ± {each.rating.doubt:.2f}")
        counts = (str(count) for count in (each.matches, each.wins, each.draws, each.losses))
        rows.append((visible(f"{each.task} {of[:16]}"), str(rank), visible(each.name), *told, *counts))
    click.echo("\n".join(columns(rows, right=(1, 3, 4, 5, 6, 7, 8))))


def _lines(entries: list[Entry], units: dict[str, str]) -> list[str]:
    """Lays the entries out in columns."""
    rows = [("task", "", "score", "", "spread", "genome", "hash", "author", "recording", "recorded")]
    rank, of = 0, ""
    for entry in entries:
        rank, of = (rank + 1 if entry.task_hash == of else 1), entry.task_hash
        name = entry.title if entry.broken is None else f"{entry.title} (broken: {entry.broken})"
        rows.append(
            (
                visible(f"{entry.task_title} {of[:16]}"),
                str(rank),
                f"{entry.score:.6g}",
                visible(units[entry.task_hash]),
                f"{entry.spread:.3g}",
                visible(name),
                entry.genome_hash[:16],
                visible(entry.signed_author),
                entry.recording_hash[:16],
                visible(entry.recorded[:10]),
            )
        )
    return columns(rows, right=(1, 2, 3))


@command.command()
@click.argument("file", metavar="FILE", type=_FILE)
@click.argument("entries", metavar="[ENTRY]...", type=click.IntRange(1), nargs=-1)
@JOBS
@click.option("--write", is_flag=True, help="Mark what is broken in FILE; what was marked and holds is listed again.")
@click.option("--json", "as_json", is_flag=True, help="Print the verdicts as JSON.")
@QUIET
def verify(file: Path, entries: tuple[int, ...], jobs: int | None, write: bool, as_json: bool) -> None:
    """Run every entry's recordings again, and compare all that it says.

    Of those entries alone whose numbers are given, as `show --json` tells them.

    An entry is broken if its recordings are gone or changed, do not come out as recorded, are not one for each seed of
    a task that FILE takes, or prove anything else than is listed. It could not be judged here if that may be this
    machine's doing: another processor, a missing engine, a disk, a process that was killed. Each is judged by itself.

    Exit status: 0 all hold, 1 one is broken, 2 wrong usage, 3 none is broken, but one could not be judged.

    For example:

    \b
        nmes leaderboard verify board.sqlite --jobs 4
        nmes leaderboard verify board.sqlite --write
        nmes leaderboard verify board.sqlite 3 7
    """
    board = _open(file)
    only = frozenset(entries) or None
    total = len(board) if only is None else len(only)
    verdicts: list[Verdict] = []
    with progress_bars(total > 1) as progress:
        progress("verifying", 0, total)
        for each in board.verify(jobs=jobs or os.cpu_count() or 1, only=only):
            verdicts.append(each)
            progress("verifying", len(verdicts), total)
    verdicts.sort(key=lambda each: each.id)
    if missing := (only or frozenset()) - {each.id for each in verdicts}:
        raise click.UsageError(f"{file} has no entry {', '.join(map(str, sorted(missing)))}")
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
    """Write the entries as a page for a browser: one file, with a picture of each creature, and a film of the best.

    It links to the recordings beside FILE, and says how to check them.

    For example:

    \b
        nmes leaderboard export board.sqlite -o board.html --top 100
    """
    from nmes.view.leaderboard_page import write_page

    board = _open(file)
    with whole_file(output, file, *board.recordings.glob("*")) as page, progress_bars() as progress:
        count = write_page(board, page, task=task, top=top, progress=progress)
    click.echo(f"{visible(str(output))}: {_entries(count)}")
