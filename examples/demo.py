"""Serves, drives, records and reproduces the example worlds, prints a table of the results, and draws a picture.

Everything goes through the doors that users have: `nmes serve`, the example programs over TCP, `nmes replay` and
`nmes render`.
"""

from __future__ import annotations

import argparse
import json
import os
import secrets
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from common import Figure

HERE = Path(__file__).parent
EXAMPLES = ["tier1_target", "tier2_grid", "tier2_pole", "tier3_swarm", "tier3_creature"]
NMES = [str(Path(sys.executable).parent / "nmes")]
TIMEOUT = 60.0  # s, for any one step
AT_ONCE = 2  # worlds: most of the time goes into starting programs, which need a core each


class Failed(Exception):
    """A step of the demo failed; the message has its output."""


@contextmanager
def served(record_to: Path, *options: str) -> Iterator[dict[str, Any]]:
    """Runs `nmes serve` on a free port; yields its first message, which has address and recording, and the password."""
    password = secrets.token_hex()
    command = [*NMES, "serve", "--json", "--port", "0", "--record", str(record_to), *options]
    with tempfile.TemporaryFile("w+") as log:
        server = subprocess.Popen(
            command, env={**os.environ, "NMES_PASSWORD": password}, stdout=subprocess.PIPE, stderr=log, text=True
        )
        try:
            assert server.stdout is not None
            ready = server.stdout.readline()
            if ready:
                yield {**json.loads(ready), "password": password}
        finally:
            server.send_signal(signal.SIGTERM)
            server.communicate(timeout=TIMEOUT)
        log.seek(0)
        if not ready or server.returncode != 0:
            raise Failed(f"nmes serve (exit {server.returncode})\n{log.read()}")


def run(command: list[str], **environment: str) -> Any:
    """Runs a command that prints JSON, and returns the parsed output; a missed aim is no failure."""
    process = subprocess.run(
        command, env={**os.environ, **environment}, capture_output=True, text=True, timeout=TIMEOUT, check=False
    )
    try:
        return json.loads(process.stdout)
    except ValueError:
        raise failure(process) from None


def failure(process: subprocess.CompletedProcess[str]) -> Failed:
    """Returns the error that tells what a command said."""
    command = " ".join(process.args)
    return Failed(f"{command} (exit {process.returncode})\n{process.stdout}{process.stderr}")


def drive(example: str, record_to: Path) -> tuple[Any, Path]:
    """Runs one example against a server of its own; returns its figures and the recording."""
    with served(record_to, "--mode", "lockstep") as server:
        script = [sys.executable, str(HERE / f"{example}.py"), "--json", "--port", str(server["port"])]
        figures = run(script, NMES_PASSWORD=server["password"])
    return figures, Path(server["recording"])


def replay(recording: Path) -> Any:
    """Runs a recording again; returns the report."""
    return run([*NMES, "replay", str(recording), "--json"])


def rows(example: str, figures: Any, recording: Path, report: Any) -> Iterator[tuple[str, ...]]:
    """Yields an example's part of the table."""
    yield f"[bold]{example}[/]", "", "", ""
    for figure in (Figure(**row) for row in figures["figures"]):
        color = "green" if figure.ok else "red"
        yield f"  {figure.name}", f"[{color}]{figure.value:.3f}[/]", figure.unit, figure.aim
    size = recording.stat().st_size / 1024
    yield "  recorded", f"{size:.0f}", "KiB", f"{report['ticks']} ticks, {report['commands']} commands"
    color = "green" if report["verdict"] == "reproduced" else "red"
    yield "  replayed", f"[{color}]{report['verdict']}[/]", "", f"{report['speed']:.0f} x real time"


def reproduce(example: str, record_to: Path, progress: Callable[[str], None]) -> tuple[Any, Path, Any]:
    """Drives an example and replays its recording; returns the figures, the recording and the replay's report."""
    figures, recording = drive(example, record_to / example)
    progress(f"{example}: served, driven, recorded")
    report = replay(recording)
    progress(f"{example}: {report['verdict']}")
    return figures, recording, report


def reproduce_all(record_to: Path, console: Console) -> list[tuple[Any, Path, Any]]:
    """Reproduces all examples, a few at a time, under a progress bar; returns what came of each, in their order."""
    columns = (TextColumn("{task.description:<42}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as bar, ThreadPoolExecutor(AT_ONCE) as pool:
        task = bar.add_task("starting", total=2 * len(EXAMPLES))

        def progress(what: str) -> None:
            bar.update(task, advance=1, description=what)

        return list(pool.map(lambda example: reproduce(example, record_to, progress), EXAMPLES))


def draw(recording: Path, picture: Path) -> str:
    """Draws the last moment of a recording; tells where the picture is, or why there is none on this machine."""
    command = [*NMES, "render", str(recording), "-o", str(picture), "--size", "800x450"]
    process = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT, check=False)
    if "no OpenGL" in process.stderr:
        return f"Here no picture is drawn. {process.stderr.strip()}"
    if process.returncode:
        raise failure(process)
    return f"The creature at its end: {os.path.relpath(picture)}"


def next_steps(recording: Path) -> list[str]:
    """Returns three commands to go on with, as they can be typed in the current folder."""
    nmes = os.path.relpath(NMES[0])
    return [
        f"{nmes} render {shlex.quote(os.path.relpath(recording))} -o creature.mp4",
        f"{nmes} eval walker --task walk --record proofs",
        f"{nmes} evolve random --task walk --budget 100 --seed 1 -o runs/first",
    ]


def main() -> int:
    """Runs the demo; returns 1 if an aim was missed or a recording was not reproduced."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = HERE.parent / "recordings"
    parser.add_argument("--record", type=Path, default=default, metavar="DIR", help="directory for the recordings")
    options = parser.parse_args()
    console = Console()
    console.print("Five worlds: each is served, driven over TCP and recorded; then its recording is run again.")
    began = time.monotonic()
    results = reproduce_all(options.record, console)
    table = Table("", "measured", "", "aim")
    table.columns[1].justify = "right"
    for example, (figures, recording, report) in zip(EXAMPLES, results, strict=True):
        for row in rows(example, figures, recording, report):
            table.add_row(*row)
        table.add_section()
    console.print(table)
    creature = results[-1][1]
    picture = draw(creature, options.record / "creature.png")
    console.print(f"{time.monotonic() - began:.1f} s. The recordings are in {os.path.relpath(options.record)}.")
    # As they are, not wrapped: they are to be copied.
    print(picture, "A film of it, a score, and evolution:", sep="\n\n")
    print(*(f"    {step}" for step in next_steps(creature)), sep="\n")
    good = all(figures["ok"] and report["verdict"] == "reproduced" for figures, _, report in results)
    return 0 if good else 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except Failed as error:
        sys.exit(f"the demo failed:\n{error}")
