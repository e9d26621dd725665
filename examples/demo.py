"""Serves, drives, records and reproduces the example worlds, one after the other, and prints a table of the results.

Everything goes through the doors that users have: `nmes serve`, the example programs over TCP, `nmes replay`.
"""

from __future__ import annotations

import argparse
import json
import os
import secrets
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
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
        raise Failed(f"{' '.join(command)} (exit {process.returncode})\n{process.stdout}{process.stderr}") from None


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


def main() -> int:
    """Runs the demo; returns 1 if an aim was missed or a recording was not reproduced."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = HERE.parent / "recordings"
    parser.add_argument("--record", type=Path, default=default, metavar="DIR", help="directory for the recordings")
    options = parser.parse_args()
    console = Console()
    table = Table("", "measured", "", "aim")
    table.columns[1].justify = "right"
    good = True
    began = time.monotonic()
    columns = (TextColumn("{task.description:<34}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("", total=2 * len(EXAMPLES))
        for example in EXAMPLES:
            progress.update(task, description=f"{example}: served and driven")
            figures, recording = drive(example, options.record / example)
            progress.update(task, advance=1, description=f"{example}: replayed")
            report = replay(recording)
            progress.advance(task)
            for row in rows(example, figures, recording, report):
                table.add_row(*row)
            table.add_section()
            good &= figures["ok"] and report["verdict"] == "reproduced"
    console.print(table)
    where = os.path.relpath(options.record)
    console.print(f"{time.monotonic() - began:.1f} s. The recordings are in {where}: try nmes info, and nmes replay.")
    return 0 if good else 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except Failed as error:
        sys.exit(f"the demo failed:\n{error}")
