"""`nmes diff`: where two recordings part."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import click
import orjson
from rich.console import Console
from rich.table import Table

from nmes.cli._drift import plot
from nmes.cli._json import print_json
from nmes.cli._output import check_output
from nmes.cli.info import open_recording
from nmes.errors import visible
from nmes.playback.diff import Comparison, compare, excerpts
from nmes.recording import Recording

__all__ = ["command"]

_CUBES = 20  # rows of the table: those that come apart most


@click.command("diff")
@click.argument("first", metavar="A", callback=open_recording)
@click.argument("second", metavar="B", callback=open_recording)
@click.option(
    "--plot", "plot_to", type=click.Path(dir_okay=False, path_type=Path), help="Write the distances to an .svg or .png."
)
@click.option("--keep-going", is_flag=True, help="Go on where a tick does not come out as recorded.")
@click.option("--anyway", "keep_going", is_flag=True, hidden=True)  # its old name
@click.option("--json", "as_json", is_flag=True, help="Print the comparison as JSON.")
def command(first: Recording, second: Recording, plot_to: Path | None, keep_going: bool, as_json: bool) -> None:
    """Compare two recordings.

    Shows the first input that is not the same, with the field that differs, the first tick after which the worlds are
    not, with the value that differs most, and how far each cube comes apart.

    Exit status: 0 the same, 1 not, 2 wrong usage or an unreadable file, 3 a recording does not come out the same here,
    where other numbers come out than where it was made.

    For example:

    \b
        nmes diff before.mcap after.mcap --plot apart.svg
    """
    check_output(plot_to, first.path, second.path)
    comparison = compare(first, second, keep_going=keep_going)
    if plot_to is not None:
        plot(f"Drift of {second.path.name} from the recording on {first.path.name}", comparison.drifts, plot_to)
    if as_json:
        print_json(comparison.to_json())
    else:
        _show(comparison, Console(highlight=False, markup=False, soft_wrap=True))
    sys.exit(0 if comparison.same else 1)


def _show(comparison: Comparison, console: Console) -> None:
    inputs, states = comparison.inputs, comparison.states
    if inputs is None:
        console.print("inputs: the same")
    else:
        console.print(f"inputs part after {inputs.ticks:,} ticks")
        if inputs.field is not None:
            one, other = excerpts(*(orjson.dumps(value).decode() for value in inputs.values))
            console.print(visible(f"  {inputs.field}: A {one}, B {other}"))
        console.print(f"  A: {visible(inputs.first)}")
        console.print(f"  B: {visible(inputs.second)}")
    if states is None:
        console.print(f"states: the same after each of {comparison.ticks[0]:,} ticks")
        return
    console.print(f"states part at tick {states.tick:,} (A has {comparison.ticks[0]:,}, B has {comparison.ticks[1]:,})")
    if states.field is not None:
        where = states.field if states.cube is None else f"cube {states.cube}: {states.field}"
        one, other = excerpts(str(states.first), str(states.second))
        console.print(visible(f"  {where}: A {one}, B {other}"))
    if comparison.drifts:
        worst = {name: max(drift.distance for drift in line) for name, line in comparison.drifts.items()}
        table = Table("cube", "apart at last (m)", "at most (m)", "turned", box=None, pad_edge=False)
        for column in table.columns[1:]:
            column.justify = "right"
        for name in sorted(worst, key=lambda name: -worst[name])[:_CUBES]:
            last = comparison.drifts[name][-1]
            table.add_row(
                visible(name), f"{last.distance:.6g}", f"{worst[name]:.6g}", f"{math.degrees(last.angle):.2f}°"
            )
        console.print(table)
        if len(worst) > _CUBES:
            console.print(f"and {len(worst) - _CUBES} cubes that come less far apart")
