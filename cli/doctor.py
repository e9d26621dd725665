"""`nmes doctor`: see whether this machine and this installation have what worlds need."""

from __future__ import annotations

from dataclasses import asdict

import click
from rich.console import Console
from rich.table import Table

from nmes.cli._checks import look_at_everything
from nmes.cli._json import print_json

__all__ = ["command"]

_MARKS = {"ok": "ok", "note": "note", "wrong": "WRONG"}


@click.command("doctor")
@click.option("--port", type=click.IntRange(1, 65535), default=14000, show_default=True, help="The port to look at.")
@click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")
def command(port: int, as_json: bool) -> None:
    """See whether everything is as it must be.

    Looks at versions, engines and what is known to be wrong with them, numbers (each engine's probe, taken twice),
    graphics, the port of a host, disks and limits. Ends with status 1 where something is wrong.

    For example:

    \b
        nmes doctor
        nmes doctor --json
    """
    findings = list(look_at_everything(port))
    if as_json:
        print_json([asdict(finding) for finding in findings])
    else:
        table = Table(box=None, pad_edge=False, show_header=False)
        for finding in findings:
            table.add_row(_MARKS[finding.status], finding.name, finding.value)
            if finding.hint:
                table.add_row("", "", f"→ {finding.hint}")
        Console(highlight=False, markup=False).print(table)
    if any(finding.status == "wrong" for finding in findings):
        click.get_current_context().exit(1)
