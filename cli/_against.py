"""The report of `nmes replay --against`: a verdict, the fields that differ, and the commands that were not sent."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import orjson

from nmes.errors import visible
from nmes.playback.answers import Mismatch
from nmes.playback.remote import RemoteReplayReport

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["show"]

FIELDS = 40  # rows of the table
_SHORT = 60  # characters of a value


def show(report: RemoteReplayReport, console: Console) -> None:
    """Prints a report."""
    from rich.table import Table

    amount = f"{report.commands:,} commands, {report.ticks:,} ticks, {report.values:,} values"
    console.print(f"{report.verdict}: {amount}; numbers may differ by {report.tolerance:g}", soft_wrap=True)
    if report.fields:
        console.print(f"{report.commands - report.equal:,} answers differ, in these fields:")
        table = Table("command", "field", "times", "first", "worst", box=None, pad_edge=False)
        table.columns[2].justify = "right"
        for row in report.fields[:FIELDS]:
            worst = "" if row.worst is row.first else _place(row.worst)
            cells = (row.command, row.field or "answer", f"{row.count:,}", _place(row.first), worst)
            table.add_row(*map(visible, cells))
        console.print(table)
        if len(report.fields) > FIELDS:
            console.print(f"and {len(report.fields) - FIELDS} fields more; --json has them all")
    lines = [f"not supported there: {kind} ({count} times)" for kind, count in report.unsupported.items()]
    if report.ended is not None:
        lines.append(f"ended early: {report.ended}")
    for name, (recorded, there) in report.differences.items():
        lines.append(f"its world is made otherwise: {name}: recorded {_value(recorded)}, there {_value(there)}")
    lines += [f"not sent: {reason} ({count} times)" for reason, count in report.kept_back.items()]
    if report.renamed:
        first = ", ".join(f"{ours} is {theirs}" for ours, theirs in list(report.renamed.items())[:3])
        lines.append(f"{len(report.renamed)} names are others there: {first}{', ...' * (len(report.renamed) > 3)}")
    if report.damage is not None:
        lines.append(f"the recording ends early: {report.damage}")
    for line in lines:
        console.print(visible(f"  {line}"), soft_wrap=True)


def _place(mismatch: Mismatch) -> str:
    place = f"frame {mismatch.frame}" + (f", {mismatch.cube}" if mismatch.cube is not None else "")
    amount = f", by {mismatch.difference:.3g}" if mismatch.difference is not None else ""
    return f"{place}: {_value(mismatch.expected)}, there {_value(mismatch.actual)}{amount}"


def _value(value: Any) -> str:
    if value is None:
        return "nothing"
    text = orjson.dumps(value).decode()
    return text if len(text) <= _SHORT else f"{text[:_SHORT]}..."
