"""`nmes export`: a recording as data for other programs."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import click

from nmes.cli._output import whole_file
from nmes.cli.info import open_recording
from nmes.errors import visible
from nmes.playback import states
from nmes.playback.export import messages, state_rows, write_csv, write_jsonl, write_parquet
from nmes.recording import Recording

__all__ = ["command"]


@click.command("export")
@click.argument("recording", metavar="FILE", callback=open_recording)
@click.option("--to", "kind", type=click.Choice(["jsonl", "csv", "parquet"]), required=True, help="The format.")
@click.option(
    "--what",
    type=click.Choice(["messages", "states"]),
    help="Commands, replies and what happened; or each cube after each tick.  "
    "[default: messages in jsonl, states in csv and parquet]",
)
@click.option("-o", "--output", type=click.Path(dir_okay=False, path_type=Path), help="The file; else standard output.")
@click.option("--keep-going", is_flag=True, help="States: go on where a tick does not come out as recorded.")
@click.option("--anyway", "keep_going", is_flag=True, hidden=True)  # its old name
def command(recording: Recording, kind: str, what: str | None, output: Path | None, keep_going: bool) -> None:
    """Write a recording as data for other programs.

    States are not in a recording: they are made by running it again, and each tick is compared with its recorded
    digest. Of a recording that is cut or damaged, what comes before is written.

    Exit status: 0 all of it is written; 1 what comes before the damage, or nothing; 2 wrong usage, or no
    recording.

    For example:

    \b
        nmes export run.mcap --to jsonl
        nmes export run.mcap --to parquet -o states.parquet
    """
    if kind == "parquet" and output is None:
        raise click.UsageError("parquet needs --output")
    as_messages = what == "messages" if what is not None else kind == "jsonl"
    rows = messages(recording) if as_messages else state_rows(states(recording, keep_going=keep_going))
    if kind == "parquet":
        assert output is not None
        with whole_file(output, recording.path) as unfinished:
            write_parquet(rows, unfinished)
    else:
        with _text(output, recording.path) as file:
            if kind == "jsonl":
                write_jsonl(rows, file)
            else:
                write_csv(rows, file)
    if recording.damage is not None:
        click.echo(f"{recording.path} ends early, and so does what was written: {recording.damage.message}", err=True)
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
