"""`nmes export`: recordings as data for other programs."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING

import click

from nmes.cli._output import whole_file, whole_folder
from nmes.cli.info import open_recording
from nmes.errors import visible
from nmes.playback.export import TABLES, write_csv, write_jsonl, write_parquet
from nmes.recording import Recording

if TYPE_CHECKING:
    from nmes.learning import RecordedEpisode

__all__ = ["command"]


_VIDEO_SIZE = 320, 240
_DATASETS = ("minari", "lerobot")


def _open(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> list[Recording]:
    return [open_recording(context, parameter, value) for value in values]


@click.command("export")
@click.argument("recordings", metavar="FILE...", nargs=-1, required=True, callback=_open)
@click.option(
    "--to", "kind", type=click.Choice(["jsonl", "csv", "parquet", *_DATASETS]), required=True, help="The format."
)
@click.option(
    "--what",
    type=click.Choice(list(TABLES)),
    help="Commands, replies and what happened; or, after each tick, each cube (states), joint, motor (controls), "
    "sensor, or the score so far.  [default: messages in jsonl, states in csv and parquet]",
)
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="The file, or the dataset's folder; else standard output."
)
@click.option("--keep-going", is_flag=True, help="Go on where a tick does not come out as recorded; not of scores.")
@click.option("--videos", is_flag=True, help="LeRobot: a video of each episode, too.")
@click.option("--anyway", "keep_going", is_flag=True, hidden=True)  # its old name
def command(
    recordings: list[Recording], kind: str, what: str | None, output: Path | None, keep_going: bool, videos: bool
) -> None:
    """Write recordings as data for other programs.

    A recording as a table (jsonl, csv, parquet); or recordings of `nmes eval` as a dataset that others learn from
    (minari, lerobot), each an episode: what the creature sensed, did and earned in each tick.

    Neither states nor senses are in a recording: they are made by running it again, and each tick is compared with its
    recorded digest. Of a recording that is cut or damaged, a table holds what comes before, a dataset nothing.

    Exit status: 0 all of it is written; 1 what comes before the damage, or nothing; 2 wrong usage, or no
    recording.

    For example:

    \b
        nmes export run.mcap --to jsonl
        nmes export run.mcap --to parquet -o states.parquet
        nmes export proofs/walker-1.mcap --to csv --what sensors -o sensors.csv
        nmes export proofs/walker-*.mcap --to minari -o datasets/walker-v0
        nmes export proofs/walker-*.mcap --to lerobot --videos -o walker
    """
    if videos and kind != "lerobot":
        raise click.UsageError(f"--videos are a part of --to lerobot, not of {kind}")
    if kind in _DATASETS:
        if what is not None or keep_going:
            raise click.UsageError(f"--what and --keep-going are for tables, not for {kind}")
        _write_dataset(recordings, kind, output, videos)
    elif len(recordings) > 1:
        raise click.UsageError(f"{kind} is made of one recording; of several, --to minari or lerobot")
    else:
        _write_table(recordings[0], kind, what, output, keep_going)


def _write_dataset(recordings: list[Recording], kind: str, output: Path | None, videos: bool) -> None:
    if output is None:
        raise click.UsageError(f"{kind} needs --output")
    # Their imports take long, and all commands import this.
    from nmes.learning.lerobot import write_lerobot
    from nmes.learning.minari import check_name, write_minari

    paths, name = [recording.path for recording in recordings], output.absolute().name
    if kind == "minari":
        check_name(name)
    with whole_folder(output) as unfinished:
        if kind == "minari":
            counts = write_minari(paths, unfinished, name)
        else:
            counts = write_lerobot(paths, unfinished, _film if videos else None)
    click.echo(f"wrote {visible(str(output))}: {counts[0]:,} episodes, {counts[1]:,} ticks")


def _film(episode: RecordedEpisode, path: Path) -> None:
    """Writes a video of an episode, with a picture for each of its ticks, as it was before it."""
    from nmes.view.film import Cut, film

    rate = episode.task.tick_rate
    first = round(episode.begin * rate)
    last = first + len(episode.actions) - 1
    film([Recording(episode.path)], path, Cut(begin=first / rate, end=last / rate), fps=rate, size=_VIDEO_SIZE)


def _write_table(recording: Recording, kind: str, what: str | None, output: Path | None, keep_going: bool) -> None:
    if kind == "parquet" and output is None:
        raise click.UsageError("parquet needs --output")
    if output is not None and output.is_dir():
        raise click.UsageError(f"{output} is a folder: {kind} is a file")
    what = what or ("messages" if kind == "jsonl" else "states")
    if what == "scores" and keep_going:
        raise click.UsageError("--keep-going is not for scores: each tick of an episode must come out as recorded")
    from nmes.evaluation.tables import table_rows  # here, as above

    rows = table_rows(recording, what, keep_going=keep_going)
    if kind == "parquet":
        assert output is not None
        with whole_file(output, recording.path) as unfinished:
            write_parquet(rows, what, unfinished)
    else:
        with _text(output, recording.path) as file:
            if kind == "jsonl":
                write_jsonl(rows, file)
            else:
                write_csv(rows, file)
    if recording.damage is not None:
        told = f"{recording.path} ends early, and so does what was written: {recording.damage.message}"
        click.echo(visible(told), err=True)
        sys.exit(1)


class _Terminal:
    """A terminal, to which nothing is written that would command it."""

    def __init__(self, terminal: IO[str]) -> None:
        self._terminal = terminal

    def write(self, text: str) -> int:
        """Writes text; what does not print in it is escaped."""
        return self._terminal.write(visible(text, keep="\n"))


@contextmanager
def _text(output: Path | None, source: Path) -> Iterator[_Terminal | IO[str]]:
    """Opens the file to write, or standard output."""
    if output is None:
        with click.open_file("-", "w", encoding="utf-8") as standard:
            yield _Terminal(standard) if standard.isatty() else standard
            standard.flush()
    else:
        with whole_file(output, source) as unfinished, unfinished.open("w", encoding="utf-8", newline="") as file:
            yield file
