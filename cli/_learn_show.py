"""`nmes learn show`: what a run of learning has come to."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from nmes.cli._columns import columns
from nmes.cli._json import print_json
from nmes.cli._output import whole_file, whole_folder
from nmes.cli._pictures import write_picture
from nmes.errors import visible

if TYPE_CHECKING:
    from nmes.learning.run import LearningRun

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
@click.option("--json", "as_json", is_flag=True, help="Print it as JSON, with all legs.")
def command(folder: Path, output: Path | None, as_json: bool) -> None:
    """Show what a run of learning has come to: how far it is, the best, and its settings.

    RUN is a run's folder. One that is still going on is shown as far as it is. With -o it is drawn: scores, returns and
    the learner's own figures over the steps that were learned from.

    For example:

    \b
        nmes learn show runs/walk-ppo-0
        nmes learn show runs/walk-ppo-0 -o walk.html
    """
    from nmes.learning.run import LearningRun
    from nmes.view import learning_page

    if output is not None and output.suffix != ".html" and output.exists() and not output.is_dir():
        raise click.UsageError(f"{output} is no folder: a page ends in .html")
    run = LearningRun.open(folder)
    if output is not None:
        _draw(run, output)
    if as_json:
        print_json(learning_page.to_json(run))
    elif output is None:
        facts, settings = learning_page.facts(run), learning_page.settings(run)
        lines = [learning_page.title(run), *columns(facts), "", *columns(settings)]
        click.echo(visible("\n".join(lines), keep="\n"))


def _draw(run: LearningRun, output: Path) -> None:
    """Writes the page of a run and, unless the output is a page, its pictures beside it."""
    from nmes.view.learning_page import curves, write_learning_page

    single = output.suffix == ".html"
    pictures = list(curves(run))
    with whole_file(output, *run.folder.iterdir()) if single else whole_folder(output) as made:
        if not single:
            for picture in pictures:
                write_picture(picture, made)
        write_learning_page(run, made if single else made / "index.html", pictures)
    click.echo(visible(f"wrote {output if single else output / 'index.html'}"), err=True)
