"""`nmes evolve show`: what a run has come to."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from nmes.cli._columns import columns
from nmes.cli._json import print_json
from nmes.cli._output import whole_file, whole_folder
from nmes.cli._pictures import write_picture
from nmes.cli._progress import QUIET, progress_bars
from nmes.errors import visible

if TYPE_CHECKING:
    from nmes.evolution.run import Run
    from nmes.view.run_summary import RunSummary

__all__ = ["command"]


@click.command("show")
@click.argument("folder", metavar="RUN", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="PATH",
    help="Draw it: as one page, FILE.html, or as a new folder with that page and its pictures.",
)
@click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")
@QUIET
def command(folder: Path, output: Path | None, as_json: bool) -> None:
    """Show what a run has come to: how far it is, the best, and which operators helped.

    RUN is a run's folder. One that is still going on is shown as far as it is. With -o it is drawn: scores over time,
    where the winner comes from, and, where the algorithm has such, its archive, its front and its species. Of several
    populations it is scores by era, and, of two roles, the champions of all eras against each other.

    For example:

    \b
        nmes evolve show runs/walk-ga-1
        nmes evolve show runs/walk-ga-1 -o walk.html
        nmes evolve show runs/walk-ga-1 -o pictures/
    """
    from nmes.evolution.run import Run
    from nmes.view.run_summary import RunSummary

    if output is not None and output.suffix != ".html" and output.exists() and not output.is_dir():
        raise click.UsageError(f"{output} is no folder: a page ends in .html")
    run = Run.open(folder)
    summary = RunSummary(run)
    if output is not None:
        _draw(run, summary, output)
    if as_json:
        print_json(summary.to_json())
    elif output is None:
        click.echo(visible("\n".join(_lines(summary)), keep="\n"))


def _lines(summary: RunSummary) -> list[str]:
    """Returns a run in words, as lines."""
    from nmes.view.chart import number

    lines = [summary.title, *columns(summary.facts()), "", *columns(summary.settings())]
    best: list[tuple[str, ...]] = [(summary.outcome, "candidate", "score", "generation", "operator")]
    for rank, row in enumerate(summary.top, 1):
        who = row.group if summary.champions else f"{rank}"
        best.append((who, f"{row.index}", number(row.score), f"{row.generation}", row.operator))
    operators: list[tuple[str, ...]] = [
        ("operator", "candidates", "better than the parent", "best so far", "without a score")
    ]
    for each in summary.history.operators():
        counts = each.candidates, each.better, each.champions, each.without_score
        operators.append((each.name, *(f"{count:,}" for count in counts)))
    if len(best) > 1:
        lines += ["", *columns(best, right=(1, 2, 3))]
    if len(operators) > 1:
        lines += ["", *columns(operators, right=(1, 2, 3, 4))]
    return lines


def _draw(run: Run, summary: RunSummary, output: Path) -> None:
    """Writes the page of a run and, unless the output is a page, its pictures beside it."""
    from nmes.view.run_page import write_page
    from nmes.view.run_pictures import Portraits, draw_run

    single = output.suffix == ".html"
    whole = whole_file(output, *run.folder.iterdir()) if single else whole_folder(output)
    with whole as made, progress_bars() as progress:
        portraits = Portraits(run)
        pictures = list(draw_run(run, summary, portraits, progress))
        if not single:
            for picture in pictures:
                write_picture(picture, made)
        write_page(summary, made if single else made / "index.html", pictures, portraits)
    click.echo(visible(f"wrote {output if single else output / 'index.html'}"), err=True)
