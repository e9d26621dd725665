"""`nmes info`: show what a recording holds."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click
from rich.filesize import decimal

from nmes.cli._json import print_json
from nmes.cli._output import check_output
from nmes.errors import RecordingError, visible
from nmes.recording import Recording

__all__ = ["command", "open_recording"]

_DIGITS = 19  # of a frame


def open_recording(_: click.Context, parameter: click.Parameter, value: str) -> Recording:
    """Opens the file that an argument names; one that cannot be read is wrong usage."""
    try:
        return Recording(value)
    except RecordingError as error:
        raise click.BadParameter(error.message, param=parameter) from error


@click.command("info")
@click.argument("recording", metavar="FILE", callback=open_recording)
@click.option(
    "--plot",
    "plot_to",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write score, height, energy and gait over time to an SVG, too.",
)
@click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")
def command(recording: Recording, plot_to: Path | None, as_json: bool) -> None:
    """Show what a recording holds.

    The world, its seed and engine, clients, commands by type, ticks and duration, and whether the file is whole.

    For example:

    \b
        nmes info run.mcap
        nmes info run.mcap --plot run.svg
    """
    check_output(plot_to, recording.path)
    about = _about(recording)
    if plot_to is not None:
        from nmes.cli._recording_plot import plot_recordings  # its imports take long, and all commands import this

        plot_recordings([recording], plot_to)
    if as_json:
        print_json(about)
        return
    rows = _rows(about)
    width = max(len(visible(name)) for name, _ in rows)
    for name, value in rows:
        click.echo(f"{visible(name):<{width}}  {visible(value)}")


def _about(recording: Recording) -> dict[str, Any]:
    summary, damage, config = recording.summary(), recording.damage, recording.config
    return {
        "file": str(recording.path),
        "world": config["name"],
        "seed": config["seed"],
        "config": config,
        "fingerprint": recording.fingerprint,
        "created": recording.metadata["nmes.recording"]["created"],
        "format": recording.metadata["nmes.recording"]["format"],
        "clients": summary.clients,
        "commands": dict(summary.commands.most_common()),
        "refused": summary.refused,
        "errors": summary.errors,
        "ignored": dict(summary.ignored.most_common()),
        "without_effect": dict(summary.without_effect.most_common()),
        "first_frame": recording.start().frame,
        "parent": recording.metadata.get("nmes.parent"),
        "ticks": summary.ticks,
        "keyframes": summary.keyframes,
        "faults": summary.faults,
        "sim_seconds": summary.ticks / config["tick_rate"],
        "wall_seconds": (summary.ended - summary.began) / 1e9,
        "size": recording.size,
        "complete": damage is None,
        "damage": None if damage is None else {"message": damage.message, "offset": damage.offset, "cut": damage.cut},
    }


def _date(text: str) -> str:
    """Returns a date for people; one that is none, as a forger may write, as it stands."""
    try:
        return f"{datetime.fromisoformat(text).astimezone(UTC):%Y-%m-%d %H:%M:%S} UTC"
    except (ValueError, OverflowError):
        return text


def _rows(about: dict[str, Any]) -> list[tuple[str, str]]:
    fingerprint, damage = about["fingerprint"], about["damage"]
    engine = [fingerprint["backend"], fingerprint.get("engine.version", ""), f"nmes {fingerprint['nmes']}"]
    commands = sum(about["commands"].values())
    parent = about["parent"]
    begins = f", from frame {about['first_frame']:,} on" if about["first_frame"] else ""
    saved = f", {about['keyframes']:,} keyframes" if about["keyframes"] else ""
    rows = [
        ("world", f"{about['world']}, seed {about['seed']}"),
        ("engine", ", ".join(part for part in engine if part)),
        ("machine", ", ".join(fingerprint[name] for name in ("cpu", "simd", "libc", "python"))),
        ("created", _date(about["created"])),
        ("duration", f"{about['sim_seconds']:,.2f} s of simulation in {about['wall_seconds']:,.2f} s"),
        ("ticks", f"{about['ticks']:,}{begins}{saved}"),
        ("clients", f"{about['clients']:,}"),
        ("commands", f"{commands:,}, and {about['refused']:,} refused frames; {about['errors']:,} errors"),
    ]
    rows += [(f"  {name}", f"{count:,}") for name, count in about["commands"].items()]
    for key, heading in (("ignored", "not understood"), ("without_effect", "without effect")):
        if about[key]:
            rows.append((heading, f"{sum(about[key].values()):,} fields"))
            rows += [(f"  {name}", f"{count:,}") for name, count in about[key].items()]
    if parent is not None:
        rows.append(("parent", f"{parent['file']}, frame {parent['frame'][:_DIGITS]} ({parent['recording'][:16]})"))
    if about["faults"]:
        rows.append(("faults", f"{about['faults']:,}"))
    rows.append(("size", decimal(about["size"])))
    rows.append(("complete", "yes" if damage is None else f"no: {damage['message']}"))
    return rows
