"""`nmes genome publish`: a creature with the proof of what it can do, in a folder for others."""

from __future__ import annotations

import re
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click
import orjson

from nmes.cli._output import whole_folder
from nmes.cli._progress import progress_bars
from nmes.cli._tasks import require_own_name
from nmes.errors import DocumentError, MissingPackage, WorldError, visible
from nmes.genome import Genome

if TYPE_CHECKING:
    from nmes.evaluation import Evaluation, Task

__all__ = ["command"]

Loaded = TypeVar("Loaded", "Genome", "Task")

_FILM_SIZE, _FILM_RATE = (480, 360), 20
_PAGE = """# {name}

{about}![{name}](picture.png)

On the task `{task}` it has **{score}**, the mean over {seeds}. What the task asks:

> {asked}

| seed | score | energy (J) | ended by |
|---|---|---|---|
{rows}

## Check it

Each recording here holds the task and the creature, and all that its brain did. In this folder,

```console
$ nmes eval --from-recording *.mcap
```

runs them again, tick by tick, compares every tick with what was recorded, and computes the score from them alone. It
fails if anything comes out otherwise. `genome.json` is the creature itself{more}.

- genome: `{genome_hash}`
- task: `{task_hash}`
"""


@click.command("publish")
@click.argument("source", metavar="GENOME")
@click.option("--task", "task_name", metavar="T", required=True, help="A file, or the name of a task that ships.")
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(file_okay=False, path_type=Path),
    metavar="FOLDER",
    help="The folder to write; it must not be there yet, or be empty.",
)
def command(source: str, task_name: str, output: Path) -> None:
    """Write a folder with a creature and the proof of its score, for others to check.

    GENOME is a file, or the name of one that ships. It is run on all seeds of the task; the folder holds the genome, a
    recording of each episode, a picture, a film of the first (with the extra film), the task if it is none that ships,
    and a README.md with the scores and the one command that checks them. The folder is there whole or not at all.

    Exit status: 0 it is there, 1 the creature has no score, 2 wrong usage.

    For example:

    \b
        nmes genome publish mine.json --task walk -o mine
    """
    from nmes.evaluation import Task, evaluate
    from nmes.evaluation.identity import shipped_hash

    genome, task = _read(source, Genome), _read(task_name, Task)
    require_own_name(task, task_name)
    documents = {"genome.json": genome.document}
    if task.hash != shipped_hash(task.name):
        documents["task.json"] = task.document
    with whole_folder(output) as folder:
        evaluation = evaluate(genome, task, record=folder)
        _require_score(evaluation)
        for name, document in documents.items():
            (folder / name).write_bytes(orjson.dumps(document, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE))
        _draw(genome, folder / "picture.png")
        filmed = _film(evaluation, folder / "film.mp4")
        page = _page(genome, task, evaluation, "task.json" in documents, filmed)
        (folder / "README.md").write_text(page, encoding="utf-8")
    score = f"{evaluation.score:.6g} {task.unit}".strip()
    click.echo(visible(f"wrote {output}: {genome.name} on {task.name}, score {score}; see its README.md"))


def _read(name: str, kind: type[Loaded]) -> Loaded:
    try:
        return kind.load(name)
    except DocumentError as error:
        raise click.UsageError(f"{visible(name)}:\n{error.message}") from error


def _require_score(evaluation: Evaluation) -> None:
    """Refuses a creature that has no score in an episode."""
    reasons = [evaluation.error, *(result.fault for result in evaluation.results)]
    reason = next((each for each in reasons if each is not None), None)
    if reason is not None:
        raise click.ClickException(visible(f"{evaluation.genome} has no score: {reason}", keep="\n"))


def _draw(genome: Genome, path: Path) -> None:
    from PIL import Image

    from nmes.genome.preview import render_body

    Image.fromarray(render_body(genome.body)).save(path)


def _film(evaluation: Evaluation, path: Path) -> bool:
    """Films the first episode; tells whether that can be done here, and on standard error why not."""
    from nmes.recording import Recording
    from nmes.view.film import film

    try:
        if find_spec("av") is None:
            raise MissingPackage("films need PyAV: pip install 'nmes[film]'")
        with progress_bars() as progress:
            film([Recording(evaluation.recordings[0])], path, fps=_FILM_RATE, size=_FILM_SIZE, progress=progress)
    except (MissingPackage, WorldError) as error:  # no encoder, or no OpenGL
        click.echo(f"no film: {visible(error.message)}", err=True)
        return False
    return True


def _page(genome: Genome, task: Task, evaluation: Evaluation, own_task: bool, filmed: bool) -> str:
    document = genome.document
    told = (("author", "By {}."), ("license", "Licence: {}."), ("description", "{}"))
    about = [words.format(document[field]) for field, words in told if document.get(field)]
    rows = [
        f"| {result.seed} | {result.score:.6g} | {result.energy:.6g} | {_text(result.ended or 'its time')} |"
        for result in evaluation.results
    ]
    more = ", `task.json` the task" if own_task else ""
    return _PAGE.format(
        name=_text(genome.name),
        about="".join(f"{_text(line)}\n\n" for line in about),
        task=task.name,
        asked=_text(task.description),
        score=f"{evaluation.score:.6g} {_text(task.unit)}".strip(),
        seeds="its one seed" if len(rows) == 1 else f"its {len(rows)} seeds",
        rows="\n".join(rows),
        more=f"{more}, `film.mp4` shows its first episode" if filmed else more,
        genome_hash=genome.hash,
        task_hash=task.hash,
    )


def _text(text: str) -> str:
    """Returns a text that Markdown shows as it is, in one line."""
    return re.sub(r"([\\`*_{}\[\]<>#|!~])", r"\\\1", visible(" ".join(text.split())))
