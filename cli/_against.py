"""How `nmes replay --against` shows what it found: a verdict, the fields that differ, and what was left out."""

from __future__ import annotations

from typing import Any

import orjson
from rich.console import Console
from rich.table import Table

from nmes.playback.remote import Mismatch, RemoteReplayReport

__all__ = ["show"]

FIELDS = 40  # rows of the table
_SHORT = 60  # characters of a value


def show(report: RemoteReplayReport, console: Console) -> None:
    """Prints a report."""
    amount = f"{report.commands:,} commands, {report.ticks:,} ticks, {report.values:,} values"
    console.print(f"{report.verdict}: {amount}; numbers may differ by {report.tolerance:g}", soft_wrap=True)
    if report.fields:
        console.print(f"{report.commands - report.equal:,} answers differ, in these fields:")
        table = Table("command", "field", "times", "first", "worst", box=None, pad_edge=False)
        table.columns[2].justify = "right"
        for found in report.fields[:FIELDS]:
            worst = "" if found.worst is found.first else _sighting(found.worst)
            table.add_row(found.command, found.field or "answer", f"{found.count:,}", _sighting(found.first), worst)
        console.print(table)
        if len(report.fields) > FIELDS:
            console.print(f"and {len(report.fields) - FIELDS} fields more; --json has them all")
    lines = [f"not supported there: {kind} ({count} times)" for kind, count in report.unsupported.items()]
    if report.ended is not None:
        lines.append(f"ended early: {report.ended}")
    for name, (recorded, there) in report.unlike.items():
        lines.append(f"its world is made otherwise: {name}: recorded {_value(recorded)}, there {_value(there)}")
    lines += [f"not sent: {reason} ({count} times)" for reason, count in report.kept_back.items()]
    if report.renamed:
        first = ", ".join(f"{ours} is {theirs}" for ours, theirs in list(report.renamed.items())[:3])
        lines.append(f"{len(report.renamed)} names are others there: {first}{', ...' * (len(report.renamed) > 3)}")
    if report.damage is not None:
        lines.append(f"the recording ends early: {report.damage}")
    for line in lines:
        console.print(f"  {line}", soft_wrap=True)


def _sighting(seen: Mismatch) -> str:
    where = f"frame {seen.frame}" + (f", {seen.cube}" if seen.cube is not None else "")
    by = f", by {seen.difference:.3g}" if seen.difference is not None else ""
    return f"{where}: {_value(seen.expected)}, there {_value(seen.actual)}{by}"


def _value(value: Any) -> str:
    if value is None:
        return "nothing"
    text = orjson.dumps(value).decode()
    return text if len(text) <= _SHORT else f"{text[:_SHORT]}..."
