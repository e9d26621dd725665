"""`nmes corpus`: evolved creatures in one file, each with its scores, and the digests that prove them."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
import orjson

from nmes.cli._columns import columns
from nmes.cli._json import print_json
from nmes.cli._output import whole_file
from nmes.cli._pool import JOBS
from nmes.cli._progress import QUIET, progress_bars
from nmes.cli._sample import SEED, drawn_by
from nmes.cli._tasks import borrowed_names
from nmes.errors import CorpusError, visible
from nmes.schemas.files import lock_kept

if TYPE_CHECKING:
    from nmes.evolution.corpus import Corpus, CorpusCreature

__all__ = ["command"]

_STATUS: Final = {"holds": 0, "broken": 1, "not_judged": 3}
_WORDS: Final = {"holds": "holds", "broken": "broken", "not_judged": "could not be judged here"}
_SHIPPED: Final = "corpus/creatures.jsonl.zst"
_PATH: Final = click.Path(dir_okay=False, path_type=Path)
_FILE = click.argument("file", metavar="[FILE]", type=_PATH, default=_SHIPPED)


@click.group("corpus")
def command() -> None:
    """Keep evolved creatures with the proofs of their scores.

    FILE is a corpus; without it, corpus/creatures.jsonl.zst, that of the repository.
    """


def _read(file: Path) -> Corpus:
    """Reads the corpus that an argument names; what is none is wrong usage."""
    from nmes.evolution.corpus import Corpus

    try:
        return Corpus.read(file)
    except CorpusError as error:
        raise click.UsageError(error.message) from error


@contextmanager
def _alone(file: Path) -> Iterator[None]:
    """Keeps other processes from adding to a corpus meanwhile: what one adds would be lost to the other.

    The folder is locked, since the file is another one afterwards.
    """
    folder = None
    try:
        folder = os.open(file.absolute().parent, os.O_RDONLY)
        lock_kept(folder, file)
    except BlockingIOError as error:
        what = f"{visible(str(file))}: another process adds to a corpus in this folder; try again once it is done"
        raise click.ClickException(what) from error
    except OSError as error:
        raise click.ClickException(f"cannot write {visible(str(file))}: {error.strerror}") from error
    else:
        yield
    finally:
        if folder is not None:
            os.close(folder)


@command.command("add")
@click.argument("file", metavar="FILE", type=_PATH)
@click.argument("runs", metavar="RUN...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--best", metavar="N", type=click.IntRange(1), default=50, show_default=True, help="At most so many a run."
)
@JOBS
@QUIET
def add(file: Path, runs: tuple[Path, ...], best: int, jobs: int | None) -> None:
    """Add the best creatures of runs of evolution.

    RUN is a run's folder. Of each run these are its elites, then the best of the others whose scores differ: candidates
    that were varied, with a score above 0, and none that is there already. Their episodes are run here on all of the
    task's seeds. FILE is made if it is not there; the same runs in the same order give the same bytes.

    For example:

    \b
        nmes corpus add mine.jsonl.zst runs/walk-1 runs/walk-2
        nmes corpus add mine.jsonl.zst runs/* --best 20
    """
    from nmes.evolution.corpus import Corpus
    from nmes.evolution.corpus_add import add_runs

    with _alone(file):
        before = _read(file) if file.exists() else Corpus({}, (), ())
        with progress_bars() as progress:
            after = add_runs(before, runs, best=best, jobs=jobs or os.cpu_count() or 1, progress=progress)
        with whole_file(file) as unfinished:
            after.write(unfinished)
    new = len(after.creatures) - len(before.creatures)
    click.echo(f"{visible(str(file))}: {new:,} new, {len(after.creatures):,} creatures in all")


@command.command("show")
@_FILE
@click.option("--task", metavar="T", help="Only creatures of this task.")
@click.option("--top", type=click.IntRange(1), help="Only so many of each task.")
@click.option("--json", "as_json", is_flag=True, help="Print them as JSON, all but the genomes.")
def show(file: Path, task: str | None, top: int | None, as_json: bool) -> None:
    """Show the creatures, task by task, the highest score first.

    For example:

    \b
        nmes corpus show --task walk --top 10
        nmes corpus show mine.jsonl.zst --json
    """
    corpus = _read(file)
    shown = _shown(corpus, task, top)
    if as_json:
        runs = [run.settings | {"digest": run.digest} for run in corpus.runs]
        print_json([_facts(corpus, each) | {"run": _origin(runs, each)} for each in shown])
        return
    rows: list[tuple[str, ...]] = [("creature", "score", "", "generation", "genome", "operator")]
    for each in shown:
        score = f"{each.score:.6g}", _unit(corpus, each)
        rows.append((corpus.name_of(each), *score, str(each.generation), each.name, each.operator))
    lines = columns([tuple(map(visible, row)) for row in rows], right=(1, 3))
    click.echo("\n".join(lines))
    for line in borrowed_names({digest: known.task.name for digest, known in corpus.tasks.items()}):
        click.echo(line)
    click.echo(f"{len(shown):,} of {len(corpus.creatures):,} creatures of {len(corpus.runs):,} runs")
    click.echo(f"digest: {corpus.digest}")


def _shown(corpus: Corpus, task: str | None, top: int | None) -> list[CorpusCreature]:
    """Returns the creatures of a task, or of all, so many of each; a task that is not there is wrong usage."""
    names = {digest: known.task.name for digest, known in corpus.tasks.items()}
    if task is not None and task not in names.values():
        raise click.BadParameter(
            f"there are creatures of {', '.join(sorted(set(names.values())))}", param_hint="--task"
        )
    counts: dict[str, int] = {}
    shown = []
    for each in corpus.creatures:
        if task in (None, names.get(each.task)):
            counts[each.task] = counts.get(each.task, 0) + 1
            if top is None or counts[each.task] <= top:
                shown.append(each)
    return shown


def _facts(corpus: Corpus, each: CorpusCreature) -> dict[str, object]:
    told = each.to_json()
    del told["genome"]
    return {"name": corpus.name_of(each), "unit": _unit(corpus, each), **told}


def _origin(runs: list[dict[str, object]], each: CorpusCreature) -> dict[str, object] | None:
    return runs[each.run] if each.run < len(runs) else None


def _unit(corpus: Corpus, each: CorpusCreature) -> str:
    known = corpus.tasks.get(each.task)
    return "" if known is None else known.task.unit


@command.command("export")
@click.argument("creature", metavar="CREATURE")
@_FILE
@click.option("-o", "--output", required=True, type=_PATH, help="The genome's file.")
def export(creature: str, file: Path, output: Path) -> None:
    """Write a creature's genome, for every command that takes one.

    CREATURE is its name, as `nmes corpus show` tells it, or the beginning of it.

    For example:

    \b
        nmes corpus export walk-0123456789ab -o walker.json
        nmes corpus export walk-0123 mine.jsonl.zst -o walker.json
    """
    corpus = _read(file)
    found = corpus.find(creature)
    with whole_file(output, file) as unfinished:
        unfinished.write_bytes(orjson.dumps(found.genome, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE))
    known = corpus.tasks.get(found.task)
    click.echo(
        visible(f"wrote {output}: {corpus.name_of(found)}, score {found.score:.6g} {_unit(corpus, found)}".rstrip())
    )
    if known is not None:
        click.echo(visible(f"to run it: nmes eval {shlex.quote(str(output))} --task {known.task.name}"))


@command.command("verify")
@_FILE
@click.option(
    "--sample",
    metavar="N",
    type=click.IntRange(0),
    default=100,
    show_default=True,
    help="How many beside the best of each task are run again.",
)
@click.option("--all", "everything", is_flag=True, help="Run all creatures again.")
@SEED
@click.option(
    "--record",
    metavar="DIR",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Leave a recording of each episode that is run in this folder.",
)
@JOBS
@click.option("--json", "as_json", is_flag=True, help="Print the verdict as JSON.")
@QUIET
def verify(
    file: Path, sample: int, everything: bool, seed: int | None, record: Path | None, jobs: int | None, as_json: bool
) -> None:
    """Prove a corpus: its lines are what they say, and episodes come out again.

    Every genome is judged, and every hash, score and place computed anew. The best of each task and others, drawn anew
    each time, or all, are run again: each figure must be the same to the last bit, and the digest of the world at each
    episode's end.

    Exit status: 0 it holds, 1 something is broken, 2 wrong usage, 3 nothing is broken, but something could not be
    judged here, since other numbers come out, an ONNX brain may round otherwise, or this machine lacks something.

    For example:

    \b
        nmes corpus verify
        nmes corpus verify mine.jsonl.zst --all --jobs 4
        nmes corpus verify --sample 3 --seed 7 --record recordings/
    """
    from nmes.evolution.corpus_verify import verify_corpus

    corpus = _read(file)
    with progress_bars() as progress:
        found = verify_corpus(
            corpus,
            jobs=jobs or os.cpu_count() or 1,
            sample=None if everything else sample,
            seed=seed,
            record=record,
            progress=progress,
        )
    if as_json:
        print_json(asdict(found))
    else:
        for each in found.findings:
            about = f"{each.name}: " if each.name else ""
            click.echo(visible(f"{_WORDS[each.verdict]}: {about}{each.reason}"))
        again = f"{found.again:,} of {found.creatures:,} creatures run again, in {found.episodes:,} episodes"
        click.echo(f"{_WORDS[found.verdict]}: {again}{drawn_by(found.seed, found.again, found.creatures)}")
        click.echo(f"digest: {found.digest}")
    sys.exit(_STATUS[found.verdict])


@command.command("page")
@_FILE
@click.option("-o", "--output", required=True, type=_PATH, help="The page, an .html file.")
@click.option("--top", type=click.IntRange(1), default=10, show_default=True, help="So many of each task.")
@QUIET
def page(file: Path, output: Path, top: int) -> None:
    """Write the best creatures as a page for a browser: one file, with a picture of each.

    For example:

    \b
        nmes corpus page -o gallery.html
    """
    from nmes.view.corpus_page import write_page

    corpus = _read(file)
    shown = _shown(corpus, None, top)
    with whole_file(output, file) as unfinished, progress_bars() as progress:
        write_page(corpus, shown, unfinished, progress)
    click.echo(f"{visible(str(output))}: {len(shown):,} creatures")
