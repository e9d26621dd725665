"""`nmes evolve best`: a candidate of a run with the proof of its score."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from nmes.cli._json import print_json
from nmes.cli._proof_files import check_place, write_documents
from nmes.cli._tasks import borrowed_names
from nmes.errors import RunError, visible
from nmes.schemas.documents import JsonObject

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    from nmes.evaluation import Evaluation
    from nmes.evaluation.setting import Setting
    from nmes.evolution.run import Run

__all__ = ["command"]


def _cell(_: click.Context, parameter: click.Parameter, value: str | None) -> tuple[int, ...] | None:
    """Reads `3,4`."""
    if value is None or re.fullmatch(r"\d{1,5}(,\d{1,5})*", value):
        return None if value is None else tuple(map(int, value.split(",")))
    raise click.BadParameter("expected a number a measure, counted from 0: 3,4", param=parameter)


@click.command("best")
@click.argument("folder", metavar="RUN", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="FOLDER",
    help="Where to write it.  [default: best-INDEX in RUN]",
)
@click.option("--index", type=click.IntRange(min=0), help="This candidate, instead of the best.")
@click.option("--cell", "place", callback=_cell, metavar="I,J", help="The elite in this cell of the archive.")
@click.option(
    "--sign",
    "key",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    metavar="KEY",
    help="Sign the recordings: an Ed25519 private key, PEM without a passphrase.",
)
@click.option("--json", "as_json", is_flag=True, help="Print what was written as JSON.")
def command(
    folder: Path,
    output: Path | None,
    index: int | None,
    place: tuple[int, ...] | None,
    key: Path | None,
    as_json: bool,
) -> None:
    """Write the best of a run: its genome, and the recordings that prove its score.

    It is run again, and every figure must be that of the log. Then there are its genome, a recording of each episode,
    and the line that lists it on a leaderboard. With --index or --cell it is another candidate than the best. A folder
    that holds a run, another genome or task, or a recording that is signed, is refused.

    Of a run of several populations it is the champion of each, in a folder of its own, with its matches against those
    whom it met in the run.

    For example:

    \b
        nmes evolve best runs/walk-ga-1
        nmes evolve best runs/walk-ga-1 -o champion --sign ada.pem
        nmes evolve best runs/walk-map-elites-1 --cell 3,4
    """
    from nmes.evolution.run import Run
    from nmes.recording.signing import private_key

    run = Run.open(folder)
    signing = None if key is None else private_key(key)
    targets = [
        (chosen, output / part if output else folder / f"best-{chosen}")
        for part, chosen in _chosen(run, index, place).items()
    ]
    for chosen, target in targets:
        check_place(target, _documents(run, chosen))
    written = [_written(run, chosen, target, signing) for chosen, target in targets]
    if as_json:
        print_json(written if run.settings.populations and index is None else written[0])
    else:
        for told in written:
            _print(told)
        for line in borrowed_names({run.settings.task.hash: run.settings.task.name}):
            click.echo(line)


def _written(run: Run, chosen: int, target: Path, signing: Ed25519PrivateKey | None) -> dict[str, Any]:
    """Writes a candidate into a folder, and returns what was written, as plain data."""
    from nmes.evolution.rerun import record_candidate
    from nmes.recording import Recording
    from nmes.recording.signing import sign

    target.mkdir(parents=True, exist_ok=True)
    task = run.settings.task
    seeds = tuple(dict.fromkeys([*run.settings.seeds, *task.seeds]))
    found = record_candidate(run, chosen, target, seeds)
    files = write_documents(target, _documents(run, chosen))
    recordings = list(dict.fromkeys(found.recordings))
    return {
        "index": chosen,
        "score": run.records[chosen].score,
        "files": [str(path) for path in files],
        "recordings": recordings,
        "signatures": [] if signing is None else [str(sign(Recording(path), signing)) for path in recordings],
        "leaderboard": [] if run.settings.populations else _leaderboard_lines(run.settings.task, target, found),
    }


def _documents(run: Run, chosen: int) -> dict[str, JsonObject]:
    """Returns the documents to be written beside the recordings of a candidate, by the names of their files."""
    from nmes.evaluation.identity import shipped_hash

    task, genome = run.settings.task, run.genome(chosen)
    own = {} if task.hash == shipped_hash(task.name) else {"task.json": task.document}
    return {"genome.json": genome.document, **own}


def _chosen(run: Run, index: int | None, place: tuple[int, ...] | None) -> dict[str, int]:
    """Returns the indices of the candidates that are asked for, which have scores, by what each adds to a folder.

    Raises:
        UsageError: There is no such candidate.
        RunError: None has a score, or that one has none (`no_score`).
    """
    if index is not None and place is not None:
        raise click.UsageError("either --index or --cell")
    if index is not None and index >= len(run):
        raise click.UsageError(f"there is no candidate {index}: the run has {len(run):,}")
    if place is not None:
        index = _elite(run, place)
    if index is None:
        best = {"": run.best} if run.best is not None else run.champions()
        if not best:
            raise RunError("no_score", f"no candidate of {run.folder} has a score")
        return {part: record.index for part, record in best.items()}
    if run.records[index].score is None:
        raise RunError("no_score", f"candidate {index} of {run.folder} has no score: {run.records[index].error}")
    return {"": index}


def _elite(run: Run, place: tuple[int, ...]) -> int:
    """Returns the index of the elite in a cell."""
    from nmes.evolution.archive import cell

    measures = run.settings.measures
    if len(place) != len(measures) or any(at >= each.cells for at, each in zip(place, measures, strict=True)):
        sizes = " x ".join(str(measure.cells) for measure in measures) or "no"
        raise click.UsageError(f"there is no such cell: the archive has {sizes} cells, counted from 0")
    for index in run.elites():
        if cell(measures, run.records[index].measures) == place:
            return index
    raise click.UsageError(f"the cell {','.join(map(str, place))} is empty")


def _leaderboard_lines(task: Setting, folder: Path, found: Evaluation) -> list[str]:
    """Returns the commands that list a creature on a leaderboard."""
    from nmes.evaluation.identity import shipped_hash

    paths = dict(zip((result.seed for result in found.results), found.recordings, strict=True))
    lines = [["nmes", "leaderboard", "add", "board.sqlite", *(paths[seed] for seed in task.seeds)]]
    if task.hash != shipped_hash(task.name):
        lines.insert(0, ["nmes", "leaderboard", "tasks", "board.sqlite", "--allow", str(folder / "task.json")])
    return [shlex.join(line) for line in lines]


def _print(told: Mapping[str, Any]) -> None:
    click.echo(f"candidate {told['index']}: score {told['score']:.6g}, again as the log says")
    for path in (*told["files"], *told["recordings"], *told["signatures"]):
        click.echo(visible(f"wrote {path}"))
    if told["leaderboard"]:
        click.echo("to list it on a leaderboard:")
    for line in told["leaderboard"]:
        click.echo(visible(f"  {line}"))
